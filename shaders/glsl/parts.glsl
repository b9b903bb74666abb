// The parts of a scene that a frame draws, and the share of each. Twin: renderer/src/parts.rs.
#ifndef PARTS_GLSL
#define PARTS_GLSL
#include "layout.glsl"

layout(set = 0, binding = 1, std430) readonly buffer PartList {
    uint part_count;
    uint part_padding[3];
    uvec4 parts[]; // first splat, first place among the splats of all parts, splats, share (float); rising
};

const uint BY_SPLAT = 0u;
const uint BY_PLACE = 1u;

// The last part that begins at or before a splat or place; the first where none does.
uint last_part(uint value, uint by) {
    uint low = 0u, high = part_count;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        if (parts[middle][by] <= value) low = middle;
        else high = middle;
    }
    return low;
}

// The splat at a place.
uint part_splat(uint place) {
    uvec4 part = parts[last_part(place, BY_PLACE)];
    return part.x + (place - part.y);
}

// Light that passes a splat and its part's other level together is what passes one: (1 - o)^share.
float shared_opacity(float opacity, uint splat) {
    if (part_count == 0u) return 0.0;
    uvec4 part = parts[last_part(splat, BY_SPLAT)];
    // Below the first part the difference wraps round.
    if (splat - part.x >= part.z) return 0.0;
    float share = uintBitsToFloat(part.w);
    return share < 1.0 ? 1.0 - pow(1.0 - min(opacity, MAX_ALPHA), share) : opacity;
}

#endif
