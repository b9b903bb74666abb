//! `motes lod`: what is observed of a scene's levels, curves through it, and tests of what the curves promise.

pub mod cross;
pub mod fit;
pub mod observe;
pub mod plots;
pub mod stream;
pub mod walk;
