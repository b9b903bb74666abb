#version 460
// Brings keys and values to their places: behind all smaller digits, behind equal digits of earlier tiles, of earlier
// invocations, and of the invocation's own earlier keys.
#include "sort_move.glsl"

shared uint columns[DIGITS / 2u * GROUP];
shared uint places[DIGITS]; // of the tile's first key of each digit
shared uint sums[GROUP];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint tile = gl_WorkGroupID.x;
    for (uint pair = 0u; pair < DIGITS / 2u; pair++) columns[pair * GROUP + local] = 0u;
    uint begin = tile * TILE + local * RUN;
    uint end = min(begin + RUN, sort.count);
    for (uint at = begin; at < end; at++) {
        uint digit = digit_of(keys_in[at]);
        columns[(digit >> 1) * GROUP + local] += 1u << (16u * (digit & 1u));
    }
    // Meanwhile: where each digit begins among all keys. Every invocation has a run of digits.
    const uint SHARE = (DIGITS + GROUP - 1u) / GROUP;
    uint first = min(local * SHARE, DIGITS);
    uint last = min(first + SHARE, DIGITS);
    uint sum = 0u;
    for (uint digit = first; digit < last; digit++) sum += totals[digit];
    sums[local] = sum;
    barrier();
    uint before = 0u;
    for (uint other = 0u; other < local; other++) before += sums[other];
    for (uint digit = first; digit < last; digit++) {
        places[digit] = before + counts[count_place(digit, tile)];
        before += totals[digit];
    }
    // And which keys of the same digit the invocations before have.
    for (uint pair = local; pair < DIGITS / 2u; pair += GROUP) {
        uint running = 0u;
        for (uint column = 0u; column < GROUP; column++) {
            uint count = columns[pair * GROUP + column];
            columns[pair * GROUP + column] = running;
            running += count;
        }
    }
    barrier();
    for (uint at = begin; at < end; at++) {
        uint key = keys_in[at];
        uint digit = digit_of(key);
        uint column = (digit >> 1) * GROUP + local;
        uint upper = 16u * (digit & 1u);
        uint ranks = columns[column];
        columns[column] = ranks + (1u << upper);
        move_key(key, VALUES_APART ? values_in[at] : at, places[digit] + ((ranks >> upper) & 0xffffu));
    }
}
