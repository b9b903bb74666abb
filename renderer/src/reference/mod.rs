//! The f64 reference: what a picture of a scene *is*, computed on the CPU without regard for time.
//!
//! Every rung of the projection ladder and every image that the device draws is measured against it. It knows
//! nothing of Vulkan, shares no code with the shaders but the formulas of [`crate::projection`],
//! [`crate::spherical_harmonics`] and [`crate::motion`], and decides every pixel by itself: all splats that may reach
//! it, in order, front to back.
//!
//! # What is drawn
//! * **Order**: by depth, by distance, or (exact only) by where each pixel's own ray meets the splat. Equal keys keep
//!   the order of the scene.
//! * **Alpha** of a splat at a pixel: `min(0.99, opacity · exp(−D²/2))`, `D` the distance from the mean in standard
//!   deviations under the chosen [`Projection`]; below 1/255 it is left out.
//! * **Blending** in sRGB-encoded values: `C += T α c`, `T *= 1 − α`, and the background last.
//! * **Near plane**: a splat whose mean is nearer than [`ReferenceOptions::near`] is left out: depth along the view
//!   axis for the affine projection, which has no meaning behind it, and distance for the others.
//!
//! # Around and behind the eye
//! The exact projection takes a splat's largest response along the *ray*, which starts at the eye. Where the line
//! through a pixel has its maximum at or behind the eye (depth ≤ 0), the ray sees only a slope that falls away from
//! the viewer, and the splat gives **nothing** to that pixel. So an eye inside a splat sees it where its densest
//! part lies ahead, a splat whose mean is behind the eye is seen if it reaches round far enough, and nothing is ever
//! mirrored or wrapped. The tangent projection does the same with the rays that meet its plane ahead of the eye. The planar
//! low-pass filter has no width at or behind depth 0, since a pixel has none there.

mod lens;
mod prepare;
mod raster;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod textbook;

use glam::DVec3;
use motes_scenes::{Splats, sh_coefficients};

use crate::config::{Lens, LowPass, OrderKey, Projection, RadiusRule, RenderConfig};
use crate::projection::MIN_ALPHA;
use crate::view::View;

/// Pixels of the largest picture: 2²⁶, some 3.8 GB.
pub const MAX_PIXELS: u64 = 1 << 26;

/// What splats are ordered by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReferenceOrder {
    /// Depth of the mean along the view axis.
    Depth,
    /// Distance of the mean from a point in scene axes; from the eye where none is named. Name the point between the
    /// eyes for one order in both.
    Radial(Option<DVec3>),
    /// Depth of the largest response along the pixel's own ray: another order in every pixel. Exact projection only.
    AlongRay,
}

/// How far a splat reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Up to the rule's radius in standard deviations under the chosen projection; alphas below 1/255 are left out
    /// in any case, so [`RadiusRule::Full`] cuts nothing off.
    Rule(RadiusRule),
    /// As the trainers do it (Kerbl et al. 2023): into every pixel of every 16 × 16 tile that the square of
    /// `ceil(3 √λ1)` pixels around the mean touches. Affine projection only.
    TrainerTiles,
}

/// Everything that decides what a reference picture shows.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceOptions {
    /// How a splat is projected. Affine through a lens that is not perspective linearises that lens at the mean.
    pub projection: Projection,
    /// The lens.
    pub lens: Lens,
    /// The low-pass filter.
    pub low_pass: LowPass,
    /// What splats are ordered by.
    pub order: ReferenceOrder,
    /// How far a splat reaches.
    pub reach: Reach,
    /// Nearest depth (affine) or distance (tangent, exact) of a mean that is drawn, metres, 0 and up.
    pub near: f64,
    /// Splats fade in over this distance beyond `near`, metres, 0 and up.
    pub near_fade: f64,
    /// A pixel is finished before the splat that would take its transmittance below this, as in the trainers'
    /// rasteriser. 0: never.
    pub stop_below: f64,
    /// Transmittance that [`ReferencePixel::layers_until`] counts up to, `0 ..= 1`.
    pub count_until: f64,
    /// Splats of lower opacity (at the time, before any fade) are left out. 0: none.
    pub min_opacity: f64,
    /// Highest degree of spherical harmonics that is evaluated.
    pub sh_degree: u8,
    /// Colour behind the splats, sRGB-encoded.
    pub background: [f64; 3],
    /// Time in a moving scene.
    pub time: f64,
}

impl Default for ReferenceOptions {
    /// The truth: exact projection, planar filter, radial order, every layer, full reach, everything beyond 0 m.
    fn default() -> Self {
        Self {
            projection: Projection::Exact,
            lens: Lens::Perspective,
            low_pass: LowPass::Planar,
            order: ReferenceOrder::Radial(None),
            reach: Reach::Rule(RadiusRule::Full),
            near: 0.0,
            near_fade: 0.0,
            stop_below: 0.0,
            count_until: MIN_ALPHA,
            min_opacity: 0.0,
            sh_degree: 3,
            background: [0.0; 3],
            time: 0.0,
        }
    }
}

impl ReferenceOptions {
    /// The trainers' semantics (Kerbl et al. 2023, `diff-gaussian-rasterization`): affine with the mean's slopes
    /// clamped to 1.3 of the frustum's, 0.3 px² of dilation, 3-sigma rectangles of 16 × 16 tiles, depth order, near
    /// plane at 0.2, stop before the transmittance falls below 10⁻⁴.
    pub fn inria() -> Self {
        Self {
            projection: Projection::Affine,
            order: ReferenceOrder::Depth,
            reach: Reach::TrainerTiles,
            near: 0.2,
            stop_below: 1e-4,
            ..Self::default()
        }
    }

    /// What a frame with this configuration aims at. Choices that only trade accuracy for time (expansion, shape,
    /// precision, early stop, resolution, sort) are not followed; projection, filter, radius, order, near plane, degree,
    /// background and time are.
    pub fn of_config(config: &RenderConfig) -> Self {
        Self {
            projection: config.projection,
            lens: config.lens,
            low_pass: config.low_pass,
            order: match config.order {
                OrderKey::Radial => ReferenceOrder::Radial(None),
                OrderKey::Depth => ReferenceOrder::Depth,
            },
            reach: match config.radius {
                RadiusRule::Tiles => Reach::TrainerTiles,
                rule => Reach::Rule(rule),
            },
            near: config.near.into(),
            near_fade: config.near_fade.into(),
            min_opacity: config.min_opacity.into(),
            sh_degree: config.sh_degree,
            background: config.background.map(f64::from),
            time: config.time.into(),
            ..Self::default()
        }
    }
}

/// Why no reference picture can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReferenceError {
    /// The view makes no picture.
    #[error("the view's {what}")]
    View {
        /// Which of its fields, and what is wrong.
        what: String,
    },
    /// The options contradict each other or are out of range.
    #[error("reference option {what}")]
    Options {
        /// Which of them, and what is wrong.
        what: String,
    },
    /// The scene's arrays do not fit together.
    #[error("the scene has {splats} means but {found} {array} ({expected} expected)")]
    Scene {
        /// Number of means.
        splats: usize,
        /// Which array.
        array: &'static str,
        /// Its length.
        found: usize,
        /// The length that fits.
        expected: usize,
    },
    /// No memory for the picture.
    #[error("no memory for a reference picture of {0} × {1} pixels; choose a smaller size")]
    Memory(u32, u32),
}

/// One pixel of a [`ReferenceImage`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePixel {
    /// Colour, background included, sRGB-encoded; not clamped.
    pub colour: [f64; 3],
    /// What the background still contributes, `0 ..= 1`.
    pub transmittance: f64,
    /// Eye depth (metres) of the first splat that takes the transmittance below ½, ∞ where none does: of its mean
    /// (affine), of the point on its plane (tangent), or of its largest response along the ray (exact). Through a lens the
    /// distance instead.
    pub median_depth: f64,
    /// Splats that were blended here: alpha of at least 1/255, before the pixel was finished.
    pub layers: u32,
    /// Splats up to and with the one that took the transmittance below [`ReferenceOptions::count_until`].
    pub layers_until: u32,
}

/// A reference picture.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceImage {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Pixels by rows from the upper left.
    pub pixels: Vec<ReferencePixel>,
    /// Splats that were candidates for at least one pixel.
    pub visible: usize,
    /// Sum over the 16 × 16 tiles of the splats that were candidates there.
    pub tile_pairs: u64,
}

impl ReferenceImage {
    /// The pixel in column `x` and row `y`.
    pub fn pixel(&self, x: u32, y: u32) -> &ReferencePixel {
        &self.pixels[y as usize * self.size[0] as usize + x as usize]
    }

    /// 8-bit colours by rows, three bytes a pixel, clamped and rounded to nearest.
    pub fn to_rgb8(&self) -> Vec<u8> {
        let byte = |c: f64| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
        self.pixels.iter().flat_map(|p| p.colour.map(byte)).collect()
    }

    /// Colours by rows in single precision, not clamped.
    pub fn to_rgb_f32(&self) -> Vec<[f32; 3]> {
        self.pixels.iter().map(|p| p.colour.map(|c| c as f32)).collect()
    }

    /// Mean over all pixels of a quantity of theirs.
    pub fn mean(&self, quantity: impl Fn(&ReferencePixel) -> f64) -> f64 {
        self.pixels.iter().map(quantity).sum::<f64>() / self.pixels.len().max(1) as f64
    }
}

/// One splat's part of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// The splat's place in the scene.
    pub splat: u32,
    /// What it covers of what lies behind it, 1/255 to 0.99.
    pub alpha: f64,
    /// Transmittance of all that lies in front of it, `0 ..= 1`: its visible blending weight is `light · alpha`.
    pub light: f64,
    /// Its colour from this eye, sRGB-encoded.
    pub colour: [f64; 3],
}

impl Layer {
    /// Share of the pixel's colour that is this splat's: `T α` of volume rendering, `0 ..= 1`.
    pub fn weight(&self) -> f64 {
        self.light * self.alpha
    }
}

/// Hands over, for every pixel (column and row), the layers that [`render`] would blend, front to back. Called from many
/// threads, in no order of pixels.
///
/// # Errors
/// As [`render`].
pub fn trace(
    splats: &Splats,
    view: &View,
    options: &ReferenceOptions,
    visit: impl Fn([u32; 2], &[Layer]) + Sync,
) -> Result<(), ReferenceError> {
    check_scene(splats)?;
    check_view(view)?;
    check_options(options)?;
    prepare::trace(splats, view, options, &visit);
    Ok(())
}

/// Renders a scene from a view.
///
/// Takes seconds for some 10⁵ to 10⁶ splats at 640 × 480, on all cores; memory: 56 bytes a pixel and some 300 bytes
/// a visible splat.
///
/// # Errors
/// [`ReferenceError`] where the view, the options or the scene's arrays make no sense, or memory runs out.
pub fn render(
    splats: &Splats,
    view: &View,
    options: &ReferenceOptions,
) -> Result<ReferenceImage, ReferenceError> {
    check_scene(splats)?;
    check_view(view)?;
    check_options(options)?;
    options.lens.check(view).map_err(|e| ReferenceError::View { what: e.0 })?;
    prepare::render(splats, view, options)
}

fn check_scene(splats: &Splats) -> Result<(), ReferenceError> {
    let n = splats.len();
    let mut arrays = vec![
        ("rotations", splats.rotations.len(), n),
        ("scales", splats.log_scales.len(), n),
        ("opacities", splats.opacities.len(), n),
        ("colour coefficients", splats.sh.len(), n.saturating_mul(sh_coefficients(splats.sh_degree))),
    ];
    if let Some(motion) = &splats.motion {
        arrays.extend([
            ("times", motion.centers.len(), n),
            ("widths in time", motion.widths.len(), n),
            ("motion polynomials", motion.polynomials.len(), n),
            ("changes of rotation", motion.omegas.len(), n),
        ]);
    }
    match arrays.into_iter().find(|(_, found, expected)| found != expected) {
        Some((array, found, expected)) => Err(ReferenceError::Scene { splats: n, array, found, expected }),
        None => Ok(()),
    }
}

fn check_view(view: &View) -> Result<(), ReferenceError> {
    let error = |what: String| Err(ReferenceError::View { what });
    let [w, h] = view.size;
    if w == 0 || h == 0 || u64::from(w) * u64::from(h) > MAX_PIXELS {
        return error(format!("size is {w} × {h} pixels; it can be 1 to {MAX_PIXELS} pixels in all"));
    }
    let fov = view.fov;
    let sides = [fov.left, fov.right, fov.up, fov.down];
    if !(sides.iter().all(|s| s.is_finite()) && fov.left < fov.right && fov.up < fov.down) {
        return error(format!(
            "field of view is {fov:?}; it needs finite tangents with left < right and up < down"
        ));
    }
    if !view.eye.is_finite() {
        return error(format!("eye is at {}; it needs a finite position", view.eye));
    }
    let product = view.rotation * view.rotation.transpose() - glam::DMat3::IDENTITY;
    if !product.to_cols_array().iter().all(|d| d.abs() < 1e-3) {
        return error(format!(
            "rotation has rows that are not at right angles and of length 1: {}",
            view.rotation
        ));
    }
    Ok(())
}

fn check_options(options: &ReferenceOptions) -> Result<(), ReferenceError> {
    let error = |what: String| Err(ReferenceError::Options { what });
    for (name, value) in [
        ("near", options.near),
        ("near_fade", options.near_fade),
        ("stop_below", options.stop_below),
        ("count_until", options.count_until),
        ("min_opacity", options.min_opacity),
    ] {
        if !(value >= 0.0 && value.is_finite()) {
            return error(format!("{name} is {value}; it needs a finite number, 0 or more"));
        }
    }
    if !(options.time.is_finite() && options.background.iter().all(|c| c.is_finite())) {
        return error(format!("time {} or background {:?} is not finite", options.time, options.background));
    }
    if options.lens != Lens::Perspective
        && (options.order == ReferenceOrder::Depth || options.reach == Reach::TrainerTiles)
    {
        return error(format!(
            "lens: {} has neither a depth to order by nor the trainers' tiles",
            options.lens
        ));
    }
    if options.reach == Reach::TrainerTiles && options.projection != Projection::Affine {
        return error(format!(
            "reach: the trainers' tiles exist in the affine projection, not in {}",
            options.projection
        ));
    }
    if options.order == ReferenceOrder::AlongRay && options.projection != Projection::Exact {
        return error(format!("order: along the ray needs the exact projection, not {}", options.projection));
    }
    Ok(())
}
