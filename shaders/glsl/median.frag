#version 460
// Median depth: whether the batches since the last look have taken more than half of a pixel's light for the first time, and
// where. What is known of the pixel is the light before and after; how light falls in between is taken from the pixel's tile,
// whose bins say what each step of the order takes there.
#include "scene.glsl"
#include "records.glsl"
layout(set = 2, binding = 5, std430) readonly buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 6, std430) readonly buffer Visible { uint visible[]; };
layout(set = 2, binding = 7, std430) readonly buffer Depths { uint depths[]; }; // bin, view, tile
layout(input_attachment_index = 0, set = 3, binding = 0) uniform subpassInput accumulated;
layout(input_attachment_index = 1, set = 3, binding = 1) uniform subpassInput before;
layout(push_constant) uniform Push { uint batch; uint view; uint first; uint width; uint height; } push; // of what is rendered
// Near over the median depth, 0 as long as it is not known; what was covered at this look.
layout(location = 1) out vec2 median;

// The least that half floats hold without a loss of digits.
const float LEAST = 6.2e-5;

bool by_depth() { return (frame.counts.w >> 31) != 0u; }

// 1 / what the order goes by, of the splat before an entry in the list of visible ones.
float closeness_before(uint entry) {
    uint splat = visible[max(entry, 1u) - 1u];
    vec3 mean = splat_mean(splat);
    if (MOTION) mean = moved_mean(mean, splat, frame.filters.w);
    vec3 d = mean - frame.sort_center.xyz;
    return 1.0 / max(by_depth() ? dot(d, frame.views[0].rotation[2].xyz) : length(d), 1e-6);
}

// That of the place at which a part of what these bins take from a tile is taken, or as much light as was `due`, if that is
// sooner.
float closeness_at(uint first, uint end, uint row, float part, float due) {
    float total = 0.0;
    for (uint bin = first; bin < end; bin++) total += float(depths[bin * 2u * TILES + row]);
    float wanted = min(part * total, due);
    for (uint bin = first; bin < end; bin++) {
        float taken = float(depths[bin * 2u * TILES + row]);
        if (taken > 0.0 && wanted <= taken) {
            float begins = closeness_before(bin == 0u ? 0u : plan.bin_ends[bin - 1u]);
            return mix(begins, closeness_before(plan.bin_ends[bin]), wanted / taken);
        }
        wanted -= taken;
    }
    // Nothing was predicted here, or rounding ate the last of it.
    float begins = closeness_before(plan.starts[push.first]);
    return mix(begins, closeness_before(plan.starts[push.batch + 1u]), part);
}

void main() {
    // Nothing stands there before the first look.
    vec2 known = push.first > 0u ? subpassLoad(before).rg : vec2(0.0);
    if (known.r > 0.0) discard;
    float covered = subpassLoad(accumulated).a;
    median = vec2(0.0, covered);
    if (!(covered > 0.5)) return;
#ifdef MULTIVIEW
    uint eye_index = uint(gl_ViewIndex);
#else
    uint eye_index = push.view;
#endif
    ViewData view = frame.views[eye_index];
    // Halvings of the light, before and after: it crosses 1.
    vec2 halvings = -log2(max(1.0 - vec2(known.g, covered), vec2(1e-6)));
    float part = clamp((1.0 - halvings.x) / max(halvings.y - halvings.x, 1e-6), 0.0, 1.0);
    vec2 place = gl_FragCoord.xy / vec2(push.width, push.height);
    uvec2 tile = min(uvec2(place * float(TILE_SIDE)), uvec2(TILE_SIDE - 1u));
    uint row = eye_index * TILES + tile.y * TILE_SIDE + tile.x;
    uint batches = frame.counts.y;
    uint first = BINS * push.first / batches, end = BINS * (push.batch + 1u) / batches;
    // A pixel that was closed on the way took part in some of these batches only.
    bool closed = 1.0 - covered < frame.filters.z;
    float due = closed ? (1.0 - halvings.x) * log(2.0) * DEPTH_UNIT : 1e30;
    float depth = 1.0 / closeness_at(first, end, row, part, due);
    if (!by_depth()) {
        // From the distance to the point between the eyes to the depth along this eye's ray of depth 1: the far root of
        // |eye + s ray| = distance.
        vec3 away = view.eye.xyz - frame.sort_center.xyz;
        vec3 eye = vec3(dot(view.rotation[0].xyz, away), dot(view.rotation[1].xyz, away), dot(view.rotation[2].xyz, away));
        vec3 ray = vec3(mix(view.tangents.xz, view.tangents.yw, place), 1.0);
        float square = dot(ray, ray);
        float along = dot(eye, ray);
        float root = along * along - square * (dot(eye, eye) - depth * depth);
        depth = (sqrt(max(root, 0.0)) - along) / square;
    }
    median.r = clamp(frame.cull.x / max(depth, 1e-6), LEAST, 1.0);
}
