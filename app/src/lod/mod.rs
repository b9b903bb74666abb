//! Level of detail by class and distance, after the thesis `000`, chapters 4 to 6.

mod curve;

pub use curve::{Branch, ClassQuality, Model, Quality};
