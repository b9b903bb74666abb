//! From a 3-D Gaussian to what an eye sees of it: the ladder affine – tangent – exact.
//!
//! Everything here works on an [`EyeSplat`]: the mean in eye axes (x right, y down, z forward, metres) and the columns
//! of a square root of the covariance, `Σ = Σ_k c_k c_kᵀ`. The covariance itself is never formed, let alone
//! inverted: a needle of 10⁶ : 1 would lose its thin side to rounding, and a flat splat has no inverse.
//!
//! The low-pass filters are part of the splat, so that they mean the same on every rung:
//! * planar (2-D): two more columns, parallel to the image plane, √0.3 px long at the mean's depth. Under the affine
//!   projection they add exactly `0.3 · I` px² to the image covariance, as the trainers do; under the tangent one they
//!   are the same 0.3 px² seen on the tangent plane; along a ray they widen the splat itself.
//! * volumetric (3-D): every standard deviation `s` becomes `hypot(s, √0.3 · z / f)`.
//!
//! Functions that end in `_f32` are the twins of the shaders' functions.

use glam::{DMat3, DQuat, DVec2, DVec3, Vec2, Vec3};

use crate::config::{Lens, LowPass, RadiusRule};
use crate::view::{Fov, View};

/// Variance of the low-pass filter, px² (Kerbl et al. 2023).
pub const LOW_PASS_VARIANCE: f64 = 0.3;
/// Affine: slopes `x/z` and `y/z` of the mean are clamped to this multiple of the frustum's, per side.
pub const FRUSTUM_CLAMP: f64 = 1.3;
/// Opacity compensation never falls below this (`√0.000025`, the trainers' guard).
pub const COMPENSATION_FLOOR: f64 = 0.005;
/// The plane of the tangent projection leans back, at one standard deviation, by at most this share of the mean's distance. So
/// it stays clear of the eye within any reach ([`reach`] is at most 3.33), and what the eye is inside of keeps its head.
pub const MAX_LEAN: f64 = 0.25;
/// No splat covers a pixel more than this.
pub const MAX_ALPHA: f64 = 0.99;
/// What covers a pixel less than this is left out: below one step of an 8-bit image.
pub const MIN_ALPHA: f64 = 1.0 / 255.0;

/// A splat in eye axes, low-pass filter included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeSplat {
    /// The mean, metres.
    pub mean: DVec3,
    /// Columns of a square root of the covariance, metres: three principal axes, one standard deviation long, and
    /// the planar filter's two (zero without one).
    pub columns: [DVec3; 5],
}

/// The three columns of `W R S`: principal axes in eye axes, one standard deviation long.
/// `rotation` (a unit quaternion) turns splat axes to scene axes.
pub fn principal_axes(world_to_eye: &DMat3, rotation: DQuat, scales: DVec3) -> [DVec3; 3] {
    let axes = *world_to_eye * DMat3::from_quat(rotation);
    [axes.x_axis * scales.x, axes.y_axis * scales.y, axes.z_axis * scales.z]
}

/// Standard deviations widened by the volumetric filter at eye depth `z` (0 where the mean is behind the eye).
/// The focal length is the geometric mean of both directions', pixels.
pub fn volumetric_scales(scales: DVec3, z: f64, focal: [f64; 2]) -> DVec3 {
    let filter = LOW_PASS_VARIANCE.sqrt() * z.max(0.0) / (focal[0] * focal[1]).sqrt();
    DVec3::new(scales.x.hypot(filter), scales.y.hypot(filter), scales.z.hypot(filter))
}

/// The planar filter's two columns at eye depth `z` (0 where the mean is behind the eye).
pub fn planar_columns(z: f64, focal: [f64; 2]) -> [DVec3; 2] {
    let filter = LOW_PASS_VARIANCE.sqrt() * z.max(0.0);
    [DVec3::X * (filter / focal[0]), DVec3::Y * (filter / focal[1])]
}

impl EyeSplat {
    /// A splat with its low-pass filter. `mean` and `scales` in metres, `rotation` a unit quaternion (splat to scene axes).
    pub fn new(view: &View, low_pass: LowPass, mean: DVec3, rotation: DQuat, scales: DVec3) -> Self {
        let focal = view.focal();
        let (scales, filter) = match low_pass {
            LowPass::Off => (scales, [DVec3::ZERO; 2]),
            LowPass::Planar | LowPass::PlanarCompensated => (scales, planar_columns(mean.z, focal)),
            LowPass::Volumetric | LowPass::VolumetricCompensated => {
                (volumetric_scales(scales, mean.z, focal), [DVec3::ZERO; 2])
            }
        };
        let [a, b, c] = principal_axes(&view.rotation, rotation, scales);
        Self { mean, columns: [a, b, c, filter[0], filter[1]] }
    }

    /// [`EyeSplat::new`] through any lens. The filters are as wide as a pixel is at the mean: the planar one's columns are
    /// the steps that lead one pixel on, the volumetric one is the side of a square of a pixel's area.
    pub fn through(
        lens: Lens,
        view: &View,
        low_pass: LowPass,
        mean: DVec3,
        rotation: DQuat,
        scales: DVec3,
    ) -> Self {
        if lens == Lens::Perspective {
            return Self::new(view, low_pass, mean, rotation, scales);
        }
        let [fx, fy] = view.focal();
        let distance = mean.length();
        let [x, y] = lens.steps(mean / distance);
        let deviation = LOW_PASS_VARIANCE.sqrt() * distance;
        let (scales, filter) = match low_pass {
            LowPass::Off => (scales, [DVec3::ZERO; 2]),
            LowPass::Planar | LowPass::PlanarCompensated => {
                (scales, [x * (deviation / fx), y * (deviation / fy)])
            }
            LowPass::Volumetric | LowPass::VolumetricCompensated => {
                let width = deviation * (x.cross(y).length() / (fx * fy)).sqrt();
                (scales.map(|s| s.hypot(width)), [DVec3::ZERO; 2])
            }
        };
        let [a, b, c] = principal_axes(&view.rotation, rotation, scales);
        Self { mean, columns: [a, b, c, filter[0], filter[1]] }
    }

    /// Columns of a square root of the image covariance, px: linearised at the mean on the plane z = 1, with the
    /// mean's slopes clamped to [`FRUSTUM_CLAMP`] times the frustum's on each side. For means in front of the eye.
    pub fn affine_columns(&self, fov: &Fov, focal: [f64; 2]) -> [DVec2; 5] {
        let z = self.mean.z;
        let slope = affine_slope(self.mean, fov);
        self.columns
            .map(|c| DVec2::new(focal[0] * (c.x - slope.x * c.z) / z, focal[1] * (c.y - slope.y * c.z) / z))
    }

    /// Columns of a square root of the covariance on the plane tangent to the unit sphere at the mean's direction
    /// (`003`, equation 21), in the basis [`tangent_basis`] of that plane.
    pub fn tangent_columns(&self, basis: &[DVec3; 2]) -> [DVec2; 5] {
        let distance = self.mean.length();
        self.columns.map(|c| DVec2::new(basis[0].dot(c), basis[1].dot(c)) / distance)
    }

    /// How far the ellipse on the tangent plane at the direction `m` leans back from it: at one standard deviation along each
    /// of the ellipse's axes (unit vectors in the plane), the splat is strongest so far behind the plane, on the parallel to `m`
    /// (the mean depth there, given the place in the plane: `cov(depth, place) / variance(place)`). Over the mean's distance,
    /// as [`EyeSplat::tangent_columns`]; at most [`MAX_LEAN`] in all.
    ///
    /// A ray that meets the leaning ellipse at `q` squared standard deviations is at most `q / (1 + q s²)` away from the
    /// mean, `s` what is left of the depth's deviation ([`RaySplat`]): the plane alone errs in the second order of the
    /// splat's depth over its distance, where the upright plane errs in the first.
    pub fn lean(&self, m: DVec3, basis: &[DVec3; 2], ellipse: &Ellipse) -> [f64; 2] {
        // The slope of the mean depth over the place is a ratio of sums of 2 × 2 minors (Cauchy-Binet): a covariance along the
        // shorter axis would be a difference of what a needle has along the longer one.
        let rows = [basis[0], basis[1], m].map(|axis| self.columns.map(|c| c.dot(axis)));
        let (mut slope, mut det) = (DVec2::ZERO, 0.0);
        for i in 0..rows[0].len() {
            for j in 0..i {
                let minor = |a: usize, b: usize| rows[a][i] * rows[b][j] - rows[a][j] * rows[b][i];
                slope += DVec2::new(minor(2, 1), minor(0, 2)) * minor(0, 1);
                det += minor(0, 1) * minor(0, 1);
            }
        }
        let axes = [ellipse.direction, ellipse.direction.perp()];
        let lean = [0, 1].map(|i| slope.dot(axes[i]) / det * ellipse.deviations[i]);
        let length = lean[0].hypot(lean[1]);
        if length > MAX_LEAN { lean.map(|l| l * (MAX_LEAN / length)) } else { lean }
    }

    /// Largest reach of the ellipsoid of `k` standard deviations along `normal` (any length), from the mean.
    pub fn support(&self, normal: DVec3, k: f64) -> f64 {
        k * self.columns.iter().map(|c| c.dot(normal).powi(2)).sum::<f64>().sqrt()
    }
}

/// Slopes of the mean, `x/z` and `y/z`, clamped per side.
pub fn affine_slope(mean: DVec3, fov: &Fov) -> DVec2 {
    let clamp = |slope: f64, low: f64, high: f64| slope.max(FRUSTUM_CLAMP * low).min(FRUSTUM_CLAMP * high);
    DVec2::new(clamp(mean.x / mean.z, fov.left, fov.right), clamp(mean.y / mean.z, fov.up, fov.down))
}

/// Two unit vectors that complete the unit vector `m` to a right-handed orthonormal basis (Duff et al. 2017, branchless).
pub fn tangent_basis(m: DVec3) -> [DVec3; 2] {
    let sign = 1f64.copysign(m.z);
    let a = -1.0 / (sign + m.z);
    let b = m.x * m.y * a;
    [DVec3::new(1.0 + sign * m.x * m.x * a, sign * b, -sign * m.x), DVec3::new(b, sign + m.y * m.y * a, -m.y)]
}

/// [`tangent_basis`] in single precision.
pub fn tangent_basis_f32(m: Vec3) -> [Vec3; 2] {
    let sign = 1f32.copysign(m.z);
    let a = -1.0 / (sign + m.z);
    let b = m.x * m.y * a;
    [Vec3::new(1.0 + sign * m.x * m.x * a, sign * b, -sign * m.x), Vec3::new(b, sign + m.y * m.y * a, -m.y)]
}

/// A 2-D Gaussian's principal axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Unit vector along the longer axis; the shorter one is at a right angle to it.
    pub direction: DVec2,
    /// Standard deviations along the longer and the shorter axis.
    pub deviations: [f64; 2],
}

impl Ellipse {
    /// From the columns of a square root of the covariance, without subtracting nearly equal numbers: with the rows
    /// `a1`, `a2` and `E = |a1|²`, `G = |a2|²`, `F = a1·a2`, `r = hypot(½(E−G), F)`: `λ1 = ½(E+G) + r`, `λ2 = det / λ1`,
    /// `det = |a1 × a2|²` as a sum of squares (Lagrange's identity), and the direction by half the angle of `(½(E−G), F)`.
    pub fn from_columns(columns: &[DVec2]) -> Self {
        let scale = columns.iter().fold(0.0, |m: f64, c| m.max(c.x.abs()).max(c.y.abs()));
        if !(scale > 0.0 && scale.is_finite()) {
            return Self { direction: DVec2::X, deviations: [scale; 2] };
        }
        let (mut e, mut f, mut g, mut det) = (0.0, 0.0, 0.0, 0.0);
        for (i, &c) in columns.iter().enumerate() {
            let c = c / scale;
            e += c.x * c.x;
            f += c.x * c.y;
            g += c.y * c.y;
            for &d in &columns[..i] {
                let minor = c.perp_dot(d / scale);
                det += minor * minor;
            }
        }
        let half = 0.5 * (e - g);
        let larger = 0.5 * (e + g) + half.hypot(f);
        let angle = 0.5 * f.atan2(half);
        Self {
            direction: DVec2::new(angle.cos(), angle.sin()),
            deviations: [scale * larger.sqrt(), scale * (det / larger).sqrt()],
        }
    }

    /// Square root of the covariance's determinant; `2π` times this is the area under the Gaussian.
    pub fn area(&self) -> f64 {
        self.deviations[0] * self.deviations[1]
    }
}

/// [`Ellipse::from_columns`] in single precision: unit direction of the longer axis, and both standard deviations.
pub fn ellipse_f32(columns: &[Vec2]) -> (Vec2, [f32; 2]) {
    let scale = columns.iter().fold(0.0, |m: f32, c| m.max(c.x.abs()).max(c.y.abs()));
    if !(scale > 0.0 && scale.is_finite()) {
        return (Vec2::X, [scale; 2]);
    }
    let (mut e, mut f, mut g, mut det) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
    for (i, &c) in columns.iter().enumerate() {
        let c = c / scale;
        e += c.x * c.x;
        f += c.x * c.y;
        g += c.y * c.y;
        for &d in &columns[..i] {
            let minor = c.perp_dot(d / scale);
            det += minor * minor;
        }
    }
    let half = 0.5 * (e - g);
    let larger = 0.5 * (e + g) + (half * half + f * f).sqrt();
    let angle = 0.5 * f.atan2(half);
    (Vec2::new(angle.cos(), angle.sin()), [scale * larger.sqrt(), scale * (det / larger).sqrt()])
}

/// What a splat gives along the rays through the eye, at most: the exact rung (Hahlbohm et al. 2024).
///
/// The ray through the image point of slopes `(x, y)` is where the planes `p_x = x p_z` and `p_y = y p_z` meet. In
/// the splat's own coordinates `p = mean + L q` these are `n1·q = a`, `n2·q = b` with `n1 = −L0 + x L2`, `n2 = −L1 + y L2`,
/// `a = mean_x − x mean_z`, `b = mean_y − y mean_z` (`L0 … L2` the rows of L). The point nearest to the mean is
/// `q = w × N / |N|²`, `w = a n2 − b n1`, `N = n1 × n2`, and its squared distance, in standard deviations, `|w|² / |N|²`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySplat {
    /// The mean in eye axes, metres.
    pub mean: DVec3,
    /// Rows of a 3 × 3 square root of the covariance, metres.
    pub rows: [DVec3; 3],
}

impl From<&EyeSplat> for RaySplat {
    /// Brings the five columns to three by Householder reflections (`C = L Q`), which lose nothing.
    fn from(splat: &EyeSplat) -> Self {
        let mut rows: [[f64; 5]; 3] = [[0.0; 5]; 3];
        for (k, c) in splat.columns.iter().enumerate() {
            rows[0][k] = c.x;
            rows[1][k] = c.y;
            rows[2][k] = c.z;
        }
        for r in 0..3 {
            // Reflects columns r.. so that row r keeps only its r-th entry.
            let norm = rows[r][r..].iter().fold(0.0f64, |n, &v| n.hypot(v));
            if !(norm > 0.0 && norm.is_finite()) {
                continue;
            }
            let mut mirror = [0.0; 5];
            for k in r..5 {
                mirror[k] = rows[r][k] / norm;
            }
            mirror[r] += 1f64.copysign(mirror[r]);
            let square: f64 = mirror.iter().map(|v| v * v).sum();
            for row in &mut rows[r..] {
                let dot: f64 = row.iter().zip(mirror).map(|(a, b)| a * b).sum();
                for (v, m) in row.iter_mut().zip(mirror) {
                    *v -= 2.0 * dot / square * m;
                }
            }
        }
        Self { mean: splat.mean, rows: rows.map(|row| DVec3::new(row[0], row[1], row[2])) }
    }
}

impl RaySplat {
    /// As [`RaySplat::at`], for a ray in any direction (a unit vector), and the distance along it instead of the depth: two
    /// planes through the ray, at right angles to each other, take the place of the two of a slope.
    pub fn along(&self, ray: DVec3) -> (f64, f64) {
        let [l0, l1, l2] = self.rows;
        let transposed = |n: DVec3| l0 * n.x + l1 * n.y + l2 * n.z;
        let [a, b] = tangent_basis(ray);
        let (na, nb) = (transposed(a), transposed(b));
        // In the splat's coordinates q the planes are na·q = −a·μ and nb·q = −b·μ.
        let normal = na.cross(nb);
        let w = nb * a.dot(self.mean) - na * b.dot(self.mean);
        let square = normal.length_squared();
        let nearest = normal.cross(w) / square;
        (w.length_squared() / square, ray.dot(self.mean) + transposed(ray).dot(nearest))
    }

    /// Squared distance of the ray from the mean, in standard deviations, and the eye depth (metres) of the ray's
    /// point of largest response; that depth can be negative, and then the ray itself, which starts at the eye, sees
    /// nothing of it. Not finite where the splat has no extent across the ray.
    pub fn at(&self, slope: DVec2) -> (f64, f64) {
        let [l0, l1, l2] = self.rows;
        let n1 = slope.x * l2 - l0;
        let n2 = slope.y * l2 - l1;
        let a = self.mean.x - slope.x * self.mean.z;
        let b = self.mean.y - slope.y * self.mean.z;
        let normal = n1.cross(n2);
        let w = a * n2 - b * n1;
        let square = normal.length_squared();
        (w.length_squared() / square, self.mean.z + l2.dot(w.cross(normal)) / square)
    }
}

/// How many standard deviations out a splat of this opacity (0 ..= 1) is drawn, `None` where it is nowhere as much as
/// [`MIN_ALPHA`]: `√(2 ln(255 α))`, at most √8 with [`RadiusRule::OpacityAware`], always √8 with [`RadiusRule::Sqrt8`].
pub fn reach(rule: RadiusRule, opacity: f64) -> Option<f64> {
    if !(opacity >= MIN_ALPHA) {
        return None;
    }
    let full = (2.0 * (opacity / MIN_ALPHA).ln()).max(0.0).sqrt();
    Some(match rule {
        RadiusRule::Full | RadiusRule::Tiles => full,
        RadiusRule::OpacityAware => full.min(8f64.sqrt()),
        RadiusRule::Sqrt8 => 8f64.sqrt(),
    })
}

/// Factor on the opacity that keeps a widened splat's total (Mip-Splatting): `√(det / det′)`, floored.
/// `plain` and `widened` are the projected areas without and with the filter.
pub fn opacity_compensation(plain: f64, widened: f64) -> f64 {
    (plain / widened).clamp(COMPENSATION_FLOOR, 1.0)
}

/// How much of a splat at `distance` is shown: 0 up to `near`, 1 from `near + fade`, a straight line between (metres).
pub fn near_fade(distance: f64, near: f64, fade: f64) -> f64 {
    if !(distance > near) {
        return 0.0;
    }
    if fade > 0.0 { ((distance - near) / fade).min(1.0) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat2;

    fn rotation(seed: f64) -> DQuat {
        DQuat::from_xyzw(seed.sin(), (2.3 * seed).cos(), (seed * 0.7).sin() - 0.3, 0.4 + seed.cos().abs())
            .normalize()
    }

    fn view() -> View {
        View::look_at(
            DVec3::new(0.3, -0.2, -4.0),
            DVec3::new(0.1, 0.2, 1.0),
            DVec3::NEG_Y,
            Fov { left: -0.7, right: 0.9, up: -0.6, down: 0.5 },
            [160, 100],
        )
    }

    fn covariance(columns: &[DVec3]) -> DMat3 {
        columns.iter().fold(DMat3::ZERO, |m, &c| m + DMat3::from_cols(c * c.x, c * c.y, c * c.z))
    }

    fn covariance2(columns: &[DVec2]) -> DMat2 {
        columns.iter().fold(DMat2::ZERO, |m, &c| m + DMat2::from_cols(c * c.x, c * c.y))
    }

    fn splats(low_pass: LowPass) -> impl Iterator<Item = EyeSplat> {
        (0..60).map(move |i| {
            let s = f64::from(i);
            let mean =
                DVec3::new((1.7 * s).sin() * 2.0, (0.9 * s).cos() * 2.0, 0.2 + (s * 0.37).sin().abs() * 6.0);
            let scales = DVec3::new(0.3, 0.02 * (1.0 + s), 1e-3);
            EyeSplat::new(&view(), low_pass, mean, rotation(s), scales)
        })
    }

    #[test]
    fn ellipse_has_the_covariance_of_its_columns() {
        for splat in splats(LowPass::Planar) {
            let columns = splat.affine_columns(&view().fov, view().focal());
            let c = covariance2(&columns);
            let e = Ellipse::from_columns(&columns);
            let major = e.direction * e.deviations[0];
            let minor = e.direction.perp() * e.deviations[1];
            let back = covariance2(&[major, minor]);
            assert!((back - c).to_cols_array().iter().all(|d| d.abs() < 1e-12 * c.col(0).x.max(c.col(1).y)));
            assert!(e.deviations[0] >= e.deviations[1]);
            assert!((e.area() - c.determinant().sqrt()).abs() < 1e-6 * e.area());
            // Control: the direction matters.
            let turned = covariance2(&[major.perp(), minor.perp()]);
            assert!(!(turned - c).to_cols_array().iter().all(|d| d.abs() < 1e-12 * c.col(0).x));
        }
    }

    /// Round splats have no direction (0/0 in the usual formula), needles lose their width to cancellation, and tiny
    /// or huge ones under- or overflow a determinant.
    #[test]
    fn ellipse_of_round_thin_tiny_and_huge_splats() {
        for size in [1e-150, 1e-12, 0.01, 1.0, 1e12, 1e150] {
            let round = Ellipse::from_columns(&[DVec2::new(size, 0.0), DVec2::new(0.0, size)]);
            assert!((round.deviations[0] / size - 1.0).abs() < 1e-15);
            assert!((round.deviations[1] / size - 1.0).abs() < 1e-15);
            assert!((round.direction.length() - 1.0).abs() < 1e-15);
            let (c, s) = (0.6, 0.8);
            let thin = Ellipse::from_columns(&[DVec2::new(c, s) * size, DVec2::new(-s, c) * (size * 1e-9)]);
            assert!((thin.deviations[1] / (size * 1e-9) - 1.0).abs() < 1e-6, "{thin:?}");
            assert!(thin.direction.perp_dot(DVec2::new(c, s)).abs() < 1e-15);
        }
        let point = Ellipse::from_columns(&[DVec2::ZERO; 5]);
        assert_eq!(point.deviations, [0.0; 2]);
        // Control: the textbook formula does lose the thin side.
        let (e, f, g) = (0.36 + 0.64e-18, 0.48 - 0.48e-18, 0.64 + 0.36e-18);
        let mid = 0.5 * (e + g);
        let textbook: f64 = mid - f64::sqrt(mid * mid - (e * g - f * f));
        assert!((textbook.abs().sqrt() / 1e-9 - 1.0).abs() > 1e-3);
    }

    #[test]
    fn single_precision_twins_agree() {
        for splat in splats(LowPass::Planar) {
            let columns = splat.affine_columns(&view().fov, view().focal());
            let e = Ellipse::from_columns(&columns);
            let (direction, deviations) = ellipse_f32(&columns.map(|c| c.as_vec2()));
            assert!((f64::from(deviations[0]) / e.deviations[0] - 1.0).abs() < 1e-5);
            assert!((f64::from(deviations[1]) / e.deviations[1] - 1.0).abs() < 1e-4);
            assert!(direction.as_dvec2().perp_dot(e.direction).abs() < 1e-3);
            let m = splat.mean.normalize();
            let (a, b) = (tangent_basis(m), tangent_basis_f32(m.as_vec3()));
            for i in 0..2 {
                assert!((a[i] - b[i].as_dvec3()).length() < 1e-6);
            }
        }
        // Scaled first: an f32 determinant of these would be 0 or infinite.
        for size in [1e-15f32, 1e15] {
            let (_, d) = ellipse_f32(&[Vec2::new(size, size), Vec2::new(-2.0 * size, 2.0 * size)]);
            assert!(
                (d[0] / size / 8f32.sqrt() - 1.0).abs() < 1e-6
                    && (d[1] / size / 2f32.sqrt() - 1.0).abs() < 1e-6
            );
        }
    }

    #[test]
    fn tangent_basis_is_orthonormal_everywhere() {
        for m in [
            DVec3::Z,
            DVec3::NEG_Z,
            DVec3::X,
            DVec3::NEG_Y,
            DVec3::new(0.48, -0.6, -0.64),
            DVec3::new(1e-9, 0.0, -1.0),
        ] {
            let [u, v] = tangent_basis(m);
            let frame = DMat3::from_cols(u, v, m);
            let product = frame.transpose() * frame;
            assert!((product - DMat3::IDENTITY).to_cols_array().iter().all(|d| d.abs() < 1e-12), "{m}");
            assert!((frame.determinant() - 1.0).abs() < 1e-12, "{m}");
        }
    }

    #[test]
    fn planar_filter_is_three_tenths_of_a_square_pixel() {
        let view = view();
        for (with, without) in splats(LowPass::Planar).zip(splats(LowPass::Off)) {
            let a = covariance2(&with.affine_columns(&view.fov, view.focal()));
            let b = covariance2(&without.affine_columns(&view.fov, view.focal()));
            let added = a - b;
            let tolerance = 1e-12 * (a.col(0).x + a.col(1).y);
            assert!((added - DMat2::IDENTITY * 0.3).to_cols_array().iter().all(|d| d.abs() < tolerance));
        }
    }

    /// On the axis, with square pixels, both filters are the same; else the 3-D one takes the mean of both directions.
    #[test]
    fn volumetric_filter_is_as_wide_as_the_planar_one() {
        let at = |low_pass, focal: [f64; 2], mean| {
            let size = [200, 100];
            let view = View { fov: Fov::pinhole(focal[0], focal[1], 100.0, 50.0, size), size, ..view() };
            let splat = EyeSplat::new(&view, low_pass, mean, rotation(3.0), DVec3::new(0.02, 0.03, 0.01));
            covariance2(&splat.affine_columns(&view.fov, focal))
        };
        let mean = DVec3::new(0.0, 0.0, 3.0);
        let square = at(LowPass::Planar, [80.0, 80.0], mean) - at(LowPass::Volumetric, [80.0, 80.0], mean);
        assert!(square.to_cols_array().iter().all(|d| d.abs() < 1e-12));
        let added = at(LowPass::Volumetric, [80.0, 45.0], mean) - at(LowPass::Off, [80.0, 45.0], mean);
        let expected = DMat2::from_diagonal(DVec2::new(0.3 * 80.0 / 45.0, 0.3 * 45.0 / 80.0));
        assert!((added - expected).to_cols_array().iter().all(|d| d.abs() < 1e-12), "{added}");
    }

    /// The tangent plane seen in the image, to first order at the mean, is the (unclamped) affine projection.
    #[test]
    fn tangent_and_affine_agree_to_first_order() {
        let view = view();
        let focal = view.focal();
        let wide = Fov { left: -100.0, right: 100.0, up: -100.0, down: 100.0 };
        for splat in splats(LowPass::Planar) {
            let m = splat.mean.normalize();
            let basis = tangent_basis(m);
            let tangent = splat.tangent_columns(&basis);
            let affine = splat.affine_columns(&wide, focal);
            for (t, a) in tangent.iter().zip(affine) {
                // d(pixel) for a step e on the tangent plane: f · (P_x/P_z) differentiated at P = m.
                let e = basis[0] * t.x + basis[1] * t.y;
                let image = DVec2::new(
                    focal[0] * (e.x - m.x / m.z * e.z) / m.z,
                    focal[1] * (e.y - m.y / m.z * e.z) / m.z,
                );
                assert!((image - a).length() < 1e-9 * a.length().max(1.0));
            }
        }
    }

    /// The identity that the leaning plane rests on: along any ray, the exact distance is `q / (1 + q s²)`.
    #[test]
    fn leaning_plane_is_exact_but_for_the_depth_that_is_left() {
        let (mut leaning, mut upright, mut met) = (0.0f64, 0.0f64, 0);
        for splat in splats(LowPass::Planar) {
            let distance = splat.mean.length();
            let m = splat.mean / distance;
            let basis = tangent_basis(m);
            let ellipse = Ellipse::from_columns(&splat.tangent_columns(&basis));
            let in_space = |v: DVec2| basis[0] * v.x + basis[1] * v.y;
            let axes = [in_space(ellipse.direction), in_space(ellipse.direction.perp())];
            let lean = splat.lean(m, &basis, &ellipse);
            if lean[0].hypot(lean[1]) > 0.999 * MAX_LEAN {
                continue;
            }
            let depth: f64 = splat.columns.iter().map(|c| (c.dot(m) / distance).powi(2)).sum();
            let left = depth - lean[0] * lean[0] - lean[1] * lean[1];
            assert!(left > -1e-12);
            let exact = RaySplat::from(&splat);
            for (p, q) in [(0.5, 0.0), (-1.0, 1.5), (0.3, -2.0)] {
                let [a, b] = [p * ellipse.deviations[0], q * ellipse.deviations[1]];
                let flat = axes[0] * a + axes[1] * b;
                let point = m + flat + m * (p * lean[0] + q * lean[1]);
                if point.z < 0.05 * point.length() {
                    continue;
                }
                let truth = exact.at(point.truncate() / point.z).0;
                let square = p * p + q * q;
                let wanted = square / (1.0 + square * left);
                assert!((truth - wanted).abs() < 1e-6 * wanted.max(1.0), "{truth} {wanted}");
                // Control: upright, the same place in the plane has another distance.
                let there = m + flat;
                leaning = leaning.max((truth - square).abs() / square);
                upright = upright.max((exact.at(there.truncate() / there.z).0 - square).abs() / square);
                met += 1;
            }
        }
        assert!(met > 100 && upright > 2.0 * leaning, "{met} {upright} {leaning}");
    }

    #[test]
    fn rows_of_the_ray_form_have_the_same_covariance() {
        // A reflection onto an axis that a row already lies on, backwards, has no direction of its own.
        let backwards = [DVec3::NEG_X, DVec3::NEG_Y * 2.0, DVec3::NEG_Z, DVec3::ZERO, DVec3::ZERO];
        let backwards = EyeSplat { mean: DVec3::Z, columns: backwards };
        for splat in splats(LowPass::Planar).chain([backwards]) {
            let c = covariance(&splat.columns);
            let l = RaySplat::from(&splat).rows;
            for i in 0..3 {
                for j in 0..3 {
                    assert!((l[i].dot(l[j]) - c.col(j)[i]).abs() < 1e-14, "{i} {j}");
                }
            }
        }
    }

    /// Against the classic form with the inverse covariance: `t* = dᵀΣ⁻¹μ / dᵀΣ⁻¹d`.
    #[test]
    fn ray_response_is_the_maximum_along_the_ray() {
        let mut behind = 0;
        for (i, mut splat) in splats(LowPass::Planar).enumerate() {
            if i % 4 == 0 {
                splat.mean *= 0.02; // the eye is inside the splat
            }
            let inverse = covariance(&splat.columns).inverse();
            let ray = RaySplat::from(&splat);
            for slope in [DVec2::new(0.1, -0.2), DVec2::new(-1.5, 0.7), DVec2::new(3.0, 4.0)] {
                let d = slope.extend(1.0);
                let depth = d.dot(inverse * splat.mean) / d.dot(inverse * d);
                let offset = d * depth - splat.mean;
                let square = offset.dot(inverse * offset);
                let (got_square, got_depth) = ray.at(slope);
                assert!((got_square - square).abs() < 1e-6 * square.max(1.0), "{got_square} {square}");
                assert!((got_depth - depth).abs() < 1e-6 * depth.abs().max(1.0), "{got_depth} {depth}");
                behind += usize::from(got_depth < 0.0);
                // Control: neighbours along the ray respond less.
                for step in [-1e-2, 1e-2] {
                    let off = d * (depth + step) - splat.mean;
                    assert!(off.dot(inverse * off) > square);
                }
            }
        }
        assert!(behind > 0, "no case with its maximum behind the eye");
    }

    /// A ray in a direction is the ray of a slope.
    #[test]
    fn rays_in_any_direction_answer_as_slopes_do() {
        for splat in splats(LowPass::Planar) {
            let ray = RaySplat::from(&splat);
            for slope in [DVec2::new(0.1, -0.2), DVec2::new(-1.5, 0.7), DVec2::new(3.0, 4.0)] {
                let d = slope.extend(1.0).normalize();
                let ((square, depth), (same, along)) = (ray.at(slope), ray.along(d));
                assert!((square - same).abs() < 1e-6 * square.max(1.0), "{square} {same}");
                assert!((depth - along * d.z).abs() < 1e-6 * depth.abs().max(1.0), "{depth} {along}");
                // Control: the other way it has another answer.
                assert!((ray.along(-d).1 + along).abs() < 1e-6 * along.abs().max(1.0));
            }
        }
    }

    /// A flat splat has no inverse covariance; its response is that of the plane's hit point.
    #[test]
    fn flat_splats_answer_without_an_inverse() {
        let splat = EyeSplat {
            mean: DVec3::new(0.2, 0.1, 2.0),
            columns: [
                DVec3::new(0.5, 0.0, 0.0),
                DVec3::new(0.0, 0.25, 0.0),
                DVec3::ZERO,
                DVec3::ZERO,
                DVec3::ZERO,
            ],
        };
        let (square, depth) = RaySplat::from(&splat).at(DVec2::new(0.35, 0.0));
        assert!((square - (1.0 + 0.16)).abs() < 1e-12, "{square}");
        assert!((depth - 2.0).abs() < 1e-12);
        // A ray along its plane never meets it: no finite answer, which callers take as nothing.
        let aside = EyeSplat {
            mean: DVec3::new(1.0, 0.1, 2.0),
            columns: [
                DVec3::new(0.0, 0.5, 0.0),
                DVec3::new(0.0, 0.0, 0.5),
                DVec3::ZERO,
                DVec3::ZERO,
                DVec3::ZERO,
            ],
        };
        assert!(!RaySplat::from(&aside).at(DVec2::new(0.0, 0.0)).0.is_finite());
        // A plane through the eye is met at the eye.
        let edge_on = EyeSplat { mean: DVec3::new(0.0, 0.1, 2.0), ..aside };
        assert!(RaySplat::from(&edge_on).at(DVec2::new(0.3, 0.0)).1.abs() < 1e-12);
    }

    #[test]
    fn reach_ends_where_alpha_falls_below_one_step() {
        for opacity in [0.004, 0.1, 0.5, 1.0] {
            let k = reach(RadiusRule::Full, opacity).unwrap();
            assert!((opacity * (-0.5 * k * k).exp() - MIN_ALPHA).abs() < 1e-12);
        }
        assert_eq!(reach(RadiusRule::Full, 0.0039), None);
        assert_eq!(reach(RadiusRule::Sqrt8, f64::NAN), None);
        assert_eq!(reach(RadiusRule::OpacityAware, 1.0), Some(8f64.sqrt()));
        assert_eq!(reach(RadiusRule::Sqrt8, 0.01), Some(8f64.sqrt()));
    }

    #[test]
    fn fades_in_behind_the_near_plane() {
        assert_eq!(near_fade(0.1, 0.1, 0.1), 0.0);
        assert!((near_fade(0.15, 0.1, 0.1) - 0.5).abs() < 1e-12);
        assert_eq!(near_fade(0.3, 0.1, 0.1), 1.0);
        assert_eq!(near_fade(0.2001, 0.2, 0.0), 1.0);
        assert_eq!(near_fade(f64::NAN, 0.2, 0.0), 0.0);
    }
}
