//! What the viewer does, wherever it runs: opens scenes, moves the eye, keeps time.

pub mod framing;
pub mod headset;
pub mod opened;
pub mod prediction;
pub mod time;
