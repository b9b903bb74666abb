#version 460
// Splats by tiles: from the numbers of entries, by tile and by run, to where each begins. One workgroup. A sum that would
// overflow stays at the largest number: there is no room for such a list in any case.
#include "tile_lists.glsl"

const uint THREADS = 128u;
layout(local_size_x = THREADS) in;

shared uint sums[THREADS];

uint sum(uint a, uint b) { return a + b < a ? ~0u : a + b; }

void main() {
    uint local = gl_LocalInvocationID.x;
    uint n = push.views * tiles() * RUNS;
    uint share = (n + THREADS - 1u) / THREADS;
    uint begin = min(local * share, n);
    uint end = min(begin + share, n);
    uint mine = 0u;
    for (uint i = begin; i < end; i++) mine = sum(mine, lists[i]);
    sums[local] = mine;
    barrier();
    for (uint step = 1u; step < THREADS; step <<= 1) {
        uint before = local >= step ? sums[local - step] : 0u;
        barrier();
        sums[local] = sum(sums[local], before);
        barrier();
    }
    uint total = local > 0u ? sums[local - 1u] : 0u;
    for (uint i = begin; i < end; i++) {
        uint count = lists[i];
        lists[i] = total;
        total = sum(total, count);
    }
}
