//! Splats cut into pieces that several threads fill at once, without a copy and without `unsafe`.

use rayon::prelude::*;

use crate::load::LoadContext;
use crate::source::Source;
use crate::{Motion, SceneError, Splats, sh_coefficients};

/// A run of splats, to be written to.
pub(crate) struct SplatsMut<'a> {
    /// Index of its first splat in the scene.
    pub(crate) first: usize,
    pub(crate) means: &'a mut [[f32; 3]],
    pub(crate) rotations: &'a mut [[f32; 4]],
    pub(crate) log_scales: &'a mut [[f32; 3]],
    pub(crate) opacities: &'a mut [f32],
    pub(crate) sh: &'a mut [[f32; 3]],
    /// Coefficients per splat in `sh`.
    pub(crate) coefficients: usize,
    pub(crate) motion: Option<MotionMut<'a>>,
}

/// Its motion.
pub(crate) struct MotionMut<'a> {
    pub(crate) centers: &'a mut [f32],
    pub(crate) widths: &'a mut [f32],
    pub(crate) polynomials: &'a mut [[[f32; 3]; 3]],
    pub(crate) omegas: &'a mut [[f32; 4]],
}

impl<'a> SplatsMut<'a> {
    /// All of a scene.
    pub(crate) fn all(splats: &'a mut Splats) -> Self {
        Self {
            first: 0,
            means: &mut splats.means,
            rotations: &mut splats.rotations,
            log_scales: &mut splats.log_scales,
            opacities: &mut splats.opacities,
            sh: &mut splats.sh,
            coefficients: sh_coefficients(splats.sh_degree),
            motion: splats.motion.as_mut().map(MotionMut::all),
        }
    }

    /// Number of splats.
    pub(crate) fn len(&self) -> usize {
        self.means.len()
    }

    /// The first `n` (at most all), and the others.
    pub(crate) fn split_at(self, n: usize) -> (Self, Self) {
        let n = n.min(self.len());
        let (means, means_b) = self.means.split_at_mut(n);
        let (rotations, rotations_b) = self.rotations.split_at_mut(n);
        let (log_scales, log_scales_b) = self.log_scales.split_at_mut(n);
        let (opacities, opacities_b) = self.opacities.split_at_mut(n);
        let (sh, sh_b) = self.sh.split_at_mut(n * self.coefficients);
        let (motion, motion_b) = self.motion.map(|m| m.split_at(n)).unzip();
        let (first, coefficients) = (self.first, self.coefficients);
        (
            Self { first, means, rotations, log_scales, opacities, sh, coefficients, motion },
            Self {
                first: first + n,
                means: means_b,
                rotations: rotations_b,
                log_scales: log_scales_b,
                opacities: opacities_b,
                sh: sh_b,
                coefficients,
                motion: motion_b,
            },
        )
    }

    /// Pieces of `n` splats, the last one shorter.
    pub(crate) fn chunks(self, n: usize) -> Vec<Self> {
        let n = n.max(1);
        let mut chunks = Vec::with_capacity(self.len().div_ceil(n));
        let mut rest = self;
        while rest.len() > n {
            let (chunk, others) = rest.split_at(n);
            chunks.push(chunk);
            rest = others;
        }
        if rest.len() > 0 {
            chunks.push(rest);
        }
        chunks
    }
}

impl<'a> MotionMut<'a> {
    fn all(motion: &'a mut Motion) -> Self {
        Self {
            centers: &mut motion.centers,
            widths: &mut motion.widths,
            polynomials: &mut motion.polynomials,
            omegas: &mut motion.omegas,
        }
    }

    fn split_at(self, n: usize) -> (Self, Self) {
        let (centers, centers_b) = self.centers.split_at_mut(n);
        let (widths, widths_b) = self.widths.split_at_mut(n);
        let (polynomials, polynomials_b) = self.polynomials.split_at_mut(n);
        let (omegas, omegas_b) = self.omegas.split_at_mut(n);
        (
            Self { centers, widths, polynomials, omegas },
            Self { centers: centers_b, widths: widths_b, polynomials: polynomials_b, omegas: omegas_b },
        )
    }
}

/// Number of rows from `offset` to the end of the file, which must be whole.
pub(crate) fn count_rows(source: &Source, offset: u64, row_bytes: usize) -> Result<u64, SceneError> {
    let bytes = source.len().checked_sub(offset).ok_or_else(|| source.ends_early(0, offset))?;
    let rest = bytes % row_bytes as u64;
    if rest == 0 {
        return Ok(bytes / row_bytes as u64);
    }
    Err(SceneError::malformed(
        source.path(),
        format!("byte {}", source.len() - rest),
        format!("the last splat has {rest} of {row_bytes} bytes"),
        "The file was cut off, or is of another kind: copy or download it again",
    ))
}

/// Bytes that a thread reads at a time: they stay in its level-2 cache until they are decoded.
const READ_BYTES: usize = 256 << 10;

/// Reads rows of `row_bytes` from `offset` on, one per splat of `out`, on all threads, each straight from the file
/// into its piece of the arrays. `decode` gets a whole number of rows and as many splats.
pub(crate) fn read_rows(
    source: &Source,
    ctx: &LoadContext<'_>,
    offset: u64,
    row_bytes: usize,
    out: SplatsMut<'_>,
    decode: impl Fn(&[u8], SplatsMut<'_>) + Sync,
) -> Result<(), SceneError> {
    let base = out.first;
    let rows = (READ_BYTES / row_bytes.max(1)).max(1);
    out.chunks(rows).into_par_iter().try_for_each_init(Vec::new, |buffer: &mut Vec<u8>, chunk| {
        let bytes = chunk.len() * row_bytes;
        buffer.resize(bytes, 0);
        source.read_at(offset + (chunk.first - base) as u64 * row_bytes as u64, buffer)?;
        decode(buffer, chunk);
        ctx.advance(source, bytes as u64, source.len())
    })
}
