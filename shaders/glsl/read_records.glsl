// The records of visible splats, as those read them who draw.
#ifndef READ_RECORDS_GLSL
#define READ_RECORDS_GLSL
#include "records.glsl"

layout(set = 2, binding = 1, std430) readonly buffer Records { uint words[]; } records[2];

uint record_word(uint view, uint at) { return view == 0u ? records[0].words[at] : records[1].words[at]; }
float record_float(uint view, uint at) { return uintBitsToFloat(record_word(view, at)); }

struct Record {
    vec3 m;         // centre: on the plane at depth 1, or a direction
    vec2 major;     // axis of the ellipse, standard deviations on the plane
    float ratio;    // minor over major
    uint rg;        // colour and opacity, half floats
    uint ba;
    vec2 lean;      // tangent and exact
    vec3 quadratic; // exact
};

Record load_record(uint view, uint splat) {
    uint word = splat * record_words();
    Record r;
    r.m = unpack_center(vec2(record_float(view, word), record_float(view, word + 1u)));
    r.major = vec2(record_float(view, word + 2u), record_float(view, word + 3u));
    r.ratio = record_float(view, word + 4u);
    r.rg = record_word(view, word + 5u);
    r.ba = record_word(view, word + 6u);
    r.lean = vec2(0.0);
    r.quadratic = vec3(0.0);
    if (PROJECTION == PROJECTION_TANGENT) r.lean = unpackHalf2x16(record_word(view, word + 7u));
    if (PROJECTION == PROJECTION_EXACT) {
        r.lean = vec2(record_float(view, word + 7u), record_float(view, word + 8u));
        r.quadratic = vec3(record_float(view, word + 9u), record_float(view, word + 10u), record_float(view, word + 11u));
    }
    return r;
}

vec4 record_color(Record r) { return vec4(unpackHalf2x16(r.rg), unpackHalf2x16(r.ba)); }

#endif
