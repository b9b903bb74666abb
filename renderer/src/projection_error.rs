//! How far a linearised projection is off, by direction: the error function of Huang et al. 2024 (“Optimal Projection
//! for 3D Gaussian Splatting”, equations 9, 11, 13 and 16, figure 2).
//!
//! A direction is (θ, φ) as in equation 13: `(sin φ cos θ, −sin θ, cos φ cos θ)`, x right, y down, z forward. ε(θ, φ) is
//! the squared remainder of the first-order expansion at that direction, integrated over the directions within `half`
//! of it in θ and in φ; the paper takes `half` = π/4. It is a number without unit, in squared distances on the plane of
//! projection (radians, near its foot).

use crate::view::Fov;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// The paper's half-width of the region of integration.
pub const PAPER_HALF: f64 = FRAC_PI_4;

/// Nodes and weights of the Gauss–Legendre rule of ten points on `−1 ..= 1` (Abramowitz and Stegun, table 25.4).
const NODES: [(f64, f64); 5] = [
    (0.148_874_338_981_631_2, 0.295_524_224_714_752_9),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_4),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];

/// Panels that a region is cut into, along each axis.
const PANELS: usize = 8;

/// The unit vector of a direction (equation 13).
pub fn direction(theta: f64, phi: f64) -> DVec3 {
    DVec3::new(phi.sin() * theta.cos(), -theta.sin(), phi.cos() * theta.cos())
}

/// `‖R₁‖²` of equation 9 for the plane z = 1: how far the projection of `x` is from where the expansion at `mu` puts it.
pub fn remainder(mu: DVec3, x: DVec3) -> f64 {
    let project = |v: DVec3| v / v.z;
    // ∂φ/∂x at μ applied to x − μ (equation 10); φ is homogeneous, so μ may have any length.
    let d = x - mu;
    let linear = d / mu.z - DVec3::Z * (d.z / mu.z) - DVec3::new(mu.x, mu.y, 0.0) * (d.z / (mu.z * mu.z));
    let rest = project(x) - project(mu) - linear;
    rest.x * rest.x + rest.y * rest.y
}

/// ε(θ, φ) of equation 16: the error of the classic projection in a direction. ∞ where the region reaches directions that
/// do not meet the plane.
pub fn epsilon(theta: f64, phi: f64, half: f64) -> f64 {
    if !(theta.abs() + half < FRAC_PI_2 && phi.abs() + half < FRAC_PI_2) {
        return f64::INFINITY;
    }
    let mu = direction(theta, phi);
    integrate(theta, half, |t| integrate(phi, half, |p| remainder(mu, direction(t, p))))
}

/// The error of the optimal projection, the same in every direction: that of the classic one at the foot of its plane,
/// where the tangent plane *is* the plane (section 5.1).
pub fn epsilon_optimal(half: f64) -> f64 {
    epsilon(0.0, 0.0, half)
}

/// Expectation of ε over the pixels of a view: means that are equally likely anywhere in the picture. Directions whose
/// region leaves the half-space before the eye count as ∞.
pub fn expectation(fov: &Fov, half: f64) -> f64 {
    const STEPS: usize = 24;
    let at = |low: f64, high: f64, i: usize| low + (high - low) * (i as f64 + 0.5) / STEPS as f64;
    let mut sum = 0.0;
    for i in 0..STEPS {
        for j in 0..STEPS {
            let ray = DVec3::new(at(fov.left, fov.right, i), at(fov.up, fov.down, j), 1.0).normalize();
            sum += epsilon((-ray.y).asin(), ray.x.atan2(ray.z), half);
        }
    }
    sum / (STEPS * STEPS) as f64
}

fn integrate(middle: f64, half: f64, f: impl Fn(f64) -> f64) -> f64 {
    let width = half / PANELS as f64;
    (0..PANELS)
        .map(|panel| {
            let center = middle - half + width * (2 * panel + 1) as f64;
            let pair = |&(x, w): &(f64, f64)| w * (f(center - width * x) + f(center + width * x));
            width * NODES.iter().map(pair).sum::<f64>()
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integrand as equation 16 prints it.
    fn printed(tm: f64, pm: f64, t: f64, p: f64) -> f64 {
        let first = -(p - pm).sin() * t.cos() / (pm.cos().powi(2) * tm.cos()) + p.tan() - pm.tan();
        let second = t.sin() / (pm.cos() * tm.cos())
            - tm.sin() * p.cos() * t.cos() / (pm.cos().powi(2) * tm.cos().powi(2))
            + tm.tan() / pm.cos()
            - t.tan() / p.cos();
        first * first + second * second
    }

    #[test]
    fn vectors_and_the_printed_integrand_agree() {
        for (tm, pm) in [(0.0, 0.0), (0.3, -0.2), (-0.7, 0.5)] {
            for (t, p) in [(0.1, 0.2), (-0.6, 0.7), (0.9, -1.1)] {
                let (a, b) = (remainder(direction(tm, pm), direction(t, p)), printed(tm, pm, t, p));
                assert!((a - b).abs() <= 1e-12 * a.max(1.0), "{a} {b}");
            }
        }
        // An expansion is exact where it is made, and nowhere near the rim.
        assert!(remainder(direction(0.4, 0.3), direction(0.4, 0.3)) < 1e-24);
        assert!(remainder(DVec3::Z, direction(1.2, 0.0)) > 1.0);
    }

    /// Section 4: the least error is at the foot of the plane, and towards the region's limits it grows fast (figure 2).
    #[test]
    fn the_surface_has_the_published_shape() {
        let least = epsilon(0.0, 0.0, PAPER_HALF);
        let step = 1e-3;
        for (t, p) in [(step, 0.0), (0.0, step), (-step, 0.0), (0.0, -step), (0.1, 0.2), (0.5, -0.5)] {
            assert!(epsilon(t, p, PAPER_HALF) > least, "{t} {p}");
        }
        // Equation 17: the slope is zero there.
        let slope = (epsilon(step, 0.0, PAPER_HALF) - epsilon(-step, 0.0, PAPER_HALF)) / (2.0 * step);
        assert!(slope.abs() < 1e-9, "{slope}");
        // Figure 2: close to the middle hardly anything changes; at 0.95 of the limit orders of magnitude.
        let (near, far) = (0.095 * FRAC_PI_4, 0.95 * FRAC_PI_4);
        assert!(epsilon(near, near, PAPER_HALF) < 1.2 * least);
        assert!(epsilon(far, far, PAPER_HALF) > 100.0 * least);
        assert_eq!(epsilon(FRAC_PI_4, 0.0, PAPER_HALF), f64::INFINITY);
    }

    /// Integration against sums over a fine grid.
    #[test]
    fn integrals_are_right() {
        let (tm, pm, half) = (0.4, -0.3, 0.3);
        let n = 400;
        let mut sum = 0.0;
        for i in 0..n {
            for j in 0..n {
                let at = |m: f64, i: i32| m - half + 2.0 * half * (f64::from(i) + 0.5) / f64::from(n);
                sum += printed(tm, pm, at(tm, i), at(pm, j));
            }
        }
        let expected = sum * (2.0 * half / f64::from(n)).powi(2);
        let found = epsilon(tm, pm, half);
        assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
    }

    #[test]
    fn a_wider_view_errs_more_on_average() {
        let fov = |t: f64| Fov { left: -t, right: t, up: -t, down: t };
        let half = 0.05;
        let [narrow, wide] = [0.5, 1.4].map(|t| expectation(&fov(t), half));
        assert!(epsilon_optimal(half) < narrow && 4.0 * narrow < wide && wide.is_finite(), "{narrow} {wide}");
    }
}
