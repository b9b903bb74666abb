//! What a frame will cost, before it is drawn: a scene that would take seconds a frame (and may take the driver down) is
//! known from a sample of its splats, and drawn in a form that fits a budget.

use crate::projection::{Ellipse, EyeSplat, reach, tangent_basis};
use crate::{Projection, RenderConfig, View};
use glam::{DQuat, DVec3};
use motes_scenes::Splats;

/// Splats that are looked at.
const SAMPLE: usize = 8192;

/// Evenly spread splats of a scene, kept on the processor: 48 bytes each, at most 8192 of them.
#[derive(Clone, Debug, Default)]
pub struct CostSample {
    splats: Vec<SampledSplat>,
    /// Splats of the scene for each one here.
    weight: f64,
}

#[derive(Clone, Copy, Debug)]
struct SampledSplat {
    mean: DVec3,
    rotation: DQuat,
    scales: DVec3,
    opacity: f64,
}

/// What a frame will take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Prediction {
    /// Pixels of all polygons in all views, clipped to the image: fragments, without any early stop.
    pub fragments: f64,
    /// The same over the pixels of all views.
    pub layers: f64,
}

impl CostSample {
    /// Looks at a scene.
    pub fn of(splats: &Splats) -> Self {
        let step = splats.len().div_ceil(SAMPLE).max(1);
        let origin = DVec3::from_array(splats.origin);
        let sampled: Vec<SampledSplat> = (0..splats.len())
            .step_by(step)
            .map(|i| SampledSplat {
                mean: origin + DVec3::from_array(splats.means[i].map(f64::from)),
                rotation: DQuat::from_array(splats.rotations[i].map(f64::from)),
                scales: DVec3::from_array(splats.log_scales[i].map(|s| f64::from(s).exp())),
                opacity: f64::from(splats.opacities[i]),
            })
            .collect();
        let weight = splats.len() as f64 / sampled.len().max(1) as f64;
        Self { splats: sampled, weight }
    }

    /// What a frame of these views will take.
    pub fn predict(&self, views: &[View], config: &RenderConfig) -> Prediction {
        let mut fragments = 0.0;
        let mut pixels = 0.0;
        for view in views {
            let scale = f64::from(config.resolution_scale);
            let size = view.size.map(|s| (f64::from(s) * scale).ceil().max(1.0) as u32);
            let view = View { size, ..*view };
            pixels += f64::from(size[0]) * f64::from(size[1]);
            fragments += self.splats.iter().map(|s| area(s, &view, config)).sum::<f64>();
        }
        let fragments = fragments * self.weight;
        Prediction { fragments, layers: fragments / f64::max(pixels, 1.0) }
    }

    /// The configuration itself where its frame fits the budget (fragments), else one that does: first the largest
    /// splats shrink, with their covariance, then the resolution falls to half a side. `None` where even that is more.
    pub fn budgeted(&self, views: &[View], config: &RenderConfig, budget: f64) -> Option<RenderConfig> {
        let fits = |c: &RenderConfig| self.predict(views, c).fragments <= budget;
        if fits(config) {
            return Some(config.clone());
        }
        for resolution_scale in [config.resolution_scale, 0.71, 0.5] {
            let resolution_scale = resolution_scale.min(config.resolution_scale);
            let mut max_radius = 0.5;
            while max_radius > 1e-3 {
                let candidate = RenderConfig {
                    resolution_scale,
                    max_radius: config.max_radius.min(max_radius),
                    ..config.clone()
                };
                if fits(&candidate) {
                    return Some(candidate);
                }
                max_radius *= 0.7;
            }
        }
        None
    }
}

/// Pixels of one splat's polygon in one view: inside of the image, by the box around its ellipse.
fn area(splat: &SampledSplat, view: &View, config: &RenderConfig) -> f64 {
    let mean = view.to_eye(splat.mean);
    let distance = mean.length();
    let measure = if config.projection == Projection::Affine { mean.z } else { distance };
    let Some(k) = reach(config.radius, splat.opacity) else { return 0.0 };
    if !(measure > f64::from(config.near) && splat.opacity >= f64::from(config.min_opacity)) {
        return 0.0;
    }
    let body = EyeSplat::new(view, config.low_pass, mean, splat.rotation, splat.scales);
    let ellipse = Ellipse::from_columns(&body.tangent_columns(&tangent_basis(mean / distance)));
    let [fx, fy] = view.focal();
    let z = (mean.z / distance).max(1e-2);
    let [w, h] = view.size.map(f64::from);
    // An area on the tangent plane is 1/z³ of it on the image.
    let to_pixels = (fx * fy / z.powi(3)).sqrt();
    let cap = f64::from(config.max_radius) * w.max(h);
    let [a, b] = ellipse.deviations.map(|d| (k * d * to_pixels).min(cap));
    // What of the box around it lies inside of the image; the ellipse fills its polygon's share of that.
    let [cx, cy] = view.principal_point();
    let centre =
        if mean.z > 0.0 { [cx + fx * mean.x / mean.z, cy + fy * mean.y / mean.z] } else { [f64::NAN; 2] };
    let half = (a * b).sqrt();
    let inside = |c: f64, size: f64| {
        let seen = ((c + half).min(size) - (c - half).max(0.0)).max(0.0);
        if half > 0.0 { seen / (2.0 * half) } else { 0.0 }
    };
    let share = if centre[0].is_finite() {
        inside(centre[0], w) * inside(centre[1], h)
    } else if mean.z + body.support(DVec3::Z, k) > 0.0 {
        1.0
    } else {
        0.0
    };
    // 3.31 for an octagon; a square is 4.
    (3.31 * a * b * share).min(w * h)
}
