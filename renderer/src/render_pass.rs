//! Render passes: what the splats' depends on and how it is made, and what others have in common with it.

use crate::gpu::{During, Gpu, GpuError, Side};
use ash::vk;

/// Format of the marks of early stop.
pub(crate) const MARK_FORMAT: vk::Format = vk::Format::D16_UNORM;

/// Format of the distances of stochastic transparency.
pub(crate) const DISTANCE_FORMAT: vk::Format = vk::Format::D32_SFLOAT;

/// Format of layer counts: shaded, and of those the ones that reach 1/255 (whole numbers are exact up to 2048); and of
/// what leads to the median depth.
pub(crate) const SECOND_FORMAT: vk::Format = vk::Format::R16G16_SFLOAT;

/// What a render pass depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PassKey {
    /// Format of the blended image.
    pub blended: vk::Format,
    /// Format of the output and the layout it is left in; without one the blended image is kept for a further pass.
    pub output: Option<(vk::Format, vk::ImageLayout)>,
    /// Views rendered at once, as a bit mask; 0 without multiview.
    pub view_mask: u32,
    /// Whether saturated pixels are marked in a depth attachment.
    pub early_stop: bool,
    /// Whether layers are counted into a second colour attachment.
    pub count: bool,
    /// Whether a second colour attachment follows the light for the median depth (early stop; not with counts).
    pub median: bool,
    /// Whether a fragment density map says how coarse fragments are.
    pub density: bool,
    /// Whether splats are opaque or absent, and a depth attachment finds the nearest.
    pub stochastic: bool,
}

impl PassKey {
    /// Format of the depth attachment: the marks of early stop, or distances.
    pub fn depth_format(self) -> Option<vk::Format> {
        match (self.stochastic, self.early_stop) {
            (true, _) => Some(DISTANCE_FORMAT),
            (false, true) => Some(MARK_FORMAT),
            (false, false) => None,
        }
    }

    /// The layout that a second colour attachment is left in, of [`SECOND_FORMAT`]; none where there is none.
    pub fn second(self) -> Option<vk::ImageLayout> {
        match (self.count, self.median) {
            (true, _) => Some(vk::ImageLayout::TRANSFER_SRC_OPTIMAL),
            (false, true) => Some(vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL),
            (false, false) => None,
        }
    }

    /// Colour attachments that splats are drawn with.
    pub fn colours(self) -> usize {
        1 + usize::from(self.second().is_some())
    }

    /// How dependencies within the pass reach: a pixel waits for itself, in its own view.
    pub fn by_region(self) -> vk::DependencyFlags {
        if self.view_mask == 0 {
            vk::DependencyFlags::BY_REGION
        } else {
            vk::DependencyFlags::BY_REGION | vk::DependencyFlags::VIEW_LOCAL
        }
    }

    /// Makes the pass. Attachments: blended image, output (if any), marks or distances (if any), layer counts or median (if
    /// any), density map (if any).
    ///
    /// Subpass 0 blends the splats. With early stop it also reads the blended image back as an input attachment, between
    /// batches and on chip, to write the marks: its self-dependency allows the barrier. Subpass 1 resolves into the output.
    pub fn make(self, gpu: &Gpu) -> Result<vk::RenderPass, GpuError> {
        let blended_layout = if self.early_stop {
            vk::ImageLayout::GENERAL
        } else {
            vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL
        };
        let cleared = |format, left| attachment(format, left).load_op(vk::AttachmentLoadOp::CLEAR);
        let stored = |a: vk::AttachmentDescription| a.store_op(vk::AttachmentStoreOp::STORE);
        let blended = cleared(self.blended, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL);
        let mut attachments = vec![if self.output.is_some() { blended } else { stored(blended) }];
        if let Some((format, left)) = self.output {
            attachments.push(stored(attachment(format, left)));
        }
        let depth_at = attachments.len() as u32;
        let depth_layout = vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL;
        if let Some(format) = self.depth_format() {
            attachments.push(cleared(format, depth_layout));
        }
        let second_at = attachments.len() as u32;
        if let Some(left) = self.second() {
            attachments.push(stored(cleared(SECOND_FORMAT, left)));
        }
        let density_at = attachments.len() as u32;
        let density_layout = vk::ImageLayout::FRAGMENT_DENSITY_MAP_OPTIMAL_EXT;
        if self.density {
            let map = attachment(vk::Format::R8G8_UNORM, density_layout);
            attachments.push(map.load_op(vk::AttachmentLoadOp::LOAD).initial_layout(density_layout));
        }
        let reference = |attachment, layout| vk::AttachmentReference { attachment, layout };
        let drawn = [0, second_at].map(|at| reference(at, blended_layout));
        let blended_read = [reference(0, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL)];
        let output = [reference(1, vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)];
        let depth = reference(depth_at, depth_layout);
        let mut splats = vk::SubpassDescription::default()
            .pipeline_bind_point(vk::PipelineBindPoint::GRAPHICS)
            .color_attachments(&drawn[..self.colours()]);
        if self.depth_format().is_some() {
            splats = splats.depth_stencil_attachment(&depth);
        }
        if self.early_stop {
            splats = splats.input_attachments(&drawn[..1 + usize::from(self.median)]);
        }
        let kept = [second_at];
        let resolve = vk::SubpassDescription::default()
            .pipeline_bind_point(vk::PipelineBindPoint::GRAPHICS)
            .input_attachments(&blended_read)
            .color_attachments(&output)
            .preserve_attachments(&kept[..self.colours() - 1]);
        let subpasses = [splats, resolve];
        let dependencies = self.dependencies();
        let mut info = vk::RenderPassCreateInfo::default()
            .attachments(&attachments)
            .subpasses(&subpasses[..if self.output.is_some() { 2 } else { 1 }])
            .dependencies(&dependencies);
        let mut density = vk::RenderPassFragmentDensityMapCreateInfoEXT::default()
            .fragment_density_map_attachment(reference(density_at, density_layout));
        if self.density {
            info = info.push_next(&mut density);
        }
        make(gpu, info, self.view_mask)
    }

    fn dependencies(self) -> Vec<vk::SubpassDependency> {
        let color = vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT;
        let fragment = vk::PipelineStageFlags::FRAGMENT_SHADER;
        let transfer = vk::PipelineStageFlags::TRANSFER;
        let tests =
            vk::PipelineStageFlags::EARLY_FRAGMENT_TESTS | vk::PipelineStageFlags::LATE_FRAGMENT_TESTS;
        let written = vk::AccessFlags::COLOR_ATTACHMENT_WRITE;
        let blended = vk::AccessFlags::COLOR_ATTACHMENT_READ | written;
        let depth =
            vk::AccessFlags::DEPTH_STENCIL_ATTACHMENT_READ | vk::AccessFlags::DEPTH_STENCIL_ATTACHMENT_WRITE;
        let input = vk::AccessFlags::INPUT_ATTACHMENT_READ;
        let read = vk::AccessFlags::TRANSFER_READ | vk::AccessFlags::SHADER_READ;
        let outside = color | fragment | transfer | tests;
        let external = vk::SUBPASS_EXTERNAL;
        // The frame before may still read or write these images.
        let mut dependencies =
            vec![dependency([external, 0], (outside, written | depth), (color | tests, blended | depth))];
        // Without an output, the further pass waits for this one by itself.
        if self.output.is_some() {
            dependencies.extend([
                dependency([external, 1], (outside, written), (color, blended)),
                dependency([0, 1], (color, written), (fragment | color, input | blended))
                    .dependency_flags(self.by_region()),
                dependency(
                    [1, external],
                    (color, written),
                    (transfer | fragment | vk::PipelineStageFlags::BOTTOM_OF_PIPE, read),
                ),
            ]);
        }
        if self.early_stop {
            // The marks are made from what has been blended so far.
            dependencies.push(
                dependency([0, 0], (color, written), (fragment, input)).dependency_flags(self.by_region()),
            );
        }
        if self.second().is_some() {
            dependencies.push(dependency([0, external], (color, written), (transfer | fragment, read)));
        }
        dependencies
    }
}

/// An attachment of one sample: what was in it is not kept, and what becomes of it is neither, unless the caller says so.
/// `left`: the layout it is left in.
pub(crate) fn attachment(format: vk::Format, left: vk::ImageLayout) -> vk::AttachmentDescription {
    vk::AttachmentDescription::default()
        .format(format)
        .samples(vk::SampleCountFlags::TYPE_1)
        .load_op(vk::AttachmentLoadOp::DONT_CARE)
        .store_op(vk::AttachmentStoreOp::DONT_CARE)
        .stencil_load_op(vk::AttachmentLoadOp::DONT_CARE)
        .stencil_store_op(vk::AttachmentStoreOp::DONT_CARE)
        .initial_layout(vk::ImageLayout::UNDEFINED)
        .final_layout(left)
}

/// What one subpass did, and what of another waits for it.
pub(crate) fn dependency([from, to]: [u32; 2], done: Side, waits: Side) -> vk::SubpassDependency {
    vk::SubpassDependency::default()
        .src_subpass(from)
        .dst_subpass(to)
        .src_stage_mask(done.0)
        .dst_stage_mask(waits.0)
        .src_access_mask(done.1)
        .dst_access_mask(waits.1)
}

/// A render pass whose subpasses all render the views of a mask at once; 0 without multiview.
pub(crate) fn make(
    gpu: &Gpu,
    info: vk::RenderPassCreateInfo<'_>,
    view_mask: u32,
) -> Result<vk::RenderPass, GpuError> {
    let masks = vec![view_mask; info.subpass_count as usize];
    let mut multiview = vk::RenderPassMultiviewCreateInfo::default().view_masks(&masks);
    let info = if view_mask == 0 { info } else { info.push_next(&mut multiview) };
    // SAFETY: everything that `info` points to lives until the call returns.
    unsafe { gpu.device().create_render_pass(&info, None) }.during("vkCreateRenderPass")
}
