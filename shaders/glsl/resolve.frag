#version 460
// Puts the background behind the blended splats and converts to what the output stores. Colours are sRGB-encoded
// values up to here: they are trained, and must be blended, so.
#include "layout.glsl"
layout(input_attachment_index = 0, set = 3, binding = 0) uniform subpassInput accumulated;
layout(location = 0) out vec4 shown;
layout(push_constant) uniform Push { vec4 background; uint decode; } push;

vec3 srgb_to_linear(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045)));
}

void main() {
    vec4 c = subpassLoad(accumulated);
    c.rgb += (1.0 - c.a) * push.background.rgb;
    c.a += (1.0 - c.a) * push.background.a;
    // An output in an sRGB format encodes what it is given.
    if (push.decode != 0u) c.rgb = srgb_to_linear(clamp(c.rgb, 0.0, 1.0));
    shown = c;
}
