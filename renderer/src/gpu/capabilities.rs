//! What a device offers, read once, so that every fall-back has one place and one line in the log.

use ash::vk;
use std::ffi::CStr;

/// What the chosen device offers beyond the least that Motes needs.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Capabilities {
    /// The device's name.
    pub device: String,
    /// The driver's name and version, as it states them.
    pub driver: String,
    /// Vulkan version `major.minor.patch`.
    pub api: String,
    /// Two views in one pass.
    pub multiview: bool,
    /// A geometry stage.
    pub geometry_shader: bool,
    /// Attachments of one pass that blend differently (to count layers).
    pub independent_blend: bool,
    /// Counts of invocations per pass.
    pub pipeline_statistics: bool,
    /// Device timestamps: nanoseconds per tick, 0 where there are none.
    pub timestamp_period: f32,
    /// Half-float arithmetic in shaders.
    pub shader_float16: bool,
    /// 16-bit values in storage buffers.
    pub storage_16bit: bool,
    /// 32-bit float images that can be blended.
    pub blend_rgba32f: bool,
    /// Fragment density maps (`VK_EXT_fragment_density_map`) that go with plain images: foveation.
    #[serde(default)]
    pub density_map: bool,
    /// Subgroup size.
    pub subgroup_size: u32,
    /// Compute stages exchange values within subgroups of 8 invocations and more: splats by tiles.
    #[serde(default)]
    pub subgroup_shuffle: bool,
    /// Bytes of one storage-buffer binding.
    pub max_storage_range: u64,
    /// Side of the largest image.
    pub max_image_side: u32,
    /// Whether the device renders on the processor.
    pub software: bool,
}

impl Capabilities {
    /// Asks the device.
    pub(crate) fn read(instance: &ash::Instance, physical: vk::PhysicalDevice, queue_family: u32) -> Self {
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        // SAFETY: `physical` belongs to `instance`. Properties of version 1.0 say whether the driver structure is known.
        let basic = unsafe { instance.get_physical_device_properties(physical) };
        let has_driver = basic.api_version >= vk::API_VERSION_1_2;
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut subgroup);
        if has_driver {
            properties = properties.push_next(&mut driver);
        }
        // SAFETY: the chain holds structures of the device's version.
        unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
        let limits = properties.properties.limits;

        let mut multiview = vk::PhysicalDeviceMultiviewFeatures::default();
        let mut storage16 = vk::PhysicalDevice16BitStorageFeatures::default();
        let mut float16 = vk::PhysicalDeviceShaderFloat16Int8Features::default();
        let mut features =
            vk::PhysicalDeviceFeatures2::default().push_next(&mut multiview).push_next(&mut storage16);
        if has_driver {
            features = features.push_next(&mut float16);
        }
        // SAFETY: as above.
        unsafe { instance.get_physical_device_features2(physical, &mut features) };
        let plain = features.features;
        let density_map = has_extension(instance, physical, ash::ext::fragment_density_map::NAME) && {
            let mut density = vk::PhysicalDeviceFragmentDensityMapFeaturesEXT::default();
            let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut density);
            // SAFETY: as above; the device knows the extension.
            unsafe { instance.get_physical_device_features2(physical, &mut features) };
            density.fragment_density_map == vk::TRUE
                && density.fragment_density_map_non_subsampled_images == vk::TRUE
        };
        // SAFETY: as above.
        let float32 = unsafe {
            instance.get_physical_device_format_properties(physical, vk::Format::R32G32B32A32_SFLOAT)
        };
        let blended = vk::FormatFeatureFlags::COLOR_ATTACHMENT_BLEND;
        // SAFETY: as above.
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
        let timestamps = families.get(queue_family as usize).is_some_and(|f| f.timestamp_valid_bits > 0);

        let text = |s: &CStr| s.to_string_lossy().into_owned();
        let version = |v: u32| {
            format!("{}.{}.{}", vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v))
        };
        let driver_text = match (driver.driver_name_as_c_str(), driver.driver_info_as_c_str()) {
            (Ok(name), Ok(info)) if has_driver => format!("{} {}", text(name), text(info)),
            _ => version(basic.driver_version),
        };
        Self {
            device: basic.device_name_as_c_str().map(text).unwrap_or_else(|_| "unnamed device".to_owned()),
            driver: driver_text,
            api: version(basic.api_version),
            multiview: multiview.multiview == vk::TRUE,
            geometry_shader: plain.geometry_shader == vk::TRUE,
            independent_blend: plain.independent_blend == vk::TRUE,
            pipeline_statistics: plain.pipeline_statistics_query == vk::TRUE,
            timestamp_period: if timestamps { limits.timestamp_period } else { 0.0 },
            shader_float16: float16.shader_float16 == vk::TRUE,
            storage_16bit: storage16.storage_buffer16_bit_access == vk::TRUE,
            blend_rgba32f: float32.optimal_tiling_features.contains(blended),
            density_map,
            subgroup_size: subgroup.subgroup_size,
            subgroup_shuffle: subgroup.subgroup_size >= motes_shaders::layout::TILE_LANES
                && subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE)
                && subgroup.supported_operations.contains(
                    vk::SubgroupFeatureFlags::BASIC
                        | vk::SubgroupFeatureFlags::VOTE
                        | vk::SubgroupFeatureFlags::SHUFFLE,
                ),
            max_storage_range: u64::from(limits.max_storage_buffer_range),
            max_image_side: limits
                .max_image_dimension2_d
                .min(limits.max_framebuffer_width)
                .min(limits.max_framebuffer_height),
            software: basic.device_type == vk::PhysicalDeviceType::CPU,
        }
    }

    /// One line for every offer that is missing and what follows from it.
    pub fn fallbacks(&self) -> Vec<&'static str> {
        let mut lines = Vec::new();
        let mut check = |there: bool, line| {
            if !there {
                lines.push(line);
            }
        };
        check(self.multiview, "no multiview: stereo takes two passes");
        check(self.geometry_shader, "no geometry stage: the geometry expansion is not offered");
        check(self.independent_blend, "no independent blending: layers per pixel are not shown");
        check(self.pipeline_statistics, "no pipeline statistics: fragment and vertex counts are not shown");
        check(self.timestamp_period > 0.0, "no timestamps: device times are not shown");
        check(
            self.shader_float16,
            "no half-float arithmetic: the naive half-float experiment is not offered",
        );
        lines
    }
}

fn has_extension(instance: &ash::Instance, physical: vk::PhysicalDevice, name: &CStr) -> bool {
    // SAFETY: `physical` belongs to `instance`.
    let offered = unsafe { instance.enumerate_device_extension_properties(physical) }.unwrap_or_default();
    offered.iter().any(|e| e.extension_name_as_c_str() == Ok(name))
}
