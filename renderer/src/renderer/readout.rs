//! Passes that read what the splats left in the second colour attachment, into an image of the caller's: depth, or layers
//! as colours.

use super::frame_data::is_srgb;
use super::full_screen::{Bindings, FullScreenKey, FullScreenPass};
use super::{DepthTarget, DrawRequest, Renderer};
use crate::gpu::GpuError;
use crate::render_pass::PassKey;
use crate::resolution::Resolution;
use crate::shader::Constants;
use ash::vk;
use motes_shaders::modules;

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
pub(super) struct ReadoutKey {
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

impl FullScreenKey for ReadoutKey {
    fn describe(self) -> FullScreenPass {
        let (stages, reads, writes) = match self.what {
            Readout::Depth => (
                vk::PipelineStageFlags::EARLY_FRAGMENT_TESTS | vk::PipelineStageFlags::LATE_FRAGMENT_TESTS,
                vk::AccessFlags::DEPTH_STENCIL_ATTACHMENT_READ,
                vk::AccessFlags::DEPTH_STENCIL_ATTACHMENT_WRITE,
            ),
            Readout::Layers => (
                vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT,
                vk::AccessFlags::COLOR_ATTACHMENT_READ,
                vk::AccessFlags::COLOR_ATTACHMENT_WRITE,
            ),
        };
        let transfer = vk::PipelineStageFlags::TRANSFER;
        FullScreenPass {
            outputs: vec![(self.format, self.layout)],
            depth: self.what == Readout::Depth,
            view_mask: self.view_mask,
            // What is read is visible by the pass before, or by the barrier. This image's last use is over.
            before: [(stages | transfer, writes), (stages, reads | writes)],
            after: [
                (stages, writes),
                (transfer | vk::PipelineStageFlags::BOTTOM_OF_PIPE, vk::AccessFlags::TRANSFER_READ),
            ],
            fragment: match (self.what, self.view_mask) {
                (Readout::Depth, 0) => modules::MEDIAN_DEPTH_FRAG,
                (Readout::Depth, _) => modules::MEDIAN_DEPTH_FRAG_MULTIVIEW,
                (Readout::Layers, 0) => modules::LAYERS_FRAG,
                (Readout::Layers, _) => modules::LAYERS_FRAG_MULTIVIEW,
            },
            constants: Constants::default(),
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
        let key =
            ReadoutKey { what, format: output.format, layout: output.layout, view_mask: pass.view_mask };
        let set = self.sampled_set(slot, [second])?;
        // Where each eye is drawn by itself, the second attachment holds that eye alone.
        let size = [0, 1].map(|i| (output.size[i] as f32 * covered[i]).to_bits());
        let bindings = Bindings {
            views: [output.view, vk::ImageView::null()],
            size: output.size,
            sets: &[(3, set)],
            push: &[size[0], size[1], 0, own[0], own[1]],
        };
        let slot = &mut self.slots[slot];
        self.readouts.record(slot, &self.passes, &mut self.framebuffers, key, &bindings)
    }
}
