// The splats of a frame in the order in which they are drawn, in blocks.
#ifndef DRAWN_GLSL
#define DRAWN_GLSL
#include "records.glsl"

layout(set = 2, binding = 0, std430) readonly buffer Order { uint order[]; };

struct Block {
    uint seen;  // a bit for each of its splats
    float area; // pixels
    uint place; // of its first splat in the list of those that are seen
    uint bin;
};

// Whether all of the scene's splats are drawn: then their order is one of all of them.
bool whole_scene() { return (frame.counts.w & WHOLE_SCENE) != 0u; }

// The splat at a place of the order.
uint drawn_splat(uint slot) {
    if (COMPOSITE == COMPOSITE_STOCHASTIC) return PARTS ? part_splat(slot) : slot;
    return order[COMPOSITE == COMPOSITE_BACK_TO_FRONT ? frame.counts.x - 1u - slot : slot];
}

#endif
