//! From attributes' bytes to splats.

use half::f16;
use rayon::prelude::*;

use super::{COLOR_SCALE, Header};
use crate::{Splats, sh_coefficients};

/// Splats per unit of work.
const CHUNK: usize = 1 << 13;

/// Decodes attributes in the order of [`Header::sizes`], each of exactly its length. `range` is the value of the
/// bytes 0 and 255 of higher bands, where the file states it.
pub(super) fn decode(header: &Header, attributes: &[&[u8]; 6], range: Option<[f32; 2]>) -> Splats {
    let [means, opacities, colors, scales, rotations, higher] = *attributes;
    let sizes = header.sizes().map(|size| size as usize);
    let degree = header.degree.min(3);
    let mut splats = Splats::zeroed(header.count as usize, degree, false);
    let stride = sh_coefficients(degree);
    let coefficient = coefficients(range);
    let step = (-f64::from(header.fractional_bits)).exp2();
    (
        splats.means.par_chunks_mut(CHUNK),
        splats.rotations.par_chunks_mut(CHUNK),
        splats.log_scales.par_chunks_mut(CHUNK),
        splats.opacities.par_chunks_mut(CHUNK),
        splats.sh.par_chunks_mut(CHUNK * stride),
    )
        .into_par_iter()
        .enumerate()
        .for_each(|(chunk, (out_means, out_rotations, out_scales, out_opacities, out_sh))| {
            let first = chunk * CHUNK;
            let count = out_means.len();
            let of = |attribute: &'_ [u8], k: usize| -> std::ops::Range<usize> {
                debug_assert_eq!(attribute.len(), header.count as usize * sizes[k]);
                first * sizes[k]..(first + count) * sizes[k]
            };
            if header.version == 1 {
                for (out, b) in out_means.iter_mut().zip(means[of(means, 0)].chunks_exact(6)) {
                    *out = std::array::from_fn(|k| f16::from_le_bytes([b[2 * k], b[2 * k + 1]]).to_f32());
                }
            } else {
                for (out, b) in out_means.iter_mut().zip(means[of(means, 0)].chunks_exact(9)) {
                    *out = std::array::from_fn(|k| {
                        // Into the upper three bytes, and back with the sign.
                        let fixed = i32::from_le_bytes([0, b[3 * k], b[3 * k + 1], b[3 * k + 2]]) >> 8;
                        (f64::from(fixed) * step) as f32
                    });
                }
            }
            for (out, &b) in out_opacities.iter_mut().zip(&opacities[of(opacities, 1)]) {
                *out = f32::from(b) / 255.0;
            }
            for (out, b) in out_scales.iter_mut().zip(scales[of(scales, 3)].chunks_exact(3)) {
                *out = std::array::from_fn(|k| f32::from(b[k]) / 16.0 - 10.0);
            }
            let bytes = &rotations[of(rotations, 4)];
            if header.version < 3 {
                for (out, b) in out_rotations.iter_mut().zip(bytes.chunks_exact(3)) {
                    *out = first_three([b[0], b[1], b[2]]);
                }
            } else {
                for (out, b) in out_rotations.iter_mut().zip(bytes.chunks_exact(4)) {
                    *out = smallest_three(u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                }
            }
            for (out, b) in out_sh.chunks_exact_mut(stride).zip(colors[of(colors, 2)].chunks_exact(3)) {
                out[0] = std::array::from_fn(|k| (f32::from(b[k]) / 255.0 - 0.5) / COLOR_SCALE);
            }
            if sizes[5] > 0 {
                let bytes = higher[of(higher, 5)].chunks_exact(sizes[5]);
                for (out, bytes) in out_sh.chunks_exact_mut(stride).zip(bytes) {
                    for (out, b) in out[1..].iter_mut().zip(bytes.chunks_exact(3)) {
                        *out = std::array::from_fn(|k| coefficient[usize::from(b[k])]);
                    }
                }
            }
        });
    splats
}

/// The value of each byte of the higher bands: by default `(byte − 128) / 128`.
fn coefficients(range: Option<[f32; 2]>) -> [f32; 256] {
    match range {
        Some([min, max]) if min < max && [min, max] != [-1.0, 1.0] => {
            std::array::from_fn(|byte| min + (max - min) * (byte as f32 / 255.0))
        }
        // The format's library takes an empty range for "all zero".
        Some([min, max]) if [min, max] != [-1.0, 1.0] => [0.0; 256],
        _ => std::array::from_fn(|byte| (byte as f32 - 128.0) / 128.0),
    }
}

/// Versions 1 and 2: x, y, z in a byte each; w is not negative and follows from the length.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f32::from(b) / 127.5 - 1.0);
    [x, y, z, (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt()]
}

/// Version 3 on: the index of the largest component (order x, y, z, w) in the upper two bits, below it the others in
/// their order with the first one uppermost, each a sign and a magnitude of 9 bits, in units of `√½ / 511`.
fn smallest_three(bits: u32) -> [f32; 4] {
    const MAGNITUDE: u32 = (1 << 9) - 1;
    let largest = (bits >> 30) as usize;
    let mut rest = bits;
    let mut q = [0.0; 4];
    let mut squares = 0.0;
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = (rest & MAGNITUDE) as f32 / MAGNITUDE as f32 * std::f32::consts::FRAC_1_SQRT_2;
        q[i] = if rest & (MAGNITUDE + 1) == 0 { magnitude } else { -magnitude };
        squares += magnitude * magnitude;
        rest >>= 10;
    }
    q[largest] = (1.0_f32 - squares).max(0.0).sqrt();
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_follow_their_range() {
        let usual = coefficients(None);
        assert_eq!([usual[0], usual[128], usual[192]], [-1.0, 0.0, 0.5]);
        assert_eq!(coefficients(Some([-1.0, 1.0])), usual);
        let own = coefficients(Some([-0.5, 2.0]));
        assert_eq!([own[0], own[51], own[255]], [-0.5, 0.0, 2.0]);
        // An empty range is all zero, wherever it lies.
        assert_eq!(coefficients(Some([0.5, 0.5])), [0.0; 256]);
        assert_eq!(coefficients(Some([2.0, -0.5])), [0.0; 256]);
    }
}
