//! SPZ, versions 1 to 4.

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

/// See [`super`].
pub(crate) fn read(source: &Source, _ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    Err(SceneError::unsupported(source.path(), "spz files are not read yet", "Convert it to .ply"))
}

/// See [`super`].
pub(crate) fn write(_splats: &Splats, _out: &mut impl std::io::Write) -> std::io::Result<()> {
    Err(std::io::Error::new(std::io::ErrorKind::Unsupported, "writing .spz is not supported yet"))
}
