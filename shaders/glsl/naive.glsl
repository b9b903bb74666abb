// The Quest report's half floats, to be shown and never used: attributes, covariance and eigenvalues all rounded to 16
// bits, as a viewer computes them whose shader says `precision mediump float` (002, figures 15 and 16).
#ifndef NAIVE_GLSL
#define NAIVE_GLSL
#include "scene.glsl"

// The nearest half float (IEEE 754 binary16, ties to even). By integers: a compiler takes packing and unpacking for
// nothing done, and devices differ in what they round beyond 65504 to.
float half_of(float x) {
    uint bits = floatBitsToUint(x);
    uint magnitude = bits & 0x7fffffffu;
    if (magnitude >= 0x477ff000u) return magnitude > 0x7f800000u ? x : uintBitsToFloat((bits & 0x80000000u) | 0x7f800000u);
    if (magnitude < 0x38800000u) return roundEven(x * 16777216.0) / 16777216.0; // subnormal
    return uintBitsToFloat((bits + 0xfffu + ((bits >> 13) & 1u)) & 0xffffe000u);
}
vec3 half_of(vec3 v) { return vec3(half_of(v.x), half_of(v.y), half_of(v.z)); }
float half_dot(vec3 a, vec3 b) {
    return half_of(half_of(half_of(a.x * b.x) + half_of(a.y * b.y)) + half_of(a.z * b.z));
}

// Columns of R S S R', rounded after every step.
mat3 naive_covariance(Splat s) {
    vec4 q = s.rotation;
    vec3 r0 = half_of(vec3(1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y - q.w * q.z), 2.0 * (q.x * q.z + q.w * q.y)));
    vec3 r1 = half_of(vec3(2.0 * (q.x * q.y + q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z - q.w * q.x)));
    vec3 r2 = half_of(vec3(2.0 * (q.x * q.z - q.w * q.y), 2.0 * (q.y * q.z + q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)));
    vec3 a = half_of(r0 * s.scale), b = half_of(r1 * s.scale), c = half_of(r2 * s.scale);
    float ab = half_dot(a, b), ac = half_dot(a, c), bc = half_dot(b, c);
    return mat3(half_dot(a, a), ab, ac, ab, half_dot(b, b), bc, ac, bc, half_dot(c, c));
}

// Direction of the major axis, and both standard deviations, at depth 1: the affine projection in pixels, with the
// eigenvalues by the widely copied difference of squares. `eye` is the scene-to-eye rotation.
vec4 naive_axes(Splat s, vec3 mean, mat3 eye, ViewData view) {
    mat3 covariance = naive_covariance(s);
    mat3 rows = transpose(eye);
    mean = half_of(mean);
    vec2 f = vec2(half_of(view.image.x), half_of(view.image.y));
    float inverse = half_of(1.0 / mean.z);
    vec2 j = vec2(half_of(f.x * inverse), half_of(f.y * inverse));
    vec2 k = vec2(half_of(half_of(j.x * mean.x) * inverse), half_of(half_of(j.y * mean.y) * inverse));
    vec3 tx = half_of(half_of(j.x * half_of(rows[0])) - half_of(k.x * half_of(rows[2])));
    vec3 ty = half_of(half_of(j.y * half_of(rows[1])) - half_of(k.y * half_of(rows[2])));
    vec3 vx = vec3(half_dot(covariance[0], tx), half_dot(covariance[1], tx), half_dot(covariance[2], tx));
    vec3 vy = vec3(half_dot(covariance[0], ty), half_dot(covariance[1], ty), half_dot(covariance[2], ty));
    float a = half_of(half_dot(tx, vx) + frame.filters.x), b = half_dot(tx, vy), d = half_of(half_dot(ty, vy) + frame.filters.x);
    float middle = half_of(0.5 * half_of(a + d));
    float square = half_of(half_of(middle * middle) - half_of(half_of(a * d) - half_of(b * b)));
    // Infinity minus infinity: whatever the square root is guarded with is taken for the difference of the axes.
    float difference = half_of(sqrt(square > 0.1 ? square : 0.1));
    float major = half_of(middle + difference), minor = half_of(middle - difference);
    if (!(minor > 0.0)) return vec4(0.0);
    vec2 direction = vec2(b, half_of(major - a));
    float n = length(direction);
    direction = n > 0.0 ? direction / n : vec2(1.0, 0.0);
    // Pixels to the plane at depth 1; the pixel is as good as square.
    return vec4(direction, sqrt(vec2(major, minor)) / f.x);
}

#endif
