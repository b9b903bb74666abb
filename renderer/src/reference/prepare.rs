//! From the scene to the splats that one view can see: evaluated, projected, culled, in order.

use glam::{DVec2, DVec3};
use motes_scenes::{Splats, sh_coefficients};
use rayon::prelude::*;

use super::lens::{LensAffineFootprint, LensRayFootprint, LensTiles};
use super::raster::{Candidate, Footprint, follow, rasterise};
use super::{Layer, Reach, ReferenceError, ReferenceImage, ReferenceOptions, ReferenceOrder};
use crate::config::{Lens, LowPass, Projection, RadiusRule};
use crate::motion::{Moment, moment};
use crate::projection::{
    Ellipse, EyeSplat, MIN_ALPHA, RaySplat, near_fade, opacity_compensation, reach, tangent_basis,
};
use crate::spherical_harmonics::sh_colour;
use crate::view::View;

/// Side of a tile, pixels: the trainers', whose reach is defined by it.
pub(super) const TILE: u32 = 16;

/// Tiles `[x0, x1) × [y0, y1)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TileRect {
    pub x: [u32; 2],
    pub y: [u32; 2],
}

/// What a footprint is made from: one splat in front of one view, with its reach `k` in standard deviations.
pub(super) struct Projected<'a> {
    pub view: &'a View,
    pub options: &'a ReferenceOptions,
    /// Where the image is not perspective, which tiles show which directions.
    lens_tiles: Option<&'a LensTiles>,
    pub splat: EyeSplat,
    opacity: f64,
}

/// Renders with the footprint that the projection calls for; every branch is a copy of the same loops.
pub(super) fn render(
    splats: &Splats,
    view: &View,
    options: &ReferenceOptions,
) -> Result<ReferenceImage, ReferenceError> {
    if options.lens != Lens::Perspective {
        return match options.projection {
            Projection::Affine => draw::<LensAffineFootprint>(splats, view, options),
            Projection::Tangent => draw::<TangentFootprint>(splats, view, options),
            Projection::Exact => draw::<LensRayFootprint>(splats, view, options),
        };
    }
    match (options.projection, options.reach) {
        (Projection::Affine, Reach::TrainerTiles) => draw::<TrainerFootprint>(splats, view, options),
        (Projection::Affine, Reach::Rule(_)) => draw::<AffineFootprint>(splats, view, options),
        (Projection::Tangent, _) => draw::<TangentFootprint>(splats, view, options),
        (Projection::Exact, _) => draw::<RayFootprint>(splats, view, options),
    }
}

/// [`render`], but every pixel's layers go to `visit`.
pub(super) fn trace(
    splats: &Splats,
    view: &View,
    options: &ReferenceOptions,
    visit: &(impl Fn([u32; 2], &[Layer]) + Sync),
) {
    if options.lens != Lens::Perspective {
        return match options.projection {
            Projection::Affine => hand_over::<LensAffineFootprint>(splats, view, options, visit),
            Projection::Tangent => hand_over::<TangentFootprint>(splats, view, options, visit),
            Projection::Exact => hand_over::<LensRayFootprint>(splats, view, options, visit),
        };
    }
    match (options.projection, options.reach) {
        (Projection::Affine, Reach::TrainerTiles) => {
            hand_over::<TrainerFootprint>(splats, view, options, visit)
        }
        (Projection::Affine, Reach::Rule(_)) => hand_over::<AffineFootprint>(splats, view, options, visit),
        (Projection::Tangent, _) => hand_over::<TangentFootprint>(splats, view, options, visit),
        (Projection::Exact, _) => hand_over::<RayFootprint>(splats, view, options, visit),
    }
}

fn hand_over<F: Project>(
    splats: &Splats,
    view: &View,
    options: &ReferenceOptions,
    visit: &(impl Fn([u32; 2], &[Layer]) + Sync),
) {
    follow(&candidates::<F>(splats, view, options), view, options, visit);
}

fn draw<F: Project>(
    splats: &Splats,
    view: &View,
    options: &ReferenceOptions,
) -> Result<ReferenceImage, ReferenceError> {
    rasterise(&candidates::<F>(splats, view, options), view, options)
}

/// What the view can see, in order.
fn candidates<F: Project>(splats: &Splats, view: &View, options: &ReferenceOptions) -> Vec<Candidate<F>> {
    let tiles = LensTiles::of(view, options.lens);
    let mut candidates: Vec<Candidate<F>> = (0..splats.len())
        .into_par_iter()
        .filter_map(|i| prepare(splats, i, view, options, tiles.as_ref()))
        .collect();
    // Stable: equal keys keep the order of the scene.
    candidates.par_sort_by(|a, b| a.key.total_cmp(&b.key));
    candidates
}

/// One splat as a candidate, or nothing where it cannot be seen.
pub(super) fn prepare<F: Project>(
    splats: &Splats,
    i: usize,
    view: &View,
    options: &ReferenceOptions,
    lens_tiles: Option<&LensTiles>,
) -> Option<Candidate<F>> {
    let Moment { mean: relative, rotation, opacity } = moment(splats, i, options.time)?;
    if !(opacity >= MIN_ALPHA && opacity >= options.min_opacity) {
        return None;
    }
    // Near its own origin a scene keeps the precision that it was stored with, wherever that origin is.
    let origin = DVec3::from_array(splats.origin);
    let from_eye = relative - (view.eye - origin);
    let mean = view.rotation * from_eye;
    let distance = from_eye.length();
    let by_depth = options.projection == Projection::Affine && options.lens == Lens::Perspective;
    let measure = if by_depth { mean.z } else { distance };
    let opacity = opacity * near_fade(measure, options.near, options.near_fade);
    let scales = DVec3::from_array(splats.log_scales[i].map(|s| f64::from(s).exp()));
    if !(opacity >= MIN_ALPHA && mean.is_finite() && scales.is_finite()) {
        return None;
    }
    let key = match options.order {
        ReferenceOrder::Depth => mean.z,
        ReferenceOrder::Radial(None) | ReferenceOrder::AlongRay => distance,
        ReferenceOrder::Radial(Some(centre)) => (relative - (centre - origin)).length(),
    };
    let mut projected = Projected {
        view,
        options,
        lens_tiles,
        splat: EyeSplat::through(options.lens, view, options.low_pass, mean, rotation, scales),
        opacity,
    };
    if matches!(options.low_pass, LowPass::PlanarCompensated | LowPass::VolumetricCompensated) {
        let plain = EyeSplat::through(options.lens, view, LowPass::Off, mean, rotation, scales);
        projected.opacity *= opacity_compensation(F::area(&plain, view), F::area(&projected.splat, view));
    }
    let (footprint, tiles) = F::project(&projected)?;
    if tiles.x[0] >= tiles.x[1] || tiles.y[0] >= tiles.y[1] {
        return None;
    }
    let coefficients = sh_coefficients(options.sh_degree.min(splats.sh_degree));
    let colour = sh_colour(&splats.sh_of(i)[..coefficients], from_eye / distance);
    if !colour.iter().all(|c| c.is_finite()) {
        return None;
    }
    Some(Candidate {
        index: i as u32,
        key,
        tiles,
        footprint,
        opacity: projected.opacity,
        colour,
        limit: projected.limit()?,
    })
}

impl Projected<'_> {
    /// Squared distance, in standard deviations, beyond which nothing is drawn. `None`: nothing is drawn at all.
    pub fn limit(&self) -> Option<f64> {
        let rule = match self.options.reach {
            Reach::Rule(rule) => rule,
            Reach::TrainerTiles => RadiusRule::Full,
        };
        // The fixed radius never goes beyond what an alpha of 1/255 allows.
        let full = reach(RadiusRule::Full, self.opacity)?;
        reach(rule, self.opacity).map(|k| k.min(full).powi(2))
    }

    /// Tiles that the pixels with centres inside `[low, high]` (pixel-edge coordinates) lie in.
    fn tiles_between(&self, low: DVec2, high: DVec2) -> Option<TileRect> {
        if !(low.is_finite() && high.is_finite()) {
            return None;
        }
        let range = |low: f64, high: f64, size: u32| {
            // A hundredth of a pixel to spare for rounding.
            let first = (low - 0.51).ceil().clamp(0.0, f64::from(size)) as u32;
            let last = ((high - 0.49).floor() + 1.0).clamp(0.0, f64::from(size)) as u32;
            if first < last { [first / TILE, last.div_ceil(TILE)] } else { [0, 0] }
        };
        let [w, h] = self.view.size;
        Some(TileRect { x: range(low.x, high.x, w), y: range(low.y, high.y, h) })
    }

    /// Tiles that can see the body with the given mean and covariance columns out to `k` standard deviations: an
    /// ellipsoid (exact) or an ellipse on the tangent plane (tangent), as a cone from the eye.
    ///
    /// The plane `x = c z` through the eye touches the body where `(μx − c μz)² = k² |row0 − c row2|²`: a quadratic
    /// in c whose roots bound the silhouette (Steiner et al. 2025), as long as the whole body lies in front of the
    /// eye. Where the plane z = 0 cuts the body, each row and column of tiles is tested against its own two planes.
    pub fn tiles_of_cone(&self, body: &EyeSplat, k: f64) -> Option<TileRect> {
        if let Some(tiles) = self.lens_tiles {
            return tiles.around(body, k);
        }
        let depth = body.support(DVec3::Z, k);
        let mean = body.mean;
        if !(mean.z + depth > 0.0) {
            return None;
        }
        if mean.z > depth * (1.0 + 1e-9) {
            let [cx, cy] = self.view.principal_point();
            let [fx, fy] = self.view.focal();
            let x = silhouette(body, k, DVec3::X)?;
            let y = silhouette(body, k, DVec3::Y)?;
            return self.tiles_between(
                DVec2::new(cx + fx * x[0], cy + fy * y[0]),
                DVec2::new(cx + fx * x[1], cy + fy * y[1]),
            );
        }
        let [w, h] = self.view.size;
        let fov = &self.view.fov;
        let bands = |axis: DVec3, low: f64, high: f64, size: u32| {
            // The body reaches to the far side of the plane `p·axis = slope · p_z`, seen from inside.
            let beyond = |slope: f64, side: f64| {
                let normal = (axis - DVec3::Z * slope) * side;
                normal.dot(mean) + body.support(normal, k) >= -1e-9 * (mean.length() + depth)
            };
            let step = (high - low) / f64::from(size);
            let touches = |tile: u32| {
                let first = low + step * f64::from(tile * TILE);
                let last = low + step * f64::from(((tile + 1) * TILE).min(size));
                beyond(first, 1.0) && beyond(last, -1.0)
            };
            let tiles = size.div_ceil(TILE);
            let first = (0..tiles).find(|&t| touches(t))?;
            let last = (first..tiles).rev().find(|&t| touches(t))?;
            Some([first, last + 1])
        };
        Some(TileRect {
            x: bands(DVec3::X, fov.left, fov.right, w)?,
            y: bands(DVec3::Y, fov.up, fov.down, h)?,
        })
    }
}

/// Lowest and highest slope `p·axis / p_z` of a body that lies in front of the eye.
fn silhouette(body: &EyeSplat, k: f64, axis: DVec3) -> Option<[f64; 2]> {
    let (m, z) = (body.mean.dot(axis), body.mean.z);
    let (mut along, mut cross, mut depth, mut gram) = (0.0, 0.0, 0.0, 0.0);
    for (i, c) in body.columns.iter().enumerate() {
        let (a, b) = (c.dot(axis), c.z);
        along += (a * z - m * b).powi(2);
        cross += a * b;
        depth += b * b;
        for d in &body.columns[..i] {
            gram += (a * d.z - d.dot(axis) * b).powi(2);
        }
    }
    let kk = k * k;
    let leading = z * z - kk * depth;
    let middle = m * z - kk * cross;
    let root = (kk * (along - kk * gram)).max(0.0).sqrt();
    let bounds = [(middle - root) / leading, (middle + root) / leading];
    bounds.iter().all(|b| b.is_finite()).then_some(bounds)
}

/// A footprint that can be made from a splat.
pub(super) trait Project: Footprint + Sized {
    /// The footprint, and the tiles that it may reach; nothing where there are none.
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)>;
    /// The projected area (a measure of its own; only ratios matter).
    fn area(splat: &EyeSplat, view: &View) -> f64;
}

/// Affine with the trainers' rectangles and their conic.
pub(super) struct TrainerFootprint {
    centre: DVec2,
    conic: [f64; 3],
    depth: f64,
}

impl Footprint for TrainerFootprint {
    fn at(&self, pixel: DVec2, _ray: DVec3) -> (f64, f64) {
        let d = self.centre - pixel;
        let [a, b, c] = self.conic;
        (a * d.x * d.x + c * d.y * d.y + 2.0 * b * d.x * d.y, self.depth)
    }
}

impl Project for TrainerFootprint {
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)> {
        let (view, splat) = (from.view, &from.splat);
        let columns = splat.affine_columns(&view.fov, view.focal());
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for c in columns {
            xx += c.x * c.x;
            xy += c.x * c.y;
            yy += c.y * c.y;
        }
        let determinant = xx * yy - xy * xy;
        if !(determinant > 0.0 && determinant.is_finite()) {
            return None;
        }
        let middle = 0.5 * (xx + yy);
        let larger = middle + (middle * middle - determinant).max(0.1).sqrt();
        let radius = (3.0 * larger.sqrt()).ceil();
        let centre = image_point(splat.mean, view);
        if !(centre.is_finite() && radius.is_finite()) {
            return None;
        }
        // The trainers' pixel coordinates have their origin at the centre of the first pixel; they cut towards zero.
        let range = |position: f64, size: u32| {
            let tiles = f64::from(size.div_ceil(TILE));
            let tile = f64::from(TILE);
            let first = ((position - 0.5 - radius) / tile).trunc().clamp(0.0, tiles);
            let last = ((position - 0.5 + radius + tile - 1.0) / tile).trunc().clamp(0.0, tiles);
            [first as u32, last as u32]
        };
        let tiles = TileRect { x: range(centre.x, view.size[0]), y: range(centre.y, view.size[1]) };
        let conic = [yy / determinant, -xy / determinant, xx / determinant];
        Some((Self { centre, conic, depth: splat.mean.z }, tiles))
    }

    fn area(splat: &EyeSplat, view: &View) -> f64 {
        AffineFootprint::area(splat, view)
    }
}

/// Where the mean lies in the image, pixel-edge coordinates.
fn image_point(mean: DVec3, view: &View) -> DVec2 {
    let [fx, fy] = view.focal();
    let [cx, cy] = view.principal_point();
    DVec2::new(cx + fx * mean.x / mean.z, cy + fy * mean.y / mean.z)
}

/// Affine, to the reach of the radius rule.
pub(super) struct AffineFootprint {
    centre: DVec2,
    /// Axes of the ellipse over their own squared length.
    axes: [DVec2; 2],
    depth: f64,
}

impl Footprint for AffineFootprint {
    fn at(&self, pixel: DVec2, _ray: DVec3) -> (f64, f64) {
        let d = pixel - self.centre;
        (d.dot(self.axes[0]).powi(2) + d.dot(self.axes[1]).powi(2), self.depth)
    }
}

impl Project for AffineFootprint {
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)> {
        let (view, splat) = (from.view, &from.splat);
        let ellipse = Ellipse::from_columns(&splat.affine_columns(&view.fov, view.focal()));
        let [major, minor] = ellipse.deviations;
        if !(minor > 0.0 && major.is_finite()) {
            return None;
        }
        let centre = image_point(splat.mean, view);
        let (u, v) = (ellipse.direction, ellipse.direction.perp());
        let k = from.limit()?.sqrt();
        let half = DVec2::new((u.x * major).hypot(v.x * minor), (u.y * major).hypot(v.y * minor)) * k;
        let tiles = from.tiles_between(centre - half, centre + half)?;
        Some((Self { centre, axes: [u / major, v / minor], depth: splat.mean.z }, tiles))
    }

    fn area(splat: &EyeSplat, view: &View) -> f64 {
        Ellipse::from_columns(&splat.affine_columns(&view.fov, view.focal())).area()
    }
}

/// Tangent: the ray meets the leaning plane at `P = d / (d·n)`, `n` the plane's normal with `n·m = 1`; its offset from `m`,
/// along the ellipse's axes.
pub(super) struct TangentFootprint {
    normal: DVec3,
    axes: [DVec3; 2],
    distance: f64,
}

impl Footprint for TangentFootprint {
    fn at(&self, _pixel: DVec2, ray: DVec3) -> (f64, f64) {
        let along = ray.dot(self.normal);
        let square = ray.dot(self.axes[0]).powi(2) + ray.dot(self.axes[1]).powi(2);
        // Rays that point away from the plane (along ≤ 0) have a negative depth, and are left out by it.
        (square / (along * along), self.distance / along)
    }
}

impl Project for TangentFootprint {
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)> {
        let splat = &from.splat;
        let distance = splat.mean.length();
        let direction = splat.mean / distance;
        let basis = tangent_basis(direction);
        let ellipse = Ellipse::from_columns(&splat.tangent_columns(&basis));
        let [major, minor] = ellipse.deviations;
        if !(minor > 0.0 && major.is_finite() && direction.is_finite()) {
            return None;
        }
        let in_space = |v: DVec2| basis[0] * v.x + basis[1] * v.y;
        let (u, v) = (in_space(ellipse.direction), in_space(ellipse.direction.perp()));
        let lean = splat.lean(direction, &basis, &ellipse);
        // The ellipse as a body in space, at a distance of 1.
        let columns = [u * major + direction * lean[0], v * minor + direction * lean[1]];
        let body = EyeSplat {
            mean: direction,
            columns: [columns[0], columns[1], DVec3::ZERO, DVec3::ZERO, DVec3::ZERO],
        };
        let tiles = from.tiles_of_cone(&body, from.limit()?.sqrt())?;
        let axes = [u / major, v / minor];
        let normal = direction - axes[0] * lean[0] - axes[1] * lean[1];
        Some((Self { normal, axes, distance }, tiles))
    }

    fn area(splat: &EyeSplat, _view: &View) -> f64 {
        Ellipse::from_columns(&splat.tangent_columns(&tangent_basis(splat.mean.normalize_or(DVec3::Z))))
            .area()
    }
}

/// Exact: the largest response along the ray.
pub(super) struct RayFootprint(RaySplat);

impl Footprint for RayFootprint {
    fn at(&self, _pixel: DVec2, ray: DVec3) -> (f64, f64) {
        self.0.at(ray.truncate())
    }
}

impl Project for RayFootprint {
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)> {
        let tiles = from.tiles_of_cone(&from.splat, from.limit()?.sqrt())?;
        Some((Self(RaySplat::from(&from.splat)), tiles))
    }

    fn area(splat: &EyeSplat, view: &View) -> f64 {
        // Ratios of projected areas are the same on every plane that a ray through the mean crosses.
        TangentFootprint::area(splat, view)
    }
}
