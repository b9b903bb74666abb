//! Makes the promises of [`Splats`] true, whatever a file said.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::Splats;
use crate::chunks::SplatsMut;
use crate::report::DropReason;

/// Largest coordinate, metres: its square, and its product with [`MAX_TIME`]³, still fit an f32.
pub const MAX_LENGTH: f32 = 1e15;
/// Largest time centre. (Scene time is `0 ..= 1`.)
pub const MAX_TIME: f32 = 1e6;
/// Smallest log-scale: `exp` is 4·10⁻¹⁸ m, and its square is a normal f32. A scale of zero becomes this.
pub const MIN_LOG_SCALE: f32 = -40.0;
/// Largest log-scale: `exp` is 2·10¹⁷ m, and its square fits an f32.
pub const MAX_LOG_SCALE: f32 = 40.0;
/// Largest colour coefficient: a sum of 16 still fits an f32.
pub const MAX_SH: f32 = 1e30;
/// Smallest time width: narrower ones would be visible in no frame, and zero is not a number at its centre.
pub const MIN_WIDTH: f32 = 1e-6;
/// Smallest length of a quaternion that still is one: `|q|² ≥ 10⁻⁶`.
const MIN_QUATERNION: f64 = 1e-3;

/// What [`sanitise`] did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sanitised {
    /// Splats dropped per reason.
    pub dropped: BTreeMap<DropReason, usize>,
    /// Log-scales raised to [`MIN_LOG_SCALE`].
    pub raised_scales: usize,
    /// Time widths brought into [`MIN_WIDTH`]` ..= f32::MAX`.
    pub bounded_widths: usize,
}

/// Splats per unit of work.
const CHUNK: usize = 1 << 12;

/// Drops and counts splats with values that no picture can be made of, normalises quaternions (and divides
/// [`crate::Motion::omegas`] by the same length), bounds scales, opacities and time widths. Order is kept.
///
/// Guards are in their positive form, so that NaN fails them.
pub fn sanitise(splats: &mut Splats) -> Sanitised {
    let n = splats.len();
    let mut found =
        SplatsMut::all(splats).chunks(CHUNK).into_par_iter().map(judge).reduce(Found::default, Found::with);
    let mut dropped = BTreeMap::new();
    for (_, reason) in &found.drops {
        *dropped.entry(*reason).or_default() += 1;
    }
    if !found.drops.is_empty() {
        let mut gone = vec![false; n];
        for (i, _) in found.drops.drain(..) {
            gone[i] = true;
        }
        splats.retain(|i| !gone[i]);
    }
    Sanitised { dropped, raised_scales: found.raised_scales, bounded_widths: found.bounded_widths }
}

/// What was found in some of the splats.
#[derive(Default)]
struct Found {
    drops: Vec<(usize, DropReason)>,
    raised_scales: usize,
    bounded_widths: usize,
}

impl Found {
    fn with(mut self, other: Self) -> Self {
        self.drops.extend(other.drops);
        self.raised_scales += other.raised_scales;
        self.bounded_widths += other.bounded_widths;
        self
    }
}

fn judge(mut splats: SplatsMut<'_>) -> Found {
    let mut found = Found::default();
    for i in 0..splats.len() {
        let length = length(splats.rotations[i]);
        if let Some(reason) = reason_to_drop(&splats, i, length) {
            found.drops.push((splats.first + i, reason));
            continue;
        }
        let divide = |q: &mut [f32; 4]| *q = q.map(|v| (f64::from(v) / length) as f32);
        divide(&mut splats.rotations[i]);
        for v in &mut splats.log_scales[i] {
            if *v < MIN_LOG_SCALE {
                *v = MIN_LOG_SCALE;
                found.raised_scales += 1;
            }
        }
        splats.opacities[i] = splats.opacities[i].clamp(0.0, 1.0);
        if let Some(motion) = &mut splats.motion {
            divide(&mut motion.omegas[i]);
            let width = motion.widths[i].clamp(MIN_WIDTH, f32::MAX);
            if width != motion.widths[i] {
                motion.widths[i] = width;
                found.bounded_widths += 1;
            }
        }
    }
    found
}

/// In f64: the square of a finite f32 does not overflow.
fn length(q: [f32; 4]) -> f64 {
    q.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt()
}

fn reason_to_drop(splats: &SplatsMut<'_>, i: usize, length: f64) -> Option<DropReason> {
    let coefficients = splats.coefficients;
    let sh = splats.sh[i * coefficients..(i + 1) * coefficients].as_flattened();
    if !within(&splats.means[i], MAX_LENGTH) {
        return Some(DropReason::Mean);
    }
    if !length.is_finite() {
        return Some(DropReason::Rotation);
    }
    if length < MIN_QUATERNION {
        return Some(DropReason::ZeroRotation);
    }
    if !splats.log_scales[i].iter().all(|v| *v <= MAX_LOG_SCALE) {
        return Some(DropReason::Scale);
    }
    if splats.opacities[i].is_nan() {
        return Some(DropReason::Opacity);
    }
    if !within(sh, MAX_SH) {
        return Some(DropReason::Color);
    }
    let motion = splats.motion.as_ref()?;
    if !(within(motion.polynomials[i].as_flattened(), MAX_LENGTH) && within(&motion.omegas[i], MAX_LENGTH)) {
        return Some(DropReason::Motion);
    }
    if !(within(&[motion.centers[i]], MAX_TIME) && motion.widths[i] >= 0.0) {
        return Some(DropReason::Time);
    }
    None
}

/// Whether no value lies farther out; false for NaN.
fn within(values: &[f32], limit: f32) -> bool {
    // No early way out: that way the comparisons run several at a time.
    values.iter().fold(true, |all, v| all & (v.abs() <= limit))
}
