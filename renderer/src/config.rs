//! Every choice that the renderer offers, in one [`RenderConfig`]: parsed from the command line, shown in the
//! panel, swept by the bench, written to the report. A new axis is one enum here.

use crate::renderer::tiles_fit;
use crate::view::View;
use std::fmt;
use std::str::FromStr;

/// A choice among named values; implemented by every enum of [`RenderConfig`].
pub trait Axis: Copy + Eq + Sized + 'static {
    /// The axis's name, as on the command line.
    const NAME: &'static str;
    /// Every value, in the order in which they are listed.
    const ALL: &'static [Self];
    /// The value's name, as on the command line.
    fn name(self) -> &'static str;
    /// What the value means, one line.
    fn about(self) -> &'static str;
}

/// A name that is not among an axis's values.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{axis} cannot be '{given}'; it is one of: {choices}")]
pub struct UnknownChoice {
    /// The axis.
    pub axis: &'static str,
    /// What was given.
    pub given: String,
    /// What may be given.
    pub choices: String,
}

macro_rules! axis {
    ($(#[$meta:meta])* $enum:ident = $axis:literal { $($(#[doc = $about:literal])+ $variant:ident = $name:literal,)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
        pub enum $enum { $($(#[doc = $about])+ #[serde(rename = $name)] $variant,)+ }

        impl Axis for $enum {
            const NAME: &'static str = $axis;
            const ALL: &'static [Self] = &[$(Self::$variant),+];
            fn name(self) -> &'static str { match self { $(Self::$variant => $name),+ } }
            fn about(self) -> &'static str { match self { $(Self::$variant => concat!($($about),+).trim_ascii()),+ } }
        }

        impl fmt::Display for $enum {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result { f.pad(self.name()) }
        }

        impl FromStr for $enum {
            type Err = UnknownChoice;
            fn from_str(s: &str) -> Result<Self, UnknownChoice> {
                Self::ALL.iter().copied().find(|v| v.name() == s).ok_or_else(|| UnknownChoice {
                    axis: $axis,
                    given: s.to_owned(),
                    choices: Self::ALL.iter().map(|v| v.name()).collect::<Vec<_>>().join(", "),
                })
            }
        }
    };
}

axis!(
    /// Where a splat becomes a polygon.
    Expansion = "expansion" {
        /// Compute pass writes compact records, then indexed quads.
        Precomputed = "precomputed",
        /// Vertex stage projects at every corner.
        Instanced = "instanced",
        /// Geometry stage, one invocation per splat (single view; where the device has it).
        Geometry = "geometry",
        /// Compute passes list every tile's splats and blend them in full precision, without a rasteriser: the fastest
        /// way on drivers that render on the processor.
        Tiles = "tiles",
    }
);

impl Expansion {
    /// Whether a compute pass writes the visible splats' records, and predicts what they cost.
    pub fn writes_records(self) -> bool {
        matches!(self, Self::Precomputed | Self::Tiles)
    }
}

axis!(
    /// How a splat's 3-D Gaussian becomes a 2-D one.
    Projection = "projection" {
        /// Classic: linearised at the mean on the plane z = 1 (Zwicker 2002, Kerbl 2023).
        Affine = "affine",
        /// Optimal: seen on the plane tangent to the unit sphere at the mean (Huang 2024), which leans back along the splat.
        Tangent = "tangent",
        /// Maximum response along the pixel's ray (Hahlbohm 2024).
        Exact = "exact",
    }
);

axis!(
    /// How directions become places in the image.
    Lens = "lens" {
        /// Straight lines stay straight: what screens and headsets show.
        Perspective = "perspective",
        /// Equidistant fisheye: the distance from the middle is the angle from the axis (pictures only).
        Fisheye = "fisheye",
        /// Longitude across, latitude down (pictures only).
        Equirectangular = "equirectangular",
    }
);

axis!(
    /// The filter that keeps small splats from flickering.
    LowPass = "low-pass" {
        /// 2-D: 0.3 px² added to the projected covariance.
        Planar = "2d",
        /// 2-D with opacity compensation (Mip-Splatting).
        PlanarCompensated = "2d-compensated",
        /// 3-D: scales widened by their depth before projecting.
        Volumetric = "3d",
        /// 3-D with opacity compensation.
        VolumetricCompensated = "3d-compensated",
        /// No filter.
        Off = "none",
    }
);

axis!(
    /// The polygon that covers a splat.
    QuadShape = "shape" {
        /// 8 corners, 3.31 k²: loses nothing.
        Octagon = "octagon",
        /// 4 corners along the ellipse's axes, 4 k².
        Square = "square",
        /// 4 corners on the ellipse's axes, 2 k²: cuts the rims.
        Diamond = "diamond",
        /// Rectangle along the screen's axes.
        AxisAligned = "axis-aligned",
        /// Octagons, and squares where splats are small (up to 256 pixels): fewer corners and triangles.
        Adaptive = "adaptive",
    }
);

impl QuadShape {
    /// Corners of a splat's polygon.
    pub fn corners(self) -> u32 {
        match self {
            Self::Octagon | Self::Adaptive => 8,
            Self::Square | Self::Diamond | Self::AxisAligned => 4,
        }
    }
}

axis!(
    /// How far a splat's polygon reaches, in standard deviations.
    RadiusRule = "radius" {
        /// Until its own opacity falls below 1/255, at most √8.
        OpacityAware = "opacity-aware",
        /// √8 for every splat.
        Sqrt8 = "sqrt8",
        /// Until its own opacity falls below 1/255, uncapped.
        Full = "full",
        /// As the trainers: the 16 × 16 tiles that a square of 3 standard deviations touches (affine only).
        Tiles = "tiles",
    }
);

axis!(
    /// What splats are ordered by.
    OrderKey = "order" {
        /// Distance from the point between the eyes: turning the head changes nothing.
        Radial = "radial",
        /// Depth along the view axis, as the trainers do.
        Depth = "depth",
    }
);

axis!(
    /// Bits of the sort key.
    KeyBits = "key-bits" {
        /// 32 bits: order-preserving float.
        B32 = "32",
        /// 16 bits on a logarithmic scale.
        B16 = "16",
    }
);

axis!(
    /// Who sorts.
    Sorter = "sort" {
        /// Worker thread, newest finished order is used.
        Cpu = "cpu",
        /// Radix sort on the device.
        Gpu = "gpu",
        /// Nobody: hashed transparency, averaged over frames.
        Stochastic = "stochastic",
    }
);

axis!(
    /// Which splats of a moving scene a frame looks at.
    TimeCull = "time-cull" {
        /// Those that an index lists as alive around the frame's time.
        Index = "index",
        /// All of them.
        Off = "none",
    }
);

#[allow(clippy::derivable_impls, reason = "the macro has no room for the attribute")]
impl Default for TimeCull {
    fn default() -> Self {
        Self::Index
    }
}

axis!(
    /// In which direction splats are blended.
    Composite = "composite" {
        /// Front to back in batches, saturated pixels are skipped.
        EarlyStop = "early-stop",
        /// Back to front, every layer.
        BackToFront = "back-to-front",
        /// Front to back, every layer.
        FrontToBack = "front-to-back",
    }
);

axis!(
    /// Where early stop looks for saturated pixels between batches.
    Marks = "marks" {
        /// In the tiles that are predicted to fill up (precomputed expansion; the others know of none and look everywhere).
        Due = "due",
        /// Everywhere.
        Everywhere = "everywhere",
    }
);

axis!(
    /// How splats are stored on the device.
    Precision = "precision" {
        /// f32 throughout.
        F32 = "f32",
        /// 16-bit attributes done right: f32 means, compact rotation and log-scale, f32 arithmetic.
        F16 = "f16",
        /// Everything in half floats, in the affine projection the covariance too: shows the Quest report's halo.
        F16Naive = "f16-naive",
    }
);

axis!(
    /// How spherical harmonics above the constant band are stored on the device.
    ShPrecision = "sh-precision" {
        /// f32.
        F32 = "f32",
        /// f16.
        F16 = "f16",
        /// 8 bits, scaled per splat.
        U8 = "u8",
    }
);

axis!(
    /// Format of the image that splats are blended into.
    TargetFormat = "target-format" {
        /// 16-bit floats.
        Rgba16F = "rgba16f",
        /// 32-bit floats, to measure what the others lose (where the device blends them).
        Rgba32F = "rgba32f",
        /// 8 bits.
        Rgba8 = "rgba8",
        /// 10 bits, 2 of alpha.
        Rgb10A2 = "rgb10a2",
    }
);

axis!(
    /// How a reduced resolution is brought back to full size.
    Upscale = "upscale" {
        /// Interleaved sampling, reconstructed from known sample positions.
        Interleaved = "interleaved",
        /// Interleaved sampling, gathered over eight frames.
        InterleavedTemporal = "interleaved-temporal",
        /// Bilinear.
        Bilinear = "bilinear",
    }
);

/// Transmittance below which a pixel is opaque by default: three quarters of a step of 255, so that what a stop leaves
/// and what rounding adds stay below one step together.
pub const STOP_BELOW: f32 = 0.003;

/// Of that transmittance, where tiles finish a pixel. They stop every pixel by itself, at the very layer, while batches of
/// polygons blend some behind it: at a fifth, both leave about as much out (FLIP to every layer), and tiles blend less.
pub const TILES_STOP: f32 = 0.2;

/// Everything that decides how a frame is drawn.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderConfig {
    /// Where a splat becomes a polygon.
    pub expansion: Expansion,
    /// How a splat is projected.
    pub projection: Projection,
    /// The lens. All but perspective are for pictures: one view, in front of which nothing else is.
    pub lens: Lens,
    /// The low-pass filter.
    pub low_pass: LowPass,
    /// The polygon that covers a splat.
    pub shape: QuadShape,
    /// How far that polygon reaches.
    pub radius: RadiusRule,
    /// Largest projected radius, as a fraction of the larger image side; the covariance is capped with it. ∞: no cap.
    pub max_radius: f32,
    /// What splats are ordered by.
    pub order: OrderKey,
    /// Bits of the sort key.
    pub key_bits: KeyBits,
    /// Who sorts.
    pub sorter: Sorter,
    /// An own order for each eye instead of one from the midpoint. Two passes then, and twice the sorting.
    pub sort_per_eye: bool,
    /// A new order every n-th frame (1: always the newest).
    pub sort_interval: u32,
    /// Stochastic: frames that a picture is averaged from, `1 ..= 4096`. A
    /// window's is the mean of its last ones, so far as eye and scene keep still.
    pub samples: u32,
    /// Which splats of a moving scene a frame looks at.
    pub time_cull: TimeCull,
    /// The direction of blending.
    pub composite: Composite,
    /// Early stop: batches per frame, `2 ..= 128`.
    pub batches: u32,
    /// Early stop: where saturated pixels are looked for between batches.
    pub marks: Marks,
    /// Transmittance below which a pixel counts as opaque: it is shown so, and early stop finishes it
    /// (tiles at [`TILES_STOP`] of it). 0: never.
    pub stop_below: f32,
    /// Storage of geometry on the device.
    pub precision: Precision,
    /// Storage of spherical harmonics on the device.
    pub sh_precision: ShPrecision,
    /// Highest spherical-harmonics degree that is evaluated, `0 ..= 3`.
    pub sh_degree: u8,
    /// Format of the blended image.
    pub target: TargetFormat,
    /// Side of the rendered image over the side of the shown one, `0.5 ..= 1`.
    pub resolution_scale: f32,
    /// The way back to full size.
    pub upscale: Upscale,
    /// Sharpening of the shown image, within the range of its neighbouring pixels: 0 (none) to 1.
    pub sharpen: f32,
    /// Splats of lower opacity are left out.
    pub min_opacity: f32,
    /// Splats whose whole contribution (opacity · 2π √det, pixels) is lower are left out.
    pub min_contribution: f32,
    /// Nearest depth (distance, for radial projections) that is drawn, metres.
    pub near: f32,
    /// Splats fade in over this distance beyond `near`, metres. 0: none.
    pub near_fade: f32,
    /// Colour behind the splats, sRGB-encoded.
    pub background: [f32; 3],
    /// Time in a moving scene, `0 ..= 1`.
    pub time: f32,
}

impl Default for RenderConfig {
    fn default() -> Self {
        Self {
            expansion: Expansion::Precomputed,
            projection: Projection::Tangent,
            lens: Lens::Perspective,
            low_pass: LowPass::Planar,
            shape: QuadShape::Octagon,
            radius: RadiusRule::OpacityAware,
            max_radius: f32::INFINITY,
            order: OrderKey::Radial,
            key_bits: KeyBits::B32,
            sorter: Sorter::Cpu,
            sort_per_eye: false,
            sort_interval: 1,
            samples: 16,
            time_cull: TimeCull::Index,
            composite: Composite::EarlyStop,
            batches: 32,
            marks: Marks::Due,
            stop_below: STOP_BELOW,
            precision: Precision::F32,
            sh_precision: ShPrecision::F32,
            sh_degree: 3,
            target: TargetFormat::Rgba16F,
            resolution_scale: 1.0,
            upscale: Upscale::Interleaved,
            sharpen: 0.0,
            min_opacity: 1.0 / 255.0,
            min_contribution: 0.0,
            near: 0.05,
            near_fade: 0.05,
            background: [0.0; 3],
            time: 0.0,
        }
    }
}

/// Choices that make no sense, alone or together; the text says why.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{0}")]
pub struct ConfigError(pub String);

impl RenderConfig {
    /// Whether these choices make sense together, for so many views on this device.
    ///
    /// # Errors
    /// The first choice that does not, with the reason.
    pub fn check(&self, views: usize, capabilities: &crate::gpu::Capabilities) -> Result<(), ConfigError> {
        let refuse = |reason: String| Err(ConfigError(reason));
        let in_range = |v: f32, low: f32, high: f32| v >= low && v <= high;
        if !(1..=2).contains(&views) {
            return refuse(format!("a frame has one view or two, not {views}"));
        }
        if self.expansion == Expansion::Geometry && !capabilities.geometry_shader {
            return refuse(format!(
                "expansion geometry: {} has no geometry stage; choose precomputed or instanced",
                capabilities.device
            ));
        }
        if self.expansion == Expansion::Tiles {
            self.check_tiles(capabilities)?;
        }
        if self.target == TargetFormat::Rgba32F && !capabilities.blend_rgba32f {
            return refuse(format!(
                "target-format rgba32f: {} does not blend 32-bit floats; choose rgba16f",
                capabilities.device
            ));
        }
        if self.lens != Lens::Perspective {
            self.check_lens(views)?;
        }
        if self.radius == RadiusRule::Tiles && self.projection != Projection::Affine {
            return refuse(format!(
                "radius tiles: the trainers' tiles exist in the affine projection, not in {}",
                self.projection
            ));
        }
        if !(2..=motes_shaders::layout::MAX_BATCHES as u32).contains(&self.batches) {
            return refuse(format!(
                "batches must be 2 to {}, not {}",
                motes_shaders::layout::MAX_BATCHES,
                self.batches
            ));
        }
        if !in_range(self.stop_below, 0.0, 1.0) {
            return refuse(format!("stop-below is a transmittance, 0 to 1, not {}", self.stop_below));
        }
        if self.sort_interval == 0 {
            return refuse("sort-interval is a number of frames from 1, not 0".into());
        }
        if !(1..=4096).contains(&self.samples) {
            return refuse(format!("samples must be 1 to 4096, not {}", self.samples));
        }
        if self.sorter == Sorter::Stochastic {
            self.check_stochastic()?;
        }
        if !(0.0..=3.0).contains(&f32::from(self.sh_degree)) {
            return refuse(format!("sh-degree must be 0 to 3, not {}", self.sh_degree));
        }
        if !in_range(self.resolution_scale, 0.5, 1.0) {
            return refuse(format!("resolution-scale must be 0.5 to 1, not {}", self.resolution_scale));
        }
        if self.target == TargetFormat::Rgb10A2 && self.composite != Composite::BackToFront {
            return refuse(format!(
                "target rgb10a2 has 2 bits of opacity, which composite {} reads back; choose back-to-front, rgba8 or rgba16f",
                self.composite
            ));
        }
        if !in_range(self.sharpen, 0.0, 1.0) {
            return refuse(format!("sharpen must be 0 to 1, not {}", self.sharpen));
        }
        if !(self.near > 0.0 && self.near.is_finite()) {
            return refuse(format!("near must be a positive distance in metres, not {}", self.near));
        }
        if !(self.near_fade >= 0.0 && self.near_fade.is_finite()) {
            return refuse(format!("near-fade must be zero or a distance in metres, not {}", self.near_fade));
        }
        if !(self.max_radius > 0.0) {
            return refuse(format!("max-radius must be positive, not {}", self.max_radius));
        }
        if !(self.min_opacity >= 0.0 && self.min_contribution >= 0.0) {
            return refuse(format!(
                "min-opacity and min-contribution must not be negative, but are {} and {}",
                self.min_opacity, self.min_contribution
            ));
        }
        if !self.time.is_finite() || self.background.iter().any(|b| !b.is_finite()) {
            return refuse("time and background must be finite".into());
        }
        Ok(())
    }

    fn check_lens(&self, views: usize) -> Result<(), ConfigError> {
        let reason = if self.projection == Projection::Affine {
            "affine straightens the image at each splat, and this one is bent; choose projection tangent or exact"
        } else if self.expansion != Expansion::Precomputed {
            "splats meet the lens in the precomputed expansion only"
        } else if self.shape == QuadShape::AxisAligned {
            "a splat's image is bent, and has no box along the image's axes; choose another shape"
        } else if self.order == OrderKey::Depth {
            "depth along an axis says nothing about what lies beside and behind it; choose order radial"
        } else if self.sorter == Sorter::Stochastic {
            "stochastic splats are compared by perspective depth; choose sort cpu or gpu"
        } else if self.resolution_scale < 1.0 || self.sharpen > 0.0 {
            "pixels are reconstructed and sharpened for perspective; choose resolution-scale 1 and sharpen 0"
        } else if views != 1 {
            "two eyes look in one direction, and a picture all around has none; draw one view"
        } else {
            return Ok(());
        };
        Err(ConfigError(format!("lens {}: {reason}", self.lens)))
    }

    /// These choices with the expansion that is fastest on a device for so many splats: [tiles](Expansion::Tiles) where it renders
    /// on the processor, they go with the rest and its buffers hold what they need; else as they are.
    #[must_use]
    pub fn on(self, capabilities: &crate::gpu::Capabilities, splats: u32, views: &[View]) -> Self {
        let tiles = Self { expansion: Expansion::Tiles, ..self.clone() };
        let drawn = self.expansion == Expansion::Precomputed && self.sorter != Sorter::Stochastic;
        let eyes = views.len() as u32;
        let fits = |view: &View| tiles_fit(capabilities, self.projection, splats, eyes, view.size);
        let suited = capabilities.software && drawn && views.iter().all(fits);
        if suited && tiles.check_tiles(capabilities).is_ok() { tiles } else { self }
    }

    fn check_tiles(&self, capabilities: &crate::gpu::Capabilities) -> Result<(), ConfigError> {
        let reason = if !capabilities.subgroup_shuffle {
            "the device's compute stages exchange nothing within subgroups of 8 and more; choose precomputed"
        } else if self.lens != Lens::Perspective {
            "tiles know where splats lie in perspective only; choose precomputed"
        } else if self.composite == Composite::BackToFront {
            "tiles are blended front to back; choose composite front-to-back or early-stop"
        } else if self.radius == RadiusRule::Tiles {
            "the trainers' tiles are those of polygons; choose another radius, or precomputed"
        } else {
            return Ok(());
        };
        Err(ConfigError(format!("expansion tiles: {reason}")))
    }

    /// Whether early stop looks for saturated pixels in predicted tiles only.
    pub(crate) fn marks_due(&self) -> bool {
        self.composite == Composite::EarlyStop
            && self.marks == Marks::Due
            && self.expansion == Expansion::Precomputed
    }

    fn check_stochastic(&self) -> Result<(), ConfigError> {
        let reason = if self.composite != Composite::FrontToBack {
            "every fragment is opaque or absent, so nothing is blended in a direction and no transmittance falls; choose \
             composite front-to-back"
        } else if self.expansion != Expansion::Precomputed {
            "which splat a fragment belongs to is known to the precomputed expansion only"
        } else if self.sort_per_eye || self.sort_interval != 1 || self.key_bits != KeyBits::B32 {
            "nothing is sorted, so sort-per-eye, sort-interval and key-bits have no meaning"
        } else if self.resolution_scale < 1.0 || self.sharpen > 0.0 {
            "noise has to be averaged before it may be enlarged or sharpened; choose resolution-scale 1 and sharpen 0"
        } else {
            return Ok(());
        };
        Err(ConfigError(format!("sort stochastic: {reason}")))
    }

    /// The trainers' semantics (INRIA): affine, depth order, near plane 0.2 without a fade, every layer, tiles.
    pub fn inria() -> Self {
        Self {
            projection: Projection::Affine,
            radius: RadiusRule::Tiles,
            order: OrderKey::Depth,
            composite: Composite::FrontToBack,
            stop_below: 0.0,
            near: 0.2,
            near_fade: 0.0,
            ..Self::default()
        }
    }

    /// The Quest report's viewer (`002`): geometry stage, square quads of radius √8, affine, back to front.
    pub fn quest_report() -> Self {
        Self {
            expansion: Expansion::Geometry,
            projection: Projection::Affine,
            shape: QuadShape::Square,
            radius: RadiusRule::Sqrt8,
            order: OrderKey::Depth,
            composite: Composite::BackToFront,
            ..Self::default()
        }
    }
}
