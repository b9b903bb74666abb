//! Shader modules, and how specialisation constants are handed to them.

use crate::gpu::{Gpu, GpuError};
use ash::vk;
use motes_shaders::layout::Specialization;
use std::sync::Arc;

/// Where each constant is found in a [`Specialization`].
pub(crate) fn specialization_entries() -> Vec<vk::SpecializationMapEntry> {
    (0..(size_of::<Specialization>() / 4) as u32)
        .map(|i| vk::SpecializationMapEntry { constant_id: i, offset: 4 * i, size: 4 })
        .collect()
}

/// A shader module that lives while a pipeline is made.
pub(crate) struct Module {
    gpu: Arc<Gpu>,
    raw: vk::ShaderModule,
}

impl Module {
    pub fn new(gpu: &Arc<Gpu>, code: &[u32]) -> Result<Self, GpuError> {
        let info = vk::ShaderModuleCreateInfo::default().code(code);
        // SAFETY: the code is SPIR-V, compiled at build time.
        let made = unsafe { gpu.device().create_shader_module(&info, None) };
        let raw = made.map_err(|result| GpuError::Call { call: "vkCreateShaderModule", result })?;
        Ok(Self { gpu: gpu.clone(), raw })
    }

    pub fn stage(&self, stage: vk::ShaderStageFlags) -> vk::PipelineShaderStageCreateInfo<'static> {
        vk::PipelineShaderStageCreateInfo::default().stage(stage).module(self.raw).name(c"main")
    }
}

impl Drop for Module {
    fn drop(&mut self) {
        // SAFETY: pipelines keep what they need of a module.
        unsafe { self.gpu.device().destroy_shader_module(self.raw, None) };
    }
}
