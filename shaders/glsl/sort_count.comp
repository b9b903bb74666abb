#version 460
// How often each digit occurs in each tile.
#extension GL_EXT_control_flow_attributes : require
#include "sort.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 0, std430) readonly buffer KeyVectors { uvec4 key_vectors[]; }; // the same
layout(set = 0, binding = 4, std430) writeonly buffer Counts { uint counts[]; }; // at count_place

// Two digits a word, a column for each invocation.
shared uint columns[DIGITS / 2u * GROUP];

void count(uint digit, uint column) { columns[(digit >> 1) * GROUP + column] += 1u << (16u * (digit & 1u)); }

void main() {
    uint local = gl_LocalInvocationID.x;
    uint tile = gl_WorkGroupID.x;
    for (uint pair = 0u; pair < DIGITS / 2u; pair++) columns[pair * GROUP + local] = 0u;
    uint begin = tile * TILE + local * RUN;
    uint end = min(begin + RUN, sort.count);
    uint at = begin;
    if (RUN % AT_ONCE == 0u) {
        for (; at + AT_ONCE <= end; at += AT_ONCE) {
            uvec4 vector = key_vectors[at / AT_ONCE];
            [[unroll]] for (uint i = 0u; i < AT_ONCE; i++) count(digit_of(vector[i]), local);
        }
    }
    for (; at < end; at++) count(digit_of(keys[at]), local);
    barrier();
    for (uint pair = local; pair < DIGITS / 2u; pair += GROUP) {
        uint sum = 0u;
        for (uint column = 0u; column < GROUP; column++) sum += columns[pair * GROUP + column];
        counts[count_place(2u * pair, tile)] = sum & 0xffffu;
        counts[count_place(2u * pair + 1u, tile)] = sum >> 16;
    }
}
