//! Turns a splat scene and a list of views into images. Knows neither windows nor OpenXR.

mod choices;
mod config;
pub mod detail;
mod frame;
pub mod gpu;
mod lens;
pub mod motion;
mod offscreen;
pub mod order;
pub mod packing;
mod passes;
pub mod pipeline_cache;
pub mod plan;
pub mod projection;
pub mod projection_error;
pub mod reference;
mod renderer;
mod report;
pub mod resolution;
mod scene;
pub mod spherical_harmonics;
mod traffic;
mod upload;
mod view;
mod watchdog;
mod workspace;

pub use choices::{CHOICES, Choice, Kind, PRESETS, Preset};
pub use config::*;
pub use offscreen::{LayerMap, Offscreen, Picture};
pub use packing::Packing;
pub use renderer::{DrawRequest, Frame, Renderer, Stereo, Target, midpoint};
pub use report::FrameReport;
pub use scene::{SceneOnDevice, Stream};
pub use traffic::Traffic;
pub use view::{Fov, View};
pub use watchdog::{CostSample, Prediction};
