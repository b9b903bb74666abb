//! Half precision, with subnormals flushed to zero as a device may do: a model in software, quantity by quantity.

use half::f16;
use motes_renderer::projection::{MAX_ALPHA, MIN_ALPHA};
use motes_renderer::spherical_harmonics::sh_colour;
use motes_renderer::{Packing, Precision, ShPrecision};
use motes_scenes::synthetic::Random;
use motes_scenes::{SH_C0, Splats, sh_coefficients};

use glam::DVec3;

use super::scene::{Gaussian, scene};

/// The smallest normal half float, 2⁻¹⁴: what is smaller may become zero.
pub const SMALLEST_NORMAL: f64 = 6.103_515_625e-5;
/// Half the distance between neighbours, relative: 2⁻¹¹.
pub const UNIT: f64 = 1.0 / 2048.0;

/// What a half float's bits mean on a device that flushes subnormals.
pub fn flushed(bits: u16) -> f64 {
    let v = f64::from(f16::from_bits(bits).to_f32());
    if v.abs() < SMALLEST_NORMAL { 0.0 } else { v }
}

/// A number as half-float arithmetic on such a device gives it.
pub fn half(v: f64) -> f64 {
    flushed(f16::from_f64(v).to_bits())
}

/// Half a step of half floats between ½ and 1, in steps of 8 bits (and a little for f32's own rounding).
const RECORD: f64 = 255.0 * UNIT / 2.0 * 1.001;

/// A quantity that is kept in half precision: what it may lose, and what it loses at most.
#[derive(Clone, Debug)]
pub struct Quantity {
    /// What it is, and where.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Largest stated error.
    pub bound: f64,
    /// Largest error found.
    pub worst: f64,
}

/// Every quantity that the renderer keeps or computes in half floats, with its bound.
pub fn quantities() -> Vec<Quantity> {
    let quantity = |name, unit, bound, worst| Quantity { name, unit, bound, worst };
    vec![
        quantity("colour of a record, 0 … 1", "1/255", RECORD, colours_of_records()),
        quantity("opacity of a record, 1/255 … 1", "1/255", RECORD, opacities_of_records()),
        quantity("base colour, f16 storage, 0 … 1", "1/255", RECORD, base_colours()),
        quantity("base colour, f16 storage, 1 … 60 000", "relative", 1.001 * UNIT, bright_colours()),
        // Fifteen coefficients, each off by a subnormal or by rounding, times the largest harmonics.
        quantity("harmonics of ±0.5, f16", "1/255", 0.5, harmonics(ShPrecision::F16, 0.5)),
        quantity("harmonics of ±10⁻⁴, f16 (flushed)", "1/255", 0.5, harmonics(ShPrecision::F16, 1e-4)),
        quantity("harmonics of ±0.5, 8 bits", "1/255", 3.0, harmonics(ShPrecision::U8, 0.5)),
        quantity(
            "harmonics of ±10⁻⁵, 8 bits (scale flushed)",
            "1/255",
            0.1,
            harmonics(ShPrecision::U8, 1e-5),
        ),
        quantity("scale, f16 storage, e⁻²⁴ … e¹² m", "relative", 2.8e-4, scales()),
        quantity("opacity, f16 storage", "1/255", 255.0 / 65535.0, opacities()),
        quantity(
            "falloff exp(−D²/2) in the fragment, in f32",
            "1/255",
            4e-5,
            falloff(|v| f64::from(v as f32)),
        ),
    ]
}

/// What the naive half floats get wrong, and by how much: controls, and the reason why they are not used.
pub fn naive() -> Vec<Quantity> {
    let quantity = |name, unit, bound, worst| Quantity { name, unit, bound, worst };
    vec![
        quantity("centre in a picture of 1680 px, as −1 … 1", "px", 0.1, projected_centres()),
        quantity("mean 100 m from the origin", "m", 1e-3, (half(99.97) - 99.97).abs()),
        quantity("smallest σ whose variance is not flushed", "m", 2.4e-4, smallest_sigma()),
        quantity("falloff exp(−D²/2) in the fragment, in f16", "1/255", 0.01, falloff(half)),
    ]
}

fn spread(low: f64, high: f64, count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| low * (high / low).powf(i as f64 / (count - 1) as f64))
}

fn worst(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, f64::max)
}

fn colours_of_records() -> f64 {
    worst(spread(1e-7, 1.0, 20_000).map(|c| 255.0 * (half(c) - c).abs()))
}

fn opacities_of_records() -> f64 {
    worst(spread(MIN_ALPHA, 1.0, 20_000).map(|a| 255.0 * (half(a).min(MAX_ALPHA) - a.min(MAX_ALPHA)).abs()))
}

/// The words that the scene's packing makes of splats.
fn packed(splats: &Splats) -> Vec<Vec<u32>> {
    let packing =
        Packing { precision: Precision::F16, sh_precision: ShPrecision::F16, sh_degree: splats.sh_degree };
    let per_splat = packing.geometry_words();
    let mut words = vec![0; per_splat * splats.len()];
    packing.geometry(splats, 0, &mut words);
    words.chunks_exact(per_splat).map(<[u32]>::to_vec).collect()
}

fn packed_colours(values: Vec<f64>, error: impl Fn(f64, f64) -> f64) -> f64 {
    let gaussians: Vec<Gaussian> =
        values.iter().map(|c| Gaussian { colour: [*c as f32; 3], ..Default::default() }).collect();
    let splats = scene(&gaussians);
    worst(packed(&splats).iter().enumerate().flat_map(|(i, words)| {
        let wanted = 0.5 + f64::from(SH_C0) * f64::from(splats.sh[i][0]);
        [(words[6] >> 16) as u16, words[7] as u16, (words[7] >> 16) as u16].map(|h| error(flushed(h), wanted))
    }))
}

fn base_colours() -> f64 {
    packed_colours(spread(1e-6, 1.0, 5000).collect(), |got, wanted| 255.0 * (got - wanted).abs())
}

fn bright_colours() -> f64 {
    packed_colours(spread(1.0, 6e4, 5000).collect(), |got, wanted| (got / wanted - 1.0).abs())
}

fn scales() -> f64 {
    let gaussians: Vec<Gaussian> = spread((-24f64).exp(), 12f64.exp(), 5000)
        .map(|s| Gaussian { scales: [s as f32; 3], ..Default::default() })
        .collect();
    let splats = scene(&gaussians);
    worst(packed(&splats).iter().zip(&splats.log_scales).map(|(words, log)| {
        let got = -24.0 + f64::from(words[3] & 0xffff) * (36.0 / 65535.0);
        ((got - f64::from(log[0])).exp() - 1.0).abs()
    }))
}

fn opacities() -> f64 {
    let gaussians: Vec<Gaussian> =
        spread(1e-6, 1.0, 5000).map(|o| Gaussian { opacity: o as f32, ..Default::default() }).collect();
    let splats = scene(&gaussians);
    worst(
        packed(&splats)
            .iter()
            .zip(&splats.opacities)
            .map(|(words, o)| 255.0 * (f64::from(words[4] >> 16) / 65535.0 - f64::from(*o)).abs()),
    )
}

/// Colours from stored harmonics of this size, decoded as the shader does, against the coefficients themselves.
fn harmonics(precision: ShPrecision, size: f64) -> f64 {
    let mut random = Random::new(3);
    let mut splats = scene(&vec![Gaussian::default(); 400]);
    splats.set_sh_degree(3);
    let n = sh_coefficients(3);
    for (k, c) in splats.sh.iter_mut().enumerate() {
        if k % n > 0 {
            *c = std::array::from_fn(|_| random.uniform(-size as f32, size as f32));
        }
    }
    let packing = Packing { precision: Precision::F32, sh_precision: precision, sh_degree: 3 };
    let per_splat = packing.sh_words();
    let mut words = vec![0; per_splat * splats.len()];
    packing.harmonics(&splats, 0, &mut words);
    let mut largest = 0.0f64;
    for (i, words) in words.chunks_exact(per_splat).enumerate() {
        let wanted = splats.sh_of(i);
        let got: Vec<[f32; 3]> = (0..n)
            .map(|k| {
                if k == 0 {
                    wanted[0]
                } else {
                    std::array::from_fn(|c| stored(precision, words, 3 * (k - 1) + c))
                }
            })
            .collect();
        let direction = DVec3::from_array(std::array::from_fn(|_| f64::from(random.uniform(-1.0, 1.0))));
        let direction = direction.normalize_or(DVec3::Z);
        let (a, b) = (sh_colour(wanted, direction), sh_colour(&got, direction));
        largest = largest.max(worst((0..3).map(|c| 255.0 * (a[c] - b[c]).abs())));
    }
    largest
}

fn stored(precision: ShPrecision, words: &[u32], at: usize) -> f32 {
    match precision {
        ShPrecision::F32 => f32::from_bits(words[at]),
        ShPrecision::F16 => flushed((words[at / 2] >> (16 * (at % 2))) as u16) as f32,
        ShPrecision::U8 => {
            let byte = (words[(at + 2) / 4] >> (8 * ((at + 2) % 4))) as u8 as i8;
            f32::from(byte) * (flushed(words[0] as u16) / 127.0) as f32
        }
    }
}

/// Largest error of the falloff where every step of `exp2(−½ log2(e) (p² + q²))` is rounded.
fn falloff(round: impl Fn(f64) -> f64) -> f64 {
    worst((0..5000).map(|i| {
        let p = 3.33 * f64::from(i) / 5000.0;
        let q = 0.4 * p;
        let (rp, rq) = (round(p), round(q));
        let square = round(round(rp * rp) + round(rq * rq));
        let alpha = round(round(-0.721_347_52 * square).exp2());
        255.0 * (alpha - (-0.5 * (p * p + q * q)).exp()).abs()
    }))
}

fn projected_centres() -> f64 {
    worst((0..100_000).map(|i| {
        let x = f64::from(i) / 1e5;
        840.0 * (half(x) - x).abs()
    }))
}

fn smallest_sigma() -> f64 {
    spread(1e-6, 1.0, 100_000).find(|s| half(s * s) > 0.0).unwrap_or(f64::INFINITY)
}

/// What one splat gives to a pixel beside its centre when the classic pipeline's every step is in half floats
/// (`precision mediump float` throughout): covariance in px², its determinant, the conic, the power.
///
/// `sigmas`: standard deviations along x and y, px; `offset`: pixel minus centre, px. `None`: not a number, and so
/// nothing, where the covariance itself overflows.
pub fn naive_alpha(
    sigmas: [f64; 2],
    offset: [f64; 2],
    opacity: f64,
    round: impl Fn(f64) -> f64,
) -> Option<f64> {
    let [xx, yy] = sigmas.map(|s| round(round(round(s) * round(s)) + 0.3));
    let det = round(xx * yy);
    let conic = [round(yy / det), round(xx / det)];
    let [dx, dy] = offset.map(&round);
    let power = round(-0.5 * round(round(conic[0] * round(dx * dx)) + round(conic[1] * round(dy * dy))));
    let alpha = round(opacity * round(power.exp()));
    (!alpha.is_nan() && power <= 0.0).then_some(alpha.min(MAX_ALPHA))
}
