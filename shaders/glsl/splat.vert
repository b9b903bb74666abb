#version 460
// Precomputed expansion: a corner from a record.
#include "corner.glsl"
#include "read_records.glsl"
#include "varyings.glsl"

layout(set = 2, binding = 5, std430) readonly buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 6, std430) readonly buffer Visible { uint visible[]; };
layout(push_constant) uniform Push { uint batch; uint view; } push;

uint view_index() {
#ifdef MULTIVIEW
    return uint(gl_ViewIndex);
#else
    return push.view;
#endif
}

// About: at the image's middle, where a unit of the plane is largest against a pixel.
float octagon_area(float opacity, vec2 major, float ratio, ViewData view) {
    float k = polygon_radius(opacity);
    return frame.shown.w * shape_area() * k * k * dot(major, major) * ratio * view.image.x * view.image.y;
}

void main() {
    uint corners = corners_per_splat();
    uint quad = uint(gl_VertexIndex) / corners;
    uint at = plan.starts[push.batch] + uint(gl_InstanceIndex) * QUADS_PER_INSTANCE + quad;
    gl_Position = OUTSIDE;
#ifdef THROUGH_LENS
    middle = vec3(0.0);
    along_p = vec3(0.0);
    along_q = vec3(0.0);
#else
    plane = vec3(0.0);
#endif
    color = vec4(0.0);
#ifdef EXACT
    lean = vec2(0.0);
    quadratic = vec3(0.0);
#endif
#ifdef STOCHASTIC
    splat = 0u;
#endif
    if (at >= plan.starts[push.batch + 1u]) return;
    uint view = view_index();
    Record r = load_record(view, visible[at]);
    vec4 rgba = record_color(r);
    if (!(rgba.a > 0.0)) return;
    color = rgba;
    bool square = SHAPE == SHAPE_ADAPTIVE && (plan.draws[push.batch].first_index != 0u
        || squared(octagon_area(color.a, r.major, r.ratio, frame.views[view])));
#ifdef EXACT
    lean = r.lean;
    quadratic = r.quadratic;
#endif
#ifdef THROUGH_LENS
    Plane p = plane_of(r.m, r.major, r.ratio, r.lean);
    middle = p.ahead;
    along_p = p.along_p;
    along_q = p.along_q;
    gl_Position = lens_corner(uint(gl_VertexIndex) % corners, square, r.m, r.major, r.ratio, color.a, r.lean, r.quadratic,
                               frame.views[view]);
#else
    Corner c = splat_corner(uint(gl_VertexIndex) % corners, square, r.m, r.major, r.ratio, color.a, r.lean, r.quadratic,
                               frame.views[view]);
    gl_Position = c.position;
    plane = c.plane;
#endif
#ifdef STOCHASTIC
    // Nobody has sorted. All of a splat lies at its own distance, and nearer is greater, where floats are dense for what is far.
    splat = visible[at];
    vec3 mean = splat_mean(splat);
    if (MOTION) mean = moved_mean(mean, splat, frame.filters.w);
    vec3 d = mean - frame.sort_center.xyz;
    bool by_depth = (frame.counts.w >> 31) != 0u;
    float distance = by_depth ? max(0.0, dot(d, frame.views[0].rotation[2].xyz)) : length(d);
    gl_Position.z = gl_Position.w / (1.0 + distance);
#endif
}
