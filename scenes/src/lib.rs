//! Splat scenes: what they are in memory, and every file format they are read from and written to.
//!
//! This crate knows files and splats, and nothing of Vulkan or windows. Its one in-memory form is
//! [`Splats`]; its way in is [`load`].

pub mod cameras;
mod error;
mod splats;

pub use error::SceneError;
pub use splats::{Motion, SH_C0, Splats, sh_coefficients};
