//! Instance, device, queue and allocator, created once and shared.

use super::error::During;
use super::{Capabilities, GpuError};
use ash::vk;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use std::ffi::{CStr, CString, c_void};
use std::mem::ManuallyDrop;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How instance and device come to be: plainly, or by way of an OpenXR runtime that insists on creating them.
pub trait Bootstrap {
    /// Instance extensions that this way needs.
    fn instance_extensions(&self) -> Vec<CString>;
    /// Device extensions that this way needs.
    fn device_extensions(&self) -> Vec<CString>;
    /// Creates the instance.
    ///
    /// # Errors
    /// The driver's or runtime's.
    fn create_instance(
        &self,
        entry: &ash::Entry,
        info: &vk::InstanceCreateInfo<'_>,
    ) -> Result<ash::Instance, GpuError>;
    /// Chooses the device and the queue family.
    ///
    /// # Errors
    /// No device fits.
    fn choose(
        &self,
        entry: &ash::Entry,
        instance: &ash::Instance,
    ) -> Result<(vk::PhysicalDevice, u32), GpuError>;
    /// Creates the device.
    ///
    /// # Errors
    /// The driver's or runtime's.
    fn create_device(
        &self,
        instance: &ash::Instance,
        physical: vk::PhysicalDevice,
        info: &vk::DeviceCreateInfo<'_>,
    ) -> Result<ash::Device, GpuError>;
    /// Whether fragment density maps are turned on where the device offers them.
    fn density_map(&self) -> bool {
        false
    }
    /// Takes away from what the device offers, before it is created: a fault of a driver to be avoided, or a lesser
    /// device to be tried on a better one. Nothing may be added.
    fn restrict(&self, _: &mut Capabilities) {}
}

/// Which device, and how closely it is watched.
#[derive(Clone, Debug, Default)]
pub struct GpuOptions {
    /// Turns on the validation layer with synchronisation validation. It must be installed. Where the environment says
    /// `MOTES_VALIDATION=gpu-assisted`, the layer instruments the shaders instead: slow, and it sees what they read and write.
    pub validation: bool,
}

/// The plain way: the loader's own devices, discrete before integrated before software.
#[derive(Clone, Debug, Default)]
pub struct Plain {
    /// Instance extensions for a window surface; empty offscreen.
    pub surface_extensions: Vec<CString>,
    /// Part of a device's name that must match.
    pub device: Option<String>,
}

impl Bootstrap for Plain {
    fn instance_extensions(&self) -> Vec<CString> {
        self.surface_extensions.clone()
    }

    fn device_extensions(&self) -> Vec<CString> {
        if self.surface_extensions.is_empty() {
            Vec::new()
        } else {
            vec![ash::khr::swapchain::NAME.to_owned()]
        }
    }

    fn create_instance(
        &self,
        entry: &ash::Entry,
        info: &vk::InstanceCreateInfo<'_>,
    ) -> Result<ash::Instance, GpuError> {
        // SAFETY: `info` and all it points to live until the call returns.
        match unsafe { entry.create_instance(info, None) } {
            Err(vk::Result::ERROR_LAYER_NOT_PRESENT) => Err(GpuError::NoDevice(
                "the validation layer is not installed (package vulkan-validationlayers); run without validation".into(),
            )),
            Err(vk::Result::ERROR_INCOMPATIBLE_DRIVER) => {
                Err(GpuError::NoDevice("no driver is installed; on a machine without a graphics card: mesa-vulkan-drivers".into()))
            }
            other => other.during("vkCreateInstance"),
        }
    }

    fn choose(
        &self,
        _: &ash::Entry,
        instance: &ash::Instance,
    ) -> Result<(vk::PhysicalDevice, u32), GpuError> {
        // SAFETY: the instance is alive.
        let devices =
            unsafe { instance.enumerate_physical_devices() }.during("vkEnumeratePhysicalDevices")?;
        let mut rejected = Vec::new();
        let mut best: Option<(u32, vk::PhysicalDevice, u32)> = None;
        for physical in devices {
            // SAFETY: `physical` belongs to the instance.
            let properties = unsafe { instance.get_physical_device_properties(physical) };
            let name = properties
                .device_name_as_c_str()
                .map(|n| n.to_string_lossy().into_owned())
                .unwrap_or_default();
            if let Some(wanted) = &self.device
                && !name.to_lowercase().contains(&wanted.to_lowercase())
            {
                rejected.push(format!("{name} is not '{wanted}'"));
                continue;
            }
            if properties.api_version < vk::API_VERSION_1_1 {
                rejected.push(format!("{name} offers Vulkan 1.0 only"));
                continue;
            }
            // SAFETY: as above.
            let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
            let wanted = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
            let Some(family) = families.iter().position(|f| f.queue_flags.contains(wanted)) else {
                rejected.push(format!("{name} has no queue for graphics and compute"));
                continue;
            };
            let rank = match properties.device_type {
                vk::PhysicalDeviceType::DISCRETE_GPU => 4,
                vk::PhysicalDeviceType::INTEGRATED_GPU => 3,
                vk::PhysicalDeviceType::VIRTUAL_GPU => 2,
                _ => 1,
            };
            if best.is_none_or(|(r, ..)| rank > r) {
                best = Some((rank, physical, family as u32));
            }
        }
        best.map(|(_, physical, family)| (physical, family)).ok_or_else(|| {
            GpuError::NoDevice(if rejected.is_empty() {
                "the driver lists none".into()
            } else {
                rejected.join("; ")
            })
        })
    }

    fn create_device(
        &self,
        instance: &ash::Instance,
        physical: vk::PhysicalDevice,
        info: &vk::DeviceCreateInfo<'_>,
    ) -> Result<ash::Device, GpuError> {
        // SAFETY: `info` and all it points to live until the call returns.
        unsafe { instance.create_device(physical, info, None) }.during("vkCreateDevice")
    }
}

/// Instance, device, queue and allocator. Everything made with it holds an `Arc` of it.
pub struct Gpu {
    /// What the device offers.
    pub capabilities: Capabilities,
    queue_family: u32,
    queue: Mutex<vk::Queue>,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    physical: vk::PhysicalDevice,
    device: ash::Device,
    debug: Option<(ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    names: Option<ash::ext::debug_utils::Device>,
    messages: Arc<Mutex<Vec<String>>>,
    instance: ash::Instance,
    entry: ash::Entry,
}

impl Gpu {
    /// Loads Vulkan and creates a device for offscreen use.
    ///
    /// # Errors
    /// No loader, no driver, no device.
    pub fn offscreen(options: &GpuOptions) -> Result<Arc<Self>, GpuError> {
        Self::new(&Plain::default(), options)
    }

    /// Loads Vulkan and creates a device in the given way.
    ///
    /// # Errors
    /// No loader, no driver, no device, or the runtime's refusal.
    pub fn new(bootstrap: &dyn Bootstrap, options: &GpuOptions) -> Result<Arc<Self>, GpuError> {
        // SAFETY: loading the system's Vulkan loader runs its initialisers, which is what it is for.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| GpuError::NoVulkan(e.to_string()))?;
        let messages = Arc::new(Mutex::new(Vec::new()));
        let mut extensions = bootstrap.instance_extensions();
        // What the shaders do is watched instead of what the host does: both at once take longer than any test should.
        let assisted =
            options.validation && std::env::var_os("MOTES_VALIDATION").is_some_and(|v| v == "gpu-assisted");
        if options.validation {
            extensions.push(ash::ext::debug_utils::NAME.to_owned());
        }
        let extension_pointers: Vec<_> = extensions.iter().map(|e| e.as_ptr()).collect();
        let layers: Vec<_> =
            if options.validation { vec![c"VK_LAYER_KHRONOS_validation".as_ptr()] } else { Vec::new() };
        let application = vk::ApplicationInfo::default()
            .application_name(c"Motes")
            .engine_name(c"Motes")
            .api_version(vk::API_VERSION_1_1);
        let checks = [
            vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION,
            vk::ValidationFeatureEnableEXT::GPU_ASSISTED,
            vk::ValidationFeatureEnableEXT::GPU_ASSISTED_RESERVE_BINDING_SLOT,
        ];
        let (enabled, disabled) = if assisted {
            (&checks[1..], &[vk::ValidationFeatureDisableEXT::CORE_CHECKS][..])
        } else {
            (&checks[..1], &[][..])
        };
        let mut features = vk::ValidationFeaturesEXT::default()
            .enabled_validation_features(enabled)
            .disabled_validation_features(disabled);
        let mut messenger = messenger_info(&messages);
        let mut info = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_extension_names(&extension_pointers)
            .enabled_layer_names(&layers);
        if options.validation {
            info = info.push_next(&mut features).push_next(&mut messenger);
        }
        let instance = bootstrap.create_instance(&entry, &info)?;
        let debug = if options.validation {
            let loader = ash::ext::debug_utils::Instance::new(&entry, &instance);
            // SAFETY: the user data outlives the messenger: both are fields of the same structure.
            let messenger = unsafe { loader.create_debug_utils_messenger(&messenger_info(&messages), None) }
                .during("vkCreateDebugUtilsMessengerEXT")?;
            Some((loader, messenger))
        } else {
            None
        };

        let (physical, queue_family) = bootstrap.choose(&entry, &instance)?;
        let mut capabilities = Capabilities::read(&instance, physical, queue_family);
        capabilities.density_map &= bootstrap.density_map();
        bootstrap.restrict(&mut capabilities);
        let priorities = [1.0];
        let queues = [vk::DeviceQueueCreateInfo::default()
            .queue_family_index(queue_family)
            .queue_priorities(&priorities)];
        let mut device_extensions = bootstrap.device_extensions();
        if capabilities.density_map {
            device_extensions.push(ash::ext::fragment_density_map::NAME.to_owned());
        }
        let device_extension_pointers: Vec<_> = device_extensions.iter().map(|e| e.as_ptr()).collect();
        // Only what a Quest offers, and each only where it is there. Structures are chained one by one: an OpenXR
        // runtime adds its own, and a structure may be in a chain only once.
        let mut multiview = vk::PhysicalDeviceMultiviewFeatures::default().multiview(capabilities.multiview);
        let mut float16 = vk::PhysicalDeviceShaderFloat16Int8Features::default()
            .shader_float16(capabilities.shader_float16);
        let mut density = vk::PhysicalDeviceFragmentDensityMapFeaturesEXT::default()
            .fragment_density_map(true)
            .fragment_density_map_non_subsampled_images(true);
        let core = vk::PhysicalDeviceFeatures::default()
            .geometry_shader(capabilities.geometry_shader)
            .independent_blend(capabilities.independent_blend)
            .pipeline_statistics_query(capabilities.pipeline_statistics);
        let mut info = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&device_extension_pointers)
            .enabled_features(&core)
            .push_next(&mut multiview);
        if capabilities.shader_float16 {
            info = info.push_next(&mut float16);
        }
        if capabilities.density_map {
            info = info.push_next(&mut density);
        }
        let device = bootstrap.create_device(&instance, physical, &info)?;
        // SAFETY: the family was asked for with one queue.
        let queue = unsafe { device.get_device_queue(queue_family, 0) };
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.clone(),
            device: device.clone(),
            physical_device: physical,
            debug_settings: Default::default(),
            buffer_device_address: false,
            allocation_sizes: Default::default(),
        })
        .map_err(|e| GpuError::Memory {
            name: "the allocator".into(),
            bytes: 0,
            problem: e.to_string(),
        })?;
        log::info!("device: {} ({}), Vulkan {}", capabilities.device, capabilities.driver, capabilities.api);
        for line in capabilities.fallbacks() {
            log::info!("{line}");
        }
        let names = options.validation.then(|| ash::ext::debug_utils::Device::new(&instance, &device));
        Ok(Arc::new(Self {
            capabilities,
            queue_family,
            queue: Mutex::new(queue),
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            physical,
            device,
            debug,
            names,
            messages,
            instance,
            entry,
        }))
    }

    /// The Vulkan loader's entry points.
    pub fn entry(&self) -> &ash::Entry {
        &self.entry
    }

    /// The instance.
    pub fn instance(&self) -> &ash::Instance {
        &self.instance
    }

    /// The physical device.
    pub fn physical(&self) -> vk::PhysicalDevice {
        self.physical
    }

    /// The device.
    pub fn device(&self) -> &ash::Device {
        &self.device
    }

    /// The queue family of [`Gpu::queue`].
    pub fn queue_family(&self) -> u32 {
        self.queue_family
    }

    /// The one queue, locked: Vulkan wants submissions one at a time.
    pub fn queue(&self) -> MutexGuard<'_, vk::Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the validation layer has said so far. Tests demand that it is empty.
    pub fn messages(&self) -> Vec<String> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Waits until the device has done all it was given.
    ///
    /// # Errors
    /// The device was lost.
    pub fn wait_idle(&self) -> Result<(), GpuError> {
        let _queue = self.queue();
        // SAFETY: no other thread submits while the queue is locked.
        unsafe { self.device.device_wait_idle() }.during("vkDeviceWaitIdle")
    }

    /// Bytes of everything that is allocated on the device now.
    pub fn allocated_bytes(&self) -> u64 {
        self.allocator().generate_report().total_allocated_bytes
    }

    pub(crate) fn allocator(&self) -> MutexGuard<'_, Allocator> {
        self.allocator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives an object a name that validation messages and captures show.
    pub(crate) fn name<H: vk::Handle>(&self, handle: H, name: &str) {
        if let Some(loader) = &self.names
            && let Ok(name) = CString::new(name)
        {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&name);
            // SAFETY: the handle was made by this device. A name that is refused changes nothing.
            let _ = unsafe { loader.set_debug_utils_object_name(&info) };
        }
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        // SAFETY: everything made with the device held an `Arc` of it and is gone; the allocator goes before the device.
        unsafe {
            let _ = self.device.device_wait_idle();
            ManuallyDrop::drop(&mut self.allocator);
            self.device.destroy_device(None);
            if let Some((loader, messenger)) = self.debug.take() {
                loader.destroy_debug_utils_messenger(messenger, None);
            }
            self.instance.destroy_instance(None);
        }
    }
}

fn messenger_info(messages: &Arc<Mutex<Vec<String>>>) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(
            vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
        )
        .message_type(
            vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
        )
        .pfn_user_callback(Some(on_message))
        .user_data(Arc::as_ptr(messages).cast_mut().cast())
}

/// Keeps what the validation layer says.
unsafe extern "system" fn on_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes a valid structure with a terminated message, and `user` is the mutex that
    // `messenger_info` was given, alive as long as the instance.
    unsafe {
        if let (Some(data), Some(messages)) = (data.as_ref(), user.cast::<Mutex<Vec<String>>>().as_ref())
            && !data.p_message.is_null()
        {
            let text = CStr::from_ptr(data.p_message).to_string_lossy().into_owned();
            // What the layer says of itself: which features it turns on to instrument shaders.
            if text.contains("Internal Warning") {
                log::info!("validation: {text}");
                return vk::FALSE;
            }
            log::error!("validation: {text}");
            messages.lock().unwrap_or_else(PoisonError::into_inner).push(text);
        }
    }
    vk::FALSE
}
