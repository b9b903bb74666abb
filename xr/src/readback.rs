//! Copies of what the eyes see: for screenshots and tests.

use crate::{EyeImages, XrError};
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_renderer::Picture;
use motes_renderer::gpu::{Buffer, Gpu};
use std::sync::Arc;

/// A buffer that both eyes' images are copied to.
pub struct Readback {
    gpu: Arc<Gpu>,
    buffer: Buffer,
    images: EyeImages,
}

impl Readback {
    /// For images of this kind.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(gpu: &Arc<Gpu>, images: EyeImages) -> Result<Self, XrError> {
        let bytes = 2 * 4 * u64::from(images.size[0]) * u64::from(images.size[1]);
        let usage = vk::BufferUsageFlags::TRANSFER_DST;
        let buffer = Buffer::new(gpu, "eyes read back", bytes, usage, MemoryLocation::GpuToCpu)?;
        Ok(Self { gpu: gpu.clone(), buffer, images })
    }

    /// Records the copy of an image that was drawn before in the same commands. The image is left as it was found, in
    /// the layout for drawing.
    pub fn record(&self, commands: vk::CommandBuffer, image: vk::Image) {
        use vk::{AccessFlags as Access, ImageLayout as Layout, PipelineStageFlags as Stage};
        let [width, height] = self.images.size;
        let [drawn, source] = [Layout::COLOR_ATTACHMENT_OPTIMAL, Layout::TRANSFER_SRC_OPTIMAL];
        let to_host = vk::MemoryBarrier::default()
            .src_access_mask(Access::TRANSFER_WRITE)
            .dst_access_mask(Access::HOST_READ);
        let copy = vk::BufferImageCopy {
            image_subresource: vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: 0,
                base_array_layer: 0,
                layer_count: 2,
            },
            image_extent: vk::Extent3D { width, height, depth: 1 },
            ..Default::default()
        };
        let none = vk::DependencyFlags::empty();
        let device = self.gpu.device();
        let output = Stage::COLOR_ATTACHMENT_OUTPUT;
        let wrote = (output, Access::COLOR_ATTACHMENT_WRITE);
        let reads = (Stage::TRANSFER, Access::TRANSFER_READ);
        // SAFETY: the image has two layers of this size, and the buffer holds both.
        unsafe {
            self.gpu.change_layout(commands, (image, 2), [drawn, source], wrote, reads);
            device.cmd_copy_image_to_buffer(commands, image, source, self.buffer.raw(), &[copy]);
            let (copied, next) =
                ((Stage::TRANSFER, Access::empty()), (output, Access::COLOR_ATTACHMENT_READ));
            self.gpu.change_layout(commands, (image, 2), [source, drawn], copied, next);
            device.cmd_pipeline_barrier(commands, Stage::TRANSFER, Stage::HOST, none, &[to_host], &[], &[]);
        }
    }

    /// What was copied by a frame that is done: left and right eye, sRGB-encoded.
    pub fn pictures(&self) -> [Picture; 2] {
        let swapped = matches!(self.images.format, vk::Format::B8G8R8A8_SRGB | vk::Format::B8G8R8A8_UNORM);
        let [width, height] = self.images.size;
        let bytes = 4 * (width * height) as usize;
        [0, 1].map(|eye| {
            let layer = self.buffer.mapped().get(eye * bytes..(eye + 1) * bytes).unwrap_or_default();
            let pixel = |p: &[u8]| if swapped { [p[2], p[1], p[0], p[3]] } else { [p[0], p[1], p[2], p[3]] };
            Picture { size: self.images.size, pixels: layer.chunks_exact(4).map(pixel).collect() }
        })
    }
}
