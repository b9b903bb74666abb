// Real spherical harmonics up to degree 3, constants as the trainers use them (Kerbl et al. 2023).
// Twin: renderer/src/spherical_harmonics.rs.
#ifndef HARMONICS_GLSL
#define HARMONICS_GLSL
#include "scene.glsl"

// The k-th coefficient above the constant band (k = 0 .. 14), as r g b.
vec3 sh_coefficient(uint splat, uint k, float byte_scale) {
    uint at = 3u * k;
    if (SH_PRECISION == SH_PRECISION_F32) {
        return vec3(uintBitsToFloat(sh_word(splat, at)), uintBitsToFloat(sh_word(splat, at + 1u)),
                    uintBitsToFloat(sh_word(splat, at + 2u)));
    }
    if (SH_PRECISION == SH_PRECISION_F16) {
        vec2 a = unpackHalf2x16(sh_word(splat, at / 2u));
        vec2 b = unpackHalf2x16(sh_word(splat, at / 2u + 1u));
        return (at & 1u) == 0u ? vec3(a, b.x) : vec3(a.y, b);
    }
    uvec3 byte_at = uvec3(at + 2u, at + 3u, at + 4u);
    uvec3 words = uvec3(sh_word(splat, byte_at.x / 4u), sh_word(splat, byte_at.y / 4u), sh_word(splat, byte_at.z / 4u));
    ivec3 bytes = ivec3(words >> (8u * (byte_at & 3u))) & 0xff;
    return vec3((bytes ^ 0x80) - 0x80) * byte_scale;
}

// Colour seen along the unit direction d (from the eye to the splat, scene axes), never negative, at most 60000.
vec3 splat_color(uint i, vec3 base, vec3 d) {
    vec3 c = base;
    if (SH_DEGREE > 0u) {
        float scale = SH_PRECISION == SH_PRECISION_U8 ? unpackHalf2x16(sh_word(i, 0u)).x / 127.0 : 1.0;
        c += 0.48860251 * (-d.y * sh_coefficient(i, 0u, scale) + d.z * sh_coefficient(i, 1u, scale)
                           - d.x * sh_coefficient(i, 2u, scale));
        if (SH_DEGREE > 1u) {
            vec3 s = d * d;
            c += 1.09254843 * (d.x * d.y * sh_coefficient(i, 3u, scale) - d.y * d.z * sh_coefficient(i, 4u, scale)
                               - d.x * d.z * sh_coefficient(i, 6u, scale))
                + 0.31539157 * (2.0 * s.z - s.x - s.y) * sh_coefficient(i, 5u, scale)
                + 0.54627421 * (s.x - s.y) * sh_coefficient(i, 7u, scale);
            if (SH_DEGREE > 2u) {
                c += -0.59004359 * d.y * (3.0 * s.x - s.y) * sh_coefficient(i, 8u, scale)
                    + 2.89061144 * d.x * d.y * d.z * sh_coefficient(i, 9u, scale)
                    - 0.45704579 * d.y * (4.0 * s.z - s.x - s.y) * sh_coefficient(i, 10u, scale)
                    + 0.37317633 * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y) * sh_coefficient(i, 11u, scale)
                    - 0.45704579 * d.x * (4.0 * s.z - s.x - s.y) * sh_coefficient(i, 12u, scale)
                    + 1.44530572 * d.z * (s.x - s.y) * sh_coefficient(i, 13u, scale)
                    - 0.59004359 * d.x * (s.x - 3.0 * s.y) * sh_coefficient(i, 14u, scale);
            }
        }
    }
    // Blended weights sum to one, so that no pixel exceeds the half floats that it is blended in.
    return clamp(c, vec3(0.0), vec3(6e4));
}

#endif
