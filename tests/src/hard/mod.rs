//! Hard cases: deterministic scenes that break splat viewers, and what must hold for each.

pub mod cases;
pub mod colour;
mod input;
mod order;
pub mod rig;
pub mod scene;
pub mod sweeps;
mod view;
