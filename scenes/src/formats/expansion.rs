//! How much a compressed file may unpack to.

use std::path::Path;

use crate::SceneError;

/// What a scene may take beyond a multiple of its file, bytes: small files of very regular scenes.
const FREE: u64 = 64 << 20;

/// Trained scenes take 5 to 9 times their compressed file in memory; a generated grid of equal splats may take 50.
/// Deflate and lossless WebP reach a thousand and more, which only a damaged or hostile file does.
const MAX_EXPANSION: u64 = 64;

/// Call before allocating `needed` bytes for what `stored` bytes of compressed file claim to hold.
pub(crate) fn check(path: &Path, place: &str, needed: u64, stored: u64) -> Result<(), SceneError> {
    if needed <= stored.saturating_mul(MAX_EXPANSION).saturating_add(FREE) {
        return Ok(());
    }
    Err(SceneError::malformed(
        path,
        place,
        format!(
            "claims contents of {needed} bytes in {stored} bytes of file, more than {MAX_EXPANSION} times as much"
        ),
        "The file is damaged or made to fill memory. If it is neither, save the scene as .ply",
    ))
}
