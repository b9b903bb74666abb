#version 460
// Splats by tiles: what each visible splat looks like to the pixels, and how many of a run's splats reach each tile; with LIST
// the splats themselves, tile by tile.
#include "tile_lists.glsl"

layout(local_size_x = LANES) in;

// Lowest and highest slope x / z of the ellipse m + cos t · a + sin t · b: from the planes through the eye that touch it.
// Written with minors, so that nothing cancels for small ellipses. Low beyond high where it reaches round the eye.
vec2 slopes(vec2 m, vec2 a, vec2 b) {
    float w = m.y * m.y - a.y * a.y - b.y * b.y;
    if (!(w > 1e-6 * m.y * m.y && m.y > 0.0)) return vec2(1.0, -1.0);
    float ma = m.x * a.y - m.y * a.x, mb = m.x * b.y - m.y * b.x, ab = a.x * b.y - a.y * b.x;
    float root = sqrt(max(0.0, ma * ma + mb * mb - ab * ab));
    float middle = m.x * m.y - a.x * a.y - b.x * b.y;
    return vec2(middle - root, middle + root) / w;
}

TileSplat tile_splat(uint view, uint rank) {
    Record r = load_record(view, visible[rank]);
    float opacity = record_color(r).a;
    TileSplat s;
    s.rg = r.rg;
    s.ba = r.ba;
    s.box = ivec4(1, 1, 0, 0);
    s.p = s.q = s.ahead = vec3(0.0);
    s.power = s.least = 0.0;
    // The plane that leans is done with: only the exact projection's pixels ask again.
    s.lean = PROJECTION == PROJECTION_EXACT ? r.lean / UNIT : vec2(0.0);
    s.quadratic = r.quadratic / (UNIT * UNIT);
    if (!(opacity > 0.0)) return s;
    Plane plane = plane_of(r.m, r.major, r.ratio, r.lean);
    float k = polygon_radius(opacity);
    Reach reach = reach_of(k, r.lean, r.quadratic);
    s.power = log2(opacity);
    s.least = max(MIN_ALPHA, exp2(s.power - pow(UNIT * k, 2.0)));

    vec4 shown = frame.views[view].tangents;
    vec4 box = shown;
    if (reach.bounded) {
        vec3 l = factor_of(reach);
        vec3 center = plane_point(plane, reach.center);
        vec3 a = l.x * plane.axis_p + l.y * plane.axis_q;
        vec3 b = l.z * plane.axis_q;
        vec2 x = slopes(center.xz, a.xz, b.xz), y = slopes(center.yz, a.yz, b.yz);
        // Samples of reduced resolution lie beside their pixels.
        float beside = SAMPLING == SAMPLING_CENTERS ? 0.0 : frame.shown.z;
        if (x.x <= x.y) box.xy = x + vec2(-beside, beside);
        if (y.x <= y.y) box.zw = y;
    }
    // From slopes to the pixels whose centres lie between them, and a quarter of one for rounding.
    vec2 pixels = vec2(push.width, push.height);
    vec2 step = (shown.yw - shown.xz) / pixels;
    vec2 low = clamp(ceil((box.xz - shown.xz) / step - 0.75), vec2(0.0), pixels);
    vec2 high = clamp(floor((box.yw - shown.xz) / step - 0.25), vec2(-1.0), pixels - 1.0);
    if (!(all(lessThanEqual(low, high)))) return s;
    s.box = ivec4(low, high);
    vec3 first = vec3(shown.xz + (low + 0.5) * step, 1.0);
    s.p = UNIT * vec3(dot(plane.along_p, first), plane.along_p.xy * step);
    s.q = UNIT * vec3(dot(plane.along_q, first), plane.along_q.xy * step);
    if (PROJECTION != PROJECTION_EXACT) {
        vec2 down = vec2(s.p.z, s.q.z);
        float length = sqrt(dot(down, down));
        vec2 turn = length > 0.0 ? down / length : vec2(1.0, 0.0);
        vec3 turned = turn.x * s.p + turn.y * s.q;
        s.q = vec3((turn.x * s.q - turn.y * s.p).xy, 0.0);
        s.p = turned;
    }
    s.ahead = vec3(dot(plane.ahead, first), plane.ahead.xy * step);
    return s;
}

// a × b of the functions' steps in one direction and their values: nothing cancels for what is long and thin.
float wedge(vec2 step, vec2 at) { return step.x * at.y - step.y * at.x; }

// What a splat covers of a row of tiles: the ellipse p² + q² = ahead² in pixels from the box's first one.
struct Outline {
    vec3 p;
    vec3 q;
    vec3 ahead;
    float square;   // p² + q² - ahead² of a step to the right
    vec2 extremes;  // rows of its leftmost and its rightmost point
    bool known;
};

// x of the leftmost and the rightmost point at a height; both in the middle above and below the ellipse.
vec2 outline_at(Outline o, vec2 y) {
    vec2 p = o.p.x + o.p.z * y, q = o.q.x + o.q.z * y, ahead = o.ahead.x + o.ahead.z * y;
    vec2 pq = o.p.y * q - o.q.y * p, pa = o.p.y * ahead - o.ahead.y * p, qa = o.q.y * ahead - o.ahead.y * q;
    vec2 root = sqrt(max(pa * pa + qa * qa - pq * pq, 0.0));
    vec2 middle = o.ahead.y * ahead - o.p.y * p - o.q.y * q;
    return (middle + vec2(-1.0, 1.0) * root) / o.square;
}

Outline outline_of(TileSplat s) {
    Outline o;
    float k = polygon_radius(unpackHalf2x16(s.ba).y);
    Reach reach = reach_of(UNIT * k, s.lean, s.quadratic);
    // In axes in which the reach is the unit circle.
    vec3 l = factor_of(reach);
    o.ahead = s.ahead;
    o.p = (s.p - reach.center.x * s.ahead) / l.x;
    o.q = (s.q - reach.center.y * s.ahead - l.y * o.p) / l.z;
    o.square = o.p.y * o.p.y + o.q.y * o.q.y - o.ahead.y * o.ahead.y;
    // Where two points of a column fall together: the discriminant over x, whose leading term is the determinant.
    vec2 pq = vec2(o.p.z * o.q.x - o.q.z * o.p.x, o.p.z * o.q.y - o.q.z * o.p.y);
    vec2 pa = vec2(o.p.z * o.ahead.x - o.ahead.z * o.p.x, o.p.z * o.ahead.y - o.ahead.z * o.p.y);
    vec2 qa = vec2(o.q.z * o.ahead.x - o.ahead.z * o.q.x, o.q.z * o.ahead.y - o.ahead.z * o.q.y);
    float c = pq.x * pq.x - pa.x * pa.x - qa.x * qa.x;
    float b = pq.x * pq.y - pa.x * pa.y - qa.x * qa.y;
    float a = pq.y * pq.y - pa.y * pa.y - qa.y * qa.y;
    float root = sqrt(max(b * b - a * c, 0.0));
    vec2 x = (-b + vec2(-1.0, 1.0) * root) / a;
    vec2 p = o.p.x + o.p.y * x, q = o.q.x + o.q.y * x, ahead = o.ahead.x + o.ahead.y * x;
    float down = o.p.z * o.p.z + o.q.z * o.q.z - o.ahead.z * o.ahead.z;
    o.extremes = (o.ahead.z * ahead - o.p.z * p - o.q.z * q) / down;
    // Beyond an ellipse in front of the eye, and beyond what a float can tell, the box alone counts.
    o.known = reach.bounded && o.square > 0.0 && down > 0.0 && a > 0.0 && all(lessThan(abs(o.extremes), vec2(1e6)));
    return o;
}

// First and last column of tiles, of a row of them.
ivec2 tile_columns(TileSplat s, Outline o, int row) {
    ivec2 columns = s.box.xz;
    if (o.known) {
        float top = float(row * SIDE - s.box.y);
        vec2 x = outline_at(o, clamp(o.extremes, vec2(top - 0.25), vec2(top + float(SIDE) - 0.75)));
        // Half a pixel for rounding, and what samples lie beside their pixels at most.
        float beside = SAMPLING == SAMPLING_CENTERS ? 0.5 : SAMPLING == SAMPLING_CHECKERBOARD ? 0.75 : 1.0;
        vec2 most = vec2(s.box.z - s.box.x);
        if (all(equal(x, x))) columns = s.box.x + ivec2(clamp(x + vec2(-beside, beside), vec2(0.0), most));
    }
    return columns / SIDE;
}

void main() {
    uint run = gl_GlobalInvocationID.x;
    uint layer = gl_WorkGroupID.y;
    uint end = first_rank(run + 1u);
#ifdef LIST
    uint capacity = capacity();
#endif
    for (uint rank = first_rank(run); rank < end; rank++) {
#ifdef LIST
        TileSplat s = load_tile_splat(layer, rank);
#else
        TileSplat s = tile_splat(push.first_view + layer, rank);
        store_tile_splat(layer, rank, s);
#endif
        if (s.box.y > s.box.w) continue;
        Outline o = outline_of(s);
        for (int row = s.box.y / SIDE; row <= s.box.w / SIDE; row++) {
            ivec2 columns = tile_columns(s, o, row);
            uint at = end_at(layer, uint(row) * push.columns + uint(columns.x), run);
            for (int column = columns.x; column <= columns.y; column++, at += RUNS) {
#ifdef LIST
                uint place = lists[at];
                lists[at] = place + 1u;
                if (place < capacity) lists[entry_at(place)] = rank;
#else
                lists[at]++;
#endif
            }
        }
    }
}
