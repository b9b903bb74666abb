#version 460
// Writes the list of visible splats, in order: stable compaction by prefix sums.
#include "records.glsl"

layout(local_size_x = BLOCK) in;
layout(set = 2, binding = 3, std430) readonly buffer Flags { uint flags[]; };
layout(set = 2, binding = 4, std430) readonly buffer Offsets { uint offsets[]; };
layout(set = 2, binding = 6, std430) writeonly buffer Visible { uint visible[]; };

shared uint ranks[BLOCK];

void main() {
    uint local = gl_LocalInvocationID.x;
    uint slot = gl_GlobalInvocationID.x;
    uint flag = slot < frame.counts.x ? flags[slot] : 0u;
    ranks[local] = flag;
    barrier();
    for (uint step = 1u; step < BLOCK; step <<= 1) {
        uint r = local >= step ? ranks[local - step] : 0u;
        barrier();
        ranks[local] += r;
        barrier();
    }
    if (flag != 0u) visible[offsets[gl_WorkGroupID.x] + ranks[local] - 1u] = slot;
}
