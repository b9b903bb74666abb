#version 460
// Median depth: the whole image after a batch of splats, and between which distances that batch lies.
#include "scene.glsl"
#include "records.glsl"

layout(set = 2, binding = 0, std430) readonly buffer Order { uint order[]; };
layout(set = 2, binding = 5, std430) readonly buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 6, std430) readonly buffer Visible { uint visible[]; };
layout(push_constant) uniform Push { uint batch; uint view; } push;
layout(location = 0) flat out vec2 closeness; // 1 / what the order goes by, at the batch's beginning and end

float closeness_at(uint entry) {
    uint splat = order[visible[entry]];
    vec3 mean = splat_mean(splat);
    if (MOTION) mean = moved_mean(mean, splat, frame.filters.w);
    vec3 d = mean - frame.sort_center.xyz;
    bool by_depth = (frame.counts.w >> 31) != 0u;
    return 1.0 / max(by_depth ? dot(d, frame.views[0].rotation[2].xyz) : length(d), 1e-6);
}

void main() {
    uint begin = plan.starts[push.batch], end = plan.starts[push.batch + 1u];
    closeness = vec2(0.0);
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);
    // A batch without splats has changed nothing.
    if (begin == end) return;
    closeness = vec2(closeness_at(max(begin, 1u) - 1u), closeness_at(end - 1u));
    vec2 p = vec2((gl_VertexIndex << 1) & 2, gl_VertexIndex & 2);
    gl_Position = vec4(2.0 * p - 1.0, 0.0, 1.0);
}
