//! Hard cases: deterministic scenes that break splat viewers, and what must hold for each.

pub mod cases;
pub mod colour;
mod input;
mod order;
pub mod precision;
pub mod rig;
pub mod scene;
pub mod sweeps;
pub mod temporal;
mod view;
