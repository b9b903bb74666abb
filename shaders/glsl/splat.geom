#version 460
// Geometry expansion (the Quest report's viewer): one invocation per splat projects it and emits its polygon.
#include "corner.glsl"
#include "harmonics.glsl"

layout(points) in;
layout(triangle_strip, max_vertices = 8) out;
layout(location = 0) flat in uint slot[];
#include "varyings.glsl"

layout(set = 2, binding = 0, std430) readonly buffer Order { uint order[]; };
layout(push_constant) uniform Push { uint batch; uint view; uint first; uint last; } push;

void main() {
    uint view = push.view;
    uint i = order[COMPOSITE == COMPOSITE_BACK_TO_FRONT ? frame.counts.x - 1u - slot[0] : slot[0]];
    Splat s = read_splat(i);
    if (MOTION) move_splat(s, i, frame.filters.w);
    Ellipse e = project_splat(s, frame.views[view]);
    if (!e.visible) return;
    vec4 c = vec4(splat_color(i, s.base, normalize(s.mean - frame.views[view].eye.xyz)), e.opacity);
    bool square = squared(e.area);
    uint corners = square ? 4u : corners_per_splat();
    for (uint j = 0u; j < corners; j++) {
        // A strip zigzags over the polygon: 0, 1, n-1, 2, n-2, ...
        uint corner = j == 0u ? 0u : (j & 1u) == 1u ? (j + 1u) / 2u : corners - j / 2u;
        Corner p = splat_corner(square ? 2u * corner : corner, square, e.m, e.major, e.ratio, e.opacity, e.lean, e.quadratic, frame.views[view]);
        gl_Position = p.position;
        plane = p.plane;
        color = c;
#ifdef EXACT
        lean = e.lean;
        quadratic = e.quadratic;
#endif
        EmitVertex();
    }
    EndPrimitive();
}
