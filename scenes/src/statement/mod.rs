//! The statement of a scene: what is in it, in figures (`motes info`).

mod histogram;
mod text;

use std::collections::BTreeMap;
use std::f64::consts::PI;

use rayon::prelude::*;

pub use histogram::{Bin, Histogram};

use crate::{LoadReport, Motion, Scene, SourceInfo, Splats, sh_coefficients};

/// What is in a scene. Lengths are in scene units (metres where the settings' scale is 1).
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Statement {
    /// The files it came from, in order.
    pub sources: Vec<SourceInfo>,
    /// Number of splats in the scene.
    pub splats: usize,
    /// Degree of the spherical harmonics, `0 ..= 3`.
    pub sh_degree: u8,
    /// Bytes of its files together.
    pub bytes_on_disk: u64,
    /// Bytes of its splats in memory.
    pub bytes_in_memory: u64,
    /// What loading dropped and changed, and why.
    pub loading: LoadReport,
    /// Where it lies; `None` in an empty scene.
    pub bounds: Option<Bounds>,
    /// Opacities at the centre of splats.
    pub opacity: Opacity,
    /// Sizes: the largest of a splat's three standard deviations.
    pub size: Histogram,
    /// Anisotropy: the largest over the smallest standard deviation, ≥ 1.
    pub anisotropy: Histogram,
    /// Strength of each band of the spherical harmonics, the constant one (degree 0) first.
    pub bands: Vec<Band>,
    /// Motion; `None` in a still scene.
    pub motion: Option<MotionStatement>,
    /// Splats per class, 0 = unlabelled; `None` where nobody labelled the scene.
    pub labels: Option<BTreeMap<u16, usize>>,
}

/// Where a scene lies.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Bounds {
    /// The origin that the means are stored relative to (already in the other fields).
    pub origin: [f64; 3],
    /// Least mean per axis.
    pub min: [f64; 3],
    /// Greatest mean per axis.
    pub max: [f64; 3],
    /// Per axis, what one in a hundred means lies below.
    pub inner_min: [f64; 3],
    /// Per axis, what one in a hundred means lies above.
    pub inner_max: [f64; 3],
}

/// Opacities.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Opacity {
    /// Ten bins from 0 to 1.
    pub histogram: Histogram,
    /// Splats of opacity 0: never seen.
    pub exactly_zero: usize,
    /// Splats of opacity 1.
    pub exactly_one: usize,
}

/// A band of the spherical harmonics.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Band {
    /// Its degree.
    pub degree: u8,
    /// Root mean square of what the band adds to the colour, over all directions, splats and channels; 1 is from
    /// black to white. (By Parseval, `√(Σ c² / 4π)` per splat and channel.)
    pub rms: f64,
    /// Share of the splats for which that is at least 1/255 in some channel, `0 ..= 1`.
    pub visible: f64,
}

/// What moves, and how long splats last. Times are shares of the scene's duration.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MotionStatement {
    /// Share of splats that, while they can be seen, leave their place by more than a tenth of their size.
    pub moving: f64,
    /// Share of splats that turn by more than a degree while they can be seen.
    pub turning: f64,
    /// Share of splats that can be seen during the whole scene.
    pub permanent: f64,
    /// Splats that can be seen at a moment, on average.
    pub alive: f64,
    /// How long splats can be seen: the time within the scene at which their opacity is at least 1/255.
    pub support: Histogram,
    /// How far splats leave their place while they can be seen; those that do not are not counted.
    pub displacement: Histogram,
}

/// Below this opacity nothing lands on an 8-bit image.
const VISIBLE: f64 = 1.0 / 255.0;

impl Statement {
    /// States what is in a scene.
    pub fn of(scene: &Scene) -> Self {
        let splats = &scene.splats;
        let opacities = &splats.opacities;
        let count = |value: f32| opacities.par_iter().filter(|&&opacity| opacity == value).count();
        let widest = |s: &[f32; 3]| f64::from(s[0].max(s[1]).max(s[2]));
        let narrowest = |s: &[f32; 3]| f64::from(s[0].min(s[1]).min(s[2]));
        let scales = splats.log_scales.par_iter();
        Self {
            sources: scene.sources.clone(),
            splats: splats.len(),
            sh_degree: splats.sh_degree,
            bytes_on_disk: scene.sources.iter().map(|source| source.bytes).sum(),
            bytes_in_memory: bytes_in_memory(splats),
            loading: scene.report.clone(),
            bounds: bounds(splats),
            opacity: Opacity {
                histogram: Histogram::linear(10, opacities.par_iter().map(|&opacity| opacity.into())),
                exactly_zero: count(0.0),
                exactly_one: count(1.0),
            },
            size: Histogram::logarithmic(scales.clone().map(|s| widest(s).exp())),
            anisotropy: Histogram::logarithmic(scales.map(|s| (widest(s) - narrowest(s)).exp())),
            bands: bands(splats),
            motion: splats.motion.as_ref().map(|motion| MotionStatement::of(splats, motion)),
            labels: splats.labels.as_ref().map(|labels| {
                let mut classes = BTreeMap::new();
                for &label in labels {
                    *classes.entry(label).or_default() += 1;
                }
                classes
            }),
        }
    }
}

fn bytes_in_memory(splats: &Splats) -> u64 {
    let each = Splats::bytes_per_splat(splats.sh_degree, splats.motion.is_some());
    let label = if splats.labels.is_some() { size_of::<u16>() } else { 0 };
    (splats.len() * (each + label)) as u64
}

fn bounds(splats: &Splats) -> Option<Bounds> {
    let last = splats.len().checked_sub(1)?;
    let axis = |k: usize| {
        let mut values: Vec<f32> = splats.means.iter().map(|mean| mean[k]).collect();
        let mut at = |index: usize| f64::from(*values.select_nth_unstable_by(index, f32::total_cmp).1);
        // Every selection leaves a permutation, and the next one starts from it.
        [0, last, last / 100, last - last / 100].map(|index| splats.origin[k] + at(index))
    };
    let [x, y, z]: [[f64; 4]; 3] = {
        let ((x, y), z) = rayon::join(|| rayon::join(|| axis(0), || axis(1)), || axis(2));
        [x, y, z]
    };
    let of = |index: usize| [x[index], y[index], z[index]];
    Some(Bounds { origin: splats.origin, min: of(0), max: of(1), inner_min: of(2), inner_max: of(3) })
}

fn bands(splats: &Splats) -> Vec<Band> {
    let n = splats.len();
    (0..=splats.sh_degree)
        .map(|degree| {
            let first = if degree == 0 { 0 } else { sh_coefficients(degree - 1) };
            let range = first..sh_coefficients(degree);
            let (energy, visible) = (0..n)
                .into_par_iter()
                .with_min_len(1 << 12)
                .map(|i| {
                    let mut energy = [0.0; 3];
                    for coefficient in &splats.sh_of(i)[range.clone()] {
                        for (energy, c) in energy.iter_mut().zip(coefficient) {
                            *energy += f64::from(*c).powi(2) / (4.0 * PI);
                        }
                    }
                    let most = energy.iter().copied().fold(0.0, f64::max);
                    (energy.iter().sum::<f64>(), usize::from(most >= VISIBLE * VISIBLE))
                })
                .reduce(|| (0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
            let share = |total: f64, of: usize| if of == 0 { 0.0 } else { total / of as f64 };
            Band { degree, rms: share(energy, 3 * n).sqrt(), visible: share(visible as f64, n) }
        })
        .collect()
}

/// What a splat does during the scene.
struct Life {
    /// How long it can be seen, share of the duration.
    seen: f64,
    /// How far it leaves its place meanwhile.
    displacement: f64,
    /// How far it turns meanwhile, radians.
    turn: f64,
}

impl Life {
    fn of(splats: &Splats, motion: &Motion, i: usize) -> Self {
        let (center, width) = (f64::from(motion.centers[i]), f64::from(motion.widths[i]));
        let opacity = f64::from(splats.opacities[i]);
        // α exp(−(dt / w)²) ≥ 1/255  ⇔  |dt| ≤ w √(ln 255 α)
        let half = if opacity < VISIBLE { -1.0 } else { width * (opacity / VISIBLE).ln().sqrt() };
        let (from, to) = ((center - half).max(0.0), (center + half).min(1.0));
        if !(from <= to) {
            return Self { seen: 0.0, displacement: 0.0, turn: 0.0 };
        }
        let polynomial = motion.polynomials[i].map(|p| p.map(f64::from));
        let omega = motion.omegas[i].map(f64::from);
        let rotation = splats.rotations[i].map(f64::from);
        let (mut displacement, mut turn) = (0.0_f64, 0.0_f64);
        // A cubic's extremes lie between samples by little, and this is a figure to look at.
        const SAMPLES: usize = 8;
        for s in 0..=SAMPLES {
            let dt = from + (to - from) * s as f64 / SAMPLES as f64 - center;
            let moved: f64 = (0..3)
                .map(|k| (dt * (polynomial[0][k] + dt * (polynomial[1][k] + dt * polynomial[2][k]))).powi(2))
                .sum();
            displacement = displacement.max(moved.sqrt());
            let turned: [f64; 4] = std::array::from_fn(|k| rotation[k] + dt * omega[k]);
            let length = turned.iter().map(|v| v * v).sum::<f64>().sqrt();
            let cosine = turned.iter().zip(rotation).map(|(a, b)| a * b).sum::<f64>() / length;
            if cosine.is_finite() {
                turn = turn.max(2.0 * cosine.abs().min(1.0).acos());
            }
        }
        Self { seen: to - from, displacement, turn }
    }
}

impl MotionStatement {
    fn of(splats: &Splats, motion: &Motion) -> Self {
        let n = splats.len();
        let lives: Vec<Life> = (0..n).into_par_iter().map(|i| Life::of(splats, motion, i)).collect();
        let share = |count: usize| if n == 0 { 0.0 } else { count as f64 / n as f64 };
        let moves = |i: usize| {
            let [x, y, z] = splats.log_scales[i];
            lives[i].displacement > 0.1 * f64::from(x.max(y).max(z)).exp()
        };
        Self {
            moving: share((0..n).filter(|&i| moves(i)).count()),
            turning: share(lives.iter().filter(|life| life.turn > PI / 180.0).count()),
            permanent: share(lives.iter().filter(|life| life.seen >= 1.0).count()),
            alive: lives.iter().map(|life| life.seen).sum(),
            support: Histogram::linear(10, lives.par_iter().map(|life| life.seen)),
            displacement: Histogram::logarithmic(
                lives.par_iter().map(|life| life.displacement).filter(|&d| d > 0.0),
            ),
        }
    }
}

#[cfg(test)]
mod tests;
