//! Turns a splat scene and a list of views into images. Knows neither windows nor OpenXR.

mod config;
pub mod motion;
pub mod projection;
pub mod reference;
pub mod spherical_harmonics;
mod view;

pub use config::*;
pub use view::{Fov, View};
