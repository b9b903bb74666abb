#version 460
// Opacity and colour of one splat in one pixel, premultiplied.
#define FRAGMENT
#include "interleaved.glsl"
#ifdef THROUGH_LENS
#include "lens.glsl"
#endif
#include "varyings.glsl"

#ifdef STOCHASTIC
// Stochastic transparency (Enderton et al. 2010): a splat is opaque in a pixel with the probability of its opacity, else
// absent, and the depth test finds the first. Numbers are hashed from pixel, splat and sample (PCG; Jarzynski & Olano
// 2020), so that no two of them go together.
float chance(uvec2 pixel, uint splat, uint sample_index) {
    uvec3 v = uvec3(pixel.x | (pixel.y << 16), splat, sample_index) * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v ^= v >> 16;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    return float(v.x >> 8) * (1.0 / 16777216.0);
}
#else
layout(early_fragment_tests) in;
#endif
layout(location = 0) out vec4 blended;
#ifdef COUNT
// Layers of this pixel, added up: shaded, and of those the ones that reach 1/255.
layout(location = 1) out vec2 layers;
#endif

// A fragment without effect. Where layers are counted it is blended as nothing, else it ends here.
#ifdef COUNT
#define LEAVE { blended = vec4(0.0); layers = vec2(1.0, 0.0); return; }
#else
#define LEAVE discard;
#endif

void main() {
#ifdef THROUGH_LENS
    // Where this pixel's ray meets the splat's plane; rays that point away from it do not.
    vec4 shown = frame.views[0].tangents;
    vec3 ray;
    if (!lens_ray(mix(shown.xz, shown.yw, gl_FragCoord.xy / frame.views[0].image.zw), ray)) LEAVE
    vec3 at = vec3(dot(ray, along_p), dot(ray, along_q), dot(ray, middle));
#ifndef EXACT
    if (!(at.z > 0.0)) LEAVE
    at /= at.z;
#endif
#else
    vec3 at = plane;
    if (SAMPLING != SAMPLING_CENTERS) {
        // The falloff is a function of the plane's coordinates, which over their depth are linear in the image.
        vec3 over_depth = plane * gl_FragCoord.w;
        at = over_depth + sample_offset() * dFdx(over_depth);
#ifndef EXACT
        if (PROJECTION != PROJECTION_AFFINE) at.xy /= at.z;
#endif
    }
#endif
    vec2 pq = at.xy;
    float d2 = dot(pq, pq);
#ifdef EXACT
    // Squared distance of the ray, and whether its strongest point lies before the eye.
    float along = dot(lean, pq);
    if (!(at.z - along > 0.0)) LEAVE
    d2 /= at.z * at.z - 2.0 * at.z * along + quadratic.x * pq.x * pq.x + quadratic.y * pq.x * pq.y + quadratic.z * pq.y * pq.y;
#endif
    float alpha = min(MAX_ALPHA, color.a * exp2(-HALF_LOG2_E * d2));
    if (!(alpha >= MIN_ALPHA)) LEAVE
#ifdef STOCHASTIC
    if (!(chance(uvec2(gl_FragCoord.xy), splat, frame.counts.w & 0x3fffffffu) < alpha)) LEAVE
    blended = vec4(color.rgb, 1.0);
#else
    blended = vec4(color.rgb * alpha, alpha);
#endif
#ifdef COUNT
    layers = vec2(1.0);
#endif
}
