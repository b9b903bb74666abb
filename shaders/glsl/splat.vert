#version 460
// Precomputed expansion: a corner from a record.
#include "corner.glsl"
#include "records.glsl"
#include "varyings.glsl"

layout(set = 2, binding = 1, std430) readonly buffer Records { uint words[]; } records[2];
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

uint record_word(uint view, uint at) { return view == 0u ? records[0].words[at] : records[1].words[at]; }
float record_float(uint view, uint at) { return uintBitsToFloat(record_word(view, at)); }

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
    uint word = visible[at] * record_words();
    vec2 ba = unpackHalf2x16(record_word(view, word + 6u));
    if (!(ba.y > 0.0)) return;
    vec3 m = unpack_center(vec2(record_float(view, word), record_float(view, word + 1u)));
    vec2 major = vec2(record_float(view, word + 2u), record_float(view, word + 3u));
    float ratio = record_float(view, word + 4u);
    color = vec4(unpackHalf2x16(record_word(view, word + 5u)), ba);
    bool square = SHAPE == SHAPE_ADAPTIVE && (plan.draws[push.batch].first_index != 0u
        || squared(octagon_area(color.a, major, ratio, frame.views[view])));
    vec2 l = vec2(0.0);
    vec3 h = vec3(0.0);
    if (PROJECTION == PROJECTION_TANGENT) l = unpackHalf2x16(record_word(view, word + 7u));
#ifdef EXACT
    l = vec2(record_float(view, word + 7u), record_float(view, word + 8u));
    h = vec3(record_float(view, word + 9u), record_float(view, word + 10u), record_float(view, word + 11u));
    lean = l;
    quadratic = h;
#endif
#ifdef THROUGH_LENS
    Plane p = plane_of(m, major, ratio, l);
    middle = p.ahead;
    along_p = p.along_p;
    along_q = p.along_q;
    gl_Position = lens_corner(uint(gl_VertexIndex) % corners, square, m, major, ratio, color.a, l, h, frame.views[view]);
#else
    Corner c = splat_corner(uint(gl_VertexIndex) % corners, square, m, major, ratio, color.a, l, h, frame.views[view]);
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
