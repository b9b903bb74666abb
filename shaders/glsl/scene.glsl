// Reads a splat from the scene's device buffers, whatever the precision they are stored in.
// Twin: renderer/src/packing.rs.
#ifndef SCENE_GLSL
#define SCENE_GLSL
#include "layout.glsl"
#include "parts.glsl"

// A stream may be larger than one binding may be (128 MiB on Adreno): up to four bindings, split at a power of two.
layout(set = 1, binding = 0, std430) readonly buffer Geometry { uint words[]; } geometry_stream[4];
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

uint geometry_word(uint splat, uint word) {
    if (GEOMETRY_SLOTS == 1u) return geometry_stream[0].words[splat * geometry_words() + word];
    uint at = (splat & ((1u << GEOMETRY_SHIFT) - 1u)) * geometry_words() + word;
    switch (splat >> GEOMETRY_SHIFT) {
        case 0: return geometry_stream[0].words[at];
        case 1: return geometry_stream[1].words[at];
        case 2: return geometry_stream[2].words[at];
        default: return geometry_stream[3].words[at];
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

float geometry_float(uint splat, uint word) { return uintBitsToFloat(geometry_word(splat, word)); }

vec3 splat_mean(uint i) {
    if (PRECISION == PRECISION_F16_NAIVE) {
        return vec3(unpackHalf2x16(geometry_word(i, 0u)), unpackHalf2x16(geometry_word(i, 1u)).x);
    }
    return vec3(geometry_float(i, 0u), geometry_float(i, 1u), geometry_float(i, 2u));
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
        s.opacity = geometry_float(i, 3u);
        s.rotation = vec4(geometry_float(i, 4u), geometry_float(i, 5u), geometry_float(i, 6u), geometry_float(i, 7u));
        s.scale = vec3(geometry_float(i, 8u), geometry_float(i, 9u), geometry_float(i, 10u));
        s.base = vec3(geometry_float(i, 11u), geometry_float(i, 12u), geometry_float(i, 13u));
    } else if (PRECISION == PRECISION_F16) {
        uint xy = geometry_word(i, 3u);
        uint zo = geometry_word(i, 4u);
        s.scale = vec3(unpack_log_scale(xy & 0xffffu), unpack_log_scale(xy >> 16), unpack_log_scale(zo & 0xffffu));
        s.opacity = float(zo >> 16) / 65535.0;
        uint high = geometry_word(i, 6u);
        s.rotation = unpack_rotation(geometry_word(i, 5u), high);
        s.base = vec3(unpackHalf2x16(high).y, unpackHalf2x16(geometry_word(i, 7u)));
    } else {
        s.opacity = unpackHalf2x16(geometry_word(i, 1u)).y;
        s.rotation = vec4(unpackHalf2x16(geometry_word(i, 2u)), unpackHalf2x16(geometry_word(i, 3u)));
        vec2 z = unpackHalf2x16(geometry_word(i, 5u));
        s.scale = vec3(unpackHalf2x16(geometry_word(i, 4u)), z.x);
        s.base = vec3(z.y, unpackHalf2x16(geometry_word(i, 6u)));
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
