//! What the viewer does in a headset, whoever shows it: input, locomotion, comfort, the panel's place.
//!
//! Nothing here knows OpenXR. Poses are in the **stage**: the headset's own space, metres, x right, y up, z back,
//! floor at y = 0. A [`Placement`] says where the stage stands in the world, whose axes are those of
//! [`motes_scenes::settings::Settings`].

mod comfort;
mod input;
mod joints;
mod locomotion;
pub mod menu;
mod panel;
mod placement;
mod pose;
mod settings;
mod shelf;

pub use comfort::{Comfort, Vignette};
pub use input::{Hand, HandInput, Input};
pub use joints::{Joints, Pinches};
pub use locomotion::{ARC_DOTS, Locomotion};
pub use panel::{PANEL_SIZE, Panel, PanelEvents};
pub use placement::{Placement, yaw_of};
pub use pose::{Eye, EyeFov, Pose};
pub use settings::{HeadsetSettings, SettingsError};
pub use shelf::{Listed, Offered};
