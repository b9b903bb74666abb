#version 460
// Writes the list of visible splats, in order: stable compaction by prefix sums. Where pixels stop early, also adds up how
// much light each bin of the order takes from each tile of the image.
#include "records.glsl"

layout(local_size_x = BLOCK) in;
layout(set = 2, binding = 3, std430) readonly buffer Footprints { uint footprints[]; };
layout(set = 2, binding = 4, std430) readonly buffer Offsets { uvec2 offsets[]; };
layout(set = 2, binding = 6, std430) writeonly buffer Visible { uint visible[]; };
layout(set = 2, binding = 7, std430) buffer Depths { uint depths[]; };

shared uint ranks[BLOCK];

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
    uint local = gl_LocalInvocationID.x;
    uint slot = gl_GlobalInvocationID.x;
    uint flag = 0u;
    uvec2 place = offsets[gl_WorkGroupID.x];
    if (slot < frame.counts.x) {
        for (uint view = 0u; view < VIEWS; view++) {
            uint word = footprints[slot * VIEWS + view];
            if (word == 0u) continue;
            flag = 1u;
            if (frame.counts.y > 1u) add_depth(place.y, view, slot, word);
        }
    }
    ranks[local] = flag;
    barrier();
    for (uint step = 1u; step < BLOCK; step <<= 1) {
        uint r = local >= step ? ranks[local - step] : 0u;
        barrier();
        ranks[local] += r;
        barrier();
    }
    if (flag != 0u) visible[place.x + ranks[local] - 1u] = slot;
}
