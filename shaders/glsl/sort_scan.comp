#version 460
// One workgroup a digit: turns the counts of tiles (or of single runs) into places behind the digit's first key, and sums them
// up.
#include "sort.glsl"

layout(set = 0, binding = 4, std430) buffer Counts { uint counts[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Totals { uint totals[]; };

shared uint sums[GROUP];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint digit = gl_WorkGroupID.x;
    uint run = (counted() + GROUP - 1u) / GROUP;
    uint begin = min(local * run, counted());
    uint end = min(begin + run, counted());
    uint sum = 0u;
    for (uint at = begin; at < end; at++) sum += counts[count_place(digit, at)];
    sums[local] = sum;
    barrier();
    uint before = 0u;
    for (uint other = 0u; other < local; other++) before += sums[other];
    for (uint at = begin; at < end; at++) {
        uint count = counts[count_place(digit, at)];
        counts[count_place(digit, at)] = before;
        before += count;
    }
    if (local == GROUP - 1u) totals[digit] = before;
}
