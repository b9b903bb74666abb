#version 460
// How often each digit occurs in each run.
#include "sort.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 4, std430) buffer Counts { uint counts[]; };

void main() {
    uint column = gl_GlobalInvocationID.x;
    uint own = count_place(0u, column);
    for (uint digit = 0u; digit < DIGITS; digit++) counts[own + digit * GROUP] = 0u;
    uint begin = column * RUN;
    uint end = min(begin + RUN, sort.count);
    for (uint at = begin; at < end; at++) counts[own + digit_of(keys[at]) * GROUP] += 1u;
}
