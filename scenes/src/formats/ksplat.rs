//! mkkellogg `.ksplat`.

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats};

/// See [`super`].
pub(crate) fn read(source: &Source, _ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    Err(SceneError::unsupported(source.path(), "ksplat files are not read yet", "Convert it to .ply"))
}
