//! One file a format. Every module has
//! `pub(crate) fn read(source: &Source, ctx: &LoadContext) -> Result<Splats, SceneError>`, which hands over what the
//! file says, in the units of [`Splats`] but **raw**: values may be NaN or infinite and quaternions of any length
//! (with `omegas` relative to them); [`crate::sanitise()`] follows for every format.
//!
//! Rules for readers: no count from the file sizes an allocation before it is compared with the bytes that are there,
//! then `ctx.admit`; `ctx.advance` every few milliseconds; files inside of a folder are counted with `ctx.add_bytes`.
//! Writers, where there is one: `pub(crate) fn write(splats: &Splats, out: &mut impl Write) -> io::Result<()>`.

pub(crate) mod compressed_ply;
mod expansion;
pub(crate) mod ksplat;
pub(crate) mod ply;
pub(crate) mod sog;
pub(crate) mod splat;
pub(crate) mod splatv;
pub(crate) mod spz;
pub(crate) mod streamed_parts;
pub(crate) mod streamed_sog;
pub(crate) mod values;

use crate::load::LoadContext;
use crate::source::Source;
use crate::{Format, SceneError, Splats};

/// Reads a source of a known format.
pub(crate) fn read(format: Format, source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    match format {
        Format::Ply | Format::SpacetimePly => ply::read(source, ctx),
        Format::CompressedPly => compressed_ply::read(source, ctx),
        Format::Splat => splat::read(source, ctx),
        Format::SplatV => splatv::read(source, ctx),
        Format::KSplat => ksplat::read(source, ctx),
        Format::Spz => spz::read(source, ctx),
        Format::Sog => sog::read(source, ctx),
        Format::StreamedSog => streamed_sog::read(source, ctx),
        Format::Levels => crate::levels::read(source, ctx),
        Format::Folder | Format::Synthetic => Err(SceneError::unsupported(
            source.path(),
            "not a scene file by itself",
            "Name a file in it, or the folder",
        )),
    }
}
