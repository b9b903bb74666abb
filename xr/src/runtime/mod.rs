//! A real OpenXR runtime: instance, system, extensions.

mod actions;
mod depth;
mod extensions;
mod foveation;
mod hands;
mod messages;
mod session;
mod spaces;
mod surfaces;
mod surroundings;
mod swapchain;
mod vulkan;

pub use extensions::Optional;
pub use session::{RuntimeHeadset, SessionOptions};

use crate::XrError;
use crate::error::During;
use messages::Messages;
use openxr as xr;
use openxr::sys;

/// The layer that checks our calls against the specification.
const CORE_VALIDATION: &str = "XR_APILAYER_LUNARG_core_validation";

/// Two eyes.
const STEREO: xr::ViewConfigurationType = xr::ViewConfigurationType::PRIMARY_STEREO;

/// How a runtime is used.
#[derive(Clone, Copy, Debug, Default)]
pub struct RuntimeOptions {
    /// Turns on OpenXR's core-validation layer and Vulkan's. Both must be installed.
    pub validation: bool,
    /// Lets the eyes' images be copied, for screenshots and tests.
    pub readable: bool,
    /// Tells the compositor how far away pixels are, where it wants to know: what it shows between two frames then follows
    /// the head's steps too, not its turns alone. Costs a fragment a pixel and batch.
    pub depth_layer: bool,
    /// Draws the rims of the images more coarsely than their middle where the governor has to save, and where runtime and
    /// device offer that. Not by default: no device has run it yet.
    pub foveation: bool,
}

/// What a loader needs to know of its system: on Android the virtual machine and the activity, elsewhere nothing.
#[cfg(target_os = "android")]
pub type Platform = xr::AndroidPlatformInfo;
/// What a loader needs to know of its system: on Android the virtual machine and the activity, elsewhere nothing.
#[cfg(not(target_os = "android"))]
pub type Platform = ();

/// A running OpenXR runtime with a headset.
pub struct Runtime {
    // Before the instance: it is told through it.
    messages: Option<Messages>,
    instance: xr::Instance,
    system: xr::SystemId,
    name: String,
    description: String,
    optional: Optional,
    options: RuntimeOptions,
}

impl Runtime {
    /// Finds the active runtime and its headset.
    ///
    /// # Errors
    /// No loader, no runtime, a runtime that does not run, no headset; each says what to do.
    pub fn new(platform: &Platform, options: RuntimeOptions) -> Result<Self, XrError> {
        // SAFETY: the loader in the system's search path is OpenXR's.
        let entry = unsafe { xr::Entry::load(platform) }.map_err(|e| match e {
            xr::EntryError::Load(e) => XrError::NoLoader(e.to_string()),
            xr::EntryError::Xr(result) => XrError::NoLoader(result.to_string()),
        })?;
        let absent = |call: &'static str| {
            move |result: sys::Result| match result {
                sys::Result::ERROR_RUNTIME_UNAVAILABLE => XrError::NoRuntime,
                sys::Result::ERROR_RUNTIME_FAILURE => XrError::NotRunning { call, result },
                _ => XrError::Call { call, result },
            }
        };
        let offered =
            entry.enumerate_extensions().map_err(absent("xrEnumerateInstanceExtensionProperties"))?;
        if !offered.khr_vulkan_enable2 {
            return Err(XrError::Missing {
                runtime: "the active one".into(),
                wanted: "XR_KHR_vulkan_enable2".into(),
                remedy: "Update the headset's software",
            });
        }
        let (mut wanted, optional) = Optional::choose(&offered, &options);
        wanted.khr_vulkan_enable2 = true;
        wanted.ext_debug_utils = options.validation && offered.ext_debug_utils;
        #[cfg(target_os = "android")]
        {
            wanted.khr_android_create_instance = true;
        }
        let layers: &[&str] = if options.validation { &[CORE_VALIDATION] } else { &[] };
        let application = xr::ApplicationInfo {
            application_name: "Motes",
            application_version: 1,
            engine_name: "Motes",
            engine_version: 1,
            api_version: xr::Version::new(1, 0, 0),
        };
        let instance = entry.create_instance(&application, &wanted, layers, platform).map_err(|result| {
            if result == sys::Result::ERROR_API_LAYER_NOT_PRESENT {
                XrError::Missing {
                    runtime: "the loader".into(),
                    wanted: format!("the layer {CORE_VALIDATION}"),
                    remedy: "Install openxr-layer-corevalidation, or run without validation",
                }
            } else {
                absent("xrCreateInstance")(result)
            }
        })?;
        let messages = if options.validation { Some(Messages::new(&instance)?) } else { None };
        let properties = instance.properties().during("xrGetInstanceProperties")?;
        let name = format!("{} {}", properties.runtime_name, properties.runtime_version);
        log::info!("OpenXR runtime: {name}");
        let system =
            instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).map_err(|result| match result {
                sys::Result::ERROR_FORM_FACTOR_UNAVAILABLE | sys::Result::ERROR_FORM_FACTOR_UNSUPPORTED => {
                    XrError::NoHeadset { runtime: name.clone(), result }
                }
                _ => XrError::Call { call: "xrGetSystem", result },
            })?;
        // Not every headset of a runtime that knows joints has cameras for them.
        let mut optional = optional;
        if optional.hand_tracking {
            optional.hand_tracking =
                instance.supports_hand_tracking(system).during("xrGetSystemProperties")?;
        }
        let headset = instance.system_properties(system).during("xrGetSystemProperties")?;
        let views = instance
            .enumerate_view_configuration_views(system, STEREO)
            .during("xrEnumerateViewConfigurationViews")?;
        let [left, _] = views[..] else {
            return Err(XrError::Missing {
                runtime: name,
                wanted: "two views".into(),
                remedy: "Motes shows stereo only",
            });
        };
        let description = format!(
            "{} on {name}: {} x {} pixels an eye recommended, at most {} x {}; position tracking: {}",
            headset.system_name,
            left.recommended_image_rect_width,
            left.recommended_image_rect_height,
            left.max_image_rect_width,
            left.max_image_rect_height,
            if headset.tracking_properties.position_tracking { "yes" } else { "no" },
        );
        log::info!("headset: {description}");
        log::info!("OpenXR extensions in use: {}", extensions::names(&wanted));
        for line in optional.fallbacks() {
            log::info!("{line}");
        }
        Ok(Self { messages, instance, system, name, description, optional, options })
    }

    /// The runtime's name and version.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The headset, its runtime and its images, one line.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Which optional extensions are in use.
    pub fn optional(&self) -> &Optional {
        &self.optional
    }

    /// What the core-validation layer has said so far. Tests demand that it is empty.
    pub fn messages(&self) -> Vec<String> {
        self.messages.as_ref().map(Messages::list).unwrap_or_default()
    }

    /// The size of an eye's image that the runtime recommends, times a scale, even and within the runtime's limits.
    fn image_size(&self, scale: f32) -> Result<[u32; 2], XrError> {
        let views = self
            .instance
            .enumerate_view_configuration_views(self.system, STEREO)
            .during("xrEnumerateViewConfigurationViews")?;
        let scaled = |recommended: u32, most: u32| {
            let wanted = (f64::from(recommended) * f64::from(scale) / 2.0).round() as u32 * 2;
            wanted.clamp(2, most.max(2))
        };
        // One array image holds both eyes: the larger of both counts.
        let width = views.iter().map(|v| scaled(v.recommended_image_rect_width, v.max_image_rect_width));
        let height = views.iter().map(|v| scaled(v.recommended_image_rect_height, v.max_image_rect_height));
        Ok([width.max().unwrap_or(2), height.max().unwrap_or(2)])
    }
}
