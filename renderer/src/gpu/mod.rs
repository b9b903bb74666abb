//! The Vulkan device: created with no more than a Quest offers, everything else optional.

mod barrier;
mod capabilities;
mod device;
mod device_report;
mod error;
mod memory;

pub use barrier::Side;
pub use capabilities::Capabilities;
pub use device::{Bootstrap, Gpu, GpuOptions, Plain};
pub use device_report::{DeviceReport, Finding};
pub use error::{During, GpuError};
pub use memory::{Buffer, Image, ImageDescription};
