// Where the passes of the device's radix sort read keys and values, and where they bring them.
#ifndef SORT_MOVE_GLSL
#define SORT_MOVE_GLSL
#include "sort.glsl"

layout(set = 0, binding = 0, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(set = 0, binding = 1, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(set = 0, binding = 2, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(set = 0, binding = 3, std430) writeonly buffer ValuesOut { uint values_out[]; };
layout(set = 0, binding = 4, std430) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 5, std430) readonly buffer Totals { uint totals[]; };

// Whether values are in a buffer of their own.
const bool VALUES_APART = (FLAGS & (SORT_PACKED | SORT_VALUES_ARE_PLACES)) == 0u;

// `value`: what `values_in` has, where values are apart; else the key's place.
void move_key(uint key, uint value, uint place) {
    if ((FLAGS & SORT_PACKED) != 0u) value = key & ((1u << sort.value_bits) - 1u);
    if ((FLAGS & SORT_LAST) != 0u) {
        values_out[place] = value;
    } else if ((FLAGS & SORT_PACKED) != 0u) {
        keys_out[place] = key;
    } else if ((FLAGS & SORT_PACK) != 0u) {
        keys_out[place] = (key >> (sort.shift + DIGIT_BITS)) << sort.value_bits | value;
    } else {
        keys_out[place] = key;
        values_out[place] = value;
    }
}

#endif
