#version 460
// Splats by tiles: what was blended, to where fragments would have blended it.
#ifdef MULTIVIEW
#extension GL_EXT_multiview : require
#endif
layout(set = 3, binding = 5, std430) readonly buffer TilePixels { vec4 pixels[]; };
// Those of the compute passes: tile_lists.glsl.
layout(push_constant) uniform Push { uint first_view; uint views; layout(offset = 24) uint width; uint height; } push;
layout(location = 0) out vec4 blended;
#ifdef COUNT
layout(location = 1) out vec2 layers;
#endif

void main() {
#ifdef MULTIVIEW
    uint layer = uint(gl_ViewIndex);
#else
    uint layer = 0u;
#endif
    uint image = push.width * push.height;
    uint place = layer * image + uint(gl_FragCoord.y) * push.width + uint(gl_FragCoord.x);
    blended = pixels[place];
#ifdef COUNT
    layers = pixels[push.views * image + place].xy;
#endif
}
