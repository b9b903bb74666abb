//! Changes of an image's layout.

use super::Gpu;
use ash::vk;

/// Stages and accesses on one side of a barrier.
pub type Side = (vk::PipelineStageFlags, vk::AccessFlags);

impl Gpu {
    /// Records that the first `layers` of a colour image change from one layout to another: after what `before` names, and
    /// before what `after` does.
    ///
    /// # Safety
    /// The commands are being recorded, outside of a render pass; the image is alive until they are done and has as many
    /// layers.
    pub unsafe fn change_layout(
        &self,
        commands: vk::CommandBuffer,
        (image, layers): (vk::Image, u32),
        [from, to]: [vk::ImageLayout; 2],
        before: Side,
        after: Side,
    ) {
        let change = vk::ImageMemoryBarrier::default()
            .image(image)
            .subresource_range(vk::ImageSubresourceRange {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                base_mip_level: 0,
                level_count: 1,
                base_array_layer: 0,
                layer_count: layers,
            })
            .old_layout(from)
            .new_layout(to)
            .src_access_mask(before.1)
            .dst_access_mask(after.1)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED);
        let none = vk::DependencyFlags::empty();
        // SAFETY: as the caller promises.
        unsafe {
            self.device().cmd_pipeline_barrier(commands, before.0, after.0, none, &[], &[], &[change]);
        }
    }
}
