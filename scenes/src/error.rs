//! What can go wrong with a file.

use std::path::PathBuf;

/// An error with a scene, camera or settings file. Its text names the file, the property and the place,
/// and says what to do.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's word.
        source: std::io::Error,
    },
    /// The file is not what it claims to be.
    #[error("{}: {place}: {problem}. {remedy}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in it: a byte offset, a header line, a property's name.
        place: String,
        /// What was found and what was expected.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
}
