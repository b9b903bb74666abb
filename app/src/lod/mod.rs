//! Level of detail by class and distance, after the thesis `000`, chapters 4 to 6: what is known of each class's quality
//! ([`Model`]), the levels of a scene in memory ([`Levels`]), and which of them each frame is drawn at
//! ([`LevelChoice`]), of a scene that need not fit into memory too ([`Resident`]).

mod bounds;
mod choice;
mod curve;
mod detail;
mod levels;
mod pages;
mod resident;

pub use bounds::Bounds;
pub use choice::{LevelChoice, Region, Store, Tuning};
pub use curve::{Branch, ClassQuality, Model, Quality};
pub use detail::Detail;
pub use levels::Levels;
pub use resident::{Memory, Resident};
