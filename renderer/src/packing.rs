//! Splats in the forms that the device stores. Twins of `read_splat` and `sh_coefficient` in the shaders.

use crate::{Precision, RenderConfig, ShPrecision};
use glam::{Vec2, Vec3};
use half::f16;
use motes_scenes::{SH_C0, Splats};
use motes_shaders::layout::{
    GEOMETRY_WORDS_F16, GEOMETRY_WORDS_F32, MOTION_WORDS_F16, MOTION_WORDS_F32, sh_words,
};

/// Range of the 16-bit log-scales: `e⁻²⁴ … e¹²` m; a step is 5.5·10⁻⁴, so a scale is right within 2.8·10⁻⁴.
pub const LOG_SCALE_RANGE: (f32, f32) = (-24.0, 12.0);

/// How a scene is stored on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packing {
    /// Form of means, rotations, scales, opacities and base colours.
    pub precision: Precision,
    /// Form of the spherical harmonics above the constant band.
    pub sh_precision: ShPrecision,
    /// Degree that is stored; 0 stores none.
    pub sh_degree: u8,
}

impl Packing {
    /// How a configuration wants a scene stored.
    pub fn of_config(config: &RenderConfig) -> Self {
        Self { precision: config.precision, sh_precision: config.sh_precision, sh_degree: config.sh_degree }
    }

    /// Bytes of a scene on the device, motion included.
    pub fn bytes(&self, splats: &Splats) -> u64 {
        let packing = Self { sh_degree: self.sh_degree.min(splats.sh_degree), ..*self };
        let motion = if splats.motion.is_some() { self.motion_words() } else { 0 };
        4 * (splats.len() * (packing.geometry_words() + packing.sh_words() + motion)) as u64
    }

    /// 32-bit words of one splat's geometry.
    pub fn geometry_words(&self) -> usize {
        match self.precision {
            Precision::F32 => GEOMETRY_WORDS_F32 as usize,
            Precision::F16 | Precision::F16Naive => GEOMETRY_WORDS_F16 as usize,
        }
    }

    /// 32-bit words of one splat's spherical harmonics.
    pub fn sh_words(&self) -> usize {
        let bits = match self.sh_precision {
            ShPrecision::F32 => 32,
            ShPrecision::F16 => 16,
            ShPrecision::U8 => 8,
        };
        sh_words(self.sh_degree, bits) as usize
    }

    /// Writes the geometry of splats `first ..` into `words`, as many as it holds.
    pub fn geometry(&self, splats: &Splats, first: usize, words: &mut [u32]) {
        for (i, out) in (first..).zip(words.chunks_exact_mut(self.geometry_words())) {
            let mean = splats.means[i];
            let rotation = splats.rotations[i];
            let log_scale = splats.log_scales[i];
            let opacity = splats.opacities[i];
            let dc = splats.sh_of(i)[0];
            let base = dc.map(|c| 0.5 + SH_C0 * c);
            // Each value by itself; the two zeros fill the words of half floats, and are beyond those of whole ones.
            let floats = || {
                let [x, y, z] = mean;
                let [a, b, c, d] = rotation;
                let [i, j, k] = log_scale.map(f32::exp);
                let [red, green, blue] = base;
                [x, y, z, opacity, a, b, c, d, i, j, k, red, green, blue, 0.0, 0.0]
            };
            match self.precision {
                Precision::F32 => {
                    for (o, v) in out.iter_mut().zip(floats()) {
                        *o = v.to_bits();
                    }
                }
                Precision::F16 => {
                    let s = log_scale.map(pack_log_scale);
                    let (low, high) = pack_rotation(rotation);
                    out[0] = mean[0].to_bits();
                    out[1] = mean[1].to_bits();
                    out[2] = mean[2].to_bits();
                    out[3] = s[0] | s[1] << 16;
                    out[4] = s[2] | ((opacity.clamp(0.0, 1.0) * 65535.0).round() as u32) << 16;
                    out[5] = low;
                    out[6] = high | half_bits(base[0]) << 16;
                    out[7] = half_bits(base[1]) | half_bits(base[2]) << 16;
                }
                Precision::F16Naive => {
                    for (o, v) in out.iter_mut().zip(floats().chunks_exact(2)) {
                        *o = half_bits(v[0]) | half_bits(v[1]) << 16;
                    }
                }
            }
        }
    }

    /// Writes the spherical harmonics above the constant band of splats `first ..` into `words`.
    pub fn harmonics(&self, splats: &Splats, first: usize, words: &mut [u32]) {
        let per_splat = self.sh_words();
        if per_splat == 0 {
            return;
        }
        let coefficients = motes_scenes::sh_coefficients(self.sh_degree) - 1;
        let mut values = [0.0f32; 46];
        for (i, out) in (first..).zip(words.chunks_exact_mut(per_splat)) {
            let sh = splats.sh_of(i);
            for k in 0..coefficients {
                let c = sh.get(k + 1).copied().unwrap_or_default();
                values[3 * k..3 * k + 3].copy_from_slice(&c);
            }
            let values = &values[..3 * coefficients];
            match self.sh_precision {
                ShPrecision::F32 => {
                    for (o, v) in out.iter_mut().zip(values) {
                        *o = v.to_bits();
                    }
                }
                ShPrecision::F16 => {
                    for (o, v) in out.iter_mut().zip(values.chunks(2)) {
                        *o = half_bits(v[0]) | half_bits(v.get(1).copied().unwrap_or(0.0)) << 16;
                    }
                }
                ShPrecision::U8 => {
                    let largest = values.iter().fold(0.0f32, |a, v| a.max(v.abs()));
                    // The stored scale is what the shader multiplies by, so it is what the bytes are made for.
                    let scale = f16::from_f32(largest.min(65504.0) * (1.0 + 1.0 / 2048.0));
                    let step = scale.to_f32() / 127.0;
                    out.fill(0);
                    out[0] = u32::from(scale.to_bits());
                    for (j, v) in values.iter().enumerate() {
                        let byte = if step > 0.0 { (v / step).round().clamp(-127.0, 127.0) as i8 } else { 0 };
                        let at = j + 2;
                        out[at / 4] |= u32::from(byte as u8) << (8 * (at % 4));
                    }
                }
            }
        }
    }

    /// 32-bit words of one splat's motion.
    pub fn motion_words(&self) -> usize {
        match self.precision {
            Precision::F32 => MOTION_WORDS_F32 as usize,
            Precision::F16 | Precision::F16Naive => MOTION_WORDS_F16 as usize,
        }
    }

    /// Writes the motion of splats `first ..` into `words`; nothing for a static scene.
    ///
    /// Compact rotations are stored with their largest component positive: where that turned one into its negative, which
    /// is the same rotation, the rate of change that is added to it must turn with it.
    pub fn motion(&self, splats: &Splats, first: usize, words: &mut [u32]) {
        let Some(motion) = &splats.motion else { return };
        for (i, out) in (first..).zip(words.chunks_exact_mut(self.motion_words())) {
            let mut values = [0.0; 14];
            values[0] = 1.0 / motion.widths[i];
            values[1..10].copy_from_slice(motion.polynomials[i].as_flattened());
            let omega = motion.omegas[i];
            let turned = self.precision == Precision::F16 && turns_sign(splats.rotations[i]);
            values[10..].copy_from_slice(&if turned { omega.map(|v| -v) } else { omega });
            out[0] = motion.centers[i].to_bits();
            if self.precision == Precision::F32 {
                for (o, v) in out[1..].iter_mut().zip(values) {
                    *o = v.to_bits();
                }
            } else {
                for (o, v) in out[1..].iter_mut().zip(values.chunks_exact(2)) {
                    *o = half_bits(v[0]) | half_bits(v[1]) << 16;
                }
            }
        }
    }
}

fn half_bits(v: f32) -> u32 {
    u32::from(f16::from_f32(v.clamp(-65504.0, 65504.0)).to_bits())
}

/// A log-scale in 16 bits over [`LOG_SCALE_RANGE`].
pub fn pack_log_scale(log_scale: f32) -> u32 {
    let (low, high) = LOG_SCALE_RANGE;
    (((log_scale - low) / (high - low)).clamp(0.0, 1.0) * 65535.0).round() as u32
}

/// Inverse of [`pack_log_scale`].
pub fn unpack_log_scale(bits: u32) -> f32 {
    let (low, high) = LOG_SCALE_RANGE;
    low + bits as f32 * ((high - low) / 65535.0)
}

fn largest_component(q: [f32; 4]) -> usize {
    (0..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best })
}

/// Whether [`pack_rotation`] stores the negative of a quaternion.
fn turns_sign(q: [f32; 4]) -> bool {
    q[largest_component(q)] < 0.0
}

/// The smallest three components of a unit quaternion `(x, y, z, w)`, 15 bits each, and which one is the largest:
/// 47 bits as (32, 15). The angle is right within 10⁻⁴ rad.
pub fn pack_rotation(q: [f32; 4]) -> (u32, u32) {
    let largest = largest_component(q);
    let sign = if turns_sign(q) { -1.0 } else { 1.0 };
    let mut bits = [0u32; 3];
    for (b, i) in bits.iter_mut().zip((0..4).filter(|&i| i != largest)) {
        let unit = (sign * q[i] * std::f32::consts::SQRT_2).clamp(-1.0, 1.0) * 0.5 + 0.5;
        *b = (unit * 32767.0).round() as u32;
    }
    let low = bits[0] | bits[1] << 15 | (bits[2] & 3) << 30;
    let high = bits[2] >> 2 | (largest as u32) << 13;
    (low, high)
}

/// Inverse of [`pack_rotation`].
pub fn unpack_rotation(low: u32, high: u32) -> [f32; 4] {
    let bits = [low & 0x7fff, low >> 15 & 0x7fff, low >> 30 & 3 | (high & 0x1fff) << 2];
    let s = bits.map(|b| b as f32 * (std::f32::consts::SQRT_2 / 32767.0) - std::f32::consts::FRAC_1_SQRT_2);
    let l = (1.0 - s.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    let mut q = [0.0; 4];
    let largest = (high >> 13 & 3) as usize;
    q[largest] = l;
    for (v, i) in s.iter().zip((0..4).filter(|&i| i != largest)) {
        q[i] = *v;
    }
    q
}

/// A unit vector as a point of the square that the octahedron's faces unfold to, `-1 ..= 1` (Cigolle et al. 2014).
pub fn pack_direction_f32(m: Vec3) -> Vec2 {
    let p = m.truncate() / m.abs().element_sum();
    if m.z < 0.0 { folded_f32(p) } else { p }
}

/// [`pack_direction_f32`] undone.
pub fn unpack_direction_f32(p: Vec2) -> Vec3 {
    let z = 1.0 - p.x.abs() - p.y.abs();
    (if z < 0.0 { folded_f32(p) } else { p }).extend(z).normalize()
}

fn folded_f32(p: Vec2) -> Vec2 {
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    Vec2::new((1.0 - p.y.abs()) * sign(p.x), (1.0 - p.x.abs()) * sign(p.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_survive_packing() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut worst = 0.0f32;
        for _ in 0..10_000 {
            let q = [random(), random(), random(), random()];
            let n = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            let q = q.map(|v| v / n);
            let (low, high) = pack_rotation(q);
            assert!(high < 1 << 15);
            let r = unpack_rotation(low, high);
            let dot: f32 = q.iter().zip(r).map(|(a, b)| a * b).sum();
            let apart: f32 = q.iter().zip(r).map(|(a, b)| (a * dot.signum() - b).powi(2)).sum::<f32>().sqrt();
            worst = worst.max(2.0 * apart);
        }
        assert!(worst < 1.5e-4, "worst angle {worst}");
        // Negative control: a swapped half is another rotation.
        let (low, high) = pack_rotation([0.1, 0.2, 0.3, 0.9273618]);
        let r = unpack_rotation(low.rotate_left(16), high);
        assert!((r[0] - 0.1).abs() > 1e-3);
    }

    /// Half-float coefficients put a splat at most `2⁻¹¹` of the way that it goes beside its place.
    #[test]
    fn half_float_motion_stays_within_its_bound() {
        use motes_scenes::synthetic::{Animation, Recipe};
        let animation = Animation { travel: [3.0, 0.5, -1.0], fleeting: 1.0, ..Animation::default() };
        let scene = Recipe { count: 2000, ..Recipe::default() }.moving(&animation);
        let packing = Packing { precision: Precision::F16, sh_precision: ShPrecision::F32, sh_degree: 0 };
        let per_splat = packing.motion_words();
        assert_eq!(per_splat, 8);
        let mut words = vec![0; per_splat * scene.len()];
        packing.motion(&scene, 0, &mut words);
        let motion = scene.motion.as_ref().unwrap();
        let (mut worst, mut metres, mut of_swapped) = (0.0f64, 0.0f64, 0.0f64);
        for (i, words) in words.chunks_exact(per_splat).enumerate() {
            let half = |k: usize| f16::from_bits((words[1 + k / 2] >> (16 * (k % 2))) as u16).to_f64();
            assert_eq!(f32::from_bits(words[0]), motion.centers[i]);
            assert!((half(0) * f64::from(motion.widths[i]) - 1.0).abs() < 5e-4);
            let p = motion.polynomials[i].as_flattened();
            for dt in [-0.3f64, 0.1, 0.5, 1.0] {
                for axis in 0..3 {
                    let path = |value: &dyn Fn(usize) -> f64| {
                        (0..3).map(|d| value(3 * d + axis) * dt.powi(d as i32 + 1)).sum::<f64>()
                    };
                    let way: f64 =
                        (0..3).map(|d| f64::from(p[3 * d + axis]).abs() * dt.abs().powi(d as i32 + 1)).sum();
                    let error = (path(&|k| half(1 + k)) - path(&|k| f64::from(p[k]))).abs();
                    worst = worst.max((error - 1e-7) / way);
                    metres = metres.max(error);
                    of_swapped =
                        of_swapped.max((path(&|k| half(k)) - path(&|k| f64::from(p[k]))).abs() / way);
                }
            }
        }
        println!("half-float motion: {worst:.2e} of the way, at most {:.2} mm", metres * 1e3);
        assert!(worst <= 1.0 / 2048.0, "{worst:e}");
        assert!(of_swapped > 0.1, "coefficients in each other's places must be told apart");
    }

    #[test]
    fn log_scales_survive_packing() {
        for i in 0..=3500 {
            let l = -23.5 + 0.01 * i as f32;
            assert!((unpack_log_scale(pack_log_scale(l)) - l).abs() < 2.8e-4, "{l}");
        }
        assert_eq!(pack_log_scale(f32::NEG_INFINITY), 0);
        assert_eq!(pack_log_scale(100.0), 65535);
    }

    #[test]
    fn packed_directions_come_back() {
        let mut flat = 0.0f32;
        for i in 0..2000 {
            let s = i as f32;
            let m = Vec3::new((1.3 * s).sin(), (0.7 * s).cos(), (2.1 * s).sin()).normalize();
            let p = pack_direction_f32(m);
            assert!(p.abs().max_element() <= 1.0 + 1e-6);
            assert!((unpack_direction_f32(p) - m).length() < 4e-7, "{m} {p}");
            flat = flat.max((unpack_direction_f32(p * 0.999) - m).length());
        }
        for m in [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::NEG_Y] {
            assert!((unpack_direction_f32(pack_direction_f32(m)) - m).length() < 1e-6);
        }
        // Control: a thousandth of the square is seen.
        assert!(flat > 5e-4);
    }
}
