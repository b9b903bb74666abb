//! What the viewer does, wherever it runs: opens scenes, moves the eye, keeps time.

pub mod digest;
pub mod eye;
pub mod framing;
pub mod governor;
pub mod headset;
pub mod loader;
pub mod lod;
pub mod measurement;
pub mod opened;
pub mod painter;
pub mod panel;
pub mod prediction;
pub mod quality;
pub mod sequence;
pub mod thumbnail;
pub mod time;
pub mod viewer;
