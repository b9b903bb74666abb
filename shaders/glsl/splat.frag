#version 460
// Opacity and colour of one splat in one pixel, premultiplied.
#include "layout.glsl"
#define FRAGMENT
#include "varyings.glsl"

layout(early_fragment_tests) in;
layout(location = 0) out vec4 blended;

void main() {
    vec2 pq = plane.xy;
    float d2 = dot(pq, pq);
#ifdef EXACT
    // Squared distance of the ray, and whether its strongest point lies before the eye.
    float along = dot(linear, pq);
    if (!(plane.z + 0.5 * along > 0.0)) discard;
    d2 /= plane.z * plane.z + plane.z * along + quadratic.x * pq.x * pq.x + quadratic.y * pq.x * pq.y + quadratic.z * pq.y * pq.y;
#endif
    float alpha = min(MAX_ALPHA, color.a * exp2(-HALF_LOG2_E * d2));
    if (!(alpha >= MIN_ALPHA)) discard;
    blended = vec4(color.rgb * alpha, alpha);
}
