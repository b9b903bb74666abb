#version 460
// One workgroup: batches of equal area, the indirect draws, which tiles are marked after which batch, and a prediction of
// what early stop will leave.
//
// A tile of the image is taken to be opaque where the light taken in it so far says so; what lies behind is hidden. (The
// same prediction does not make better borders of batches: tiles close at all depths alike. Measured. It does say where
// marks are worth their while: a mark is exact, so a wrong prediction costs time and never an error. Nor is it worth it to
// end the pass in between and take whole splats off the list: of those in view, 0.1 to 8 % lie wholly behind opaque tiles
// of 8 x 8 pixels, as most reach some pixel that is still open. Measured on five views.)
#include "records.glsl"

const uint THREADS = BINS;
layout(local_size_x = THREADS) in;
layout(set = 2, binding = 5, std430) buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 7, std430) readonly buffer Depths { uint depths[]; }; // bin, view, tile
layout(set = 2, binding = 8, std430) writeonly buffer Due { uint due[]; };

// Optical depth at which a tile counts as opaque: that of the transmittance at which pixels stop, and a third more, since
// a tile's pixels do not saturate together. (1/255: 7.4.)
float opaque_depth() { return -1.3355 * log(max(frame.filters.z, 1e-6)); }
// A tile is marked first where hardly any of its pixels may be opaque yet, then after every further step, whose length
// grows with the depth; and no more when less than a step is left. In units of the opaque depth.
const float FIRST_MARK = 0.14;
const float MARK_STEP = 0.055;
const float MARK_GROWTH = 0.07;
// Sums over tiles are kept in coarser steps, so that they fit.
const uint COARSE = 6u;

shared uint seen[BINS];
shared uint all[BINS];
shared vec2 running[BINS]; // unhidden share of a bin, 1 where the bin holds anything
shared uint ends[MAX_BATCHES];
shared uint marks[MAX_BATCHES];
shared int border[BINS]; // the batch that ends with a bin, or -1

void main() {
    uint local = gl_LocalInvocationID.x;
    uint batches = frame.counts.y;
    uint corners = frame.counts.z;
    seen[local] = 0u;
    all[local] = 0u;
    if (local < MAX_BATCHES) ends[local] = marks[local] = 0u;
    border[local] = -1;
    barrier();
    // A batch ends with the bin that brings the area to its share.
    if (local + 1u < batches) {
        uint last = BINS * (local + 1u) / batches - 1u;
        border[last] = int(local);
        ends[local] = plan.bin_ends[last];
    }
    barrier();
    float opaque = opaque_depth() * DEPTH_UNIT;
    if (batches > 1u) {
        for (uint tile = local; tile < VIEWS * TILES; tile += THREADS) {
            float total = 0.0;
            for (uint bin = 0u; bin < BINS; bin++) total += float(min(depths[(bin * 2u) * TILES + tile], 1u << 24));
            float through = 0.0;
            float next = FIRST_MARK * opaque;
            for (uint bin = 0u; bin < BINS; bin++) {
                uint depth = min(depths[(bin * 2u) * TILES + tile], 1u << 24);
                if (depth > 0u) {
                    atomicAdd(all[bin], (depth >> COARSE) + 1u);
                    if (through < opaque) atomicAdd(seen[bin], (depth >> COARSE) + 1u);
                    through += float(depth);
                }
                float stride = MARK_STEP * opaque + MARK_GROWTH * through;
                if (border[bin] >= 0 && through >= next && total - through > stride) {
                    next = through + stride;
                    uint batch = uint(border[bin]);
                    due[batch * DUE_ROOM + atomicAdd(marks[batch], 1u)] = tile;
                }
            }
        }
    }
    barrier();
    // Bins are of equal area. Where a block of splats takes more than one, the further ones are empty, and its own.
    uint filled = local;
    while (filled > 0u && all[filled] == 0u) filled--;
    running[local] = all[filled] > 0u ? vec2(float(seen[filled]) / float(all[filled]), 1.0) : vec2(0.0);
    barrier();
    for (uint step = BINS / 2u; step > 0u; step >>= 1) {
        if (local < step) running[local] += running[local + step];
        barrier();
    }
    if (local == 0u) {
        plan.unhidden = running[0].y > 0.0 ? plan.area * running[0].x / running[0].y : plan.area;
        uint start = 0u;
        uint marked = 0u;
        for (uint i = 0u; i < batches; i++) {
            uint stop = i + 1u == batches ? plan.visible : ends[i];
            plan.starts[i] = start;
            // Adaptive: a batch of splats that are small on average draws four corners of each, from the indices' second part.
            uint octagon = (corners - 2u) * 3u * QUADS_PER_INSTANCE;
            bool square = squared(plan.area / float(batches * VIEWS) / float(max(stop - start, 1u)));
            plan.draws[i] = Draw(square ? 6u * QUADS_PER_INSTANCE : octagon,
                                 (stop - start + QUADS_PER_INSTANCE - 1u) / QUADS_PER_INSTANCE, square ? octagon : 0u, 0, 0u);
            plan.marks[i] = MarkDraw(6u, marks[i], 0u, 0u);
            marked += marks[i];
            start = stop;
        }
        plan.starts[batches] = plan.visible;
        plan.marked = marked;
        plan.blended = 0u;
    }
}
