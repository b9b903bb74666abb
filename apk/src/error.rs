//! What can go wrong, and what to do about it.

use std::path::PathBuf;

/// Why an APK could not be made or read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The manifest cannot be encoded.
    #[error("manifest, line {line}: {problem}")]
    Manifest {
        /// Line in the XML, from 1.
        line: u32,
        /// What is wrong there.
        problem: String,
    },
    /// The manifest is not XML.
    #[error("the manifest is not XML: {0}")]
    Xml(#[from] roxmltree::Error),
    /// A zip archive cannot be read or written.
    #[error("{what}: {source}")]
    Zip {
        /// What was read or written.
        what: String,
        /// What the archive library says.
        source: zip::result::ZipError,
    },
    /// A file is not what it should be.
    #[error("{what}: {problem}")]
    Malformed {
        /// What was read.
        what: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The signing key cannot be made, read or used.
    #[error("signing key: {0}")]
    Key(String),
}

impl Error {
    /// For `map_err` of an operation on a file.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }

    /// For `map_err` of an operation on an archive.
    pub fn zip(what: impl Into<String>) -> impl FnOnce(zip::result::ZipError) -> Self {
        let what = what.into();
        move |source| Self::Zip { what, source }
    }

    /// A file that is not what it should be.
    pub fn malformed(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Malformed { what: what.into(), problem: problem.into() }
    }
}

/// The result of everything here.
pub type Result<T, E = Error> = std::result::Result<T, E>;
