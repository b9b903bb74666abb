// Which pixels of the shown image a frame of reduced resolution samples. Twin: renderer/src/resolution.rs.
#ifndef INTERLEAVED_GLSL
#define INTERLEAVED_GLSL
#include "layout.glsl"

// In a checkerboard the general rules come to what stands beside them, without a division and in a few operations: every
// fragment of every splat asks.
const bool CHECKERBOARD = SAMPLING == SAMPLING_CHECKERBOARD;
uint odd_row(uint row) { return (row + frame.sampling.y) & 1u; }

// First shown column of a cell. The pitch is 16.16 fixed point: integers, so that host and device agree exactly.
uint cell_begin(uint cell) { return (cell * frame.sampling.x + 0x8000u) >> 16; }

// The cell of a shown column.
uint cell_of(uint column) {
    if (CHECKERBOARD) return column >> 1;
    return (((column + 1u) << 16) - 0x8001u) / frame.sampling.x;
}

// The shown column that a rendered pixel samples.
uint sample_column(uint cell, uint row) {
    if (CHECKERBOARD) return 2u * cell + odd_row(row);
    uint begin = cell_begin(cell);
    uint count = cell_begin(cell + 1u) - begin;
    uint t = frame.sampling.y;
    uint eighths = 4u * ((row + t) & 1u) + 2u * (((row >> 1) + (t >> 1)) & 1u) + ((t >> 2) & 1u);
    return begin + (eighths * count >> 3);
}

// How far a sample lies to the right of its rendered pixel's centre, rendered pixels.
float sample_offset(uvec2 pixel) {
    // ±1/4 by rows: half of y + 1/2 has the fraction 1/4 or 3/4; an odd step exchanges them.
    if (CHECKERBOARD) return fract(0.5 * (float(pixel.y) + 0.5) + frame.sort_center.w) - 0.5;
    return (float(sample_column(pixel.x, pixel.y)) + 0.5) * (65536.0 / float(frame.sampling.x)) - (float(pixel.x) + 0.5);
}

#ifdef FRAGMENT
float sample_offset() {
    if (CHECKERBOARD) return fract(0.5 * gl_FragCoord.y + frame.sort_center.w) - 0.5;
    return sample_offset(uvec2(gl_FragCoord.xy));
}
#endif

#endif
