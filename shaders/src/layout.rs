//! Twin of `glsl/layout.glsl` and `glsl/records.glsl`: bindings, specialisation constants and structures.

use bytemuck::{Pod, Zeroable};

/// Invocations of a workgroup of the passes before drawing.
pub const WORKGROUP: u32 = 128;
/// Splats of a block of the order.
pub const BLOCK: u32 = 32;
/// Bytes of what is known of a block.
pub const BLOCK_BYTES: u32 = 16;
/// Of the counts of a frame: all of the scene is drawn.
pub const WHOLE_SCENE: u32 = 1 << 30;
/// Splats that one draw instance covers.
pub const QUADS_PER_INSTANCE: u32 = 256;
/// Most batches of an early-stop frame.
pub const MAX_BATCHES: usize = 128;
/// Steps of equal area that batches are made of.
pub const BINS: usize = 256;
/// Tiles that a view's image is divided into: 32 × 32.
pub const TILES: u32 = 32 * 32;
/// Bytes of the table of optical depth: bins × views × tiles × 4.
pub const DEPTH_TABLE_BYTES: u64 = BINS as u64 * 2 * TILES as u64 * 4;
/// Bytes of the lists of tiles that are marked after each batch: batches × views × tiles × 4.
pub const DUE_BYTES: u64 = MAX_BATCHES as u64 * 2 * TILES as u64 * 4;
/// 32-bit words of a record: of the affine, the tangent and the exact projection.
pub const RECORD_WORDS: [u32; 3] = [7, 8, 12];
/// Splats by tiles: pixels along a tile.
pub const TILE_PIXELS: u32 = 16;
/// Splats by tiles: runs that the order is cut into.
pub const TILE_RUNS: u32 = 64;
/// Splats by tiles: invocations of a workgroup.
pub const TILE_LANES: u32 = 8;
/// Splats by tiles: 32-bit words that tiles need to know of a splat, by projection.
pub const TILE_SPLAT_WORDS: [u32; 3] = [16, 16, 20];
/// 32-bit words of a splat's geometry in f32.
pub const GEOMETRY_WORDS_F32: u32 = 14;
/// 32-bit words of a splat's geometry in 16-bit forms.
pub const GEOMETRY_WORDS_F16: u32 = 8;
/// 32-bit words of a splat's motion in f32.
pub const MOTION_WORDS_F32: u32 = 15;
/// 32-bit words of a splat's motion in half floats, the time centre in f32.
pub const MOTION_WORDS_F16: u32 = 8;
/// log2 of the splats in one binding of the motion stream.
pub const MOTION_SHIFT: u32 = 21;
/// Bindings of the geometry and of the spherical-harmonics stream.
pub const STREAM_SLOTS: u32 = 4;
/// Bindings of the motion stream.
pub const MOTION_SLOTS: u32 = 2;

/// One view, as `ViewData` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ViewData {
    /// Rows of the scene-to-eye rotation; last what an f32 cannot hold of the eye's x, y, z.
    pub rotation: [[f32; 4]; 3],
    /// The eye in scene axes, relative to the scene's origin, metres.
    pub eye: [f32; 4],
    /// Left, right, up, down: tangents; angles where the lens is not perspective.
    pub tangents: [f32; 4],
    /// Focal length x and y, width, height: pixels of the rendered image.
    pub image: [f32; 4],
}

/// What a frame needs to know, as `Frame` in the shaders (std140).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct FrameData {
    /// Up to two views.
    pub views: [ViewData; 2],
    /// Point from which the radial key is measured, relative to the origin; half of a checkerboard's step, if that is odd.
    pub sort_center: [f32; 4],
    /// Near (m), near fade (m), least opacity, least contribution (px).
    pub cull: [f32; 4],
    /// Low-pass variance (px²), largest radius (px), transmittance below which a pixel is opaque, time.
    pub filters: [f32; 4],
    /// Splats, batches, corners; stochastic: sample and (uppermost bit) whether by depth.
    pub counts: [u32; 4],
    /// Interleaved sampling: pitch (16.16 fixed point), step of the cycle, `HISTORY_*`, bits of the history's share in motion.
    pub sampling: [u32; 4],
    /// Width and height of the shown image (px); interleaved: a sample's largest offset (slope); rendered pixels per
    /// pixel of the low-pass filter.
    pub shown: [f32; 4],
    /// Three rows a view: from the shown image (`0 ..= 1`, `0 ..= 1`, 1) to the one before.
    pub reprojection: [[f32; 4]; 6],
}

/// An indexed indirect draw, as Vulkan defines it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Draw {
    /// Indices per instance.
    pub index_count: u32,
    /// Instances.
    pub instance_count: u32,
    /// First index.
    pub first_index: u32,
    /// Added to every index.
    pub vertex_offset: i32,
    /// First instance.
    pub first_instance: u32,
}

/// An indirect draw without indices, as Vulkan defines it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct MarkDraw {
    /// Vertices per instance.
    pub vertex_count: u32,
    /// Instances: tiles.
    pub instance_count: u32,
    /// First vertex.
    pub first_vertex: u32,
    /// First instance.
    pub first_instance: u32,
}

/// Batches of a frame, written on the device, as `Plan` in the shaders (std430).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Plan {
    /// One indirect draw a batch.
    pub draws: [Draw; MAX_BATCHES],
    /// The marks after each batch.
    pub marks: [MarkDraw; MAX_BATCHES],
    /// First entry of each batch in the list of visible splats.
    pub starts: [u32; MAX_BATCHES + 1],
    /// Splats that are drawn.
    pub visible: u32,
    /// Predicted pixels of all polygons, before any early stop.
    pub area: f32,
    /// Of those, predicted pixels that early stop leaves.
    pub unhidden: f32,
    /// Tiles that are marked, all batches and views together.
    pub marked: u32,
    /// Pixels that splats were blended into, all of them together (splats by tiles).
    pub blended: u32,
    /// First entry after each bin in the list of visible splats.
    pub bin_ends: [u32; BINS],
}

/// 32-bit words of a splat's spherical harmonics above the constant band.
///
/// `values` = 3 · ((degree + 1)² − 1); `bits` is 32, 16 or 8 (8-bit streams begin with a half-float scale).
pub const fn sh_words(degree: u8, bits: u32) -> u32 {
    let n = degree as u32 + 1;
    let values = 3 * (n * n - 1);
    match bits {
        32 => values,
        16 => values.div_ceil(2),
        _ if values == 0 => 0,
        _ => (values + 2).div_ceil(4),
    }
}

/// Specialisation constants, in the order of their `constant_id`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct Specialization {
    /// `PROJECTION_*`.
    pub projection: u32,
    /// `LOW_PASS_*`.
    pub low_pass: u32,
    /// `SHAPE_*`.
    pub shape: u32,
    /// `RADIUS_*`.
    pub radius: u32,
    /// `PRECISION_*`.
    pub precision: u32,
    /// Spherical-harmonics degree that is evaluated.
    pub sh_degree: u32,
    /// Spherical-harmonics degree that is stored.
    pub sh_stored: u32,
    /// `SH_PRECISION_*`.
    pub sh_precision: u32,
    /// Bindings that the geometry stream fills.
    pub geometry_slots: u32,
    /// Bindings that the spherical-harmonics stream fills.
    pub sh_slots: u32,
    /// 1: a moving scene.
    pub motion: u32,
    /// Views per frame.
    pub views: u32,
    /// `COMPOSITE_*`.
    pub composite: u32,
    /// log2 of the splats in one geometry binding.
    pub geometry_shift: u32,
    /// log2 of the splats in one spherical-harmonics binding.
    pub sh_shift: u32,
    /// `SAMPLING_*`.
    pub sampling: u32,
    /// `LENS_*`.
    pub lens: u32,
    /// 1: only parts of the scene are drawn.
    pub parts: u32,
}
