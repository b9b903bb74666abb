// The compact record of a visible splat in one view, written by project.comp and read by splat.vert.
// 32 bytes: centre direction (3 f32), major axis (2 f32), minor/major (f32), colour and opacity (4 f16);
// exact: five more words.
#ifndef RECORDS_GLSL
#define RECORDS_GLSL
#include "projection.glsl"

uint record_words() { return PROJECTION == PROJECTION_EXACT ? 13u : 8u; }

// Batches and the indirect draws that go with them.
struct Draw {
    uint index_count;
    uint instance_count;
    uint first_index;
    int vertex_offset;
    uint first_instance;
};
struct Plan {
    Draw draws[MAX_BATCHES];
    uint starts[MAX_BATCHES + 1]; // first entry of each batch in the list of visible splats
    uint visible;                 // splats that are drawn
    float area;                   // predicted pixels of all polygons, before any early stop
    uint padding;
};

#endif
