//! antimatter15's `.splat`: 32 bytes a splat and nothing else. Mean (3 f32), scale (3 f32, linear), colour and opacity
//! (4 bytes, `value / 255`), rotation (4 bytes, w first).
//!
//! Programs disagree about the rotation's bytes: antimatter15 reads `(q − 128) / 128`, PlayCanvas `q / 255 · 2 − 1`.
//! They differ by 0.006 at most; Motes reads the latter, in which ±1 are both exact.

use std::io::Write;

use super::values::{color_of_dc, dc_of_color, f32_at};
use crate::chunks::{SplatsMut, count_rows};
use crate::early::read_rows;
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

const ROW_BYTES: usize = 32;

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let n = ctx.admit(source, count_rows(source, 0, ROW_BYTES)?, 0, false)?;
    let mut splats = Splats::zeroed(n, 0, false);
    let out = SplatsMut::all(&mut splats);
    read_rows(source, ctx, 0, ROW_BYTES, [0.0; 3], out, |bytes, out| {
        for (i, row) in bytes.chunks_exact(ROW_BYTES).enumerate() {
            out.means[i] = std::array::from_fn(|k| f32_at(row, 4 * k));
            out.log_scales[i] = std::array::from_fn(|k| f32_at(row, 12 + 4 * k).ln());
            out.sh[i] = std::array::from_fn(|c| dc_of_color(f32::from(row[24 + c]) / 255.0));
            out.opacities[i] = f32::from(row[27]) / 255.0;
            let q = |k: usize| f32::from(row[28 + k]) / 255.0 * 2.0 - 1.0;
            out.rotations[i] = [q(1), q(2), q(3), q(0)];
        }
    })?;
    Ok(splats)
}

/// See [`super`]. Spherical harmonics above the constant band, motion, and colours outside of `0 ..= 1` are lost.
pub(crate) fn write(splats: &Splats, out: &mut impl Write) -> std::io::Result<()> {
    // A cast saturates, and takes NaN to 0.
    let byte = |v: f32| (v * 255.0).round() as u8;
    for i in 0..splats.len() {
        let mut row = [0; ROW_BYTES];
        let mean = splats.mean_of(i).map(|v| v as f32);
        for (k, v) in mean.into_iter().chain(splats.log_scales[i].map(f32::exp)).enumerate() {
            row[4 * k..4 * k + 4].copy_from_slice(&v.to_le_bytes());
        }
        let [r, g, b] = splats.sh_of(i)[0].map(color_of_dc);
        let [x, y, z, w] = splats.rotations[i].map(|v| (v + 1.0) / 2.0);
        for (k, v) in [r, g, b, splats.opacities[i], w, x, y, z].into_iter().enumerate() {
            row[24 + k] = byte(v);
        }
        out.write_all(&row)?;
    }
    Ok(())
}
