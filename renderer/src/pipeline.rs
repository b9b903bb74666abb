//! Pipelines: what differs from one to the next. The rest is the same for all.

use crate::gpu::{During, Gpu, GpuError};
use crate::shader::{Constants, Module};
use ash::vk;
use std::sync::Arc;

/// What a graphics pipeline is made of.
pub(crate) struct GraphicsPipeline<'a> {
    /// SPIR-V of the stages.
    pub shaders: &'a [(vk::ShaderStageFlags, &'static [u32])],
    /// Every stage is given them, and takes those that it knows.
    pub constants: &'a Constants,
    /// What vertices are read from buffers; most are made of their index alone.
    pub input: vk::PipelineVertexInputStateCreateInfo<'a>,
    pub topology: vk::PrimitiveTopology,
    /// Without one, depth is neither tested nor written.
    pub depth: Option<Depth>,
    /// One a colour attachment of the subpass.
    pub blends: &'a [vk::PipelineColorBlendAttachmentState],
    pub layout: vk::PipelineLayout,
    pub pass: vk::RenderPass,
    pub subpass: u32,
}

/// The depth that lets a fragment through, compared with what is there, and whether it replaces that.
#[derive(Clone, Copy)]
pub(crate) struct Depth {
    pub compare: vk::CompareOp,
    pub write: bool,
}

impl GraphicsPipeline<'_> {
    /// Viewport and scissor are said while recording.
    pub fn make(&self, gpu: &Arc<Gpu>, cache: vk::PipelineCache) -> Result<vk::Pipeline, GpuError> {
        let modules = self.shaders.iter().map(|&(stage, code)| Ok((stage, Module::new(gpu, code)?)));
        let modules = modules.collect::<Result<Vec<_>, GpuError>>()?;
        let constants = self.constants.info();
        let stages: Vec<_> =
            modules.iter().map(|(at, module)| module.stage(*at).specialization_info(&constants)).collect();
        let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(self.topology);
        let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        // Never culled: a mirrored axis must not make a splat vanish.
        let raster = vk::PipelineRasterizationStateCreateInfo::default()
            .polygon_mode(vk::PolygonMode::FILL)
            .cull_mode(vk::CullModeFlags::NONE)
            .line_width(1.0);
        let samples = vk::PipelineMultisampleStateCreateInfo::default()
            .rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let mut depth = vk::PipelineDepthStencilStateCreateInfo::default();
        if let Some(Depth { compare, write }) = self.depth {
            depth = depth.depth_test_enable(true).depth_write_enable(write).depth_compare_op(compare);
        }
        let blending = vk::PipelineColorBlendStateCreateInfo::default().attachments(self.blends);
        let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
        let info = vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages)
            .vertex_input_state(&self.input)
            .input_assembly_state(&assembly)
            .viewport_state(&viewport)
            .rasterization_state(&raster)
            .multisample_state(&samples)
            .depth_stencil_state(&depth)
            .color_blend_state(&blending)
            .dynamic_state(&dynamic)
            .layout(self.layout)
            .render_pass(self.pass)
            .subpass(self.subpass);
        // SAFETY: everything that `info` points to lives until the call returns.
        let made = unsafe { gpu.device().create_graphics_pipelines(cache, &[info], None) };
        Ok(made.map_err(|(_, e)| e).during("vkCreateGraphicsPipelines")?[0])
    }
}

/// How an attachment takes what replaces its colours.
pub(crate) fn replaced() -> vk::PipelineColorBlendAttachmentState {
    vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA)
}

/// A compute pipeline.
pub(crate) fn compute(
    gpu: &Arc<Gpu>,
    cache: vk::PipelineCache,
    layout: vk::PipelineLayout,
    code: &'static [u32],
    constants: &Constants,
) -> Result<vk::Pipeline, GpuError> {
    let module = Module::new(gpu, code)?;
    let constants = constants.info();
    let stage = module.stage(vk::ShaderStageFlags::COMPUTE).specialization_info(&constants);
    let info = vk::ComputePipelineCreateInfo::default().stage(stage).layout(layout);
    // SAFETY: module and layout are alive; the constants' map lies within their data.
    let made = unsafe { gpu.device().create_compute_pipelines(cache, &[info], None) };
    Ok(made.map_err(|(_, e)| e).during("vkCreateComputePipelines")?[0])
}
