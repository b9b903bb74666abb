// Reads a splat from the scene's device buffers, whatever the precision they are stored in.
// Twin: renderer/src/packing.rs.
#ifndef SCENE_GLSL
#define SCENE_GLSL
#include "layout.glsl"
#include "parts.glsl"

// A stream may be larger than one binding may be (128 MiB on Adreno): up to four bindings, split at a power of two.
layout(set = 1, binding = 0, std430) readonly buffer Geometry { uvec2 pairs[]; } geometry_stream[4];
layout(set = 1, binding = 1, std430) readonly buffer Harmonics { uint words[]; } sh_stream[4];
layout(set = 1, binding = 2, std430) readonly buffer MotionStream { uint words[]; } motion_stream[2];

struct Splat {
    vec3 mean;     // relative to the scene's origin, m
    vec4 rotation; // unit quaternion x y z w
    vec3 scale;    // standard deviations, m
    float opacity;
    vec3 base;     // colour of the constant band
};

uint geometry_words() { return PRECISION == PRECISION_F32 ? 14u : 8u; }

uint sh_words() {
    uint values = 3u * ((SH_STORED + 1u) * (SH_STORED + 1u) - 1u);
    if (SH_PRECISION == SH_PRECISION_F32) return values;
    if (SH_PRECISION == SH_PRECISION_F16) return (values + 1u) / 2u;
    return (values + 2u + 3u) / 4u; // a half-float scale, then bytes
}

// Two words at once: a processor fetches them as fast as one.
uvec2 geometry_pair(uint splat, uint pair) {
    uint pairs = geometry_words() / 2u;
    if (GEOMETRY_SLOTS == 1u) return geometry_stream[0].pairs[splat * pairs + pair];
    uint at = (splat & ((1u << GEOMETRY_SHIFT) - 1u)) * pairs + pair;
    switch (splat >> GEOMETRY_SHIFT) {
        case 0: return geometry_stream[0].pairs[at];
        case 1: return geometry_stream[1].pairs[at];
        case 2: return geometry_stream[2].pairs[at];
        default: return geometry_stream[3].pairs[at];
    }
}

uint sh_word(uint splat, uint word) {
    if (SH_SLOTS == 1u) return sh_stream[0].words[splat * sh_words() + word];
    uint at = (splat & ((1u << SH_SHIFT) - 1u)) * sh_words() + word;
    switch (splat >> SH_SHIFT) {
        case 0: return sh_stream[0].words[at];
        case 1: return sh_stream[1].words[at];
        case 2: return sh_stream[2].words[at];
        default: return sh_stream[3].words[at];
    }
}

vec2 geometry_floats(uint splat, uint pair) { return uintBitsToFloat(geometry_pair(splat, pair)); }

vec3 splat_mean(uint i) {
    uvec2 xy = geometry_pair(i, 0u);
    if (PRECISION == PRECISION_F16_NAIVE) return vec3(unpackHalf2x16(xy.x), unpackHalf2x16(xy.y).x);
    return uintBitsToFloat(uvec3(xy, geometry_pair(i, 1u).x));
}

// Log-scales are stored in 16 bits over -24 ..= 12 (relative error of the scale: 2.8e-4).
float unpack_log_scale(uint bits) { return exp(float(bits) * (36.0 / 65535.0) - 24.0); }

// Smallest three of a unit quaternion, 15 bits each, and the index of the largest.
vec4 unpack_rotation(uint low, uint high) {
    const float STEP = 1.41421356 / 32767.0;
    uvec3 q = uvec3(low & 0x7fffu, (low >> 15) & 0x7fffu, ((low >> 30) & 3u) | ((high & 0x1fffu) << 2));
    vec3 s = vec3(q) * STEP - 0.70710678;
    float l = sqrt(max(0.0, 1.0 - dot(s, s)));
    switch ((high >> 13) & 3u) {
        case 0: return vec4(l, s);
        case 1: return vec4(s.x, l, s.yz);
        case 2: return vec4(s.xy, l, s.z);
        default: return vec4(s, l);
    }
}

Splat read_splat(uint i) {
    Splat s;
    s.mean = splat_mean(i);
    if (PRECISION == PRECISION_F32) {
        vec2 z_opacity = geometry_floats(i, 1u);
        s.opacity = z_opacity.y;
        s.rotation = vec4(geometry_floats(i, 2u), geometry_floats(i, 3u));
        vec2 z_red = geometry_floats(i, 5u);
        s.scale = vec3(geometry_floats(i, 4u), z_red.x);
        s.base = vec3(z_red.y, geometry_floats(i, 6u));
    } else if (PRECISION == PRECISION_F16) {
        uint xy = geometry_pair(i, 1u).y;
        uvec2 zo = geometry_pair(i, 2u); // and the rotation's low word
        uvec2 high = geometry_pair(i, 3u);
        s.scale = vec3(unpack_log_scale(xy & 0xffffu), unpack_log_scale(xy >> 16), unpack_log_scale(zo.x & 0xffffu));
        s.opacity = float(zo.x >> 16) / 65535.0;
        s.rotation = unpack_rotation(zo.y, high.x);
        s.base = vec3(unpackHalf2x16(high.x).y, unpackHalf2x16(high.y));
    } else {
        s.opacity = unpackHalf2x16(geometry_pair(i, 0u).y).y;
        uvec2 rotation = geometry_pair(i, 1u);
        s.rotation = vec4(unpackHalf2x16(rotation.x), unpackHalf2x16(rotation.y));
        uvec2 scale = geometry_pair(i, 2u);
        vec2 z = unpackHalf2x16(scale.y);
        s.scale = vec3(unpackHalf2x16(scale.x), z.x);
        s.base = vec3(z.y, unpackHalf2x16(geometry_pair(i, 3u).x));
    }
    if (PARTS) s.opacity = shared_opacity(s.opacity, i);
    return s;
}

// Splats move (Spacetime Gaussians, lite model): centre, 1/width, 9 polynomial coefficients, 4 of rotation; as f32, or
// all but the centre as half floats.
const uint MOTION_SHIFT = 21u;

uint motion_word(uint splat, uint word) {
    uint words = PRECISION == PRECISION_F32 ? 15u : 8u;
    uint at = (splat & ((1u << MOTION_SHIFT) - 1u)) * words + word;
    return splat >> MOTION_SHIFT == 0u ? motion_stream[0].words[at] : motion_stream[1].words[at];
}

float motion_float(uint splat, uint value) {
    if (PRECISION == PRECISION_F32 || value == 0u) return uintBitsToFloat(motion_word(splat, value));
    vec2 pair = unpackHalf2x16(motion_word(splat, (value + 1u) / 2u));
    return (value & 1u) == 1u ? pair.x : pair.y;
}

// Position at a time: mean + p1 dt + p2 dt² + p3 dt³.
vec3 moved_mean(vec3 mean, uint i, float time) {
    precise float dt = time - motion_float(i, 0u);
    vec3 p1 = vec3(motion_float(i, 2u), motion_float(i, 3u), motion_float(i, 4u));
    vec3 p2 = vec3(motion_float(i, 5u), motion_float(i, 6u), motion_float(i, 7u));
    vec3 p3 = vec3(motion_float(i, 8u), motion_float(i, 9u), motion_float(i, 10u));
    precise vec3 moved = mean + dt * (p1 + dt * (p2 + dt * p3));
    return moved;
}

void move_splat(inout Splat s, uint i, float time) {
    float dt = time - motion_float(i, 0u);
    float falloff = dt * motion_float(i, 1u);
    s.opacity *= exp(-falloff * falloff);
    s.mean = moved_mean(s.mean, i, time);
    vec4 omega = vec4(motion_float(i, 11u), motion_float(i, 12u), motion_float(i, 13u), motion_float(i, 14u));
    vec4 q = s.rotation + dt * omega;
    float norm = dot(q, q);
    s.rotation = norm > 1e-12 ? q * inversesqrt(norm) : s.rotation;
}

#endif
