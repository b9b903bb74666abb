//! PlayCanvas's SOG (spatially ordered Gaussians), versions 1 and 2.
//!
//! A `meta.json` and lossless WebP images, in a folder or zipped into one `.sog`. Pixel `i` (row-major) of every image
//! belongs to splat `i`; bytes index tables of 256 values that `meta.json` states (version 2: codebooks; version 1:
//! ranges, so that the tables are linear):
//! * `means_l`, `means_u`: low and high byte of a 16-bit number per axis, between `mins` and `maxs` of
//!   `sign(x) ln(1 + |x|)`;
//! * `scales`: log-scales; `sh0`: constant band and opacity (version 1: logit);
//! * `quats`: the three smaller components, and in alpha 252 + the index of the largest, order `(w, x, y, z)`;
//! * `shN_labels`: 16-bit index into a palette of higher bands, `shN_centroids`: 64 entries a row.
//!
//! Source: PlayCanvas, "The SOG format" (developer manual), and the sample files.

mod container;
mod image;
mod meta;
mod unpack;

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

use container::{Container, Place};
use meta::Layout;
pub(super) use unpack::Target;

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let sog = Sog::open(source, ctx)?;
    let count = sog.admit(source, ctx)?;
    let total = sog.compressed();
    let mut splats = Splats::zeroed(count, sog.sh_degree(), false);
    sog.unpack(source, ctx, total, Target::of(&mut splats))?;
    Ok(splats)
}

/// An opened scene: its description is read and checked against the sizes of its images, nothing is decoded.
pub(super) struct Sog {
    place: Place,
    layout: Layout,
    /// The images' compressed files, in the order of [`Layout::files`].
    files: Vec<Vec<u8>>,
    /// Bytes of all files together.
    stored: u64,
}

impl Sog {
    /// Opens a folder, a `meta.json` or a zip.
    pub(super) fn open(source: &Source, ctx: &LoadContext<'_>) -> Result<Self, SceneError> {
        let mut container = Container::of(source)?;
        let text = container.meta(ctx)?;
        let place = container.place().clone();
        let mut layout = Layout::parse(&place, &container.meta_name(), &text, ctx)?;
        let mut files = Vec::new();
        for name in layout.files() {
            ctx.advance(source, 0, 1)?;
            files.push(container.read(name, ctx)?);
        }
        drop(container);
        if layout.antialiased {
            ctx.set_antialiased();
        }
        let compressed: u64 = files.iter().map(|file| file.len() as u64).sum();
        let stored = text.len() as u64 + compressed;
        layout.check_images(&place, &files)?;
        Ok(Self { place, layout, files, stored })
    }

    /// Number of splats.
    pub(super) fn count(&self) -> u64 {
        self.layout.count
    }

    /// Degree of the spherical harmonics.
    pub(super) fn sh_degree(&self) -> u8 {
        self.layout.sh_degree
    }

    /// The box that holds all means.
    pub(super) fn means_within(&self) -> [[f64; 3]; 2] {
        let plain = |v: f64| v.signum() * v.abs().exp_m1();
        [self.layout.mins.map(plain), self.layout.maxs.map(plain)]
    }

    /// No splat has a larger log-scale.
    pub(super) fn largest_log_scale(&self) -> f32 {
        self.layout.scales.iter().flatten().copied().fold(crate::MIN_LOG_SCALE, f32::max)
    }

    /// Bytes of compressed image.
    pub(super) fn compressed(&self) -> u64 {
        self.files.iter().map(|file| file.len() as u64).sum()
    }

    /// Whether the scene's splats may be had, see [`LoadContext::admit`].
    pub(super) fn admit(&self, source: &Source, ctx: &LoadContext<'_>) -> Result<usize, SceneError> {
        // Each splat also has a pixel of 4 bytes in every image.
        let bytes = Splats::bytes_per_splat(self.sh_degree(), false) + 4 * self.files.len();
        let needed = self.count().saturating_mul(bytes as u64);
        super::expansion::check(self.place.path(), "the images", needed, self.stored)?;
        ctx.admit(source, self.count(), self.sh_degree(), false)
    }

    /// Decodes into `target`, whose length is [`Sog::count`], as part of a work of `total` bytes of compressed image.
    pub(super) fn unpack(
        self,
        source: &Source,
        ctx: &LoadContext<'_>,
        total: u64,
        target: Target<'_>,
    ) -> Result<(), SceneError> {
        let interrupt = image::Interrupt { source, ctx, total };
        let names = self.layout.files();
        let images = image::decode_all(&self.place, &names, self.files, &interrupt)?;
        unpack::unpack(&self.place, &self.layout, &images, target)
    }
}
