//! Colours and opacities that bring a thinned scene's pictures back to those of the whole scene, in closed form.
//!
//! A pixel is linear in the base colours of its layers, `C = Σ wᵢ cᵢ` with `w = T α`, and to first order in the logarithms
//! of their opacities, with derivatives `dᵢ = T α (cᵢ − Bᵢ)`. The least-squares step is separable where the quadratic is
//! replaced by the one that lies above it and has no mixed terms (De Pierro 1995): with residuals `r`,
//! `δxᵢ = Σ_p a_pᵢ r_p / Σ_p |a_pᵢ| Σ_j |a_pⱼ|`. Every sweep is one such step over all pixels of all views; no step of the
//! colours can make the sum of squares larger. Directional parts of the colours, shapes and places stay.

use glam::DVec3;
use motes_scenes::{SH_C0, Splats, sh_coefficients};

use super::sums::Sums;
use super::visible::each_change;
use crate::View;
use crate::reference::{self, ReferenceError, ReferenceOptions};
use std::sync::atomic::{AtomicU64, Ordering};

/// Step beyond the minimum of the separable quadratic; anything below 2 still descends.
const OVER: f64 = 1.7;
/// Largest step of an opacity's logarithm, where the first order does not reach.
const LARGEST_STEP: f64 = 0.5;
/// Opacities stay between the least that shows and what a pixel takes from one splat.
const OPACITIES: [f64; 2] = [1.0 / 255.0, 0.99];

/// What a view is to look like.
pub struct Goal {
    /// From where.
    pub view: View,
    /// sRGB-encoded colours by rows, background included.
    pub pixels: Vec<[f32; 3]>,
}

impl Goal {
    /// The view's picture of a scene.
    ///
    /// # Errors
    /// The reference's.
    pub fn of(splats: &Splats, view: &View, options: &ReferenceOptions) -> Result<Self, ReferenceError> {
        Ok(Self { view: *view, pixels: reference::render(splats, view, options)?.to_rgb_f32() })
    }
}

/// What a sweep changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// Base colours.
    Colours,
    /// Opacities.
    Opacities,
}

/// One sweep. Returns the mean square residual (mean over pixels and channels) *before* it.
///
/// # Errors
/// A goal of the wrong size, or the reference's.
pub fn sweep(
    splats: &mut Splats,
    goals: &[Goal],
    options: &ReferenceOptions,
    fit: Fit,
) -> Result<f64, ReferenceError> {
    let n = splats.len();
    let (along, majorant) = (Sums::new(3 * n), Sums::new(n));
    let background = DVec3::from_array(options.background);
    let (mut squares, mut pixels) = (0.0, 0usize);
    for Goal { view, pixels: goal } in goals {
        let width = view.size[0] as usize;
        if goal.len() != width * view.size[1] as usize {
            let what = format!("{} pixels are no goal for {:?}", goal.len(), view.size);
            return Err(ReferenceError::View { what });
        }
        let square = AtomicU64::new(0);
        reference::trace(splats, view, options, |[x, y], layers| {
            let (mut colour, mut left) = (DVec3::ZERO, 1.0);
            for layer in layers {
                colour += DVec3::from_array(layer.colour) * layer.weight();
                left = layer.light * (1.0 - layer.alpha);
            }
            let wanted = goal[y as usize * width + x as usize];
            let residual = glam::Vec3::from(wanted).as_dvec3() - colour - background * left;
            square.fetch_add((residual.length_squared() * (1u64 << 32) as f64) as u64, Ordering::Relaxed);
            match fit {
                Fit::Colours => {
                    let covered = 1.0 - left;
                    for layer in layers {
                        let (i, weight) = (layer.splat as usize, layer.weight());
                        for (c, r) in residual.to_array().into_iter().enumerate() {
                            along.add(3 * i + c, weight * r);
                        }
                        majorant.add(i, weight * covered);
                    }
                }
                Fit::Opacities => {
                    let mut all = DVec3::ZERO;
                    each_change(layers, background, |_, change| all += change.abs());
                    each_change(layers, background, |layer, change| {
                        let i = layer.splat as usize;
                        along.add(3 * i, change.dot(residual));
                        majorant.add(i, change.abs().dot(all));
                    });
                }
            }
        })?;
        squares += square.into_inner() as f64 / (1u64 << 32) as f64;
        pixels += goal.len();
    }
    let coefficients = sh_coefficients(splats.sh_degree);
    let along: Vec<f64> = along.values().collect();
    for (i, majorant) in majorant.values().enumerate() {
        // What hardly shows is not changed: its quotient would be noise.
        if !(majorant > 1e-6) {
            continue;
        }
        match fit {
            Fit::Colours => {
                for c in 0..3 {
                    let step = OVER * along[3 * i + c] / majorant;
                    splats.sh[i * coefficients][c] += (step / f64::from(SH_C0)) as f32;
                }
            }
            Fit::Opacities => {
                let step = (along[3 * i] / majorant).clamp(-LARGEST_STEP, LARGEST_STEP);
                let before = f64::from(splats.opacities[i]);
                // A splat outside of the bounds keeps its own opacity as its bound.
                let [low, high] = [OPACITIES[0].min(before), OPACITIES[1].max(before)];
                splats.opacities[i] = (before * step.exp()).clamp(low, high) as f32;
            }
        }
    }
    Ok(squares / (3 * pixels.max(1)) as f64)
}

/// Sweeps of colours and opacities in turn. Returns the mean square residual before the first and after the last.
///
/// # Errors
/// As [`sweep`].
pub fn refit(
    splats: &mut Splats,
    goals: &[Goal],
    options: &ReferenceOptions,
    sweeps: usize,
) -> Result<[f64; 2], ReferenceError> {
    let mut first = None;
    for k in 0..sweeps {
        let fit = if k % 2 == 0 { Fit::Colours } else { Fit::Opacities };
        let residual = sweep(splats, goals, options, fit)?;
        first.get_or_insert(residual);
    }
    let last = residual(splats, goals, options)?;
    Ok([first.unwrap_or(last), last])
}

/// The mean square residual, over pixels and channels.
///
/// # Errors
/// The reference's.
pub fn residual(splats: &Splats, goals: &[Goal], options: &ReferenceOptions) -> Result<f64, ReferenceError> {
    let (mut squares, mut pixels) = (0.0, 0usize);
    for Goal { view, pixels: goal } in goals {
        let image = reference::render(splats, view, options)?;
        for (p, q) in image.pixels.iter().zip(goal) {
            squares += DVec3::from(p.colour).distance_squared(glam::Vec3::from(*q).as_dvec3());
        }
        pixels += goal.len();
    }
    Ok(squares / (3 * pixels.max(1)) as f64)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ahead, balls};
    use super::*;

    fn scene() -> Splats {
        balls(&[
            ([0.0, 0.0, 3.0], 0.5, 0.6, [0.8, 0.2, 0.1]),
            ([0.4, 0.1, 3.5], 0.6, 0.7, [0.2, 0.7, 0.3]),
            ([-0.3, 0.3, 4.0], 0.9, 0.9, [0.3, 0.3, 0.9]),
        ])
    }

    #[test]
    fn colours_and_opacities_come_back() {
        let options = ReferenceOptions::default();
        let truth = scene();
        let goals = [Goal::of(&truth, &ahead(), &options).unwrap()];
        let mut wrong = truth.clone();
        wrong.sh[0][0] -= 0.5;
        wrong.sh[2][1] += 0.4;
        let before = residual(&wrong, &goals, &options).unwrap();
        let mut last = f64::INFINITY;
        for _ in 0..60 {
            let now = sweep(&mut wrong, &goals, &options, Fit::Colours).unwrap();
            assert!(now <= last, "a sweep of colours never makes it worse");
            last = now;
        }
        assert!(last < 1e-3 * before, "{before} {last}");
        assert!((wrong.sh[0][0] - truth.sh[0][0]).abs() < 0.03);

        let mut wrong = truth.clone();
        wrong.opacities = vec![0.4, 0.9, 0.7];
        let before = residual(&wrong, &goals, &options).unwrap();
        for _ in 0..60 {
            sweep(&mut wrong, &goals, &options, Fit::Opacities).unwrap();
        }
        let after = residual(&wrong, &goals, &options).unwrap();
        assert!(after < 0.02 * before, "{before} {after}");
        assert!((wrong.opacities[0] - 0.6).abs() < 0.03, "{:?}", wrong.opacities);
    }

    #[test]
    fn what_fits_already_is_left_alone_and_a_wrong_goal_is_refused() {
        let options = ReferenceOptions::default();
        let mut splats = scene();
        let goals = [Goal::of(&splats, &ahead(), &options).unwrap()];
        let [first, last] = refit(&mut splats, &goals, &options, 2).unwrap();
        assert!(first < 1e-12 && last < 1e-12, "{first} {last}");
        let bad = [Goal { view: ahead(), pixels: vec![[0.0; 3]; 7] }];
        assert!(sweep(&mut splats, &bad, &options, Fit::Colours).is_err());
    }
}
