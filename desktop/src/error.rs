//! Why a command could not do what it was asked.

use std::path::PathBuf;

use motes_renderer::ConfigError;
use motes_renderer::gpu::GpuError;
use motes_renderer::reference::ReferenceError;
use motes_scenes::SceneError;

use crate::measure::MeasureError;

/// Why a command could not do what it was asked. Its text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// A scene, camera or settings file.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The reference renderer.
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    /// A digest.
    #[error(transparent)]
    Digest(#[from] motes_app::digest::DigestError),
    /// A picture.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// Choices that make no sense together.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's word.
        source: std::io::Error,
    },
    /// Arguments that do not fit together, or a name that does not exist.
    #[error("{0}")]
    Usage(String),
    /// The headset.
    #[error(transparent)]
    Headset(#[from] motes_xr::XrError),
    /// A bench.
    #[error(transparent)]
    Bench(#[from] crate::bench::BenchError),
    /// What was printed could not be written.
    #[error("cannot print: {0}")]
    Print(std::io::Error),
    /// A check that was asked for did not hold; the figures are above.
    #[error("{0}")]
    Failed(String),
    /// The validation layer complained.
    #[error("the validation layer complains:\n{0}")]
    Validation(String),
}

impl CommandError {
    /// A [`CommandError::Io`], for `map_err`.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        |source| Self::Io { path, source }
    }
}
