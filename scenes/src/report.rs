//! What loading found, kept and dropped.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use crate::Format;

/// Why a splat was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum DropReason {
    /// The mean is NaN, infinite, or farther out than [`crate::MAX_LENGTH`].
    Mean,
    /// The quaternion is NaN or infinite.
    Rotation,
    /// The quaternion is (nearly) zero, `|q|² < 10⁻⁶`: no rotation can be read from it.
    ZeroRotation,
    /// A scale is NaN, or its exponential is infinite or beyond [`crate::MAX_LOG_SCALE`].
    Scale,
    /// The opacity is NaN.
    Opacity,
    /// A colour coefficient is NaN, infinite, or beyond [`crate::MAX_SH`].
    Color,
    /// A motion coefficient is NaN, infinite, or farther out than [`crate::MAX_LENGTH`].
    Motion,
    /// The time centre or width is NaN, or the centre beyond [`crate::MAX_TIME`].
    Time,
}

impl DropReason {
    /// Every reason, in the order in which they are tested: a splat counts under its first.
    pub const ALL: [Self; 8] = [
        Self::Mean,
        Self::Rotation,
        Self::ZeroRotation,
        Self::Scale,
        Self::Opacity,
        Self::Color,
        Self::Motion,
        Self::Time,
    ];
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Mean => "position is not finite or out of range",
            Self::Rotation => "rotation is not finite",
            Self::ZeroRotation => "rotation is zero",
            Self::Scale => "scale is not finite or overflows",
            Self::Opacity => "opacity is not a number",
            Self::Color => "colour is not finite or out of range",
            Self::Motion => "motion is not finite or out of range",
            Self::Time => "time is not finite or out of range",
        })
    }
}

/// One file of a scene.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SourceInfo {
    /// The file or folder.
    pub path: PathBuf,
    /// Its format.
    pub format: Format,
    /// Bytes on disk, all its files together.
    pub bytes: u64,
    /// The splats that came from it: indices into the scene's arrays.
    pub splats: std::ops::Range<usize>,
    /// Degree of its spherical harmonics before merging, `0 ..= 3`.
    pub sh_degree: u8,
    /// Whether the file says that it was trained with the compensated low-pass filter of Mip-Splatting (Yu et al.
    /// 2024): such a scene looks right only when it is rendered with it.
    pub antialiased: bool,
}

/// What loading found, kept and dropped.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct LoadReport {
    /// Splats in the files.
    pub read: usize,
    /// Splats in the scene.
    pub kept: usize,
    /// Splats dropped per reason; reasons without any are absent.
    pub dropped: BTreeMap<DropReason, usize>,
    /// Log-scales raised to [`crate::MIN_LOG_SCALE`] (a scale of zero, usually).
    pub raised_scales: usize,
    /// Time widths brought into `MIN_WIDTH ..= f32::MAX` (an infinite one means always there).
    pub bounded_widths: usize,
    /// What else a user should know, one sentence each.
    pub warnings: Vec<String>,
}

impl LoadReport {
    /// Splats dropped, all reasons together.
    pub fn dropped_total(&self) -> usize {
        self.dropped.values().sum()
    }

    /// Adds another file's report.
    pub(crate) fn add(&mut self, other: Self) {
        self.read += other.read;
        self.kept += other.kept;
        for (reason, n) in other.dropped {
            *self.dropped.entry(reason).or_default() += n;
        }
        self.raised_scales += other.raised_scales;
        self.bounded_widths += other.bounded_widths;
        self.warnings.extend(other.warnings);
    }
}
