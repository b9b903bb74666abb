//! What the tests that go through more than one crate share.

use std::path::{Path, PathBuf};

/// A file or folder of the sample scenes: below the folder that `MOTES_SCENES` names, else `../shared/scenes` beside
/// the project.
///
/// # Panics
/// Where it is absent: a test that needs a scene fails without it, it is never skipped.
#[allow(clippy::panic, reason = "only tests call it")]
pub fn sample(path: impl AsRef<Path>) -> PathBuf {
    let folder = match std::env::var_os("MOTES_SCENES") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes"),
    };
    let file = folder.join(path.as_ref());
    if !file.exists() {
        panic!("{} is missing: set MOTES_SCENES to the folder of the sample scenes", file.display());
    }
    file
}
