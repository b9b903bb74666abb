#version 460
// One workgroup: prefix sums over the blocks' counts and pixels; where each block's splats go and in which bin they are.
#include "drawn.glsl"

const uint THREADS = BINS;
layout(local_size_x = THREADS) in;
layout(set = 2, binding = 2, std430) buffer Blocks { Block blocks[]; };
layout(set = 2, binding = 5, std430) buffer PlanBuffer { Plan plan; };

shared uint counts[THREADS];
shared float areas[THREADS];
shared uint ends[BINS];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint block_count = (frame.counts.x + BLOCK - 1u) / BLOCK;

    // Every thread owns a run of blocks.
    uint run = (block_count + THREADS - 1u) / THREADS;
    uint begin = min(local * run, block_count);
    uint end = min(begin + run, block_count);
    uint count = 0u;
    float area = 0.0;
    for (uint b = begin; b < end; b++) {
        count += uint(bitCount(blocks[b].seen));
        area += blocks[b].area;
    }
    counts[local] = count;
    areas[local] = area;
    ends[local] = 0u;
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
    for (uint b = begin; b < end; b++) {
        uint bin = total > 0.0 ? min(uint(area_before / total * float(BINS)), BINS - 1u) : 0u;
        blocks[b].place = before;
        blocks[b].bin = bin;
        before += uint(bitCount(blocks[b].seen));
        area_before += blocks[b].area;
        atomicMax(ends[bin], before);
    }
    barrier();
    // A bin without a block ends where the one before it does.
    for (uint step = 1u; step < BINS; step <<= 1) {
        uint e = local >= step ? ends[local - step] : 0u;
        barrier();
        ends[local] = max(ends[local], e);
        barrier();
    }
    plan.bin_ends[local] = ends[local];
    if (local == 0u) {
        plan.visible = visible;
        plan.area = total;
    }
}
