//! What the viewer does, wherever it runs.

pub mod prediction;
