//! View-dependent colour: real spherical harmonics of degree 0 to 3, with the trainers' signs and order
//! (Kerbl et al. 2023; the polynomials are those of Sloan 2013, "Efficient Spherical Harmonic Evaluation",
//! with the Condon–Shortley phase, as the public trainers have them).

use glam::{DVec3, Vec3};

/// Highest degree that a splat carries.
pub const MAX_SH_DEGREE: u8 = 3;

/// `½ √(1/π)`
const C0: f64 = 0.282_094_791_773_878_14;
/// `√(3 / 4π)`
const C1: f64 = 0.488_602_511_902_919_9;
/// `½ √(15/π)`, `¼ √(5/π)`, `¼ √(15/π)`
const C2: [f64; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
/// `¼ √(35/2π)`, `½ √(105/π)`, `¼ √(21/2π)`, `¼ √(7/π)`, `¼ √(105/π)`
const C3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554_3,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// The 16 basis functions up to degree 3 in the direction `d` (unit length, from the eye to the splat, scene axes).
/// Those of degree `l` are at `l² .. (l + 1)²`.
pub fn sh_basis(d: DVec3) -> [f64; 16] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        -C2[0] * y * z,
        C2[1] * (2.0 * zz - xx - yy),
        -C2[0] * x * z,
        C2[2] * (xx - yy),
        -C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        -C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3[2] * x * (4.0 * zz - xx - yy),
        C3[4] * z * (xx - yy),
        -C3[0] * x * (xx - 3.0 * yy),
    ]
}

/// [`sh_basis`] in single precision: the twin of the shader's.
pub fn sh_basis_f32(d: Vec3) -> [f32; 16] {
    let Vec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0 as f32,
        -(C1 as f32) * y,
        (C1 as f32) * z,
        -(C1 as f32) * x,
        (C2[0] as f32) * x * y,
        -(C2[0] as f32) * y * z,
        (C2[1] as f32) * (2.0 * zz - xx - yy),
        -(C2[0] as f32) * x * z,
        (C2[2] as f32) * (xx - yy),
        -(C3[0] as f32) * y * (3.0 * xx - yy),
        (C3[1] as f32) * x * y * z,
        -(C3[2] as f32) * y * (4.0 * zz - xx - yy),
        (C3[3] as f32) * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -(C3[2] as f32) * x * (4.0 * zz - xx - yy),
        (C3[4] as f32) * z * (xx - yy),
        -(C3[0] as f32) * x * (xx - 3.0 * yy),
    ]
}

/// A splat's colour (sRGB-encoded, 0 and up) as seen in the unit direction `d` from the eye to the splat:
/// `max(0, ½ + Σ sh[k] · Y_k(d))` in every channel. `sh` has 1, 4, 9 or 16 coefficients, constant band first;
/// what lies beyond the 16th is ignored.
pub fn sh_colour(sh: &[[f32; 3]], d: DVec3) -> [f64; 3] {
    let mut colour = [0.5; 3];
    for (coefficient, basis) in sh.iter().zip(sh_basis(d)) {
        for (sum, &c) in colour.iter_mut().zip(coefficient) {
            *sum += f64::from(c) * basis;
        }
    }
    colour.map(|c| c.max(0.0))
}

/// [`sh_colour`] in single precision: the twin of the shader's.
pub fn sh_colour_f32(sh: &[[f32; 3]], d: Vec3) -> [f32; 3] {
    let mut colour = [0.5; 3];
    for (coefficient, basis) in sh.iter().zip(sh_basis_f32(d)) {
        for (sum, &c) in colour.iter_mut().zip(coefficient) {
            *sum += c * basis;
        }
    }
    colour.map(|c| c.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// ∫ Y_i Y_j over the sphere by the midpoint rule in cos θ and φ: exact enough for polynomials of degree 6.
    fn inner_products(basis: impl Fn(DVec3) -> [f64; 16]) -> [[f64; 16]; 16] {
        let mut products = [[0.0; 16]; 16];
        let (rings, steps) = (400, 32);
        for ring in 0..rings {
            let z = -1.0 + (f64::from(ring) + 0.5) * 2.0 / f64::from(rings);
            let r = (1.0 - z * z).sqrt();
            for step in 0..steps {
                let phi = f64::from(step) * 2.0 * PI / f64::from(steps);
                let y = basis(DVec3::new(r * phi.cos(), r * phi.sin(), z));
                for i in 0..16 {
                    for j in 0..16 {
                        products[i][j] += y[i] * y[j] * 4.0 * PI / f64::from(rings * steps);
                    }
                }
            }
        }
        products
    }

    fn worst_deviation(products: [[f64; 16]; 16]) -> f64 {
        let mut worst = 0.0f64;
        for (i, row) in products.iter().enumerate() {
            for (j, &v) in row.iter().enumerate() {
                worst = worst.max((v - f64::from(u8::from(i == j))).abs());
            }
        }
        worst
    }

    #[test]
    fn basis_is_orthonormal() {
        assert!(worst_deviation(inner_products(sh_basis)) < 1e-4);
        // Control: one wrong constant is seen.
        let broken = |d| {
            let mut y = sh_basis(d);
            y[13] *= 1.01;
            y
        };
        assert!(worst_deviation(inner_products(broken)) > 1e-2);
    }

    /// Signs and order: one direction, values from the trigonometric definition
    /// `Y_l^m = (−1)^m √2 K_l^m cos(mφ) P_l^m(cos θ)` (P without phase), m < 0 with `sin(|m|φ)`.
    #[test]
    fn signs_follow_the_trigonometric_definition() {
        let (theta, phi) = (0.7f64, 1.9f64);
        let (ct, st) = (theta.cos(), theta.sin());
        let d = DVec3::new(st * phi.cos(), st * phi.sin(), ct);
        // Associated Legendre functions without phase, m = 0 ..= l.
        let p: [&[f64]; 4] = [
            &[1.0],
            &[ct, st],
            &[0.5 * (3.0 * ct * ct - 1.0), 3.0 * ct * st, 3.0 * st * st],
            &[
                0.5 * (5.0 * ct.powi(3) - 3.0 * ct),
                1.5 * st * (5.0 * ct * ct - 1.0),
                15.0 * ct * st * st,
                15.0 * st.powi(3),
            ],
        ];
        let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
        let basis = sh_basis(d);
        for l in 0..4i32 {
            for m in -l..=l {
                let a = m.abs();
                let k = (f64::from(2 * l + 1) / (4.0 * PI) * factorial(l - a) / factorial(l + a)).sqrt();
                let legendre = p[l as usize][a as usize];
                let angle = f64::from(a) * phi;
                let expected = match m {
                    0 => k * legendre,
                    _ => {
                        let wave = if m > 0 { angle.cos() } else { angle.sin() };
                        (-1f64).powi(a) * 2f64.sqrt() * k * wave * legendre
                    }
                };
                let got = basis[(l * l + l + m) as usize];
                assert!((got - expected).abs() < 1e-12, "l {l} m {m}: {got} is not {expected}");
            }
        }
    }

    #[test]
    fn single_precision_twin_agrees() {
        let sh: Vec<[f32; 3]> =
            (0..16).map(|k| [0.1 * k as f32 - 0.7, 0.3 - 0.05 * k as f32, 0.02]).collect();
        for d in [DVec3::new(0.36, 0.48, 0.8), DVec3::new(-0.6, 0.0, -0.8), DVec3::Y] {
            let (a, b) = (sh_colour(&sh, d), sh_colour_f32(&sh, d.as_vec3()));
            for c in 0..3 {
                assert!((a[c] - f64::from(b[c])).abs() < 2e-6, "{a:?} {b:?}");
            }
            let (a, b) = (sh_basis(d), sh_basis_f32(d.as_vec3()));
            for k in 0..16 {
                assert!((a[k] - f64::from(b[k])).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn colour_is_never_negative_and_dc_alone_is_constant() {
        assert_eq!(sh_colour(&[[-10.0, 0.0, 1.0]], DVec3::Z), [0.0, 0.5, 0.5 + C0]);
        assert_eq!(sh_colour(&[[-10.0, 0.0, 1.0]], DVec3::Z), sh_colour(&[[-10.0, 0.0, 1.0]], DVec3::X));
    }
}
