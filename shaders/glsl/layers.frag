#version 460
// How many layers a pixel took, as a colour. Twin of the ramp: tests/tests/counts.rs.
#include "output.glsl"
#ifdef MULTIVIEW
#extension GL_EXT_multiview : require
#endif
layout(set = 3, binding = 1) uniform sampler2DArray gathered;
layout(push_constant) uniform Push { vec2 size; uint layer; float most; uint decode; } push;
layout(location = 0) out vec4 shown;

// Black, blue, cyan, green, yellow, red, white.
vec3 ramp(float share) {
    float at = clamp(share, 0.0, 1.0) * 6.0;
    vec3 rising = clamp(vec3(at - 3.0, at - 1.0, at), 0.0, 1.0);
    vec3 falling = clamp(vec3(0.0, at - 4.0, at - 2.0), 0.0, 1.0);
    return clamp(rising - falling + vec3(0.0, at - 5.0, at - 5.0) * step(5.0, at), 0.0, 1.0);
}

void main() {
#ifdef MULTIVIEW
    int layer = gl_ViewIndex;
#else
    int layer = int(push.layer);
#endif
    ivec2 at = ivec2(gl_FragCoord.xy / push.size * vec2(textureSize(gathered, 0).xy));
    vec3 color = ramp(texelFetch(gathered, ivec3(at, layer), 0).r / push.most);
    shown = vec4(push.decode != 0u ? srgb_to_linear(color) : color, 1.0);
}
