// From blended splats to what the output stores. Colours are sRGB-encoded values up to here: they are trained, and must
// be blended, so.
#ifndef OUTPUT_GLSL
#define OUTPUT_GLSL
#include "layout.glsl"

vec3 srgb_to_linear(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045)));
}

// What is all but opaque made so: layers that early stop left out are taken to look like those before them, and what
// a half-float sum lost by rounding (layers below half a step of it vanish) comes back.
vec4 opaque(vec4 c) { return 1.0 - c.a < frame.filters.z ? c / c.a : c; }

// The background put behind; an output in an sRGB format encodes what it is given, and is given linear values.
vec4 output_color(vec4 c, vec4 background, bool decode) {
    c = opaque(c);
    c.rgb += (1.0 - c.a) * background.rgb;
    c.a += (1.0 - c.a) * background.a;
    if (decode) c.rgb = srgb_to_linear(clamp(c.rgb, 0.0, 1.0));
    return c;
}

#endif
