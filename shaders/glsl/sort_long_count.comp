#version 460
// How often each digit occurs in each run.
#include "sort.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Counts { uint counts[]; };

shared uint columns[DIGITS * GROUP];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint column = gl_GlobalInvocationID.x;
    for (uint digit = 0u; digit < DIGITS; digit++) columns[digit * GROUP + local] = 0u;
    uint begin = column * RUN;
    uint end = min(begin + RUN, sort.count);
    for (uint at = begin; at < end; at++) columns[digit_of(keys[at]) * GROUP + local] += 1u;
    for (uint digit = 0u; digit < DIGITS; digit++) counts[count_place(digit, column)] = columns[digit * GROUP + local];
}
