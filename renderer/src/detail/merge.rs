//! Neighbours that look alike become one splat with the same moments.
//!
//! Two Gaussians with masses `a`, `b` are replaced by the one whose mean and covariance are those of their mixture:
//! `μ = (a μ₁ + b μ₂) / (a + b)`, `Σ = Σᵢ mᵢ (Σᵢ + (μᵢ − μ)(μᵢ − μ)ᵀ) / (a + b)`. A splat's mass is its optical depth
//! `−ln(1 − opacity)`, which adds up where splats cover each other, times its cross-section (averaged over directions); the
//! merged one's opacity gives the same mass again.

use glam::{DMat3, DQuat, DVec3};
use motes_scenes::{Splats, sh_coefficients};
use rayon::prelude::*;

/// Opacities are taken to be at most this: what covers a pixel entirely would have all the mass there is.
const MAX_OPACITY: f64 = 0.99;
/// Neighbours along the curve that each splat is compared with.
const NEIGHBOURS: usize = 12;
/// Shifts of the two curves that neighbours are looked for along, as shares of the scene.
pub(super) const SHIFTS: [f32; 2] = [0.0, 0.237];
/// Bits per axis of the space-filling curve.
const CURVE_BITS: u32 = 20;
/// Deviations below this share of a splat's largest are raised to it for comparing shapes: flat splats have no inverse.
const THINNEST: f64 = 1e-2;

/// Which pairs are merged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alike {
    /// Largest mean of the two Bhattacharyya distances between a splat and the merged one; 0.05 keeps 95 % of overlap.
    pub shape: f64,
    /// Largest difference of the base colours, per channel, `0 ..= 1`.
    pub colour: f64,
}

impl Default for Alike {
    fn default() -> Self {
        Self { shape: 0.05, colour: 0.05 }
    }
}

/// A mean, principal axes with deviations, opacity: what merging works on.
#[derive(Clone, Copy, Debug)]
struct Body {
    mean: DVec3,
    covariance: DMat3,
    mass: f64,
}

impl Body {
    fn of(splats: &Splats, i: usize) -> Self {
        let axes = DMat3::from_quat(DQuat::from_array(splats.rotations[i].map(f64::from)));
        let scales = DVec3::from_array(splats.log_scales[i].map(|s| f64::from(s).exp()));
        let square = DMat3::from_diagonal(scales * scales);
        Self {
            mean: DVec3::from_array(splats.means[i].map(f64::from)),
            covariance: axes * square * axes.transpose(),
            mass: -(1.0 - f64::from(splats.opacities[i]).min(MAX_OPACITY)).ln() * cross_section(scales),
        }
    }

    fn merged(a: &Self, b: &Self) -> Self {
        let mass = a.mass + b.mass;
        // Without mass at all, both count alike.
        let share = if mass > 0.0 { a.mass / mass } else { 0.5 };
        let mean = b.mean.lerp(a.mean, share);
        let part = |body: &Self, share: f64| {
            let d = body.mean - mean;
            (body.covariance + outer(d)) * share
        };
        Self { mean, covariance: part(a, share) + part(b, 1.0 - share), mass }
    }
}

fn outer(d: DVec3) -> DMat3 {
    DMat3::from_cols(d * d.x, d * d.y, d * d.z)
}

/// Cross-section of an ellipsoid with these deviations up to a constant: the root mean square over the three axes'
/// directions (the true mean over all directions, an elliptic integral, lies within 6 % of a multiple of it).
fn cross_section(s: DVec3) -> f64 {
    let faces = DVec3::new(s.y * s.z, s.x * s.z, s.x * s.y);
    faces.length() / 3f64.sqrt()
}

/// Bhattacharyya distance of two Gaussians, 0 where they are one.
fn distance(a: &Body, b: &Body) -> f64 {
    let middle = (a.covariance + b.covariance) * 0.5;
    let d = a.mean - b.mean;
    let between = d.dot(middle.inverse() * d) / 8.0;
    let shapes =
        0.5 * (middle.determinant() / (a.covariance.determinant() * b.covariance.determinant()).sqrt()).ln();
    between + shapes
}

/// The body with its thin sides raised, so that it has an inverse.
fn thickened(body: &Body) -> Body {
    let largest = (0..3).map(|k| body.covariance.col(k)[k]).fold(0.0, f64::max);
    let floor = DMat3::from_diagonal(DVec3::splat(largest * THINNEST * THINNEST));
    Body { covariance: body.covariance + floor, ..*body }
}

/// Eigenvectors (a rotation's columns) and eigenvalues of a symmetric matrix, by Jacobi's rotations.
fn principal(mut m: DMat3) -> (DMat3, DVec3) {
    let mut axes = DMat3::IDENTITY;
    for _ in 0..16 {
        let off = |m: &DMat3| m.col(1).x.powi(2) + m.col(2).x.powi(2) + m.col(2).y.powi(2);
        if off(&m) <= 1e-30 * m.to_cols_array().iter().map(|v| v * v).sum::<f64>() {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let apq = m.col(q)[p];
            if apq == 0.0 {
                continue;
            }
            let theta = (m.col(q)[q] - m.col(p)[p]) / (2.0 * apq);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = c;
            turn.col_mut(q)[q] = c;
            turn.col_mut(q)[p] = s;
            turn.col_mut(p)[q] = -s;
            m = turn.transpose() * m * turn;
            axes *= turn;
        }
    }
    if axes.determinant() < 0.0 {
        axes.z_axis = -axes.z_axis;
    }
    (axes, DVec3::new(m.col(0).x, m.col(1).y, m.col(2).z))
}

/// What two splats cost when merged, or nothing where they are not alike: shape and colour as shares of their limits.
fn cost(splats: &Splats, i: usize, j: usize, alike: Alike) -> Option<f64> {
    if let Some(labels) = &splats.labels
        && labels[i] != labels[j]
    {
        return None;
    }
    let (a, b) = (splats.sh_of(i)[0], splats.sh_of(j)[0]);
    let colour = (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max) * motes_scenes::SH_C0;
    let colour = f64::from(colour) / alike.colour;
    if !(colour <= 1.0) {
        return None;
    }
    let (a, b) = (Body::of(splats, i), Body::of(splats, j));
    let merged = thickened(&Body::merged(&a, &b));
    let shape = 0.5 * (distance(&thickened(&a), &merged) + distance(&thickened(&b), &merged)) / alike.shape;
    (shape <= 1.0).then_some(shape + colour)
}

/// Interleaves the bits of three coordinates: neighbours along the curve are neighbours in space, mostly.
fn morton(at: [u32; 3]) -> u64 {
    (0..CURVE_BITS).fold(0, |code, bit| {
        (0..3).fold(code, |code, k| code | (u64::from(at[k] >> bit & 1) << (3 * bit + k as u32)))
    })
}

/// Splats along a space-filling curve, shifted by a share of the box so that two curves have their seams apart.
pub(super) fn along_curve(splats: &Splats, shift: f32) -> Vec<u32> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for mean in &splats.means {
        for k in 0..3 {
            low[k] = low[k].min(mean[k]);
            high[k] = high[k].max(mean[k]);
        }
    }
    let side = (0..3).map(|k| high[k] - low[k]).fold(f32::MIN_POSITIVE, f32::max) * 1.5;
    let steps = (1u32 << CURVE_BITS) as f32;
    let place = |m: &[f32; 3]| {
        morton(std::array::from_fn(|k| {
            (((m[k] - low[k]) / side + shift) * steps).clamp(0.0, steps - 1.0) as u32
        }))
    };
    let mut keyed: Vec<(u64, u32)> = splats.means.par_iter().map(place).zip(0..splats.len() as u32).collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// Pairs of splats that are alike, cheapest first, every splat in one at most; at most `most` pairs. A moving scene has none:
/// its splats meet for a moment only.
pub fn pairs(splats: &Splats, alike: Alike, most: usize) -> Vec<[u32; 2]> {
    if splats.motion.is_some() || most == 0 {
        return Vec::new();
    }
    let mut found: Vec<(f64, u32, u32)> = Vec::new();
    for shift in SHIFTS {
        let curve = along_curve(splats, shift);
        found.par_extend((0..curve.len()).into_par_iter().flat_map_iter(|at| {
            let i = curve[at];
            let others = &curve[at + 1..(at + 1 + NEIGHBOURS).min(curve.len())];
            others.iter().filter_map(move |&j| {
                Some((cost(splats, i as usize, j as usize, alike)?, i.min(j), i.max(j)))
            })
        }));
    }
    found.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut taken = vec![false; splats.len()];
    let mut pairs = Vec::new();
    for (_, i, j) in found {
        if pairs.len() == most {
            break;
        }
        if !(taken[i as usize] || taken[j as usize]) {
            taken[i as usize] = true;
            taken[j as usize] = true;
            pairs.push([i, j]);
        }
    }
    pairs
}

/// Replaces the first of each pair by the merged splat and removes the second. Colours and labels: the mean by mass, and the
/// first's.
pub fn merge(splats: &mut Splats, pairs: &[[u32; 2]]) {
    let mut gone = vec![false; splats.len()];
    let coefficients = sh_coefficients(splats.sh_degree);
    for &[i, j] in pairs {
        let (i, j) = (i as usize, j as usize);
        let (a, b) = (Body::of(splats, i), Body::of(splats, j));
        let whole = Body::merged(&a, &b);
        let share = if whole.mass > 0.0 { (a.mass / whole.mass) as f32 } else { 0.5 };
        let (axes, squares) = principal(whole.covariance);
        let scales = squares.max(DVec3::ZERO).map(f64::sqrt);
        let area = cross_section(scales);
        splats.means[i] = whole.mean.as_vec3().to_array();
        splats.rotations[i] = DQuat::from_mat3(&axes).normalize().to_array().map(|v| v as f32);
        splats.log_scales[i] = scales
            .to_array()
            .map(|s| (s.ln() as f32).clamp(motes_scenes::MIN_LOG_SCALE, motes_scenes::MAX_LOG_SCALE));
        if area > 0.0 {
            splats.opacities[i] = (1.0 - (-whole.mass / area).exp()).min(MAX_OPACITY) as f32;
        }
        for k in 0..coefficients {
            let (p, q) = (splats.sh[i * coefficients + k], splats.sh[j * coefficients + k]);
            splats.sh[i * coefficients + k] = std::array::from_fn(|c| q[c] + (p[c] - q[c]) * share);
        }
        gone[j] = true;
    }
    splats.retain(|k| !gone[k]);
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ahead, balls};
    use super::*;
    use crate::reference::{ReferenceOptions, render};
    use motes_scenes::synthetic::Random;

    #[test]
    fn merged_splats_have_the_moments_of_both() {
        let mut splats = balls(&[
            ([0.0, 0.0, 3.0], 0.2, 0.5, [1.0, 0.0, 0.0]),
            ([0.2, 0.1, 3.1], 0.2, 0.5, [0.0, 1.0, 0.0]),
        ]);
        splats.log_scales[0] = [-2.0, -3.0, -1.5];
        splats.rotations[0] = Random::new(1).rotation();
        let (a, b) = (Body::of(&splats, 0), Body::of(&splats, 1));
        merge(&mut splats, &[[0, 1]]);
        assert_eq!(splats.len(), 1);
        let found = Body::of(&splats, 0);
        let share = a.mass / (a.mass + b.mass);
        let mean = a.mean * share + b.mean * (1.0 - share);
        // Second moments about the origin add up, whatever the formula that merged them.
        let second = |body: &Body| body.covariance + outer(body.mean);
        let expected = second(&a) * share + second(&b) * (1.0 - share);
        assert!(found.mean.distance(mean) < 1e-6);
        assert!(second(&found).abs_diff_eq(expected, 1e-5), "{:?} {expected:?}", second(&found));
        assert!((found.mass / (a.mass + b.mass) - 1.0).abs() < 1e-5);
        let red = 0.5 + splats.sh[0][0] * motes_scenes::SH_C0;
        assert!((f64::from(red) - share).abs() < 1e-5);
    }

    #[test]
    fn axes_come_back_from_covariances() {
        let mut random = Random::new(7);
        for _ in 0..200 {
            let axes = DMat3::from_quat(DQuat::from_array(random.rotation().map(f64::from)).normalize());
            let squares =
                DVec3::from_array(std::array::from_fn(|_| f64::from(random.uniform(-8.0, 2.0)).exp()));
            let matrix = axes * DMat3::from_diagonal(squares) * axes.transpose();
            let (found, values) = principal(matrix);
            let again = found * DMat3::from_diagonal(values) * found.transpose();
            assert!(again.abs_diff_eq(matrix, 1e-10 * squares.max_element()));
            assert!((found.determinant() - 1.0).abs() < 1e-9);
        }
        assert_eq!(principal(DMat3::ZERO).1, DVec3::ZERO);
    }

    #[test]
    fn only_what_is_alike_is_merged_and_the_picture_stays() {
        let red = [0.8, 0.1, 0.1];
        let mut splats = balls(&[
            ([0.0, 0.0, 3.0], 0.3, 0.4, red),
            ([0.05, 0.0, 3.0], 0.3, 0.4, red),
            ([0.05, 0.05, 3.0], 0.3, 0.4, [0.1, 0.8, 0.1]), // another colour
            ([0.0, 0.05, 3.0], 0.03, 0.4, red),             // another size
            ([0.9, 0.0, 3.0], 0.3, 0.4, red),               // elsewhere
        ]);
        assert_eq!(pairs(&splats, Alike::default(), 10), [[0, 1]]);
        assert!(pairs(&splats, Alike::default(), 0).is_empty());
        assert!(pairs(&splats, Alike { shape: 9.0, colour: 1.0 }, 10).len() == 2, "control: a loose rule");
        splats.labels = Some(vec![1, 2, 1, 1, 1]);
        assert!(pairs(&splats, Alike::default(), 10).is_empty(), "classes are not mixed");
        splats.retain(|i| i < 2);
        let options = ReferenceOptions::default();
        let before = render(&splats, &ahead(), &options).unwrap();
        let mut one = splats.clone();
        one.retain(|i| i == 0);
        merge(&mut splats, &[[0, 1]]);
        let red = |image: &crate::reference::ReferenceImage| image.mean(|p| p.colour[0]);
        let change =
            |splats: &Splats| (red(&render(splats, &ahead(), &options).unwrap()) / red(&before) - 1.0).abs();
        assert!(change(&splats) < 0.12 && change(&one) > 0.25, "{} {}", change(&splats), change(&one));
    }
}
