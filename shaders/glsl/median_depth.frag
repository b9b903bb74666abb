#version 460
// Median depth, from where it was gathered to a depth image: near over depth, so that what is infinitely far is 0.
#ifdef MULTIVIEW
#extension GL_EXT_multiview : require
#endif
layout(set = 3, binding = 1) uniform sampler2DArray gathered;
layout(push_constant) uniform Push { vec2 size; uint layer; } push;

void main() {
#ifdef MULTIVIEW
    int layer = gl_ViewIndex;
#else
    int layer = int(push.layer);
#endif
    // Never between two pixels: at a rim nothing lies in the middle.
    ivec2 at = ivec2(gl_FragCoord.xy / push.size * vec2(textureSize(gathered, 0).xy));
    gl_FragDepth = texelFetch(gathered, ivec3(at, layer), 0).r;
}
