#version 460
// One invocation per splat: projects it into every view, evaluates its colour, writes its records, and says how many pixels it
// has. In the order in which the scene lies in memory, where all of it is drawn: what is fetched at random places instead, by
// what comes later, is four bytes a splat, and the records of those that are seen.
#include "harmonics.glsl"
#include "drawn.glsl"

layout(local_size_x = WORKGROUP) in;
layout(set = 2, binding = 1, std430) writeonly buffer Records { uint words[]; } records[2];
layout(set = 2, binding = 3, std430) writeonly buffer Footprints { uint footprints[]; }; // one a view; 0: not in it
layout(set = 2, binding = 4, std430) writeonly buffer Areas { float areas[]; }; // pixels of both views; 0: in neither

void write_record(uint view, uint splat, Ellipse e, vec3 color) {
    uint at = splat * record_words();
    uint rg = packHalf2x16(color.rg);
    uint ba = packHalf2x16(vec2(color.b, e.visible ? e.opacity : 0.0));
    vec2 center = pack_center(e.m);
    uint words[12] = uint[12](floatBitsToUint(center.x), floatBitsToUint(center.y), floatBitsToUint(e.major.x),
                              floatBitsToUint(e.major.y), floatBitsToUint(e.ratio), rg, ba, floatBitsToUint(e.lean.x),
                              floatBitsToUint(e.lean.y), floatBitsToUint(e.quadratic.x), floatBitsToUint(e.quadratic.y),
                              floatBitsToUint(e.quadratic.z));
    if (PROJECTION == PROJECTION_TANGENT) words[7] = packHalf2x16(e.lean);
    if (view == 0u) {
        for (uint w = 0u; w < record_words(); w++) records[0].words[at + w] = words[w];
    } else {
        for (uint w = 0u; w < record_words(); w++) records[1].words[at + w] = words[w];
    }
}

uint footprint(Ellipse e, ViewData view) {
    float k = polygon_radius(e.opacity);
    float own = max(e.area, 1e-6) / (shape_area() * max(k * k, 1e-6)); // σ₁σ₂, pixels
    // ∫ -ln(1 - o exp(-d²/2)) = 2π σ₁σ₂ Li₂(o); the polynomial is within 4 % of the dilogarithm.
    float o = min(e.opacity, MAX_ALPHA);
    float light = 6.2831853 * own * o * (1.0 + o * (0.25 + o * 0.395));
    vec2 size = view.image.zw;
    vec2 low = vec2(0.0), high = vec2(1.0);
    if (LENS != LENS_PERSPECTIVE) {
        vec2 center = lens_place_beside(e.m, lens_middle(view.tangents));
        center = (center - view.tangents.xz) / (view.tangents.yw - view.tangents.xz);
        vec2 radius = k * sqrt(own / max(e.ratio, 1e-3)) / size;
        low = clamp(center - radius, 0.0, 0.999);
        high = clamp(center + radius, 0.0, 0.999);
    } else if (e.m.z > 1e-3) {
        vec2 center = (e.m.xy / e.m.z - view.tangents.xz) / (view.tangents.yw - view.tangents.xz);
        vec2 radius = k * sqrt(own / max(e.ratio, 1e-3)) / size;
        low = clamp(center - radius, 0.0, 0.999);
        high = clamp(center + radius, 0.0, 0.999);
    }
    uvec4 tiles = uvec4(low * float(TILE_SIDE), min(high, 0.999) * float(TILE_SIDE));
    float covered = float((tiles.z - tiles.x + 1u) * (tiles.w - tiles.y + 1u));
    return pack_footprint(tiles, light * float(TILES) / (size.x * size.y * covered));
}

void main() {
    uint slot = gl_GlobalInvocationID.x;
    if (slot >= frame.counts.x) return;
    uint i = whole_scene() ? slot : drawn_splat(slot);
    Splat s = read_splat(i);
    if (MOTION) move_splat(s, i, frame.filters.w);
    Ellipse e[2];
    bool visible = false;
    float area = 0.0;
    for (uint view = 0u; view < VIEWS; view++) {
        e[view] = project_splat(s, frame.views[view]);
        visible = visible || e[view].visible;
        area += e[view].visible ? drawn_area(e[view].area) : 0.0;
    }
    areas[i] = visible ? max(area, 1e-12) : 0.0;
    if (!visible) return;
    // Where no batches end early, nobody asks where the light is taken.
    bool stops = frame.counts.y > 1u;
    for (uint view = 0u; view < VIEWS; view++) {
        vec3 color = splat_color(i, s.base, normalize(s.mean - frame.views[view].eye.xyz));
        write_record(view, i, e[view], color);
        if (stops) footprints[i * VIEWS + view] = e[view].visible ? footprint(e[view], frame.views[view]) : 0u;
    }
}
