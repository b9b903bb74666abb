// Splats by tiles of the image: who reaches which tile, in order. Twin: shaders/src/layout.rs.
//
// The order is cut into runs, one an invocation. Each invocation counts its splats in every tile in a column of its own, so
// that nobody waits for another; sums over all columns then say where each of them writes. Equal input gives equal lists.
#ifndef TILE_LISTS_GLSL
#define TILE_LISTS_GLSL
#include "corner.glsl"
#include "records.glsl"

const int SIDE = 16;    // pixels along a tile
const uint RUNS = 64u;  // runs that the order is cut into
const uint LANES = 8u;  // invocations of a workgroup: one vector of a processor

layout(set = 2, binding = 1, std430) readonly buffer Records { uint words[]; } records[2];
layout(set = 2, binding = 5, std430) buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 6, std430) readonly buffer Visible { uint visible[]; };
layout(set = 3, binding = 3, std430) buffer TileSplats { uint tile_splats[]; }; // view, splat, word
// Where the entries of every view, tile and run begin, and once they are written end; then the entries: ranks of splats.
layout(set = 3, binding = 4, std430) buffer TileLists { uint lists[]; };
layout(push_constant) uniform Push {
    uint first_view;
    uint views;     // that are drawn together
    uint columns;   // of tiles
    uint rows;
    uint room;      // for splats
    uint capacity;  // entries that there is room for
    uint width;     // of the rendered image, pixels
    uint height;
} push;

uint tiles() { return push.columns * push.rows; }
uint first_rank(uint run) { return min(run * ((plan.visible + RUNS - 1u) / RUNS), plan.visible); }
uint end_at(uint layer, uint tile, uint run) { return (layer * tiles() + tile) * RUNS + run; }
uint entry_at(uint place) { return push.views * tiles() * RUNS + place; }

// What a tile needs to know of a splat.
//
// A ray's point of the splat's plane is (p, q, 1) times a factor, each a linear function of the pixel: its value at the
// box's first pixel, and its steps to the right and downward.
struct TileSplat {
    vec3 p;
    vec3 q;
    vec3 ahead;
    uint rg; // colour and opacity, half floats
    uint ba;
    ivec4 box; // first column and row, last column and row: pixels; none where the first lies beyond the last
    vec2 lean; // exact
    vec3 quadratic;
};

uint tile_splat_words() { return PROJECTION == PROJECTION_EXACT ? 18u : 13u; }
uint tile_splat_at(uint layer, uint rank) { return (layer * push.room + rank) * tile_splat_words(); }
vec3 stored_floats(uint at) { return uintBitsToFloat(uvec3(tile_splats[at], tile_splats[at + 1u], tile_splats[at + 2u])); }

TileSplat load_tile_splat(uint layer, uint rank) {
    uint at = tile_splat_at(layer, rank);
    TileSplat s;
    s.p = stored_floats(at);
    s.q = stored_floats(at + 3u);
    s.ahead = stored_floats(at + 6u);
    s.rg = tile_splats[at + 9u];
    s.ba = tile_splats[at + 10u];
    uint x = tile_splats[at + 11u], y = tile_splats[at + 12u];
    s.box = ivec4(x & 0xffffu, y & 0xffffu, x >> 16, y >> 16);
    s.lean = vec2(0.0);
    s.quadratic = vec3(0.0);
    if (PROJECTION == PROJECTION_EXACT) {
        s.lean = uintBitsToFloat(uvec2(tile_splats[at + 13u], tile_splats[at + 14u]));
        s.quadratic = stored_floats(at + 15u);
    }
    return s;
}

void store_tile_splat(uint layer, uint rank, TileSplat s) {
    uint at = tile_splat_at(layer, rank);
    for (int i = 0; i < 3; i++) {
        tile_splats[at + i] = floatBitsToUint(s.p[i]);
        tile_splats[at + 3u + i] = floatBitsToUint(s.q[i]);
        tile_splats[at + 6u + i] = floatBitsToUint(s.ahead[i]);
    }
    tile_splats[at + 9u] = s.rg;
    tile_splats[at + 10u] = s.ba;
    tile_splats[at + 11u] = uint(s.box.x) | uint(s.box.z) << 16;
    tile_splats[at + 12u] = uint(s.box.y) | uint(s.box.w) << 16;
    if (PROJECTION == PROJECTION_EXACT) {
        tile_splats[at + 13u] = floatBitsToUint(s.lean.x);
        tile_splats[at + 14u] = floatBitsToUint(s.lean.y);
        for (int i = 0; i < 3; i++) tile_splats[at + 15u + i] = floatBitsToUint(s.quadratic[i]);
    }
}

#endif
