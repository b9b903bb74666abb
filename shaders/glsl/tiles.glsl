// The image in coarse tiles, and lists of those that are marked after each batch.
#ifndef TILES_GLSL
#define TILES_GLSL

const uint TILE_SIDE = 32u; // tiles of a view along each side
const uint TILES = TILE_SIDE * TILE_SIDE;
// Entries that a batch's list has room for; an entry is view * TILES + tile.
const uint DUE_ROOM = 2u * TILES;

#endif
