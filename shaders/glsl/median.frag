#version 460
// Median depth: where a batch has taken more than half of a pixel's light for the first time. Within the batch the logarithm
// of the light is taken to fall evenly with the closeness.
#include "layout.glsl"
layout(early_fragment_tests) in;
layout(input_attachment_index = 0, set = 3, binding = 0) uniform subpassInput accumulated;
layout(input_attachment_index = 1, set = 3, binding = 1) uniform subpassInput before;
layout(push_constant) uniform Push { uint batch; uint view; } push;
layout(location = 0) flat in vec2 closeness;
// Near over the median depth, 0 as long as it is not known; what was covered after this batch.
layout(location = 1) out vec2 median;

// The least that half floats hold without a loss of digits.
const float LEAST = 6.2e-5;

void main() {
    vec2 known = subpassLoad(before).rg;
    if (known.r > 0.0) discard;
    float covered = subpassLoad(accumulated).a;
    median = vec2(0.0, covered);
    if (!(covered > 0.5)) return;
    // Halvings of the light, before and after: it crosses 1.
    vec2 halvings = -log2(max(1.0 - vec2(known.g, covered), vec2(1e-6)));
    float part = clamp((1.0 - halvings.x) / max(halvings.y - halvings.x, 1e-6), 0.0, 1.0);
    float depth = 1.0 / mix(closeness.x, closeness.y, part);
    bool by_depth = (frame.counts.w >> 31) != 0u;
    if (!by_depth) {
        // From the distance to the point between the eyes to the depth along this eye's ray of depth 1: the far root of
        // |eye + s ray| = distance.
#ifdef MULTIVIEW
        ViewData view = frame.views[gl_ViewIndex];
#else
        ViewData view = frame.views[push.view];
#endif
        vec3 away = view.eye.xyz - frame.sort_center.xyz;
        vec3 eye = vec3(dot(view.rotation[0].xyz, away), dot(view.rotation[1].xyz, away), dot(view.rotation[2].xyz, away));
        vec3 ray = vec3(mix(view.tangents.xz, view.tangents.yw, gl_FragCoord.xy / view.image.zw), 1.0);
        float square = dot(ray, ray);
        float along = dot(eye, ray);
        float root = along * along - square * (dot(eye, eye) - depth * depth);
        depth = (sqrt(max(root, 0.0)) - along) / square;
    }
    median.r = clamp(frame.cull.x / max(depth, 1e-6), LEAST, 1.0);
}
