// Which pixels of the shown image a frame of reduced resolution samples. Twin: renderer/src/resolution.rs.
#ifndef INTERLEAVED_GLSL
#define INTERLEAVED_GLSL
#include "layout.glsl"

// First shown column of a cell. The pitch is 16.16 fixed point: integers, so that host and device agree exactly.
uint cell_begin(uint cell) { return (cell * frame.sampling.x + 0x8000u) >> 16; }

// The cell of a shown column.
uint cell_of(uint column) { return (((column + 1u) << 16) - 0x8001u) / frame.sampling.x; }

// The shown column that a rendered pixel samples.
uint sample_column(uint cell, uint row) {
    uint begin = cell_begin(cell);
    uint count = cell_begin(cell + 1u) - begin;
    uint t = frame.sampling.y;
    uint eighths = 4u * ((row + t) & 1u) + 2u * (((row >> 1) + (t >> 1)) & 1u) + ((t >> 2) & 1u);
    return begin + (eighths * count >> 3);
}

// How far a sample lies to the right of its rendered pixel's centre, rendered pixels.
float sample_offset(uvec2 pixel) {
    return (float(sample_column(pixel.x, pixel.y)) + 0.5) * (65536.0 / float(frame.sampling.x)) - (float(pixel.x) + 0.5);
}

#endif
