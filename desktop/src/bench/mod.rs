//! What accuracy costs: configurations measured against the reference, and a report of it.
//!
//! * [`sweep`], [`experiments`]: which configurations, as data.
//! * [`subject`]: scenes, and from where they are looked at.
//! * [`truth`]: what pictures are measured against.
//! * [`measure`]: the measuring; every finished frame is a line of a file, so that a run can go on where it ended.
//! * [`outcome`], [`front`]: medians, spreads, ratios; what no other configuration beats.
//! * [`quality`]: the table behind `--quality`.
//! * [`report`]: HTML, CSV and JSON.

pub mod experiments;
pub mod front;
pub mod measure;
pub mod outcome;
pub mod quality;
pub mod record;
pub mod report;
pub mod subject;
pub mod sweep;
pub mod truth;

use std::path::PathBuf;

use motes_renderer::gpu::GpuError;
use motes_renderer::reference::ReferenceError;
use motes_scenes::SceneError;

use crate::measure::MeasureError;

/// Why a bench cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A scene or its cameras.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The reference.
    #[error("reference of {subject}: {source}")]
    Reference {
        /// Scene and view.
        subject: String,
        /// Why.
        source: ReferenceError,
    },
    /// A picture.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's word.
        source: std::io::Error,
    },
    /// A file of a bench is not one.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What was found, and what to do.
        problem: String,
    },
    /// A setting that makes no sense.
    #[error("{0}")]
    Setting(String),
}

impl BenchError {
    /// For `map_err` on what concerns a file.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }
}
