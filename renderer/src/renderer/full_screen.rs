//! Passes over a whole image of the caller's, after the splats: one triangle covers it, in a render pass of its own.

use super::Slot;
use super::framebuffers::Framebuffers;
use crate::gpu::{Gpu, GpuError, Side};
use crate::passes::Passes;
use crate::pipeline::{Depth, GraphicsPipeline, replaced};
use crate::render_pass;
use crate::shader::Constants;
use ash::vk;
use motes_shaders::modules;
use std::collections::HashMap;
use std::hash::Hash;
use std::sync::Arc;

/// What a kind of pass and its pipeline depend on: equal keys, equal passes.
pub(super) trait FullScreenKey: Copy + Eq + Hash {
    fn describe(self) -> FullScreenPass;
}

/// How a pass is made.
pub(super) struct FullScreenPass {
    /// Formats of the images that are written, and the layouts that they are left in. What was in them is not kept.
    pub outputs: Vec<(vk::Format, vk::ImageLayout)>,
    /// Whether the one output is a depth image; otherwise all have colours.
    pub depth: bool,
    /// Views rendered at once, as a bit mask; 0 without multiview.
    pub view_mask: u32,
    /// What was done before, and what of this pass waits for it.
    pub before: [Side; 2],
    /// What this pass does, and what is done after it and waits for that.
    pub after: [Side; 2],
    /// SPIR-V of the fragment stage.
    pub fragment: &'static [u32],
    /// Its constants.
    pub constants: Constants,
}

/// The passes of a kind, made on first use.
pub(super) struct FullScreenPasses<K> {
    gpu: Arc<Gpu>,
    made: HashMap<K, (vk::RenderPass, vk::Pipeline)>,
}

/// What a pass writes, and what it is given.
pub(super) struct Bindings<'a> {
    /// The outputs; a null one is left out.
    pub views: [vk::ImageView; 2],
    /// Their width and height, pixels.
    pub size: [u32; 2],
    /// Descriptor sets, each with its number. Others stay as they are.
    pub sets: &'a [(u32, vk::DescriptorSet)],
    /// Push constants.
    pub push: &'a [u32],
}

impl<K: FullScreenKey> FullScreenPasses<K> {
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: gpu.clone(), made: HashMap::new() }
    }

    fn of(&mut self, key: K, passes: &Passes) -> Result<(vk::RenderPass, vk::Pipeline), GpuError> {
        if let Some(made) = self.made.get(&key) {
            return Ok(*made);
        }
        let description = key.describe();
        let pass = description.render_pass(&self.gpu)?;
        match description.pipeline(&self.gpu, passes, pass) {
            Ok(pipeline) => Ok(*self.made.entry(key).or_insert((pass, pipeline))),
            Err(error) => {
                // SAFETY: nothing was made of the pass.
                unsafe { self.gpu.device().destroy_render_pass(pass, None) };
                Err(error)
            }
        }
    }

    /// Records a pass, and counts it in the report of the frame in the slot.
    pub fn record(
        &mut self,
        slot: &mut Slot,
        passes: &Passes,
        framebuffers: &mut Framebuffers,
        key: K,
        bound: &Bindings<'_>,
    ) -> Result<(), GpuError> {
        let (render_pass, pipeline) = self.of(key, passes)?;
        let [width, height] = bound.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let [width, height] = bound.size.map(|side| side as f32);
        let viewport = vk::Viewport { width, height, max_depth: 1.0, ..Default::default() };
        let begin = vk::RenderPassBeginInfo::default()
            .render_pass(render_pass)
            .framebuffer(framebuffers.of(render_pass, bound.views, bound.size)?)
            .render_area(area);
        let device = self.gpu.device();
        let (commands, layout, stages) = (slot.commands, passes.layout, passes.push_stages());
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        // SAFETY: every handle is alive until the frame is done.
        unsafe {
            device.cmd_begin_render_pass(commands, &begin, vk::SubpassContents::INLINE);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            for &(number, set) in bound.sets {
                device.cmd_bind_descriptor_sets(commands, graphics, layout, number, &[set], &[]);
            }
            device.cmd_bind_pipeline(commands, graphics, pipeline);
            device.cmd_push_constants(commands, layout, stages, 0, bytemuck::cast_slice(bound.push));
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_render_pass(commands);
        }
        slot.report.draws += 1;
        slot.report.passes += 1;
        Ok(())
    }
}

impl FullScreenPass {
    fn render_pass(&self, gpu: &Gpu) -> Result<vk::RenderPass, GpuError> {
        let attachments: Vec<_> = self
            .outputs
            .iter()
            .map(|&(format, left)| {
                render_pass::attachment(format, left).store_op(vk::AttachmentStoreOp::STORE)
            })
            .collect();
        let layout = if self.depth {
            vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL
        } else {
            vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL
        };
        let written: Vec<_> = (0..attachments.len() as u32)
            .map(|attachment| vk::AttachmentReference { attachment, layout })
            .collect();
        let subpass = vk::SubpassDescription::default().pipeline_bind_point(vk::PipelineBindPoint::GRAPHICS);
        let subpass = if self.depth {
            subpass.depth_stencil_attachment(&written[0])
        } else {
            subpass.color_attachments(&written)
        };
        let dependencies = [
            render_pass::dependency([vk::SUBPASS_EXTERNAL, 0], self.before[0], self.before[1]),
            render_pass::dependency([0, vk::SUBPASS_EXTERNAL], self.after[0], self.after[1]),
        ];
        let info = vk::RenderPassCreateInfo::default()
            .attachments(&attachments)
            .subpasses(std::slice::from_ref(&subpass))
            .dependencies(&dependencies);
        render_pass::make(gpu, info, self.view_mask)
    }

    fn pipeline(
        &self,
        gpu: &Arc<Gpu>,
        passes: &Passes,
        pass: vk::RenderPass,
    ) -> Result<vk::Pipeline, GpuError> {
        let blends = vec![replaced(); if self.depth { 0 } else { self.outputs.len() }];
        let pipeline = GraphicsPipeline {
            shaders: &[
                (vk::ShaderStageFlags::VERTEX, modules::FULLSCREEN_VERT),
                (vk::ShaderStageFlags::FRAGMENT, self.fragment),
            ],
            constants: &self.constants,
            input: vk::PipelineVertexInputStateCreateInfo::default(),
            topology: vk::PrimitiveTopology::TRIANGLE_LIST,
            depth: self.depth.then_some(Depth { compare: vk::CompareOp::ALWAYS, write: true }),
            blends: &blends,
            layout: passes.layout,
            pass,
            subpass: 0,
        };
        pipeline.make(gpu, passes.cache())
    }
}

impl<K> Drop for FullScreenPasses<K> {
    fn drop(&mut self) {
        let device = self.gpu.device();
        // SAFETY: the renderer that owns this has waited for its frames.
        unsafe {
            for (pass, pipeline) in self.made.values() {
                device.destroy_pipeline(*pipeline, None);
                device.destroy_render_pass(*pass, None);
            }
        }
    }
}
