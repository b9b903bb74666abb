//! antimatter15 `.splat`.

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

/// See [`super`].
pub(crate) fn read(source: &Source, _ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    Err(SceneError::unsupported(source.path(), "splat files are not read yet", "Convert it to .ply"))
}

/// See [`super`].
pub(crate) fn write(_splats: &Splats, _out: &mut impl std::io::Write) -> std::io::Result<()> {
    Err(std::io::Error::new(std::io::ErrorKind::Unsupported, "writing .splat is not supported yet"))
}
