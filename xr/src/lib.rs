//! The headset: an OpenXR session, and a recorded one with the same interface.

pub mod bindings;
mod content;
mod error;
mod headset;
mod hidden;
mod panel_screen;
mod readback;
mod runtime;
mod script;
mod shelf;
mod show;
mod viewer;
mod walk;

pub use content::{About, Content, FirstView};
pub use error::XrError;
pub use headset::{EyeImages, FrameTime, Headset, MOST_QUADS, Quad, RIM_CLEAR, SessionState, Step, Surface};
pub use hidden::HiddenArea;
pub use readback::Readback;
pub use runtime::{Optional, Platform, Runtime, RuntimeHeadset, RuntimeOptions, SessionOptions};
pub use script::{Order, Recorder, Script, ScriptFrame, ScriptStep, ScriptedHeadset};
pub use shelf::scenes_in;
pub use show::{Pump, ShowError, ShowOptions, Visit, show};
pub use viewer::{FrameTimes, LastFrame, Viewer};
