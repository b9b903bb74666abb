#version 460
// The same for processors: a workgroup is one vector, which takes its tile's keys eight at a time and finds out by itself who of
// them goes first. So it writes to one place a digit, not to one a digit and invocation, and those stay in the processor's
// nearest cache.
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require
#include "sort_move.glsl"

// The same buffers as in sort_move.glsl.
layout(set = 0, binding = 0, std430) readonly buffer KeyVectors { uvec4 key_vectors[]; };
layout(set = 0, binding = 1, std430) readonly buffer ValueVectors { uvec4 value_vectors[]; };

const uint LANES = 8u; // = GROUP
const uint NONE = 0xffffffffu; // the digit of a lane without a key

// How many lanes before this one have the same digit, and whether any behind it has: not 0.
uvec2 same_digits(uint digit, uint lane) {
    uint same = 0u;
    [[unroll]] for (uint i = 0u; i < LANES; i++) same |= subgroupShuffle(digit, i) == digit ? 1u << i : 0u;
    return uvec2(bitCount(same & ((1u << lane) - 1u)), same >> lane >> 1);
}

// The lanes' words from `word` on, of words that each lane has read four of.
uint neighbours(uvec4 words, uint word, uint lane) {
    uint of = (word + lane) / 4u;
    uvec4 all;
    [[unroll]] for (uint i = 0u; i < AT_ONCE; i++) all[i] = subgroupShuffle(words[i], of);
    uvec2 pair = (lane & 2u) != 0u ? all.zw : all.xy;
    return (lane & 1u) != 0u ? pair.y : pair.x;
}

shared uint places[DIGITS];

// A processor's lanes go in step: all have read before one writes.
void take(uint key, uint value, uint digit, uvec2 same) {
    uint place = places[digit] + same.x;
    if (same.y == 0u) places[digit] = place + 1u;
    move_key(key, value, place);
    subgroupMemoryBarrierShared();
}

void main() {
    uint lane = gl_SubgroupInvocationID;
    uint tile = gl_WorkGroupID.x;
    // The places behind the digit's first key become places among all keys.
    uint before = 0u;
    for (uint first = 0u; first < DIGITS; first += LANES) {
        uint total = totals[first + lane];
        uint count = counts[count_place(first + lane, tile)];
        uint mine = before;
        [[unroll]] for (uint i = 0u; i < LANES; i++) {
            uint other = subgroupShuffle(total, i);
            mine += i < lane ? other : 0u;
            before += other;
        }
        places[first + lane] = mine + count;
    }
    subgroupMemoryBarrierShared();
    uint begin = tile * TILE;
    uint end = min(begin + TILE, sort.count);
    uint first = begin;
    for (; first + AT_ONCE * LANES <= end; first += AT_ONCE * LANES) {
        uint keys[AT_ONCE], values[AT_ONCE], digits[AT_ONCE];
        uvec2 same[AT_ONCE];
        uvec4 key_words = key_vectors[first / AT_ONCE + lane];
        uvec4 value_words = VALUES_APART ? value_vectors[first / AT_ONCE + lane] : uvec4(0u);
        [[unroll]] for (uint i = 0u; i < AT_ONCE; i++) {
            keys[i] = neighbours(key_words, i * LANES, lane);
            values[i] = VALUES_APART ? neighbours(value_words, i * LANES, lane) : first + i * LANES + lane;
            digits[i] = digit_of(keys[i]);
            same[i] = same_digits(digits[i], lane);
        }
        [[unroll]] for (uint i = 0u; i < AT_ONCE; i++) take(keys[i], values[i], digits[i], same[i]);
    }
    for (; first < end; first += LANES) {
        uint at = first + lane;
        uint key = at < end ? keys_in[at] : 0u;
        uint digit = at < end ? digit_of(key) : NONE;
        uvec2 same = same_digits(digit, lane);
        if (at < end) take(key, VALUES_APART ? values_in[at] : at, digit, same);
    }
}
