//! What differs where the image is not perspective: which pixels may see a splat, and the footprints of rays that point
//! anywhere. Nothing here is shared with how the device bounds a splat's image.

use glam::{DVec2, DVec3};

use super::prepare::{Project, Projected, TILE, TangentFootprint, TileRect};
use super::raster::Footprint;
use crate::config::Lens;
use crate::projection::{Ellipse, EyeSplat, RaySplat};
use crate::view::View;

/// The cone of directions that each tile shows.
pub(super) struct LensTiles {
    columns: u32,
    /// Middle (unit vector) and half-angle; nothing where a tile shows nothing.
    cones: Vec<Option<(DVec3, f64)>>,
}

impl LensTiles {
    /// None for perspective, whose tiles are bounded by planes.
    pub fn of(view: &View, lens: Lens) -> Option<Self> {
        if lens == Lens::Perspective {
            return None;
        }
        let [width, height] = view.size;
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let f = view.fov;
        let ray = |x: f64, y: f64| {
            lens.ray(DVec2::new(
                f.left + (f.right - f.left) * x / f64::from(width),
                f.up + (f.down - f.up) * y / f64::from(height),
            ))
        };
        let cone = |tile: u32| {
            let (x0, y0) = ((tile % columns) * TILE, (tile / columns) * TILE);
            let (x1, y1) = ((x0 + TILE).min(width), (y0 + TILE).min(height));
            let rays: Vec<DVec3> = (y0..y1)
                .flat_map(|y| (x0..x1).map(move |x| (x, y)))
                .filter_map(|(x, y)| ray(f64::from(x) + 0.5, f64::from(y) + 0.5))
                .collect();
            let middle = rays.iter().sum::<DVec3>().try_normalize().or(rays.first().copied())?;
            let half = rays.iter().map(|r| r.dot(middle).clamp(-1.0, 1.0).acos()).fold(0.0, f64::max);
            // Rounding near the middle, where the arc cosine is steep.
            Some((middle, half + 1e-6))
        };
        Some(Self { columns, cones: (0..columns * rows).map(cone).collect() })
    }

    /// The rectangle of tiles that may see a body out to `k` standard deviations: its bounding sphere, as a cone from the
    /// eye.
    pub fn around(&self, body: &EyeSplat, k: f64) -> Option<TileRect> {
        let distance = body.mean.length();
        let radius = k * body.columns.iter().map(|c| c.length_squared()).sum::<f64>().sqrt();
        let direction = body.mean / distance;
        let reach = if radius < distance { (radius / distance).asin() } else { std::f64::consts::PI };
        let mut rect = TileRect { x: [u32::MAX, 0], y: [u32::MAX, 0] };
        for (tile, cone) in (0..).zip(&self.cones) {
            let Some((middle, half)) = cone else { continue };
            let angle = (half + reach).min(std::f64::consts::PI);
            if direction.dot(*middle) >= angle.cos() - 1e-9 {
                let (x, y) = (tile % self.columns, tile / self.columns);
                rect.x = [rect.x[0].min(x), rect.x[1].max(x + 1)];
                rect.y = [rect.y[0].min(y), rect.y[1].max(y + 1)];
            }
        }
        (rect.x[1] > 0).then_some(rect)
    }
}

/// Exact: the largest response along the ray.
pub(super) struct LensRayFootprint(RaySplat);

impl Footprint for LensRayFootprint {
    fn at(&self, _pixel: DVec2, ray: DVec3) -> (f64, f64) {
        self.0.along(ray)
    }
}

impl Project for LensRayFootprint {
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)> {
        let tiles = from.tiles_of_cone(&from.splat, from.limit()?.sqrt())?;
        Some((Self(RaySplat::from(&from.splat)), tiles))
    }

    fn area(splat: &EyeSplat, view: &View) -> f64 {
        TangentFootprint::area(splat, view)
    }
}

/// Affine: the lens linearised at the mean, an ellipse in the image. What a wide lens does to it is what the others are
/// for; no device draws it.
pub(super) struct LensAffineFootprint {
    centre: DVec2,
    /// Axes of the ellipse over their own squared length.
    axes: [DVec2; 2],
    /// Pixels after which columns repeat; ∞ where they do not.
    period: f64,
    distance: f64,
}

impl Footprint for LensAffineFootprint {
    fn at(&self, pixel: DVec2, _ray: DVec3) -> (f64, f64) {
        let mut d = pixel - self.centre;
        if self.period.is_finite() {
            d.x -= self.period * (d.x / self.period).round();
        }
        (d.dot(self.axes[0]).powi(2) + d.dot(self.axes[1]).powi(2), self.distance)
    }
}

impl Project for LensAffineFootprint {
    fn project(from: &Projected<'_>) -> Option<(Self, TileRect)> {
        let (view, lens, splat) = (from.view, from.options.lens, &from.splat);
        let distance = splat.mean.length();
        let direction = splat.mean / distance;
        let [fx, fy] = view.focal();
        // A displacement on the sphere as a combination of the two steps: their Gram matrix inverted.
        let [x, y] = lens.steps(direction);
        let (xx, xy, yy) = (x.dot(x), x.dot(y), y.dot(y));
        let det = xx * yy - xy * xy;
        let columns = splat.columns.map(|c| {
            let (a, b) = (c.dot(x) / distance, c.dot(y) / distance);
            DVec2::new(fx * (yy * a - xy * b) / det, fy * (xx * b - xy * a) / det)
        });
        let ellipse = Ellipse::from_columns(&columns);
        let [major, minor] = ellipse.deviations;
        if !(minor > 0.0 && major.is_finite()) {
            return None;
        }
        let place = lens.place(direction);
        let centre = DVec2::new(fx * (place.x - view.fov.left), fy * (place.y - view.fov.up));
        let (u, v) = (ellipse.direction, ellipse.direction.perp());
        let period = if lens == Lens::Equirectangular { std::f64::consts::TAU * fx } else { f64::INFINITY };
        // An ellipse may reach anywhere in the image: every tile looks.
        let tiles = view.size.map(|s| [0, s.div_ceil(TILE)]);
        let footprint = Self { centre, axes: [u / major, v / minor], period, distance };
        Some((footprint, TileRect { x: tiles[0], y: tiles[1] }))
    }

    fn area(splat: &EyeSplat, view: &View) -> f64 {
        TangentFootprint::area(splat, view)
    }
}
