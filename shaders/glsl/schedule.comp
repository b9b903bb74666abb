#version 460
// One workgroup: batches of equal area, the indirect draws, and a prediction of what early stop will leave.
//
// A tile of the image is taken to be opaque where the light taken in it so far says so; what lies behind is hidden. (The
// same prediction does not make better borders of batches: tiles close at all depths alike. Measured.)
#include "records.glsl"

const uint THREADS = BINS;
layout(local_size_x = THREADS) in;
layout(set = 2, binding = 5, std430) buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 7, std430) readonly buffer Depths { uint depths[]; }; // bin, view, tile

// Optical depth at which a tile counts as opaque: that of the transmittance at which pixels stop, and a third more, since
// a tile's pixels do not saturate together. (1/255: 7.4.)
float opaque_depth() { return -1.3355 * log(max(frame.filters.z, 1e-6)); }
// Sums over tiles are kept in coarser steps, so that they fit.
const uint COARSE = 6u;

shared uint seen[BINS];
shared uint all[BINS];
shared vec2 running[BINS]; // unhidden share of a bin, 1 where the bin holds anything
shared uint ends[MAX_BATCHES];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint batches = frame.counts.y;
    uint corners = frame.counts.z;
    seen[local] = 0u;
    all[local] = 0u;
    if (local < MAX_BATCHES) ends[local] = 0u;
    barrier();
    float opaque = opaque_depth() * DEPTH_UNIT;
    if (batches > 1u) {
        for (uint tile = local; tile < VIEWS * TILES; tile += THREADS) {
            float through = 0.0;
            for (uint bin = 0u; bin < BINS; bin++) {
                uint depth = min(depths[(bin * 2u) * TILES + tile], 1u << 24);
                if (depth == 0u) continue;
                atomicAdd(all[bin], (depth >> COARSE) + 1u);
                if (through < opaque) atomicAdd(seen[bin], (depth >> COARSE) + 1u);
                through += float(depth);
            }
        }
    }
    barrier();
    // Bins are of equal area. Where a block of splats takes more than one, the further ones are empty, and its own.
    uint filled = local;
    while (filled > 0u && all[filled] == 0u) filled--;
    running[local] = all[filled] > 0u ? vec2(float(seen[filled]) / float(all[filled]), 1.0) : vec2(0.0);
    // A batch ends with the bin that brings the area to its share.
    for (uint i = 0u; i + 1u < batches; i++) {
        if (local == BINS * (i + 1u) / batches - 1u) ends[i] = plan.bin_ends[local];
    }
    barrier();
    for (uint step = BINS / 2u; step > 0u; step >>= 1) {
        if (local < step) running[local] += running[local + step];
        barrier();
    }
    if (local == 0u) {
        plan.unhidden = running[0].y > 0.0 ? plan.area * running[0].x / running[0].y : plan.area;
        uint start = 0u;
        for (uint i = 0u; i < batches; i++) {
            uint stop = i + 1u == batches ? plan.visible : ends[i];
            plan.starts[i] = start;
            plan.draws[i] = Draw((corners - 2u) * 3u * QUADS_PER_INSTANCE,
                                 (stop - start + QUADS_PER_INSTANCE - 1u) / QUADS_PER_INSTANCE, 0u, 0, 0u);
            start = stop;
        }
        plan.starts[batches] = plan.visible;
    }
}
