//! Gaussian splatting `.ply`.

pub(crate) mod header;

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

/// See [`super`].
pub(crate) fn read(source: &Source, _ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    Err(SceneError::unsupported(source.path(), "ply files are not read yet", "Convert it"))
}

/// See [`super`].
pub(crate) fn write(_splats: &Splats, _out: &mut impl std::io::Write) -> std::io::Result<()> {
    Err(std::io::Error::new(std::io::ErrorKind::Unsupported, "writing .ply is not supported yet"))
}
