#version 460
// One workgroup: prefix sums over the blocks' counts and pixels, batches of equal pixels, indirect draws.
#include "records.glsl"

const uint THREADS = 256;
layout(local_size_x = THREADS) in;
layout(set = 2, binding = 2, std430) buffer Blocks { vec2 blocks[]; };
layout(set = 2, binding = 4, std430) writeonly buffer Offsets { uint offsets[]; };
layout(set = 2, binding = 5, std430) buffer PlanBuffer { Plan plan; };

shared uint counts[THREADS];
shared float areas[THREADS];
shared uint ends[MAX_BATCHES];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint block_count = (frame.counts.x + BLOCK - 1u) / BLOCK;
    uint batches = frame.counts.y;
    uint corners = frame.counts.z;

    // Every thread owns a run of blocks.
    uint run = (block_count + THREADS - 1u) / THREADS;
    uint begin = min(local * run, block_count);
    uint end = min(begin + run, block_count);
    uint count = 0u;
    float area = 0.0;
    for (uint b = begin; b < end; b++) {
        count += uint(blocks[b].x);
        area += blocks[b].y;
    }
    counts[local] = count;
    areas[local] = area;
    if (local < MAX_BATCHES) ends[local] = 0u;
    barrier();
    for (uint step = 1u; step < THREADS; step <<= 1) {
        uint c = local >= step ? counts[local - step] : 0u;
        float a = local >= step ? areas[local - step] : 0.0;
        barrier();
        counts[local] += c;
        areas[local] += a;
        barrier();
    }
    uint visible = counts[THREADS - 1u];
    float total = areas[THREADS - 1u];

    uint before = counts[local] - count;
    float area_before = local > 0u ? areas[local - 1u] : 0.0;
    float share = total / float(batches);
    for (uint b = begin; b < end; b++) {
        offsets[b] = before;
        uint after = before + uint(blocks[b].x);
        float area_after = area_before + blocks[b].y;
        // A batch ends with the first block that brings the running sum to its share.
        for (uint i = 0u; i + 1u < batches; i++) {
            float target = share * float(i + 1u);
            if (area_before < target && area_after >= target) ends[i] = after;
        }
        before = after;
        area_before = area_after;
    }
    barrier();
    if (local == 0u) {
        plan.visible = visible;
        plan.area = total;
        uint start = 0u;
        for (uint i = 0u; i < batches; i++) {
            // Rounding may leave a target unmet: such a batch is empty, the last one takes the rest.
            uint stop = i + 1u == batches ? visible : max(ends[i], start);
            plan.starts[i] = start;
            plan.draws[i] = Draw((corners - 2u) * 3u * QUADS_PER_INSTANCE,
                                 (stop - start + QUADS_PER_INSTANCE - 1u) / QUADS_PER_INSTANCE, 0u, 0, 0u);
            start = stop;
        }
        plan.starts[batches] = visible;
    }
}
