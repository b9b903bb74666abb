//! From splats to a file, version 3.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::GzEncoder;
use rayon::prelude::*;

use super::{COLOR_SCALE, MAGIC};
use crate::{Splats, sh_coefficients};

/// Most fractional bits of coordinates: 15 µm. The format's own library always writes 12 (0.24 mm), which is coarse
/// against the splats of a desk-top object and too many for a landscape; readers take the number from the header.
const MAX_FRACTIONAL_BITS: u8 = 16;

/// Bits kept of the first band and of the bands above it, the format's library's own choice: coarser than the byte
/// that holds them, so that gzip finds repetitions.
const FIRST_BAND_BITS: u32 = 5;
const OTHER_BANDS_BITS: u32 = 4;

/// Writes the splats without motion and labels, with the scene's own axes.
///
/// Largest errors: half a step of coordinates (8 µm up to ± 128 m, doubling with every doubling of the extent), 0.031
/// in log-scale (3 %), 0.2 % in opacity, 0.013 in the constant band's coefficient (0.4 % in colour; coefficients
/// beyond ± 3.33 are clamped), 0.031 and 0.063 in higher bands (within ± 1), 0.27° in rotation.
pub(crate) fn write(splats: &Splats, out: &mut impl Write) -> io::Result<()> {
    let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidInput, what);
    let count = u32::try_from(splats.len())
        .map_err(|_| invalid(format!("{} splats, and .spz holds at most {}", splats.len(), u32::MAX)))?;
    let bits = fractional_bits(splats)
        .ok_or_else(|| invalid("a splat lies farther out than .spz can hold (8388 km)".to_owned()))?;

    let mut out = GzEncoder::new(out, Compression::new(7));
    out.write_all(MAGIC)?;
    out.write_all(&3_u32.to_le_bytes())?;
    out.write_all(&count.to_le_bytes())?;
    out.write_all(&[splats.sh_degree, bits, 0, 0])?;

    let steps = f64::from(bits).exp2();
    let indices = 0..splats.len();
    each(&mut out, indices.clone(), |i, bytes: &mut Vec<u8>| {
        for v in splats.mean_of(i) {
            let [a, b, c, _] = ((v * steps).round() as i32).to_le_bytes();
            bytes.extend([a, b, c]);
        }
    })?;
    each(&mut out, indices.clone(), |i, bytes| bytes.push(byte(splats.opacities[i] * 255.0)))?;
    each(&mut out, indices.clone(), |i, bytes| {
        bytes.extend(splats.sh_of(i)[0].map(|v| byte((v * COLOR_SCALE + 0.5) * 255.0)));
    })?;
    each(&mut out, indices.clone(), |i, bytes| {
        bytes.extend(splats.log_scales[i].map(|v| byte((v + 10.0) * 16.0)));
    })?;
    each(&mut out, indices.clone(), |i, bytes| {
        bytes.extend(smallest_three(splats.rotations[i]).to_le_bytes());
    })?;
    if splats.sh_degree > 0 {
        each(&mut out, indices, |i, bytes| {
            let higher = &splats.sh_of(i)[1..];
            let (first, other) = higher.split_at(sh_coefficients(1) - 1);
            bytes.extend(first.as_flattened().iter().map(|&v| coefficient(v, FIRST_BAND_BITS)));
            bytes.extend(other.as_flattened().iter().map(|&v| coefficient(v, OTHER_BANDS_BITS)));
        })?;
    }
    out.finish().map(drop)
}

/// Splats that are packed before they are written: each attribute of a scene never exists as a whole.
const BLOCK: usize = 1 << 16;

/// Packs an attribute on all cores and writes it.
fn each(
    out: &mut impl Write,
    indices: std::ops::Range<usize>,
    pack: impl Fn(usize, &mut Vec<u8>) + Sync,
) -> io::Result<()> {
    for start in indices.clone().step_by(BLOCK) {
        let end = (start + BLOCK).min(indices.end);
        let parts: Vec<Vec<u8>> = (start..end)
            .into_par_iter()
            .fold(Vec::new, |mut bytes, i| {
                pack(i, &mut bytes);
                bytes
            })
            .collect();
        for part in parts {
            out.write_all(&part)?;
        }
    }
    Ok(())
}

/// As many fractional bits as leave room for the farthest splat, at most [`MAX_FRACTIONAL_BITS`].
fn fractional_bits(splats: &Splats) -> Option<u8> {
    let farthest = (0..splats.len())
        .into_par_iter()
        .map(|i| splats.mean_of(i).into_iter().fold(0.0, |a: f64, v| a.max(v.abs())))
        .reduce(|| 0.0, f64::max);
    (0..=MAX_FRACTIONAL_BITS).rev().find(|&bits| (farthest * f64::from(bits).exp2()).round() <= 8_388_607.0)
}

fn byte(v: f32) -> u8 {
    // The cast saturates.
    v.round() as u8
}

/// A byte of `128 + 128 v`, rounded to the given number of bits such that zero stays zero.
fn coefficient(v: f32, bits: u32) -> u8 {
    let step = (1 << (8 - bits)) as f32;
    // The cast saturates.
    ((v * 128.0 / step).round() * step + 128.0) as u8
}

/// See [`super::decode`].
fn smallest_three(q: [f32; 4]) -> u32 {
    let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
    let q = q.map(|v| v / length);
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    // The largest component is not stored, hence made positive: −q is the same rotation.
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut bits = largest as u32;
    for i in (0..4).filter(|&i| i != largest) {
        let magnitude = (q[i].abs() * std::f32::consts::SQRT_2 * 511.0).round().min(511.0) as u32;
        bits = bits << 10 | u32::from(q[i] * sign < 0.0) << 9 | magnitude;
    }
    bits
}
