//! What can go wrong with a device.

use ash::vk;

/// An error of the Vulkan driver, or a limit of the device.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// There is no Vulkan loader.
    #[error(
        "Vulkan is not installed ({0}). Install your graphics card's driver; on a machine without one: mesa-vulkan-drivers and libvulkan1"
    )]
    NoVulkan(String),
    /// There is a loader, and no usable device.
    #[error("no Vulkan device can be used: {0}")]
    NoDevice(String),
    /// A call failed.
    #[error("{call}: {result}{}", remedy(*.result))]
    Call {
        /// The call.
        call: &'static str,
        /// The driver's word.
        result: vk::Result,
    },
    /// Device memory could not be had.
    #[error("device memory for {name} ({bytes} bytes): {problem}")]
    Memory {
        /// What it was for.
        name: String,
        /// How much.
        bytes: u64,
        /// The allocator's word.
        problem: String,
    },
    /// A choice that this device does not offer.
    #[error("{wanted}: this device ({device}) does not offer it. {remedy}")]
    Unsupported {
        /// The choice.
        wanted: String,
        /// The device's name.
        device: String,
        /// What can be chosen instead.
        remedy: String,
    },
    /// Choices that make no sense together.
    #[error("{0}")]
    Config(#[from] crate::ConfigError),
    /// A scene larger than the device can bind.
    #[error(
        "{splats} splats need {needed} bytes for {stream}; this device binds {available}. At most {fits} splats fit: lower the precision, or optimise the scene"
    )]
    SceneTooLarge {
        /// Number of splats.
        splats: usize,
        /// Which stream.
        stream: &'static str,
        /// Bytes it takes.
        needed: u64,
        /// Bytes the device binds.
        available: u64,
        /// Splats that fit.
        fits: u64,
    },
}

impl GpuError {
    /// Whether the device is gone, and everything made with it.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Call { result: vk::Result::ERROR_DEVICE_LOST, .. })
    }
}

fn remedy(result: vk::Result) -> &'static str {
    match result {
        vk::Result::ERROR_DEVICE_LOST => {
            ". The driver reset the device; restart the viewer, and report the scene if it happens again"
        }
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY => {
            ". Close other programs, or choose a lower precision or a smaller scene"
        }
        _ => "",
    }
}

/// Names the call that failed.
pub trait During<T> {
    /// What a Vulkan command of this name came to.
    ///
    /// # Errors
    /// [`GpuError::Call`] of it.
    fn during(self, call: &'static str) -> Result<T, GpuError>;
}

impl<T> During<T> for Result<T, vk::Result> {
    fn during(self, call: &'static str) -> Result<T, GpuError> {
        self.map_err(|result| GpuError::Call { call, result })
    }
}
