//! Turns a splat scene and a list of views into images. Knows neither windows nor OpenXR.

mod config;
mod view;

pub use config::*;
pub use view::{Fov, View};
