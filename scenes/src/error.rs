//! What can go wrong with a file.

use std::path::{Path, PathBuf};

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
    /// The file is sound, but holds what Motes does not show.
    #[error("{}: {what}. {remedy}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it holds, and why that is refused.
        what: String,
        /// What the user can do.
        remedy: String,
    },
    /// The scene is larger than [`crate::Limits`] allow.
    #[error("{}: {what}, and the limit is {limit}. Load a smaller level of the scene, or raise the limit", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What it needs.
        what: String,
        /// What it may have.
        limit: String,
    },
    /// Loading was stopped by its [`crate::CancelToken`].
    #[error("{}: loading was cancelled", path.display())]
    Cancelled {
        /// The file that was being read.
        path: PathBuf,
    },
}

impl SceneError {
    /// An [`SceneError::Io`], for `map_err`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        |source| Self::Io { path, source }
    }

    /// An [`SceneError::Malformed`].
    pub(crate) fn malformed(
        path: &Path,
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Malformed {
            path: path.to_owned(),
            place: place.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`SceneError::Unsupported`].
    pub(crate) fn unsupported(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_owned(), what: what.into(), remedy: remedy.into() }
    }
}
