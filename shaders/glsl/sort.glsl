// What the passes of the device's radix sort share. Twin: renderer/src/order/device.rs.
//
// One pass brings keys into the order of one digit, stably. A workgroup has a tile of consecutive keys, each of its
// invocations a run of consecutive keys of the tile and a column of counters of its own, one per digit: so no
// invocation waits for another to count, no atomic decides an order, and nothing is assumed about subgroups (but where
// they are asked for, sort_shuffled_scatter.comp). Counters are halves of words; their sums go to memory, by digit and tile.
//
// As soon as what is left of a key and a value fit into one word, they travel in one: value below, key above.
#ifndef SORT_GLSL
#define SORT_GLSL

layout(constant_id = 100) const uint GROUP = 32;     // invocations of a workgroup
layout(constant_id = 101) const uint RUN = 64;       // keys of an invocation
layout(constant_id = 102) const uint DIGIT_BITS = 8; // bits of a digit
// SORT_*: what is to be done with keys and values. A constant, because a processor's vector goes both ways of a branch.
layout(constant_id = 103) const uint FLAGS = 0u;
layout(local_size_x_id = 100) in;

const uint DIGITS = 1u << DIGIT_BITS;
const uint TILE = GROUP * RUN; // below 2^16: counters are halves of a word

// The values of the first pass are the keys' places, and need not be read.
const uint SORT_VALUES_ARE_PLACES = 1u;
// Nobody reads the keys of the last pass.
const uint SORT_LAST = 2u;
// From this pass on, keys and values are one word.
const uint SORT_PACK = 4u;
const uint SORT_PACKED = 8u;
// Workgroups are a processor's vectors, which like to find neighbouring digits side by side.
const uint SORT_SHUFFLED = 16u;

// Keys that an invocation reads at once, as one vector: on a processor that is half the work of reading them one by one.
const uint AT_ONCE = 4u;

layout(push_constant) uniform Sort {
    uint count; // keys
    uint tiles;
    uint shift; // of the digit
    uint value_bits; // that a packed word's value takes
    uint first; // first entry of the list of alive splats
    uint key;   // KEY_*
    float rest[3]; // of the centre: what an f32 leaves of it
} sort;

uint count_place(uint digit, uint tile) {
    return (FLAGS & SORT_SHUFFLED) != 0u ? tile * DIGITS + digit : digit * sort.tiles + tile;
}

uint digit_of(uint key) { return (key >> sort.shift) & (DIGITS - 1u); }

#endif
