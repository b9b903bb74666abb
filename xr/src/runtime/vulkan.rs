//! Instance and device by way of the runtime (`XR_KHR_vulkan_enable2`).

use super::Runtime;
use crate::XrError;
use crate::error::During;
use ash::vk::{self, Handle as _};
use motes_renderer::gpu::{Bootstrap, Gpu, GpuError, GpuOptions};
use openxr as xr;
use std::ffi::CString;
use std::sync::Arc;

/// The Vulkan that Motes uses, as [`Gpu`] asks for it.
const VULKAN: xr::Version = xr::Version::new(1, 1, 0);

impl Runtime {
    /// Creates the device that the runtime wants.
    ///
    /// # Errors
    /// The runtime's or the driver's.
    pub(super) fn gpu(&self) -> Result<Arc<Gpu>, XrError> {
        let range = self
            .instance
            .graphics_requirements::<xr::Vulkan>(self.system)
            .during("xrGetVulkanGraphicsRequirements2KHR")?;
        if VULKAN < range.min_api_version_supported {
            return Err(XrError::Missing {
                runtime: self.name.clone(),
                wanted: format!("Vulkan {VULKAN} (it wants {} or later)", range.min_api_version_supported),
                remedy: "Use an older version of the runtime, or report this",
            });
        }
        Ok(Gpu::new(&ByRuntime(self), &GpuOptions { validation: self.options.validation })?)
    }
}

struct ByRuntime<'a>(&'a Runtime);

impl ByRuntime<'_> {
    fn refused(call: &'static str) -> impl Fn(xr::sys::Result) -> GpuError {
        move |result| GpuError::NoDevice(format!("{call}: {result}"))
    }
}

/// The loader's entry point, in OpenXR's words.
fn entry_point(entry: &ash::Entry) -> xr::sys::platform::VkGetInstanceProcAddr {
    // SAFETY: both are vkGetInstanceProcAddr; the two crates name its types differently.
    unsafe {
        std::mem::transmute::<vk::PFN_vkGetInstanceProcAddr, xr::sys::platform::VkGetInstanceProcAddr>(
            entry.static_fn().get_instance_proc_addr,
        )
    }
}

impl Bootstrap for ByRuntime<'_> {
    // The runtime adds what it needs to both lists.
    fn instance_extensions(&self) -> Vec<CString> {
        Vec::new()
    }

    fn device_extensions(&self) -> Vec<CString> {
        Vec::new()
    }

    fn density_map(&self) -> bool {
        self.0.options.foveation && self.0.optional.foveation
    }

    fn create_instance(
        &self,
        entry: &ash::Entry,
        info: &vk::InstanceCreateInfo<'_>,
    ) -> Result<ash::Instance, GpuError> {
        let Runtime { instance, system, .. } = self.0;
        // SAFETY: `info` and all it points to live until the call returns; the handle is the loader's.
        unsafe {
            let raw = instance
                .create_vulkan_instance(*system, entry_point(entry), std::ptr::from_ref(info).cast())
                .map_err(Self::refused("xrCreateVulkanInstanceKHR"))?
                .map_err(|result| GpuError::Call {
                    call: "vkCreateInstance",
                    result: vk::Result::from_raw(result),
                })?;
            let raw = vk::Instance::from_raw(raw as u64);
            Ok(ash::Instance::load(entry.static_fn(), raw))
        }
    }

    fn choose(
        &self,
        _: &ash::Entry,
        instance: &ash::Instance,
    ) -> Result<(vk::PhysicalDevice, u32), GpuError> {
        let handle = instance.handle().as_raw() as xr::sys::platform::VkInstance;
        // SAFETY: the instance came from this runtime.
        let physical = unsafe { self.0.instance.vulkan_graphics_device(self.0.system, handle) }
            .map_err(Self::refused("xrGetVulkanGraphicsDevice2KHR"))?;
        let physical = vk::PhysicalDevice::from_raw(physical as u64);
        // SAFETY: the runtime names a device of this instance.
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
        let wanted = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
        families
            .iter()
            .position(|f| f.queue_flags.contains(wanted))
            .map(|family| (physical, family as u32))
            .ok_or_else(|| {
                GpuError::NoDevice("the headset's device has no queue for graphics and compute".into())
            })
    }

    fn create_device(
        &self,
        instance: &ash::Instance,
        physical: vk::PhysicalDevice,
        info: &vk::DeviceCreateInfo<'_>,
    ) -> Result<ash::Device, GpuError> {
        // SAFETY: loading the loader that the instance came from once more gives the same entry point.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| GpuError::NoVulkan(e.to_string()))?;
        let physical = physical.as_raw() as xr::sys::platform::VkPhysicalDevice;
        // SAFETY: `info` and all it points to live until the call returns.
        unsafe {
            let raw = self
                .0
                .instance
                .create_vulkan_device(
                    self.0.system,
                    entry_point(&entry),
                    physical,
                    std::ptr::from_ref(info).cast(),
                )
                .map_err(Self::refused("xrCreateVulkanDeviceKHR"))?
                .map_err(|result| GpuError::Call {
                    call: "vkCreateDevice",
                    result: vk::Result::from_raw(result),
                })?;
            Ok(ash::Device::load(instance.fp_v1_0(), vk::Device::from_raw(raw as u64)))
        }
    }
}
