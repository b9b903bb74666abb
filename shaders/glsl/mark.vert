#version 460
// Early stop: the tiles that are due after a batch, at the depth that stops every later splat.
#include "layout.glsl"
#include "tiles.glsl"
layout(set = 2, binding = 8, std430) readonly buffer Due { uint due[]; };
layout(push_constant) uniform Push { uint batch; uint view; } push;

void main() {
    uint entry = due[push.batch * DUE_ROOM + uint(gl_InstanceIndex)];
#ifdef MULTIVIEW
    uint view = uint(gl_ViewIndex);
#else
    uint view = push.view;
#endif
    uint tile = entry % TILES;
    // Two triangles; a tile of the other view shrinks to a point.
    uvec2 corner = uvec2(gl_VertexIndex == 1 || gl_VertexIndex == 2 || gl_VertexIndex == 4, gl_VertexIndex >= 2 && gl_VertexIndex != 3);
    if (entry / TILES != view) corner = uvec2(0u);
    vec2 p = vec2(uvec2(tile % TILE_SIDE, tile / TILE_SIDE) + corner) / float(TILE_SIDE);
    gl_Position = vec4(2.0 * p - 1.0, 0.0, 1.0);
}
