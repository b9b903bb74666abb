#version 460
// Splats by tiles: one workgroup a tile, whose pixels stay in registers while its splats are blended front to back in full
// precision, until all of them are finished. A pixel that is finished takes nothing more; a piece that is, is left alone.
//
// Every invocation fetches one splat, and all of them blend the eight splats one after the other: a processor's vector fetches
// from as many places one by one, so that what each of them fetched for itself would take longer than what it is for.
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require
#include "interleaved.glsl"
#include "tile_lists.glsl"

layout(local_size_x = LANES) in;
layout(set = 3, binding = 5, std430) writeonly buffer TilePixels { vec4 pixels[]; }; // view, pixel; then what is counted

// A tile is cut into strips four pixels across, and those into pieces eight pixels along, which splats reach or do not. A piece
// is four vectors of pixels, which pay for one question and its branch and wait for their results together. Smaller pieces blend
// fewer pixels for nothing, and take longer by a fifth: what a processor expected of their branches is wrong too often.
const int STRIP = 4, STRIPS = SIDE / STRIP;
const int VECTOR = int(LANES) / STRIP, VECTORS = 4; // pixels along a vector; vectors in a piece
const int PIECE = VECTOR * VECTORS, PIECES = SIDE / PIECE; // pixels along a piece; pieces in a strip
const int HELD = STRIPS * PIECES * VECTORS; // pixels that an invocation holds

const bool SCATTERED = SAMPLING != SAMPLING_CENTERS && !CHECKERBOARD; // samples lie elsewhere in every pixel
// Whether q stays the same down a strip: splats' axes are turned so.
const bool TURNED = PROJECTION != PROJECTION_EXACT && !SCATTERED;

vec4 sums[HELD]; // colour; what comes through
uint open = 0u; // a bit for each piece that goes on: those with a pixel of the image to begin with
uint hits = 0u;
float beside[HELD]; // of samples, pixels to the right. In a checkerboard they go by rows, and all of an invocation's are equal
#ifdef COUNT
vec2 layers[HELD]; // shaded; blended
#endif

vec3 shuffled(vec3 v, uint lane) {
    return vec3(subgroupShuffle(v.x, lane), subgroupShuffle(v.y, lane), subgroupShuffle(v.z, lane));
}

// A bit for each piece that a box of pixels, from the tile's corner, reaches into.
uint reached(ivec4 box) {
    ivec2 first = max(box.xy, 0) / ivec2(STRIP, PIECE);
    ivec2 beyond = (min(box.zw, SIDE - 1) + ivec2(STRIP, PIECE)) / ivec2(STRIP, PIECE);
    if (box.x > box.z || box.y > box.w || first.x >= beyond.x || first.y >= beyond.y) return 0u;
    uint pieces = (1u << beyond.y) - (1u << first.y);
    uint all = 0u;
    [[unroll]] for (int strip = 0; strip < STRIPS; strip++)
        if (strip >= first.x && strip < beyond.x) all |= pieces << (strip * PIECES);
    return all;
}

float pow2(float x) { return x * x; }

// A pixel that an invocation holds, from the tile's corner.
ivec2 held(int i, ivec2 own) {
    return own + ivec2(i / (PIECES * VECTORS) * STRIP, i % (PIECES * VECTORS) * VECTOR);
}

// A division makes every pixel of a tangent splat wait. Where ahead changes little over the pieces that all eight splats
// reach, 1 / ahead² is as good as a line: within 1.5 L² + 4 L³, L being the change, so that opacities stay within 1 / 400. It is
// not where surfaces are seen at a grazing angle.
const float MOST_CHANGE = 1.0 / 16.0;

// The first and the last pixel of the pieces that a splat reaches, from the tile's corner.
vec4 reached_box(TileSplat s, ivec2 corner) {
    ivec2 inside = ivec2(STRIP, PIECE) - 1;
    return vec4(max(s.box.xy - corner, 0) & ~inside, min(s.box.zw - corner, SIDE - 1) | inside);
}

float ahead_amid(TileSplat s, vec4 box) { return s.ahead.x + dot(s.ahead.yz, 0.5 * (box.xy + box.zw)); }

// Whether that of any of the eight splats changes too much, or lies behind the eye.
bool far_from_line(TileSplat s, ivec2 corner, uint own_reached) {
    vec4 box = reached_box(s, corner);
    float change = dot(abs(s.ahead.yz), 0.5 * (box.zw - box.xy) + 0.5); // samples may lie half a pixel beside
    bool far = own_reached != 0u && !(change <= MOST_CHANGE * ahead_amid(s, box));
    uint any = uint(far);
    [[unroll]] for (uint i = 1u; i < LANES; i *= 2u) any |= subgroupShuffle(any, gl_SubgroupInvocationID ^ i);
    return any != 0u;
}

// With that line in the place of ahead.
TileSplat with_line(TileSplat s, ivec2 corner) {
    float closer = 1.0 / ahead_amid(s, reached_box(s, corner));
    s.p *= closer;
    s.q *= closer;
    s.ahead *= -2.0 * closer;
    s.ahead.x += 3.0 + 1.5 * MOST_CHANGE * MOST_CHANGE;
    return s;
}

// Blends eight splats, one after the other. `line`: ahead is 1 / ahead², a line.
void blend(TileSplat s, uint own_reached, uint count, ivec2 own, float stop_below, bool line) {
    vec3 own_color = vec3(unpackHalf2x16(s.rg), unpackHalf2x16(s.ba).x);
    for (uint i = 0u; i < count; i++) {
        uint blends = subgroupShuffle(own_reached, i) & open;
        vec3 p = shuffled(s.p, i), q = shuffled(s.q, i), ahead = shuffled(s.ahead, i);
        if (TURNED) q.z = 0.0;
        vec3 color = shuffled(own_color, i);
        float power = subgroupShuffle(s.power, i);
        float least = subgroupShuffle(s.least, i);
        vec2 lean = vec2(0.0);
        vec3 quadratic = vec3(0.0);
        if (PROJECTION == PROJECTION_EXACT) {
            lean = vec2(subgroupShuffle(s.lean.x, i), subgroupShuffle(s.lean.y, i));
            quadratic = shuffled(s.quadratic, i);
        }
        [[unroll]] for (int strip = 0; strip < STRIPS; strip++) {
            [[dont_flatten]] if ((blends & ((1u << PIECES) - 1u) << (strip * PIECES)) != 0u) {
                vec2 place = vec2(held(strip * PIECES * VECTORS, own));
                if (CHECKERBOARD) place.x += beside[0];
                vec3 first = vec3(p.x + dot(p.yz, place), q.x + dot(q.yz, place), ahead.x + dot(ahead.yz, place));
                vec3 down = vec3(p.z, q.z, ahead.z);
                float first_q = first.y * first.y;
                [[unroll]] for (int piece = 0; piece < PIECES; piece++) {
                    [[dont_flatten]] if ((blends & 1u << (strip * PIECES + piece)) != 0u) {
                        [[unroll]] for (int vector = 0; vector < VECTORS; vector++) {
                            int pixel = (strip * PIECES + piece) * VECTORS + vector;
                            vec3 on = first + down * float(piece * PIECE + vector * VECTOR);
                            if (SCATTERED) on += vec3(p.y, q.y, ahead.y) * beside[pixel];
                            float fall = on.x * on.x + (TURNED ? first_q : on.y * on.y);
                            // A ray that meets the plane behind the eye is far from all of the splat.
                            if (line) fall *= on.z;
                            else if (PROJECTION == PROJECTION_TANGENT) fall /= pow2(max(on.z, 1e-18));
                            bool before = true;
                            if (PROJECTION == PROJECTION_EXACT) {
                                float leans = dot(lean, on.xy);
                                before = on.z - leans > 0.0;
                                fall /= on.z * on.z - 2.0 * on.z * leans + quadratic.x * on.x * on.x
                                    + quadratic.y * on.x * on.y + quadratic.z * on.y * on.y;
                            }
                            // Far outside nothing is left; not so little that it is a subnormal number, which takes many
                            // times as long.
                            float alpha = exp2(max(power - fall, -64.0));
                            vec4 sum = sums[pixel];
                            // All at once: "&&" would make branches of it.
                            bool hit = all(bvec3(before, greaterThanEqual(vec2(alpha, sum.a), vec2(least, stop_below))));
                            hits += uint(hit);
                            alpha = hit ? min(alpha, MAX_ALPHA) : 0.0;
                            float weight = sum.a * alpha;
                            sums[pixel] = vec4(sum.rgb + color * weight, sum.a - weight);
#ifdef COUNT
                            layers[pixel] += vec2(1.0, hit);
#endif
                        }
                    }
                }
            }
        }
    }
}

void main() {
    uvec2 tile = gl_WorkGroupID.xy;
    uint layer = gl_WorkGroupID.z;
    uint lane = gl_SubgroupInvocationID;
    ivec2 own = ivec2(int(lane) % STRIP, int(lane) / STRIP);
    ivec2 corner = ivec2(tile) * SIDE;
    [[unroll]] for (int i = 0; i < HELD; i++) {
        sums[i] = vec4(0.0, 0.0, 0.0, 1.0);
        beside[i] = 0.0;
        if (SAMPLING != SAMPLING_CENTERS) beside[i] = sample_offset(uvec2(corner + held(i, own)));
#ifdef COUNT
        layers[i] = vec2(0.0);
#endif
    }
    // The last run's end, and where it lay in the tile before.
    uint last = end_at(layer, tile.y * push.columns + tile.x, RUNS - 1u);
    uint at = last >= RUNS ? lists[last - RUNS] : 0u;
    uint end = lists[last];
    // A list that had no room: all splats, most of which miss the tile.
    bool listed = end <= capacity();
    if (!listed) {
        at = 0u;
        end = plan.visible;
    }
    float stop_below = push.stop_below; // asked for once, not by every pixel
    [[unroll]] for (int i = 0; i < HELD; i += VECTORS) {
        ivec2 first = corner + held(i, ivec2(0));
        if (first.x < int(push.width) && first.y < int(push.height)) open |= 1u << i / VECTORS;
    }
    for (; at < end; at += LANES) {
        uint entry = min(at + lane, end - 1u);
        uint rank = entry;
        if (listed) rank = lists[entry_at(entry)];
        TileSplat s = load_tile_splat(layer, rank);
        vec2 to_corner = vec2(corner - s.box.xy);
        s.p.x += dot(s.p.yz, to_corner);
        s.q.x += dot(s.q.yz, to_corner);
        s.ahead.x += dot(s.ahead.yz, to_corner);
        uint own_reached = reached(s.box - corner.xyxy);
        uint count = min(LANES, end - at);
        if (PROJECTION == PROJECTION_TANGENT) {
            if (far_from_line(s, corner, own_reached)) blend(s, own_reached, count, own, stop_below, false);
            else blend(with_line(s, corner), own_reached, count, own, stop_below, true);
        } else {
            blend(s, own_reached, count, own, stop_below, false);
        }
        uint mine = 0u;
        [[unroll]] for (int i = 0; i < HELD; i++) mine |= sums[i].a < stop_below ? 0u : 1u << i / VECTORS;
        uint anyones = 0u;
        [[unroll]] for (uint i = 0u; i < LANES; i++) anyones |= subgroupShuffle(mine, i);
        open &= anyones;
        if (open == 0u) break;
    }
    atomicAdd(plan.blended, hits);
    uint image = push.width * push.height;
    [[unroll]] for (int i = 0; i < HELD; i++) {
        uvec2 pixel = uvec2(corner + held(i, own));
        if (pixel.x < push.width && pixel.y < push.height) {
            uint place = layer * image + pixel.y * push.width + pixel.x;
            pixels[place] = vec4(sums[i].rgb, 1.0 - sums[i].a);
#ifdef COUNT
            pixels[push.views * image + place] = vec4(layers[i], 0.0, 0.0);
#endif
        }
    }
}
