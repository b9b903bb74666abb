//! Generated scenes for tests and benchmarks: equal arguments give equal scenes. (Machines whose mathematical
//! libraries round sines differently may differ in rotations' last digits.)

use glam::{Quat, Vec3};

use crate::{Motion, Splats, sh_coefficients};

/// A small, fast, seedable generator (SplitMix64; Steele, Lea & Flood 2014), so that scenes do not change with
/// a dependency's version.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// A generator; equal seeds give equal sequences.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// 64 uniformly distributed bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in `low .. high`.
    pub fn uniform(&mut self, low: f32, high: f32) -> f32 {
        let unit = (self.bits() >> 40) as f32 / (1_u64 << 24) as f32;
        low + (high - low) * unit
    }

    /// Uniform in `0 .. n`; 0 for `n = 0`.
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.bits()) * u128::from(n)) >> 64) as u64
    }

    /// A uniformly distributed unit quaternion `(x, y, z, w)` (Shoemake 1992).
    pub fn rotation(&mut self) -> [f32; 4] {
        let u = self.uniform(0.0, 1.0);
        let (s1, c1) = self.uniform(0.0, std::f32::consts::TAU).sin_cos();
        let (s2, c2) = self.uniform(0.0, std::f32::consts::TAU).sin_cos();
        let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
        [a * s1, a * c1, b * s2, b * c2]
    }
}

/// What a generated scene is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recipe {
    /// Number of splats.
    pub count: usize,
    /// Degree of the spherical harmonics, `0 ..= 3`.
    pub sh_degree: u8,
    /// Equal seeds give equal scenes.
    pub seed: u64,
    /// Means are uniform in the cube `−bounds .. bounds`, metres.
    pub bounds: f32,
    /// Log-scales are uniform in this range, per axis: splats are anisotropic.
    pub log_scales: [f32; 2],
}

impl Default for Recipe {
    /// 1000 splats of 1–10 cm in a cube of 2 m, without view-dependent colour.
    fn default() -> Self {
        Self { count: 1000, sh_degree: 0, seed: 1, bounds: 1.0, log_scales: [-4.6, -2.3] }
    }
}

impl Recipe {
    /// A still scene: uniform means, rotations, log-scales, opacities `0.05 ..= 1` and colours; coefficients above
    /// the constant band within ±0.2.
    pub fn still(&self) -> Splats {
        let mut random = Random::new(self.seed);
        let mut splats = Splats::zeroed(self.count, self.sh_degree, false);
        let coefficients = sh_coefficients(self.sh_degree);
        for i in 0..self.count {
            splats.means[i] = std::array::from_fn(|_| random.uniform(-self.bounds, self.bounds));
            splats.rotations[i] = random.rotation();
            splats.log_scales[i] =
                std::array::from_fn(|_| random.uniform(self.log_scales[0], self.log_scales[1]));
            splats.opacities[i] = random.uniform(0.05, 1.0);
            for (k, sh) in splats.sh[i * coefficients..(i + 1) * coefficients].iter_mut().enumerate() {
                let reach = if k == 0 { 1.7 } else { 0.2 };
                *sh = std::array::from_fn(|_| random.uniform(-reach, reach));
            }
        }
        splats
    }

    /// A moving scene: [`Recipe::still`] set in motion by [`animate`].
    pub fn moving(&self, animation: &Animation) -> Splats {
        let mut splats = self.still();
        animate(&mut splats, animation, self.seed);
        splats
    }
}

/// How [`animate`] moves a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Animation {
    /// The rigid motion: turn about this axis through the scene's centre (any length), …
    pub axis: [f32; 3],
    /// … by this angle from `t = 0` to `t = 1`, radians, …
    pub turn: f32,
    /// … and travel by this, metres.
    pub travel: [f32; 3],
    /// Amplitude of a wave that runs through the scene along `travel`'s axis or x, along `axis`, metres.
    pub wave: f32,
    /// Length of that wave, metres.
    pub wave_length: f32,
    /// Fraction of the splats that appear and vanish, `0 ..= 1`; the others are always there.
    pub fleeting: f32,
    /// Their time width: opacity falls to 1/e that far from their centre.
    pub width: f32,
}

impl Default for Animation {
    /// A quarter turn about y with a gentle wave; a third of the splats come and go.
    fn default() -> Self {
        Self {
            axis: [0.0, 1.0, 0.0],
            turn: std::f32::consts::FRAC_PI_2,
            travel: [0.2, 0.0, 0.0],
            wave: 0.05,
            wave_length: 1.0,
            fleeting: 1.0 / 3.0,
            width: 0.1,
        }
    }
}

/// Sets a still scene in motion, in the terms of Spacetime Gaussians lite: the turn's and the wave's paths around
/// each splat's time centre become its cubic polynomial (Taylor series about the centre), the turn's angular
/// velocity its omega (exact to first order). Splats that are always there have their centre at `t = ½`,
/// where path and velocity are exact.
pub fn animate(splats: &mut Splats, animation: &Animation, seed: u64) {
    let mut random = Random::new(seed ^ 0x6d6f_7469_6f6e);
    let n = splats.len();
    let axis = Vec3::from(animation.axis).try_normalize().unwrap_or(Vec3::Y);
    let travel = Vec3::from(animation.travel);
    let along = travel.try_normalize().unwrap_or(Vec3::X);
    let middle = splats.means.iter().fold(Vec3::ZERO, |sum, m| sum + Vec3::from(*m)) / n.max(1) as f32;
    let wave_number = std::f32::consts::TAU / animation.wave_length.max(f32::MIN_POSITIVE);
    let mut motion = Motion::zeroed(n);
    for i in 0..n {
        let fleeting = random.uniform(0.0, 1.0) < animation.fleeting;
        let center = if fleeting { random.uniform(0.0, 1.0) } else { 0.5 };
        motion.centers[i] = center;
        motion.widths[i] = if fleeting { animation.width } else { f32::MAX };

        // x(t) = middle + R(turn·t) (mean − middle) + travel·t + wave·axis·sin(k·s + τ·t), s = mean · along.
        let turned = Quat::from_axis_angle(axis, animation.turn * center);
        let arm = turned * (Vec3::from(splats.means[i]) - middle);
        let phase = wave_number * Vec3::from(splats.means[i]).dot(along) + std::f32::consts::TAU * center;
        let (sin, cos) = phase.sin_cos();
        let spin = axis * animation.turn;
        let tau = std::f32::consts::TAU;
        let wave = axis * animation.wave;
        let first = spin.cross(arm);
        let second = spin.cross(first);
        let third = spin.cross(second);
        splats.means[i] = (middle + arm + travel * center + wave * sin).to_array();
        motion.polynomials[i] = [
            (first + travel + wave * (tau * cos)).to_array(),
            ((second - wave * (tau * tau * sin)) / 2.0).to_array(),
            ((third - wave * (tau * tau * tau * cos)) / 6.0).to_array(),
        ];
        // q(t) = R(turn·t) q, so q̇ = ½ (spin, 0) q.
        let q = turned * Quat::from_array(splats.rotations[i]);
        splats.rotations[i] = q.to_array();
        motion.omegas[i] = (Quat::from_vec4((spin * 0.5).extend(0.0)) * q).to_array();
    }
    splats.motion = Some(motion);
}
