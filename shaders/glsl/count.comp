#version 460
// One invocation per block of the order: which of its splats are seen, and how many pixels they have.
#include "drawn.glsl"

layout(local_size_x = WORKGROUP) in;
layout(set = 2, binding = 2, std430) writeonly buffer Blocks { Block blocks[]; };
layout(set = 2, binding = 4, std430) readonly buffer Areas { float areas[]; };

void main() {
    uint block = gl_GlobalInvocationID.x;
    uint first = block * BLOCK;
    uint end = min(first + BLOCK, frame.counts.x);
    if (first >= end) return;
    uint seen = 0u;
    float sum = 0.0;
    for (uint slot = first; slot < end; slot++) {
        float area = areas[drawn_splat(slot)];
        sum += area;
        seen |= uint(area > 0.0) << (slot - first);
    }
    blocks[block].seen = seen;
    blocks[block].area = sum;
}
