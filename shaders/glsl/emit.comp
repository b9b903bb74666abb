#version 460
// Writes the list of visible splats, in order: behind those of the blocks before, and of their own block. Where pixels stop
// early, also adds up how much light each bin of the order takes from each tile of the image.
#include "drawn.glsl"

layout(local_size_x = WORKGROUP) in;
layout(set = 2, binding = 2, std430) readonly buffer Blocks { Block blocks[]; };
layout(set = 2, binding = 3, std430) readonly buffer Footprints { uint footprints[]; };
layout(set = 2, binding = 6, std430) writeonly buffer Visible { uint visible[]; };
layout(set = 2, binding = 7, std430) buffer Depths { uint depths[]; };

// A splat over many tiles adds to every n-th of them n times as much, beginning with one of its own.
const uint MOST_STEPS = 8u;

void add_depth(uint bin, uint view, uint slot, uint word) {
    uvec4 tiles = footprint_tiles(word);
    uvec2 extent = tiles.zw - tiles.xy + 1u;
    uvec2 stride = (extent + MOST_STEPS - 1u) / MOST_STEPS;
    uint depth = uint(min(footprint_depth(word), 8.0) * DEPTH_UNIT) * stride.x * stride.y;
    if (depth == 0u) return;
    uvec2 first = tiles.xy + (uvec2(slot, slot >> 3) % stride);
    uint row = (bin * 2u + view) * TILES;
    for (uint y = first.y; y <= tiles.w; y += stride.y)
        for (uint x = first.x; x <= tiles.z; x += stride.x)
            atomicAdd(depths[row + y * TILE_SIDE + x], depth);
}

void main() {
    uint slot = gl_GlobalInvocationID.x;
    if (slot >= frame.counts.x) return;
    uint seen = blocks[slot / BLOCK].seen;
    uint bit = 1u << (slot % BLOCK);
    if ((seen & bit) == 0u) return;
    uint i = drawn_splat(slot);
    visible[blocks[slot / BLOCK].place + uint(bitCount(seen & (bit - 1u)))] = i;
    if (frame.counts.y > 1u) {
        for (uint view = 0u; view < VIEWS; view++) {
            uint word = footprints[i * VIEWS + view];
            if (word != 0u) add_depth(blocks[slot / BLOCK].bin, view, slot, word);
        }
    }
}
