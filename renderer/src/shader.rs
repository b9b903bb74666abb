//! Shader modules, and how specialisation constants are handed to them.

use crate::gpu::{During, Gpu, GpuError};
use ash::vk;
use motes_shaders::layout::Specialization;
use std::sync::Arc;

/// Values of specialisation constants; those that are left out keep the shader's own.
#[derive(Default)]
pub(crate) struct Constants {
    entries: Vec<vk::SpecializationMapEntry>,
    values: Vec<u32>,
}

impl Constants {
    /// What a pipeline's stages are given.
    pub fn info(&self) -> vk::SpecializationInfo<'_> {
        vk::SpecializationInfo::default().map_entries(&self.entries).data(bytemuck::cast_slice(&self.values))
    }
}

/// Of `constant_id`s and the bits of their values.
impl FromIterator<(u32, u32)> for Constants {
    fn from_iter<T: IntoIterator<Item = (u32, u32)>>(constants: T) -> Self {
        let mut made = Self::default();
        for (constant_id, value) in constants {
            let offset = 4 * made.values.len() as u32;
            made.entries.push(vk::SpecializationMapEntry { constant_id, offset, size: 4 });
            made.values.push(value);
        }
        made
    }
}

/// A [`Specialization`]'s fields are the constants 0 and up.
impl From<&Specialization> for Constants {
    fn from(specialization: &Specialization) -> Self {
        let values: &[u32] = bytemuck::cast_slice(std::slice::from_ref(specialization));
        (0..).zip(values.iter().copied()).collect()
    }
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
        let raw = unsafe { gpu.device().create_shader_module(&info, None) }.during("vkCreateShaderModule")?;
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
