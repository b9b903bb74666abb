#version 460
// Instanced expansion (the Quest report's failed replacement of its geometry stage): every corner projects its splat anew.
#include "corner.glsl"
#include "harmonics.glsl"
#include "varyings.glsl"

layout(set = 2, binding = 0, std430) readonly buffer Order { uint order[]; };
layout(push_constant) uniform Push { uint batch; uint view; uint first; uint last; } push;

void main() {
#ifdef MULTIVIEW
    uint view = uint(gl_ViewIndex);
#else
    uint view = push.view;
#endif
    uint corners = corners_per_splat();
    uint slot = push.first + uint(gl_InstanceIndex) * QUADS_PER_INSTANCE + uint(gl_VertexIndex) / corners;
    gl_Position = OUTSIDE;
    plane = vec3(0.0);
    color = vec4(0.0);
#ifdef EXACT
    lean = vec2(0.0);
    quadratic = vec3(0.0);
#endif
    if (slot >= push.last) return;
    uint i = order[COMPOSITE == COMPOSITE_BACK_TO_FRONT ? frame.counts.x - 1u - slot : slot];
    Splat s = read_splat(i);
    if (MOTION) move_splat(s, i, frame.filters.w);
    Ellipse e = project_splat(s, frame.views[view]);
    if (!e.visible) return;
    color = vec4(splat_color(i, s.base, normalize(s.mean - frame.views[view].eye.xyz)), e.opacity);
#ifdef EXACT
    lean = e.lean;
    quadratic = e.quadratic;
#endif
    Corner c = splat_corner(uint(gl_VertexIndex) % corners, squared(e.area), e.m, e.major, e.ratio, e.opacity, e.lean, e.quadratic, frame.views[view]);
    gl_Position = c.position;
    plane = c.plane;
}
