//! splaTV `.splatv`.

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

/// See [`super`].
pub(crate) fn read(source: &Source, _ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    Err(SceneError::unsupported(source.path(), "splatv files are not read yet", "Convert it to .ply"))
}

/// The first four bytes.
pub(crate) const MAGIC: u32 = 0x674b;
