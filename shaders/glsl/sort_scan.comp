#version 460
// One workgroup a digit (one invocation, where shuffled): turns the counts of tiles into places behind the digit's first key, and sums them up.
#include "sort.glsl"

layout(set = 0, binding = 4, std430) buffer Counts { uint counts[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Totals { uint totals[]; };

shared uint sums[GROUP];

// The counts of some tiles into what was before them.
uint scan(uint digit, uint begin, uint end, uint before) {
    for (uint at = begin; at < end; at++) {
        uint count = counts[count_place(digit, at)];
        counts[count_place(digit, at)] = before;
        before += count;
    }
    return before;
}

void main() {
    if ((FLAGS & SORT_SHUFFLED) != 0u) {
        uint digit = gl_GlobalInvocationID.x;
        totals[digit] = scan(digit, 0u, sort.tiles, 0u);
        return;
    }
    uint local = gl_LocalInvocationID.x;
    uint digit = gl_WorkGroupID.x;
    uint run = (sort.tiles + GROUP - 1u) / GROUP;
    uint begin = min(local * run, sort.tiles);
    uint end = min(begin + run, sort.tiles);
    uint sum = 0u;
    for (uint at = begin; at < end; at++) sum += counts[count_place(digit, at)];
    sums[local] = sum;
    barrier();
    uint before = 0u;
    for (uint other = 0u; other < local; other++) before += sums[other];
    before = scan(digit, begin, end, before);
    if (local == GROUP - 1u) totals[digit] = before;
}
