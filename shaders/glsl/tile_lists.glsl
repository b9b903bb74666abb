// Splats by tiles of the image: who reaches which tile, in order. Twin: shaders/src/layout.rs.
//
// The order is cut into runs, one an invocation. Each invocation counts its splats in every tile in a column of its own, so
// that nobody waits for another; sums over all columns then say where each of them writes. Equal input gives equal lists.
#ifndef TILE_LISTS_GLSL
#define TILE_LISTS_GLSL
#include "corner.glsl"
#include "read_records.glsl"

const int SIDE = 16;    // pixels along a tile
const uint RUNS = 64u;  // runs that the order is cut into
const uint LANES = 8u;  // invocations of a workgroup: one vector of a processor

layout(set = 2, binding = 5, std430) buffer PlanBuffer { Plan plan; };
layout(set = 2, binding = 6, std430) readonly buffer Visible { uint visible[]; };
layout(set = 3, binding = 3, std430) buffer TileSplats { uvec4 tile_splats[]; }; // view, splat, part
// Where the entries of every view, tile and run begin, and once they are written end; then the entries: ranks of splats.
layout(set = 3, binding = 4, std430) buffer TileLists { uint lists[]; };
layout(push_constant) uniform Push {
    uint first_view;
    uint views;     // that are drawn together
    uint columns;   // of tiles
    uint rows;
    uint room;      // for splats
    float stop_below; // what comes through a pixel that is finished; 0: none is
    uint width;     // of the rendered image, pixels
    uint height;
} push;

uint tiles() { return push.columns * push.rows; }
uint first_rank(uint run) { return min(run * ((plan.visible + RUNS - 1u) / RUNS), plan.visible); }
uint end_at(uint layer, uint tile, uint run) { return (layer * tiles() + tile) * RUNS + run; }
uint entry_at(uint place) { return push.views * tiles() * RUNS + place; }
uint capacity() { return uint(lists.length()) - entry_at(0u); } // entries that there is room for

// What a tile needs to know of a splat.
//
// A ray's point of the splat's plane is (p, q, 1) times a factor, each a linear function of the pixel: its value at the
// box's first pixel, and its steps to the right and downward. Lengths of the plane are in UNITs, so that the opacity falls by
// a power of two with their squares.
struct TileSplat {
    vec3 p;
    vec3 q;    // but for the exact projection turned until it stays the same downward: only the sum of the squares counts
    vec3 ahead;
    uint rg;   // colour and opacity, half floats
    uint ba;
    ivec4 box; // first column and row, last column and row: pixels; none where the first lies beyond the last
    float power; // log2 of the opacity
    float least; // opacity below which a pixel is left alone
    vec2 lean; // exact
    vec3 quadratic;
};

const float UNIT = sqrt(HALF_LOG2_E); // a standard deviation

// In fours of words: a processor fetches four at a time as fast as one.
uint tile_splat_parts() { return PROJECTION == PROJECTION_EXACT ? 5u : 4u; }
uint tile_splat_at(uint layer, uint rank) { return (layer * push.room + rank) * tile_splat_parts(); }

TileSplat load_tile_splat(uint layer, uint rank) {
    uint at = tile_splat_at(layer, rank);
    uvec4 a = tile_splats[at], b = tile_splats[at + 1u], c = tile_splats[at + 2u], d = tile_splats[at + 3u];
    TileSplat s;
    s.p = uintBitsToFloat(a.xyz);
    s.q = uintBitsToFloat(b.xyz);
    s.ahead = uintBitsToFloat(c.xyz);
    s.rg = a.w;
    s.ba = b.w;
    s.box = ivec4(c.w & 0xffffu, d.w & 0xffffu, c.w >> 16, d.w >> 16);
    s.power = uintBitsToFloat(d.x);
    s.least = uintBitsToFloat(d.y);
    s.lean = vec2(0.0);
    s.quadratic = vec3(0.0);
    if (PROJECTION == PROJECTION_EXACT) {
        uvec4 e = tile_splats[at + 4u];
        s.lean = uintBitsToFloat(uvec2(d.z, e.x));
        s.quadratic = uintBitsToFloat(e.yzw);
    }
    return s;
}

void store_tile_splat(uint layer, uint rank, TileSplat s) {
    uint at = tile_splat_at(layer, rank);
    tile_splats[at] = uvec4(floatBitsToUint(s.p), s.rg);
    tile_splats[at + 1u] = uvec4(floatBitsToUint(s.q), s.ba);
    tile_splats[at + 2u] = uvec4(floatBitsToUint(s.ahead), uint(s.box.x) | uint(s.box.z) << 16);
    tile_splats[at + 3u] = uvec4(floatBitsToUint(vec3(s.power, s.least, s.lean.x)), uint(s.box.y) | uint(s.box.w) << 16);
    if (PROJECTION == PROJECTION_EXACT) tile_splats[at + 4u] = floatBitsToUint(vec4(s.lean.y, s.quadratic));
}

#endif
