// The compact record of a visible splat in one view, at its place in the scene; written by project.comp, read through
// read_records.glsl.
// Affine 28 bytes: centre (2 f32), major axis (2 f32), minor/major (f32), colour and opacity (4 f16); tangent 32: the lean
// too (2 f16); exact 48: lean and quadratic (5 f32).
#ifndef RECORDS_GLSL
#define RECORDS_GLSL
#include "projection.glsl"
#include "tiles.glsl"

uint record_words() { return PROJECTION == PROJECTION_EXACT ? 12u : PROJECTION == PROJECTION_TANGENT ? 8u : 7u; }

// A unit vector as a point of the octahedron's two pyramids, laid flat (Cigolle et al. 2014). Twin: pack_direction_f32.
vec2 folded(vec2 p) { return (1.0 - abs(p.yx)) * vec2(p.x < 0.0 ? -1.0 : 1.0, p.y < 0.0 ? -1.0 : 1.0); }

vec2 pack_center(vec3 m) {
    if (PROJECTION == PROJECTION_AFFINE) return m.xy;
    vec2 p = m.xy / (abs(m.x) + abs(m.y) + abs(m.z));
    return m.z < 0.0 ? folded(p) : p;
}

vec3 unpack_center(vec2 p) {
    if (PROJECTION == PROJECTION_AFFINE) return vec3(p, 1.0);
    float z = 1.0 - abs(p.x) - abs(p.y);
    return normalize(vec3(z < 0.0 ? folded(p) : p, z));
}

// Batches and the indirect draws that go with them.
struct Draw {
    uint index_count;
    uint instance_count;
    uint first_index;
    int vertex_offset;
    uint first_instance;
};
struct MarkDraw {
    uint vertex_count;
    uint instance_count;
    uint first_vertex;
    uint first_instance;
};
struct Plan {
    Draw draws[MAX_BATCHES];
    MarkDraw marks[MAX_BATCHES];  // tiles that are marked after each batch
    uint starts[MAX_BATCHES + 1]; // first entry of each batch in the list of visible splats
    uint visible;                 // splats that are drawn
    float area;                   // predicted pixels of all polygons, before any early stop
    float unhidden;               // of those, predicted pixels that early stop leaves
    uint marked;                  // tiles that are marked, all batches and views together
    uint blended;                 // pixels that splats were blended into, all of them together (splats by tiles)
    uint bin_ends[BINS];          // first entry after each bin in the list of visible splats
};

// The order in coarse steps of equal area, and the image in coarse tiles: how much light each step takes from each tile
// says where early stop will find something to do.
const float DEPTH_UNIT = 4096.0; // optical depth is summed in whole numbers, which come out the same in any order

// Where in the image a splat lies (in tiles) and what optical depth it adds to each of them, in one word; never 0.
uint pack_footprint(uvec4 tiles, float depth) {
    uint level = uint(clamp(round((log2(max(depth, 1e-6)) + 16.0) * 64.0), 0.0, 2047.0));
    return 1u | (tiles.x << 1) | (tiles.y << 6) | ((tiles.z - tiles.x) << 11) | ((tiles.w - tiles.y) << 16) | (level << 21);
}

// First and last tile, both inclusive.
uvec4 footprint_tiles(uint word) {
    uvec2 first = uvec2(word >> 1, word >> 6) & 31u;
    return uvec4(first, first + (uvec2(word >> 11, word >> 16) & 31u));
}

float footprint_depth(uint word) { return exp2(float(word >> 21) / 64.0 - 16.0); }

#endif
