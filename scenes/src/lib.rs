//! Splat scenes: what they are in memory, and every file format they are read from and written to.
//!
//! This crate knows files and splats, and nothing of Vulkan or windows. Its one in-memory form is
//! [`Splats`]; its way in is [`load()`] (one file or folder) or [`load_many`] (several, merged), its way out [`save()`].
//!
//! Every reader hands over what the file says; [`sanitise()`] then makes the promises of [`Splats`] true
//! (finite values, unit quaternions) and counts what it had to drop, in the scene's [`LoadReport`].

pub mod cameras;
mod chunks;
pub mod early;
mod error;
mod format;
mod formats;
pub mod labels;
pub mod levels;
mod load;
mod merge;
mod recentre;
mod report;
pub mod sample;
mod sanitise;
mod save;
mod sequence;
pub mod settings;
mod source;
mod splats;
pub mod statement;
pub mod synthetic;

pub use error::SceneError;
pub use format::Format;
pub use formats::streamed_sog::{StreamedLevel, streamed_levels};
pub use load::{
    CancelToken, EarlyCallback, Limits, LoadOptions, Progress, Scene, load, load_bytes, load_many,
};
pub use report::{DropReason, LoadReport, SourceInfo};
pub use sample::sample;
pub use sanitise::{
    MAX_LENGTH, MAX_LOG_SCALE, MAX_SH, MAX_TIME, MIN_LOG_SCALE, MIN_WIDTH, Sanitised, sanitise,
};
pub use save::save;
pub use sequence::{looks_like_sequence, sequence_frames};
pub use splats::{Motion, SH_C0, Splats, sh_coefficients};
