#version 460
// One workgroup a digit: turns the tiles' counts into places behind the digit's first key, and sums them up.
#include "sort.glsl"

layout(set = 0, binding = 4, std430) buffer Counts { uint counts[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Totals { uint totals[]; };

shared uint sums[GROUP];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint row = gl_WorkGroupID.x * sort.tiles;
    uint run = (sort.tiles + GROUP - 1u) / GROUP;
    uint begin = min(local * run, sort.tiles);
    uint end = min(begin + run, sort.tiles);
    uint sum = 0u;
    for (uint tile = begin; tile < end; tile++) sum += counts[row + tile];
    sums[local] = sum;
    barrier();
    uint before = 0u;
    for (uint other = 0u; other < local; other++) before += sums[other];
    for (uint tile = begin; tile < end; tile++) {
        uint count = counts[row + tile];
        counts[row + tile] = before;
        before += count;
    }
    if (local == GROUP - 1u) totals[gl_WorkGroupID.x] = before;
}
