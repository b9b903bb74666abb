//! A device's own truth, as a file: driver, limits, features, extensions, which fall-back each missing one causes, and
//! how all of that compares with what Motes takes for granted of a headset.

use std::collections::BTreeMap;
use std::ffi::CStr;

use ash::vk;
use serde::{Deserialize, Serialize};

use super::{Capabilities, Gpu};
use crate::passes::STORAGE_BUFFERS;

/// What a device offers. Read back by `motes device FILE`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// Motes' version.
    pub version: String,
    /// Operating system and architecture.
    pub system: String,
    /// What Motes asks of a device.
    pub capabilities: Capabilities,
    /// Limits by their names in Vulkan.
    pub limits: BTreeMap<String, f64>,
    /// Features by their names in Vulkan.
    pub features: BTreeMap<String, bool>,
    /// Bytes of each memory heap, and whether it is the device's own.
    pub heaps: Vec<(u64, bool)>,
    /// Device extensions.
    pub extensions: Vec<String>,
    /// A line for everything that is missing and what follows from it: the device's, and the headset's.
    pub fallbacks: Vec<String>,
    /// What is known of the headset, line by line; empty without one.
    pub headset: Vec<String>,
}

/// A line of the profile: what Motes takes for granted of a headset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What.
    pub what: &'static str,
    /// What the profile says.
    pub expected: String,
    /// What the device says.
    pub found: String,
    /// Whether the device offers as much.
    pub holds: bool,
    /// What follows where it does not.
    pub otherwise: &'static str,
    /// Whether Motes cannot do without.
    pub required: bool,
}

macro_rules! limits {
    ($limits:expr, $($field:ident $name:literal),* $(,)?) => {
        BTreeMap::from([$(($name.to_owned(), $limits.$field as f64)),*])
    };
}

macro_rules! features {
    ($features:expr, $($field:ident $name:literal),* $(,)?) => {
        [$(($name.to_owned(), $features.$field == vk::TRUE)),*]
    };
}

impl DeviceReport {
    /// Asks the device.
    pub fn of(gpu: &Gpu) -> Self {
        let (instance, physical) = (gpu.instance(), gpu.physical());
        // SAFETY: `physical` belongs to the instance, which is alive.
        let (properties, memory) = unsafe {
            (
                instance.get_physical_device_properties(physical),
                instance.get_physical_device_memory_properties(physical),
            )
        };
        let l = properties.limits;
        let mut limits = limits!(
            l,
            max_image_dimension2_d "maxImageDimension2D",
            max_image_array_layers "maxImageArrayLayers",
            max_uniform_buffer_range "maxUniformBufferRange",
            max_storage_buffer_range "maxStorageBufferRange",
            max_push_constants_size "maxPushConstantsSize",
            max_memory_allocation_count "maxMemoryAllocationCount",
            max_bound_descriptor_sets "maxBoundDescriptorSets",
            max_per_stage_descriptor_storage_buffers "maxPerStageDescriptorStorageBuffers",
            max_per_stage_resources "maxPerStageResources",
            max_descriptor_set_storage_buffers "maxDescriptorSetStorageBuffers",
            max_vertex_output_components "maxVertexOutputComponents",
            max_fragment_input_components "maxFragmentInputComponents",
            max_compute_shared_memory_size "maxComputeSharedMemorySize",
            max_compute_work_group_invocations "maxComputeWorkGroupInvocations",
            max_draw_indirect_count "maxDrawIndirectCount",
            max_framebuffer_width "maxFramebufferWidth",
            max_framebuffer_height "maxFramebufferHeight",
            max_color_attachments "maxColorAttachments",
            min_storage_buffer_offset_alignment "minStorageBufferOffsetAlignment",
            non_coherent_atom_size "nonCoherentAtomSize",
            timestamp_period "timestampPeriod",
        );
        for (axis, count) in ["X", "Y", "Z"].iter().zip(l.max_compute_work_group_count) {
            limits.insert(format!("maxComputeWorkGroupCount{axis}"), count.into());
        }
        let mut multiview = vk::PhysicalDeviceMultiviewFeatures::default();
        let mut storage16 = vk::PhysicalDevice16BitStorageFeatures::default();
        let mut all =
            vk::PhysicalDeviceFeatures2::default().push_next(&mut multiview).push_next(&mut storage16);
        // SAFETY: the chain holds structures of version 1.1, which every device of ours has.
        unsafe { instance.get_physical_device_features2(physical, &mut all) };
        let plain = all.features;
        let mut features = BTreeMap::from(features!(
            plain,
            geometry_shader "geometryShader",
            independent_blend "independentBlend",
            multi_draw_indirect "multiDrawIndirect",
            draw_indirect_first_instance "drawIndirectFirstInstance",
            pipeline_statistics_query "pipelineStatisticsQuery",
            vertex_pipeline_stores_and_atomics "vertexPipelineStoresAndAtomics",
            fragment_stores_and_atomics "fragmentStoresAndAtomics",
            shader_int16 "shaderInt16",
            shader_int64 "shaderInt64",
            shader_float64 "shaderFloat64",
            robust_buffer_access "robustBufferAccess",
            sample_rate_shading "sampleRateShading",
        ));
        features.extend(features!(
            multiview,
            multiview "multiview",
            multiview_geometry_shader "multiviewGeometryShader",
        ));
        features.extend(features!(
            storage16,
            storage_buffer16_bit_access "storageBuffer16BitAccess",
            uniform_and_storage_buffer16_bit_access "uniformAndStorageBuffer16BitAccess",
            storage_push_constant16 "storagePushConstant16",
            storage_input_output16 "storageInputOutput16",
        ));
        features.insert("shaderFloat16".to_owned(), gpu.capabilities.shader_float16);
        let heaps = memory.memory_heaps_as_slice().iter();
        let own = vk::MemoryHeapFlags::DEVICE_LOCAL;
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            capabilities: gpu.capabilities.clone(),
            limits,
            features,
            heaps: heaps.map(|h| (h.size, h.flags.contains(own))).collect(),
            // SAFETY: as above.
            extensions: unsafe { instance.enumerate_device_extension_properties(physical) }
                .unwrap_or_default()
                .iter()
                .filter_map(|e| e.extension_name_as_c_str().ok().map(CStr::to_string_lossy))
                .map(|name| name.into_owned())
                .collect(),
            fallbacks: gpu.capabilities.fallbacks().into_iter().map(str::to_owned).collect(),
            headset: Vec::new(),
        }
    }

    fn limit(&self, name: &str) -> f64 {
        self.limits.get(name).copied().unwrap_or(0.0)
    }

    /// Compares the device with the profile: what an Adreno 740 offers with Qualcomm's driver or Mesa's.
    pub fn against_profile(&self) -> Vec<Finding> {
        let c = &self.capabilities;
        let mut findings = Vec::new();
        let mut add = |what, expected: String, found: String, holds, required, otherwise| {
            findings.push(Finding { what, expected, found, holds, otherwise, required });
        };
        let version: Vec<u32> = c.api.split('.').map(|part| part.parse().unwrap_or(0)).collect();
        add(
            "Vulkan",
            "1.1 at least".into(),
            c.api.clone(),
            version.as_slice() >= [1, 1].as_slice(),
            true,
            "Motes does not run",
        );
        let mut switch = |what, there: bool, otherwise| {
            let found = if there { "yes" } else { "no" };
            add(what, "yes".into(), found.into(), there, false, otherwise);
        };
        switch("multiview", c.multiview, "stereo takes two passes");
        switch("half-float arithmetic", c.shader_float16, "the naive half-float experiment is not offered");
        switch("16-bit storage buffers", c.storage_16bit, "nothing: halves are unpacked from 32-bit words");
        switch("pipeline statistics", c.pipeline_statistics, "fragments and vertices are not counted");
        switch("timestamps", c.timestamp_period > 0.0, "device times are not shown");
        switch("independent blending", c.independent_blend, "layers per pixel are not shown");
        let mut least = |what, least: f64, found: f64, required, otherwise| {
            add(what, format!("{least} at least"), found.to_string(), found >= least, required, otherwise);
        };
        least(
            "bytes of a storage-buffer binding",
            f64::from(128 << 20),
            c.max_storage_range as f64,
            false,
            "large scenes need more bindings, and the largest do not fit",
        );
        least(
            "storage buffers of a stage",
            STORAGE_BUFFERS.into(),
            self.limit("maxPerStageDescriptorStorageBuffers"),
            true,
            "pipelines cannot be made",
        );
        least("descriptor sets", 4.0, self.limit("maxBoundDescriptorSets"), true, "pipelines cannot be made");
        least(
            "bytes of push constants",
            48.0,
            self.limit("maxPushConstantsSize"),
            true,
            "pipelines cannot be made",
        );
        least(
            "invocations of a workgroup",
            256.0,
            self.limit("maxComputeWorkGroupInvocations"),
            true,
            "the sort on the device cannot be made",
        );
        least(
            "bytes shared by a workgroup",
            16384.0,
            self.limit("maxComputeSharedMemorySize"),
            true,
            "the sort on the device cannot be made",
        );
        least("side of an image", 4096.0, c.max_image_side.into(), false, "the resolution is limited");
        add(
            "subgroup size",
            "any (64 or 128 on Adreno)".into(),
            c.subgroup_size.to_string(),
            true,
            false,
            "nothing: no shader assumes one",
        );
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> DeviceReport {
        DeviceReport {
            version: "1".into(),
            system: "android aarch64".into(),
            capabilities: Capabilities {
                device: "Adreno".into(),
                driver: "1".into(),
                api: "1.3.128".into(),
                multiview: true,
                geometry_shader: true,
                independent_blend: true,
                pipeline_statistics: true,
                timestamp_period: 52.08,
                shader_float16: true,
                storage_16bit: true,
                blend_rgba32f: true,
                density_map: true,
                subgroup_size: 64,
                subgroup_shuffle: true,
                max_storage_range: 1 << 27,
                max_image_side: 16384,
                software: false,
            },
            limits: BTreeMap::from([
                ("maxPerStageDescriptorStorageBuffers".to_owned(), 24.0),
                ("maxBoundDescriptorSets".to_owned(), 4.0),
                ("maxPushConstantsSize".to_owned(), 256.0),
                ("maxComputeWorkGroupInvocations".to_owned(), 1024.0),
                ("maxComputeSharedMemorySize".to_owned(), 32768.0),
            ]),
            features: BTreeMap::new(),
            heaps: vec![(1 << 32, true)],
            extensions: vec!["VK_KHR_multiview".into()],
            fallbacks: Vec::new(),
            headset: Vec::new(),
        }
    }

    #[test]
    fn a_headset_fits_the_profile_and_less_is_named() {
        let good = report();
        let text = serde_json::to_string(&good).unwrap_or_default();
        let again: Option<DeviceReport> = serde_json::from_str(&text).ok();
        assert_eq!(again.as_ref(), Some(&good));
        assert!(good.against_profile().iter().all(|f| f.holds), "{:?}", good.against_profile());
        let mut less = report();
        less.capabilities.multiview = false;
        less.capabilities.api = "1.0.9".into();
        less.limits.remove("maxPerStageDescriptorStorageBuffers");
        let missing: Vec<_> =
            less.against_profile().iter().filter(|f| !f.holds).map(|f| (f.what, f.required)).collect();
        assert_eq!(missing, [("Vulkan", true), ("multiview", false), ("storage buffers of a stage", true)]);
    }
}
