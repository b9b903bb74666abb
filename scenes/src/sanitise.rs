//! Makes the promises of [`Splats`] true, whatever a file said.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::report::DropReason;
use crate::{Splats, sh_coefficients};

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
/// Smallest squared length of a quaternion that still is one.
const MIN_QUATERNION: f32 = 1e-6;

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
const CHUNK: usize = 1 << 14;

/// Drops and counts splats with values that no picture can be made of, normalises quaternions (and divides
/// [`crate::Motion::omegas`] by the same length), bounds scales, opacities and time widths. Order is kept.
///
/// Guards are in their positive form, so that NaN fails them.
pub fn sanitise(splats: &mut Splats) -> Sanitised {
    let n = splats.len();
    // One chunk's verdicts: (index, reason) of what goes, and the counts of what was changed.
    #[derive(Default)]
    struct Found {
        drops: Vec<(usize, DropReason)>,
        raised_scales: usize,
        bounded_widths: usize,
    }
    let merge = |mut a: Found, b: Found| {
        a.drops.extend(b.drops);
        a.raised_scales += b.raised_scales;
        a.bounded_widths += b.bounded_widths;
        a
    };

    let coefficients = sh_coefficients(splats.sh_degree);
    let fixed = (
        splats.means.par_chunks(CHUNK),
        splats.rotations.par_chunks_mut(CHUNK),
        splats.log_scales.par_chunks_mut(CHUNK),
        splats.opacities.par_chunks_mut(CHUNK),
        splats.sh.par_chunks(CHUNK * coefficients),
    );
    let judge_static = |(chunk, (means, rotations, scales, opacities, sh)): (
        usize,
        (&[[f32; 3]], &mut [[f32; 4]], &mut [[f32; 3]], &mut [f32], &[[f32; 3]]),
    )| {
        let mut found = Found::default();
        let mut lengths = Vec::with_capacity(means.len());
        for i in 0..means.len() {
            let q = &mut rotations[i];
            let squared = q.iter().map(|v| v * v).sum::<f32>();
            // Where the square overflows, the quaternion is finite but the length in f32 is not.
            let length = if squared < f32::MAX {
                squared.sqrt()
            } else {
                q.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt() as f32
            };
            lengths.push(length);
            let reason = if !means[i].iter().all(|v| v.abs() <= MAX_LENGTH) {
                Some(DropReason::Mean)
            } else if !(length <= f32::MAX) {
                Some(DropReason::Rotation)
            } else if !(squared >= MIN_QUATERNION) {
                Some(DropReason::ZeroRotation)
            } else if !scales[i].iter().all(|v| *v <= MAX_LOG_SCALE) {
                Some(DropReason::Scale)
            } else if !(opacities[i] >= f32::NEG_INFINITY) {
                Some(DropReason::Opacity)
            } else if !sh[i * coefficients..(i + 1) * coefficients]
                .as_flattened()
                .iter()
                .all(|v| v.abs() <= MAX_SH)
            {
                Some(DropReason::Color)
            } else {
                None
            };
            if let Some(reason) = reason {
                found.drops.push((chunk * CHUNK + i, reason));
                continue;
            }
            for v in q.iter_mut() {
                *v /= length;
            }
            for v in &mut scales[i] {
                if *v < MIN_LOG_SCALE {
                    *v = MIN_LOG_SCALE;
                    found.raised_scales += 1;
                }
            }
            opacities[i] = opacities[i].clamp(0.0, 1.0);
        }
        (found, lengths)
    };

    let mut found = if let Some(motion) = &mut splats.motion {
        let moving = (
            motion.centers.par_chunks(CHUNK),
            motion.widths.par_chunks_mut(CHUNK),
            motion.polynomials.par_chunks(CHUNK),
            motion.omegas.par_chunks_mut(CHUNK),
        );
        (fixed, moving)
            .into_par_iter()
            .enumerate()
            .map(|(chunk, (fixed, (centers, widths, polynomials, omegas)))| {
                let (mut found, lengths) = judge_static((chunk, fixed));
                let dropped: Vec<usize> = found.drops.iter().map(|d| d.0 - chunk * CHUNK).collect();
                let mut next = dropped.iter().copied().peekable();
                for i in 0..centers.len() {
                    if next.next_if_eq(&i).is_some() {
                        continue;
                    }
                    let reason = if !(polynomials[i].as_flattened().iter().all(|v| v.abs() <= MAX_LENGTH)
                        && omegas[i].iter().all(|v| v.abs() <= MAX_LENGTH))
                    {
                        Some(DropReason::Motion)
                    } else if !(centers[i].abs() <= MAX_TIME && widths[i] >= 0.0) {
                        Some(DropReason::Time)
                    } else {
                        None
                    };
                    if let Some(reason) = reason {
                        found.drops.push((chunk * CHUNK + i, reason));
                        continue;
                    }
                    for v in &mut omegas[i] {
                        *v /= lengths[i];
                    }
                    let width = widths[i].clamp(MIN_WIDTH, f32::MAX);
                    if width != widths[i] {
                        widths[i] = width;
                        found.bounded_widths += 1;
                    }
                }
                found
            })
            .reduce(Found::default, merge)
    } else {
        fixed.into_par_iter().enumerate().map(|c| judge_static(c).0).reduce(Found::default, merge)
    };

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
