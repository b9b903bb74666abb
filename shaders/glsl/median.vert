#version 460
// Median depth: the whole image after some batches of splats.
#include "records.glsl"

layout(set = 2, binding = 5, std430) readonly buffer PlanBuffer { Plan plan; };
layout(push_constant) uniform Push { uint batch; uint view; uint first; } push;

void main() {
    vec2 p = vec2((gl_VertexIndex << 1) & 2, gl_VertexIndex & 2);
    // Batches without splats have changed nothing. The first look is taken in any case: it writes what the next ones read.
    bool empty = push.first > 0u && plan.starts[push.first] == plan.starts[push.batch + 1u];
    gl_Position = empty ? vec4(2.0, 2.0, 0.0, 1.0) : vec4(2.0 * p - 1.0, 0.0, 1.0);
}
