//! Parts of a large scene, to be shown before all of it is read.
//!
//! Where a file holds its splats in rows of one length that mean something by themselves (binary `.ply` of the trainers,
//! `.splat`, `.splatv`), rows can be read in any order. Before the whole scene is read in the file's own order, parts of
//! [`FIRST`] splats, then [`GROWTH`] times as many, and so on, are read and handed over, as long as a part is no more than a
//! quarter of the scene. A part is runs of [`RUN`] rows, evenly spaced through the file: trainers append splats as
//! they split others, so that every region of a scene is found all over its file.
//!
//! Of `n` splats, `m` cover less than all would. Each is therefore drawn wider by `√(n / m)` along all axes: its shape on
//! an image gains the area that the missing ones leave, so that the expected optical depth along any ray is that of the
//! whole scene. Reading the parts costs less than a third of reading the scene, mostly far less.

use rayon::prelude::*;

use crate::chunks::{self, SplatsMut};
use crate::load::LoadContext;
use crate::report::{LoadReport, SourceInfo};
use crate::source::Source;
use crate::{Format, Scene, SceneError, Splats, recentre, sanitise, sh_coefficients};

/// Splats of the first part.
pub const FIRST: usize = 1 << 16;
/// How many times as many splats the next part has.
pub const GROWTH: usize = 8;
/// Rows that are read together: about a page of a file's memory.
pub const RUN: usize = 16;

/// Sizes of the parts of a scene of `n` splats.
fn parts(n: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(FIRST), |part| part.checked_mul(GROWTH)).take_while(move |part| *part <= n / 4)
}

/// As [`chunks::read_rows`], of rows that mean something by themselves: parts of a large scene are handed over first.
/// Means are relative to `origin`.
pub(crate) fn read_rows(
    source: &Source,
    ctx: &LoadContext<'_>,
    offset: u64,
    row_bytes: usize,
    origin: [f64; 3],
    out: SplatsMut<'_>,
    decode: impl Fn(&[u8], SplatsMut<'_>) + Sync,
) -> Result<(), SceneError> {
    offer(source, ctx, [offset, row_bytes as u64], origin, &out, &decode)?;
    chunks::read_rows(source, ctx, offset, row_bytes, out, decode)
}

fn offer(
    source: &Source,
    ctx: &LoadContext<'_>,
    [offset, row_bytes]: [u64; 2],
    origin: [f64; 3],
    all: &SplatsMut<'_>,
    decode: &(impl Fn(&[u8], SplatsMut<'_>) + Sync),
) -> Result<(), SceneError> {
    let (Some(show), n) = (ctx.early(), all.len()) else { return Ok(()) };
    let Some(degree) = (0..=3).find(|degree| sh_coefficients(*degree) == all.coefficients) else {
        return Ok(());
    };
    for part in parts(n) {
        let runs = (part / RUN) as u64;
        let mut splats = Splats::zeroed(part, degree, all.motion.is_some());
        splats.origin = origin;
        let pieces = SplatsMut::all(&mut splats).chunks(RUN);
        pieces.into_par_iter().enumerate().try_for_each_init(Vec::new, |buffer, (run, piece)| {
            let first = run as u64 * n as u64 / runs;
            buffer.resize(piece.len() * row_bytes as usize, 0);
            source.read_at(offset + first * row_bytes, buffer)?;
            decode(buffer, piece);
            // Cancelled or not; what is read here is read once more.
            ctx.advance(source, 0, 1)
        })?;
        let sanitised = sanitise(&mut splats);
        recentre::recentre(&mut splats);
        widen(&mut splats, (n as f64 / part as f64).sqrt());
        let info = SourceInfo {
            path: source.path().to_owned(),
            format: Format::of(source)?,
            bytes: source.len(),
            splats: 0..splats.len(),
            sh_degree: degree,
            antialiased: ctx.is_antialiased(),
        };
        let report = LoadReport {
            read: part,
            kept: splats.len(),
            dropped: sanitised.dropped,
            raised_scales: sanitised.raised_scales,
            bounded_widths: sanitised.bounded_widths,
            warnings: Vec::new(),
        };
        show(Scene { splats, report, sources: vec![info] });
    }
    Ok(())
}

/// Makes every splat wider by a factor of at least 1.
fn widen(splats: &mut Splats, factor: f64) {
    let more = factor.ln() as f32;
    for scale in splats.log_scales.as_flattened_mut() {
        *scale = (*scale + more).min(sanitise::MAX_LOG_SCALE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_no_more_than_a_quarter() {
        assert_eq!(parts(4 * FIRST - 1).count(), 0, "a small scene comes in one piece");
        assert_eq!(parts(4 * FIRST).collect::<Vec<_>>(), [FIRST]);
        assert_eq!(parts(6_000_000).collect::<Vec<_>>(), [65_536, 524_288]);
        for n in [1 << 18, 1 << 20, 6_000_000, 100_000_000, u32::MAX as usize] {
            assert!(parts(n).sum::<usize>() * 3 < n, "{n}");
        }
    }
}
