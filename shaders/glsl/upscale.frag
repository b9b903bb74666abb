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

// The same in a checkerboard, where all four neighbours are samples, and the pixel's own cell holds one of them: two columns
// are fetched, not nine samples.
vec4 from_checkerboard(ivec2 p, int cell, int aside, vec4 own, out vec4 low, out vec4 high) {
    ivec2 last = textureSize(rendered, 0).xy - 1;
    int next = cell + aside;
    vec4 other = sample_at(next < 0 || next > last.x ? cell : next, p.y);
    vec4 up = sample_at(cell, p.y > 0 ? p.y - 1 : min(1, last.y));
    vec4 down = sample_at(cell, p.y < last.y ? p.y + 1 : max(last.y - 1, 0));
    low = min(min(own, other), min(up, down));
    high = max(max(own, other), max(up, down));
    float w_row = squared(up - down) + NOISE;
    float w_column = squared(own - other) + NOISE;
    return (w_row * (own + other) + w_column * (up + down)) * (0.5 / (w_row + w_column));
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
    p = clamp(p, ivec2(0), shown_size() - 1);
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
    vec4 own = sample_at(cell, p.y);
    vec4 low, high, c;
    if (CHECKERBOARD) {
        // Two neighbouring pixels never both have a sample: nothing is saved by asking first.
        c = from_checkerboard(p, cell, aside, own, low, high);
        if (aside == 0) c = own;
    } else {
        if (aside == 0) return own;
        c = from_neighbours(p, low, high);
    }
#ifdef TEMPORAL
    if (aside == 0) return own;
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
