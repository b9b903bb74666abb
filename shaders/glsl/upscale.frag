#version 460
// From rendered pixels to shown ones: bilinear, or from samples whose places are known; then the background, as resolve.frag.
// With MEAN: random samples of the same size, averaged over frames.
#include "interleaved.glsl"
#include "output.glsl"
layout(set = 3, binding = 1) uniform sampler2DArray rendered;
layout(location = 0) out vec4 shown;
#ifdef TEMPORAL
layout(set = 3, binding = 2) uniform sampler2DArray history;
layout(location = 1) out vec4 kept;
#endif
// Without it no pixel pays for its neighbours: some devices walk through both sides of a condition.
layout(constant_id = 18) const bool SHARPEN = false;
layout(push_constant) uniform Push { vec4 background; uint decode; float sharpen; uint view; } push;

#ifdef MULTIVIEW
#define LAYER int(gl_ViewIndex)
#define VIEW uint(gl_ViewIndex)
#else
#define LAYER 0
#define VIEW push.view
#endif

ivec2 shown_size() { return ivec2(frame.shown.xy); }

#ifdef INTERLEAVED
// Squared colour difference below which two directions count the same: two steps of an 8-bit image.
const float NOISE = 6e-5;

vec4 sample_at(int cell, int row) { return texelFetch(rendered, ivec3(cell, row, LAYER), 0); }

int mirrored(int row, int last) { return clamp(row < 0 ? -row : row > last ? 2 * last - row : row, 0, last); }

// The samples of a row at or on both sides of a column, and their distances to it.
struct Pair {
    vec4 left, right;
    float to_left, to_right;
};

Pair around(int x, int row) {
    ivec2 last = textureSize(rendered, 0).xy - 1;
    row = mirrored(row, last.y);
    int cell = int(cell_of(uint(x)));
    int at = int(sample_column(uint(cell), uint(row)));
    int l = at <= x ? cell : cell - 1;
    int r = at >= x ? cell : cell + 1;
    // Beyond the image there is no sample: the other side stands for it.
    l = l < 0 ? r : l;
    r = r > last.x ? l : r;
    Pair p;
    p.left = sample_at(l, row);
    p.right = sample_at(r, row);
    p.to_left = abs(float(x - int(sample_column(uint(l), uint(row)))));
    p.to_right = abs(float(int(sample_column(uint(r), uint(row))) - x));
    return p;
}

vec4 between(Pair p) {
    float d = p.to_left + p.to_right;
    return d > 0.0 ? mix(p.left, p.right, p.to_left / d) : p.left;
}

float squared(vec4 d) { return dot(d, d); }

// A pixel from four samples as near as each other, and their range: each direction trusted the more the less it changes.
vec4 weighted(vec4 left, vec4 right, vec4 up, vec4 down, out vec4 low, out vec4 high) {
    low = min(min(left, right), min(up, down));
    high = max(max(left, right), max(up, down));
    float w_row = squared(up - down) + NOISE;
    float w_column = squared(left - right) + NOISE;
    return (w_row * (left + right) + w_column * (up + down)) * (0.5 / (w_row + w_column));
}

// A checkerboard's pixel without a sample: all four neighbours have one, and its own cell holds one of them.
vec4 from_checkerboard(ivec2 p, int cell, int aside, vec4 own, out vec4 low, out vec4 high) {
    ivec2 last = textureSize(rendered, 0).xy - 1;
    int next = cell + aside;
    vec4 other = sample_at(next < 0 || next > last.x ? cell : next, p.y);
    vec4 up = sample_at(cell, mirrored(p.y - 1, last.y)), down = sample_at(cell, mirrored(p.y + 1, last.y));
    return weighted(own, other, up, down, low, high);
}

// What the other pixel of a row or a column of the quad has: fine differences are those of the quad's own two pixels.
vec4 in_row(vec4 v, ivec2 p) { return (p.x & 1) == 0 ? v + dFdxFine(v) : v - dFdxFine(v); }
vec4 in_column(vec4 v, ivec2 p) { return (p.y & 1) == 0 ? v + dFdyFine(v) : v - dFdyFine(v); }

// The same for a whole quad, which is two cells, one above the other, with two pixels that have samples and two that have none.
// Each pixel fetches two: its sample, or where it has none the one beside its cell; and the one beyond the quad. The other two
// are what the quad's other pixels have fetched.
vec4 from_quad(ivec2 p, int cell, int aside, out vec4 low, out vec4 high) {
    ivec2 last = textureSize(rendered, 0).xy - 1;
    int next = cell + aside;
    vec4 beside = sample_at(next < 0 || next > last.x ? cell : next, mirrored(p.y, last.y));
    vec4 beyond = sample_at(cell, mirrored((p.y & 1) == 0 ? p.y - 1 : p.y + 1, last.y));
    vec4 c = weighted(in_row(beside, p), beside, in_column(beside, p), beyond, low, high);
    return aside == 0 ? beside : c;
}

// Along the row and along the column, each trusted the more the less it changes in its own direction.
vec4 from_neighbours(ivec2 p, out vec4 low, out vec4 high) {
    Pair row = around(p.x, p.y);
    vec4 up = between(around(p.x, p.y - 1));
    vec4 down = between(around(p.x, p.y + 1));
    vec4 across = between(row);
    low = min(min(row.left, row.right), min(up, down));
    high = max(max(row.left, row.right), max(up, down));
    float reach = 0.5 * (row.to_left + row.to_right);
    float w_row = 1.0 / ((squared(row.left - row.right) + NOISE) * reach);
    float w_column = 1.0 / (squared(up - down) + NOISE);
    return (w_row * across + w_column * 0.5 * (up + down)) / (w_row + w_column);
}
#endif

#ifdef TEMPORAL
// What the frame before showed in this direction; false where it did not look there.
bool shown_before(ivec2 p, out vec2 uv) {
    vec3 uv1 = vec3((vec2(p) + 0.5) / vec2(shown_size()), 1.0);
    uint at = 3u * VIEW;
    vec3 before = vec3(dot(frame.reprojection[at].xyz, uv1), dot(frame.reprojection[at + 1u].xyz, uv1),
                       dot(frame.reprojection[at + 2u].xyz, uv1));
    uv = before.xy / before.z;
    return before.z > 0.0 && all(greaterThan(uv, vec2(0.0))) && all(lessThan(uv, vec2(1.0)));
}
#endif

vec4 reconstruct(ivec2 p) {
    // (But for a quad's pixels beyond the image, which fetch for the others.)
    if (!CHECKERBOARD || SHARPEN) p = clamp(p, ivec2(0), shown_size() - 1);
#ifdef MEAN
    vec4 c = texelFetch(rendered, ivec3(p, LAYER), 0);
    float share = uintBitsToFloat(frame.sampling.w);
    vec2 uv;
    if (frame.sampling.z == HISTORY_STILL) return mix(c, texelFetch(history, ivec3(p, VIEW), 0), share);
    if (frame.sampling.z != HISTORY_MOVING || !shown_before(p, uv)) return c;
    // Never beyond what this frame's samples show nearby: what has moved away leaves no ghost.
    vec4 low = c, high = c;
    for (int y = -2; y <= 2; y++)
        for (int x = -2; x <= 2; x++) {
            vec4 near = texelFetch(rendered, ivec3(clamp(p + ivec2(x, y), ivec2(0), shown_size() - 1), LAYER), 0);
            low = min(low, near);
            high = max(high, near);
        }
    return mix(c, clamp(texture(history, vec3(uv, VIEW)), low, high), share);
#endif
#ifdef INTERLEAVED
    int cell = int(cell_of(uint(p.x)));
    int aside = p.x - int(sample_column(uint(cell), uint(p.y)));
    vec4 low, high, c;
    if (CHECKERBOARD && !SHARPEN) {
        c = from_quad(p, cell, aside, low, high);
    } else {
        c = sample_at(cell, p.y);
        if (aside == 0) return c;
        c = CHECKERBOARD ? from_checkerboard(p, cell, aside, c, low, high) : from_neighbours(p, low, high);
    }
#ifdef TEMPORAL
    if (aside == 0) return c;
    if (frame.sampling.z == HISTORY_STILL) return texelFetch(history, ivec3(p, VIEW), 0);
    if (frame.sampling.z == HISTORY_MOVING) {
        vec2 uv;
        if (shown_before(p, uv)) {
            // Never beyond what this frame shows next to it: what has moved away leaves no ghost.
            vec4 h = clamp(texture(history, vec3(uv, VIEW)), low, high);
            c = mix(c, h, uintBitsToFloat(frame.sampling.w));
        }
    }
#endif
    return c;
#else
    return texture(rendered, vec3((vec2(p) + 0.5) / vec2(shown_size()), LAYER));
#endif
}

void main() {
    ivec2 p = ivec2(gl_FragCoord.xy);
    vec4 c = reconstruct(p);
#ifdef TEMPORAL
    kept = c;
#endif
    if (SHARPEN) {
        // Unsharp mask over the four neighbours, held within their range: no halo.
        vec4 l = reconstruct(p - ivec2(1, 0)), r = reconstruct(p + ivec2(1, 0));
        vec4 u = reconstruct(p - ivec2(0, 1)), d = reconstruct(p + ivec2(0, 1));
        vec4 low = min(c, min(min(l, r), min(u, d))), high = max(c, max(max(l, r), max(u, d)));
        c = clamp(c + push.sharpen * (c - 0.25 * (l + r + u + d)), low, high);
    }
    shown = output_color(c, push.background, push.decode != 0u);
}
