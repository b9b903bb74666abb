#version 460
// Brings keys and values to their places: behind all smaller digits, behind equal digits of earlier runs, and of the run's own
// earlier keys.
#include "sort.glsl"

layout(set = 0, binding = 0, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(set = 0, binding = 1, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(set = 0, binding = 2, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(set = 0, binding = 3, std430) writeonly buffer ValuesOut { uint values_out[]; };
layout(set = 0, binding = 4, std430) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 5, std430) readonly buffer Totals { uint totals[]; };

shared uint places[DIGITS * GROUP];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint column = gl_GlobalInvocationID.x;
    // The places behind the digit's first key become places among all keys.
    uint before = 0u;
    for (uint digit = 0u; digit < DIGITS; digit++) {
        places[digit * GROUP + local] = before + counts[count_place(digit, column)];
        before += totals[digit];
    }
    bool places_are_values = (sort.flags & SORT_VALUES_ARE_PLACES) != 0u;
    bool write_keys = (sort.flags & SORT_KEYS_ARE_DONE) == 0u;
    uint begin = column * RUN;
    uint end = min(begin + RUN, sort.count);
    for (uint at = begin; at < end; at++) {
        uint key = keys_in[at];
        uint counter = digit_of(key) * GROUP + local;
        uint place = places[counter];
        places[counter] = place + 1u;
        if (write_keys) keys_out[place] = key;
        values_out[place] = places_are_values ? at : values_in[at];
    }
}
