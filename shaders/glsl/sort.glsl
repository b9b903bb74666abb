// What the passes of the device's radix sort share. Twin: renderer/src/order/device.rs.
//
// One pass brings keys into the order of one digit, stably. A workgroup has a tile of consecutive keys, each of its
// invocations a run of consecutive keys of the tile and a column of counters of its own, one per digit: so no
// invocation waits for another to count, no atomic decides an order, and nothing is assumed about subgroups.
//
// Where runs are long against the number of digits (LONG_RUNS), whole columns go to memory, by tile, digit and invocation:
// what was counted need not be counted again to scatter, and nobody sums columns up. Else a tile's counters are halves of
// words, and their sums go to memory, by digit and tile.
#ifndef SORT_GLSL
#define SORT_GLSL

layout(constant_id = 100) const uint GROUP = 32;     // invocations of a workgroup
layout(constant_id = 101) const uint RUN = 64;       // keys of an invocation
layout(constant_id = 102) const uint DIGIT_BITS = 8; // bits of a digit
layout(local_size_x_id = 100) in;

const uint DIGITS = 1u << DIGIT_BITS;
const uint TILE = GROUP * RUN; // below 2^16: counters are halves of a word

// The values of the first pass are the keys' places, and need not be read.
const uint SORT_VALUES_ARE_PLACES = 1u;
// Nobody reads the keys of the last pass.
const uint SORT_KEYS_ARE_DONE = 2u;

layout(push_constant) uniform Sort {
    uint count; // keys
    uint tiles;
    uint shift; // of the digit
    uint flags; // SORT_*
    uint first; // first entry of the list of alive splats
    uint key;   // KEY_*
    float rest[3]; // of the centre: what an f32 leaves of it
} sort;

#ifdef LONG_RUNS
uint count_place(uint digit, uint column) { return ((column / GROUP) * DIGITS + digit) * GROUP + column % GROUP; }
uint counted() { return sort.tiles * GROUP; }
#else
uint count_place(uint digit, uint tile) { return digit * sort.tiles + tile; }
uint counted() { return sort.tiles; }
#endif

uint digit_of(uint key) { return (key >> sort.shift) & (DIGITS - 1u); }

#endif
