//! splaTV's `.splatv`: Spacetime Gaussians lite (Li et al. 2023), mostly in half floats.
//!
//! A magic number, the length of a JSON text, the text (cameras of splaTV's own; not read), then 64 bytes a splat:
//! mean (3 f32), rotation (4 halves, w first, any length), scale (3 halves, linear), 2 bytes of padding, colour and
//! opacity (4 bytes), motion (9 halves), 2 bytes of padding, 4 bytes unused, omega (4 halves), time centre and width
//! (2 halves). A width that overflows its half is infinite: the splat is always there.

use super::values::{dc_of_color, f16_at, f32_at, u32_at};
use crate::chunks::{SplatsMut, count_rows};
use crate::early::read_rows;
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

/// The first four bytes.
pub(crate) const MAGIC: u32 = 0x674b;

const ROW_BYTES: usize = 64;

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let mut head = [0; 8];
    source.read_at(0, &mut head)?;
    let offset = 8 + u64::from(u32_at(&head, 4));
    // The JSON text speaks of a texture's size, which may be larger than what is there: the bytes decide.
    let n = ctx.admit(source, count_rows(source, offset, ROW_BYTES)?, 0, true)?;
    let mut splats = Splats::zeroed(n, 0, true);
    let out = SplatsMut::all(&mut splats);
    read_rows(source, ctx, offset, ROW_BYTES, [0.0; 3], out, |bytes, mut out| {
        for (i, row) in bytes.chunks_exact(ROW_BYTES).enumerate() {
            let quaternion =
                |at: usize| [f16_at(row, at + 2), f16_at(row, at + 4), f16_at(row, at + 6), f16_at(row, at)];
            out.means[i] = std::array::from_fn(|k| f32_at(row, 4 * k));
            out.rotations[i] = quaternion(12);
            out.log_scales[i] = std::array::from_fn(|k| f16_at(row, 20 + 2 * k).ln());
            out.sh[i] = std::array::from_fn(|c| dc_of_color(f32::from(row[28 + c]) / 255.0));
            out.opacities[i] = f32::from(row[31]) / 255.0;
            if let Some(motion) = &mut out.motion {
                motion.polynomials[i] =
                    std::array::from_fn(|power| std::array::from_fn(|k| f16_at(row, 32 + 6 * power + 2 * k)));
                motion.omegas[i] = quaternion(52);
                motion.centers[i] = f16_at(row, 60);
                motion.widths[i] = f16_at(row, 62);
            }
        }
    })?;
    Ok(splats)
}
