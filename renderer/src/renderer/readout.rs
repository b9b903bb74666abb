//! Passes that read what the splats left in the second colour attachment, into an image of the caller's: depth, or layers
//! as colours.

use super::frame_data::is_srgb;
use super::{DepthTarget, DrawRequest, Renderer, call};
use crate::gpu::{Gpu, GpuError};
use crate::passes::{PassKey, Passes};
use crate::pipeline::{Depth, GraphicsPipeline, replaced};
use crate::resolution::Resolution;
use crate::shader::Constants;
use ash::vk;
use motes_shaders::layout::Specialization;
use motes_shaders::modules;
use std::collections::HashMap;
use std::sync::Arc;

/// What is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Readout {
    /// The median depth, into a depth image.
    Depth,
    /// How many layers were shaded, as colours into the shown image.
    Layers,
}

/// What a pass and its pipeline depend on.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    what: Readout,
    format: vk::Format,
    layout: vk::ImageLayout,
    view_mask: u32,
}

/// The image that a pass writes.
struct Output {
    view: vk::ImageView,
    format: vk::Format,
    size: [u32; 2],
    layout: vk::ImageLayout,
}

/// The passes, made on first use.
pub(super) struct Readouts {
    gpu: Arc<Gpu>,
    passes: HashMap<Key, (vk::RenderPass, vk::Pipeline)>,
    framebuffers: HashMap<(vk::RenderPass, vk::ImageView), vk::Framebuffer>,
}

impl Readouts {
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: gpu.clone(), passes: HashMap::new(), framebuffers: HashMap::new() }
    }

    /// Destroys framebuffers. The device must be idle.
    pub fn forget_framebuffers(&mut self) {
        for (_, framebuffer) in self.framebuffers.drain() {
            // SAFETY: the device is idle.
            unsafe { self.gpu.device().destroy_framebuffer(framebuffer, None) };
        }
    }

    fn pass(&mut self, passes: &Passes, key: Key) -> Result<(vk::RenderPass, vk::Pipeline), GpuError> {
        if let Some(made) = self.passes.get(&key) {
            return Ok(*made);
        }
        let attachments = [vk::AttachmentDescription::default()
            .format(key.format)
            .samples(vk::SampleCountFlags::TYPE_1)
            .load_op(vk::AttachmentLoadOp::DONT_CARE)
            .store_op(vk::AttachmentStoreOp::STORE)
            .stencil_load_op(vk::AttachmentLoadOp::DONT_CARE)
            .stencil_store_op(vk::AttachmentStoreOp::DONT_CARE)
            .initial_layout(vk::ImageLayout::UNDEFINED)
            .final_layout(key.layout)];
        let depth = key.what == Readout::Depth;
        let (used, stages, reads, writes) = if depth {
            (
                vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL,
                vk::PipelineStageFlags::EARLY_FRAGMENT_TESTS | vk::PipelineStageFlags::LATE_FRAGMENT_TESTS,
                vk::AccessFlags::DEPTH_STENCIL_ATTACHMENT_READ,
                vk::AccessFlags::DEPTH_STENCIL_ATTACHMENT_WRITE,
            )
        } else {
            (
                vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
                vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT,
                vk::AccessFlags::COLOR_ATTACHMENT_READ,
                vk::AccessFlags::COLOR_ATTACHMENT_WRITE,
            )
        };
        let written = [vk::AttachmentReference { attachment: 0, layout: used }];
        let subpass = vk::SubpassDescription::default().pipeline_bind_point(vk::PipelineBindPoint::GRAPHICS);
        let subpasses = [if depth {
            subpass.depth_stencil_attachment(&written[0])
        } else {
            subpass.color_attachments(&written)
        }];
        let transfer = vk::PipelineStageFlags::TRANSFER;
        let dependencies = [
            // What is read is visible by the pass before, or by the barrier. This image's last use is over.
            vk::SubpassDependency::default()
                .src_subpass(vk::SUBPASS_EXTERNAL)
                .dst_subpass(0)
                .src_stage_mask(stages | transfer)
                .dst_stage_mask(stages)
                .src_access_mask(writes)
                .dst_access_mask(reads | writes),
            vk::SubpassDependency::default()
                .src_subpass(0)
                .dst_subpass(vk::SUBPASS_EXTERNAL)
                .src_stage_mask(stages)
                .dst_stage_mask(transfer | vk::PipelineStageFlags::BOTTOM_OF_PIPE)
                .src_access_mask(writes)
                .dst_access_mask(vk::AccessFlags::TRANSFER_READ),
        ];
        let masks = [key.view_mask];
        let mut multiview = vk::RenderPassMultiviewCreateInfo::default().view_masks(&masks);
        let mut info = vk::RenderPassCreateInfo::default()
            .attachments(&attachments)
            .subpasses(&subpasses)
            .dependencies(&dependencies);
        if key.view_mask != 0 {
            info = info.push_next(&mut multiview);
        }
        // SAFETY: `info` is complete and lives until the call returns.
        let pass = call(unsafe { self.gpu.device().create_render_pass(&info, None) }, "vkCreateRenderPass")?;
        let fragment = match (key.what, key.view_mask) {
            (Readout::Depth, 0) => modules::MEDIAN_DEPTH_FRAG,
            (Readout::Depth, _) => modules::MEDIAN_DEPTH_FRAG_MULTIVIEW,
            (Readout::Layers, 0) => modules::LAYERS_FRAG,
            (Readout::Layers, _) => modules::LAYERS_FRAG_MULTIVIEW,
        };
        let pipeline = GraphicsPipeline {
            shaders: &[
                (vk::ShaderStageFlags::VERTEX, modules::FULLSCREEN_VERT),
                (vk::ShaderStageFlags::FRAGMENT, fragment),
            ],
            constants: &Constants::from(&Specialization::default()),
            input: vk::PipelineVertexInputStateCreateInfo::default(),
            topology: vk::PrimitiveTopology::TRIANGLE_LIST,
            depth: depth.then_some(Depth { compare: vk::CompareOp::ALWAYS, write: true }),
            blends: if depth { &[] } else { &[replaced()] },
            layout: passes.layout,
            pass,
            subpass: 0,
        };
        match pipeline.make(&self.gpu, passes.cache()) {
            Ok(pipeline) => {
                self.passes.insert(key, (pass, pipeline));
                Ok((pass, pipeline))
            }
            Err(error) => {
                // SAFETY: nothing was made of the pass.
                unsafe { self.gpu.device().destroy_render_pass(pass, None) };
                Err(error)
            }
        }
    }

    fn framebuffer(
        &mut self,
        pass: vk::RenderPass,
        output: vk::ImageView,
        size: [u32; 2],
    ) -> Result<vk::Framebuffer, GpuError> {
        if let Some(framebuffer) = self.framebuffers.get(&(pass, output)) {
            return Ok(*framebuffer);
        }
        let views = [output];
        let info = vk::FramebufferCreateInfo::default()
            .render_pass(pass)
            .attachments(&views)
            .width(size[0])
            .height(size[1])
            .layers(1);
        // SAFETY: pass and view are alive.
        let made = call(unsafe { self.gpu.device().create_framebuffer(&info, None) }, "vkCreateFramebuffer")?;
        self.framebuffers.insert((pass, output), made);
        Ok(made)
    }
}

impl Drop for Readouts {
    fn drop(&mut self) {
        self.forget_framebuffers();
        let device = self.gpu.device();
        // SAFETY: the renderer that owns this has waited for its frames.
        unsafe {
            for (pass, pipeline) in self.passes.values() {
                device.destroy_pipeline(*pipeline, None);
                device.destroy_render_pass(*pass, None);
            }
        }
    }
}

impl Renderer {
    /// Records what is read out of a pass at a resolution: its depth where that is asked for, its layers where they are to be
    /// seen.
    pub(super) fn record_readouts(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        pass: PassKey,
        layer: Option<usize>,
        resolution: &Resolution,
    ) -> Result<(), GpuError> {
        let target = request.target;
        // The last rendered pixels may reach beyond the shown image.
        let covered = resolution.covered();
        let covered = [0, 1].map(|i| (covered[i] / f64::from(resolution.shown[i])) as f32);
        if let (Some(DepthTarget { all, layers, format, size, layout }), true) = (target.depth, pass.median) {
            let output = Output { view: layer.map_or(all, |l| layers[l]), format, size, layout };
            self.record_readout(slot, Readout::Depth, pass, &output, covered, [0, 0])?;
        }
        if let (Some(most), true) = (self.shown_layers, pass.count) {
            if let Some(second) = self.attachments.as_ref().and_then(|a| a.second.as_ref()) {
                let layouts =
                    [vk::ImageLayout::TRANSFER_SRC_OPTIMAL, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL];
                let written = (
                    vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT,
                    vk::AccessFlags::COLOR_ATTACHMENT_WRITE,
                );
                let read = (vk::PipelineStageFlags::FRAGMENT_SHADER, vk::AccessFlags::SHADER_READ);
                let image = (second.raw(), second.description().layers);
                // SAFETY: recorded outside of a pass; the image is alive until the frame is done.
                unsafe { self.gpu.change_layout(self.slots[slot].commands, image, layouts, written, read) };
            }
            let view = layer.map_or(target.all, |l| target.layers[l]);
            let output = Output { view, format: target.format, size: target.size, layout: target.layout };
            let push = [most.to_bits(), u32::from(is_srgb(target.format))];
            self.record_readout(slot, Readout::Layers, pass, &output, covered, push)?;
        }
        Ok(())
    }

    fn record_readout(
        &mut self,
        slot: usize,
        what: Readout,
        pass: PassKey,
        output: &Output,
        covered: [f32; 2],
        own: [u32; 2],
    ) -> Result<(), GpuError> {
        let second = self.attachments.as_ref().and_then(|a| a.second.as_ref());
        let Some(second) = second.map(|image| image.array_view()) else { return Ok(()) };
        let key = Key { what, format: output.format, layout: output.layout, view_mask: pass.view_mask };
        let (render_pass, pipeline) = self.readouts.pass(&self.passes, key)?;
        let framebuffer = self.readouts.framebuffer(render_pass, output.view, output.size)?;
        let set = self.allocate_set(slot, 3)?;
        let info = [vk::DescriptorImageInfo {
            sampler: self.upscaler.sampler(),
            image_view: second,
            image_layout: vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
        }];
        let write = vk::WriteDescriptorSet { dst_set: set, ..Default::default() }
            .dst_binding(1)
            .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
            .image_info(&info);
        let [width, height] = output.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let [width, height] = output.size.map(|side| side as f32);
        let viewport = vk::Viewport { width, height, max_depth: 1.0, ..Default::default() };
        let begin = vk::RenderPassBeginInfo::default()
            .render_pass(render_pass)
            .framebuffer(framebuffer)
            .render_area(area);
        // Where each eye is drawn by itself, the second attachment holds that eye alone.
        let size = [width * covered[0], height * covered[1]].map(f32::to_bits);
        let push = [size[0], size[1], 0, own[0], own[1]];
        let commands = self.slots[slot].commands;
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        let (layout, stages) = (self.passes.layout, self.passes.push_stages());
        let device = self.gpu.device();
        // SAFETY: every handle is alive until the frame is done; the set is not in use by the device.
        unsafe {
            device.update_descriptor_sets(&[write], &[]);
            device.cmd_begin_render_pass(commands, &begin, vk::SubpassContents::INLINE);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_bind_descriptor_sets(commands, graphics, layout, 3, &[set], &[]);
            device.cmd_bind_pipeline(commands, graphics, pipeline);
            device.cmd_push_constants(commands, layout, stages, 0, bytemuck::cast_slice(&push));
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_render_pass(commands);
        }
        let report = &mut self.slots[slot].report;
        report.draws += 1;
        report.passes += 1;
        Ok(())
    }
}
