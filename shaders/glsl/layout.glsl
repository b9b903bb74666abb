// Everything that shaders and host share: specialisation constants, bindings, structures.
// Twin: shaders/src/layout.rs (checked against SPIR-V reflection).
#ifndef LAYOUT_GLSL
#define LAYOUT_GLSL

#extension GL_GOOGLE_include_directive : require
#ifdef MULTIVIEW
#extension GL_EXT_multiview : require
#endif

layout(constant_id = 0) const uint PROJECTION = 0;      // PROJECTION_*
layout(constant_id = 1) const uint LOW_PASS = 0;        // LOW_PASS_*
layout(constant_id = 2) const uint SHAPE = 0;           // SHAPE_*
layout(constant_id = 3) const uint RADIUS = 0;          // RADIUS_*
layout(constant_id = 4) const uint PRECISION = 0;       // PRECISION_*
layout(constant_id = 5) const uint SH_DEGREE = 0;       // degree that is evaluated
layout(constant_id = 6) const uint SH_STORED = 0;       // degree that is stored
layout(constant_id = 7) const uint SH_PRECISION = 0;    // SH_PRECISION_*
layout(constant_id = 8) const uint GEOMETRY_SLOTS = 1;  // bindings that the geometry stream fills
layout(constant_id = 9) const uint SH_SLOTS = 1;        // bindings that the SH stream fills
layout(constant_id = 10) const bool MOTION = false;     // a moving scene
layout(constant_id = 11) const uint VIEWS = 1;          // views per frame
layout(constant_id = 12) const uint COMPOSITE = 0;      // COMPOSITE_*
layout(constant_id = 13) const uint GEOMETRY_SHIFT = 21; // log2 of the splats in one geometry binding
layout(constant_id = 14) const uint SH_SHIFT = 19;      // log2 of the splats in one SH binding
layout(constant_id = 15) const uint SAMPLING = 0;       // SAMPLING_*
layout(constant_id = 16) const uint LENS = 0;           // LENS_*
layout(constant_id = 17) const bool PARTS = false;      // only parts of the scene are drawn

const uint PROJECTION_AFFINE = 0;
const uint PROJECTION_TANGENT = 1;
const uint PROJECTION_EXACT = 2;
const uint LOW_PASS_PLANAR = 0;
const uint LOW_PASS_PLANAR_COMPENSATED = 1;
const uint LOW_PASS_VOLUMETRIC = 2;
const uint LOW_PASS_VOLUMETRIC_COMPENSATED = 3;
const uint LOW_PASS_OFF = 4;
const uint SHAPE_OCTAGON = 0;
const uint SHAPE_SQUARE = 1;
const uint SHAPE_DIAMOND = 2;
const uint SHAPE_AXIS_ALIGNED = 3;
const uint SHAPE_ADAPTIVE = 4;
const uint RADIUS_OPACITY_AWARE = 0;
const uint RADIUS_SQRT8 = 1;
const uint RADIUS_FULL = 2;
const uint RADIUS_TILES = 3;
const uint PRECISION_F32 = 0;
const uint PRECISION_F16 = 1;
const uint PRECISION_F16_NAIVE = 2;
const uint SH_PRECISION_F32 = 0;
const uint SH_PRECISION_F16 = 1;
const uint SH_PRECISION_U8 = 2;
const uint COMPOSITE_FRONT_TO_BACK = 0;
const uint COMPOSITE_BACK_TO_FRONT = 1;
const uint COMPOSITE_STOCHASTIC = 2;
const uint SAMPLING_CENTERS = 0;
const uint SAMPLING_INTERLEAVED = 1;
const uint SAMPLING_CHECKERBOARD = 2; // interleaved, every cell of two columns
const uint LENS_PERSPECTIVE = 0;
const uint LENS_FISHEYE = 1;
const uint LENS_EQUIRECTANGULAR = 2;
const uint HISTORY_NONE = 0;
const uint HISTORY_STILL = 1;
const uint HISTORY_MOVING = 2;

// Invocations of a workgroup of the passes before drawing.
const uint WORKGROUP = 128;
// Splats of a block of the order, one bit each; also the granularity of batches.
const uint BLOCK = 32;
// Of the counts of a frame: all of the scene is drawn.
const uint WHOLE_SCENE = 1u << 30;
// Splats that one draw instance covers.
const uint QUADS_PER_INSTANCE = 256;
// Polygons up to this many pixels are squares where the shape is adaptive: an octagon saves a sixth of their pixels, and costs
// four more corners and four more triangles, which leave helper invocations along each of their sides.
const float SMALL_POLYGON = 256.0;
// Most batches of an early-stop frame.
const uint MAX_BATCHES = 128;
// Steps of equal area that batches are made of.
const uint BINS = 256;
// Most that the tangent projection's plane leans back at one standard deviation, over the mean's distance.
const float MAX_LEAN = 0.25;
// Least blended opacity: below one step of an 8-bit image nothing lands.
const float MIN_ALPHA = 1.0 / 255.0;
// Largest blended opacity (the trainers' cap).
const float MAX_ALPHA = 0.99;
// log2(e) / 2: exp(-x/2) = exp2(-x * HALF_LOG2_E).
const float HALF_LOG2_E = 0.72134752;

struct ViewData {
    vec4 rotation[3]; // rows of the scene-to-eye rotation; in w what an f32 cannot hold of the eye's x, y, z
    vec4 eye;         // the eye in scene axes, relative to the scene's origin, metres
    vec4 tangents;    // left, right, up, down; with a lens angles
    vec4 image;       // focal length x and y, width, height: pixels of the rendered image
};

layout(set = 0, binding = 0, std140) uniform Frame {
    ViewData views[2];
    vec4 sort_center; // point from which the radial key is measured; scene axes, relative to the origin; w: half a checkerboard's odd steps
    vec4 cull;        // near (m), near fade (m), least opacity, least contribution (px)
    vec4 filters;     // low-pass variance (px² of the rendered image), max radius (px), transmittance below which a pixel is opaque, time
    uvec4 counts;     // splats, batches, corners, stochastic: sample, WHOLE_SCENE, and (uppermost bit) whether by depth
    uvec4 sampling;   // interleaved: pitch (16.16), step of the cycle, HISTORY_*, share of history in motion (float)
    vec4 shown;       // width, height of the shown image (px); a sample's largest offset (slope); rendered px per filtered px
    vec4 reprojection[6]; // three rows a view: from the shown image (0 .. 1, 0 .. 1, 1) to the one before
} frame;

#endif
