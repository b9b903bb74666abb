//! Draws egui into an image of the caller's: over a window's picture, or into a headset's panel.

use std::collections::HashMap;
use std::sync::Arc;

use ash::vk;
use egui::{ClippedPrimitive, TextureId, TexturesDelta};
use egui_ash_renderer::allocator::DefaultAllocator;
use egui_ash_renderer::{Options, RenderMode, Renderer, RendererError};
use motes_renderer::gpu::{Gpu, GpuError};

/// Why a panel could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PainterError {
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The panel's own pipeline, buffers or textures.
    #[error("drawing the panel: {0}")]
    Panel(#[from] RendererError),
}

/// What is in the image before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Before {
    /// A picture to draw over, in this layout, written by a copy or by a render pass.
    Picture(vk::ImageLayout),
    /// Nothing: the image is made transparent first.
    Nothing,
}

/// Draws egui's shapes. One for a device, thread and format of images.
pub struct Painter {
    gpu: Arc<Gpu>,
    renderer: Option<Renderer<DefaultAllocator>>,
    pass: vk::RenderPass,
    pool: vk::CommandPool,
    framebuffers: HashMap<(vk::ImageView, [u32; 2]), vk::Framebuffer>,
    /// Textures to free, and how many more frames may still use them.
    retired: Vec<(usize, TextureId)>,
    frames: usize,
}

fn call<T>(result: Result<T, vk::Result>, call: &'static str) -> Result<T, GpuError> {
    result.map_err(|result| GpuError::Call { call, result })
}

impl Painter {
    /// A painter for images of a format, left in the layout `after`. `frames`: how many may be under way at once.
    /// Formats that encode to sRGB by themselves are told so.
    ///
    /// # Errors
    /// The driver's.
    pub fn new(
        gpu: &Arc<Gpu>,
        format: vk::Format,
        before: Before,
        after: vk::ImageLayout,
        frames: usize,
    ) -> Result<Self, PainterError> {
        let pass = render_pass(gpu, format, before, after)?;
        let mut painter = Self {
            gpu: gpu.clone(),
            renderer: None,
            pass,
            pool: vk::CommandPool::null(),
            framebuffers: HashMap::new(),
            retired: Vec::new(),
            frames: frames.max(1),
        };
        let info = vk::CommandPoolCreateInfo::default()
            .queue_family_index(gpu.queue_family())
            .flags(vk::CommandPoolCreateFlags::TRANSIENT);
        // SAFETY: `info` is complete.
        painter.pool = call(unsafe { gpu.device().create_command_pool(&info, None) }, "vkCreateCommandPool")?;
        let srgb = [vk::Format::R8G8B8A8_SRGB, vk::Format::B8G8R8A8_SRGB, vk::Format::A8B8G8R8_SRGB_PACK32];
        let options = Options {
            in_flight_frames: painter.frames,
            srgb_framebuffer: srgb.contains(&format),
            ..Options::default()
        };
        painter.renderer = Some(Renderer::with_default_allocator(
            gpu.instance(),
            gpu.physical(),
            gpu.device().clone(),
            RenderMode::RenderPass(pass),
            options,
        )?);
        Ok(painter)
    }

    /// Brings new textures (fonts, mostly) to the device. Before [`Painter::draw`] of the same frame.
    ///
    /// # Errors
    /// The driver's, or out of memory.
    pub fn update(&mut self, mut delta: TexturesDelta) -> Result<(), PainterError> {
        let Some(renderer) = &mut self.renderer else { return Ok(()) };
        for (left, _) in &mut self.retired {
            *left = left.saturating_sub(1);
        }
        for (_, id) in self.retired.extract_if(.., |(left, _)| *left == 0) {
            renderer.free_texture(id)?;
        }
        if !delta.set.is_empty() {
            // A texture that is replaced may be in use by the frame before; it happens when fonts grow.
            self.gpu.wait_idle()?;
            let queue = self.gpu.queue();
            for (id, changes) in delta.set.drain() {
                for change in changes {
                    renderer.set_texture(*queue, self.pool, id, &change)?;
                }
            }
        }
        self.retired.extend(delta.free.drain().map(|id| (self.frames + 1, id)));
        Ok(())
    }

    /// Records the drawing of shapes into an image.
    ///
    /// # Errors
    /// The driver's, or out of memory.
    pub fn draw(
        &mut self,
        commands: vk::CommandBuffer,
        image: vk::ImageView,
        size: [u32; 2],
        pixels_per_point: f32,
        shapes: &[ClippedPrimitive],
    ) -> Result<(), PainterError> {
        let framebuffer = self.framebuffer(image, size)?;
        let Some(renderer) = &mut self.renderer else { return Ok(()) };
        let extent = vk::Extent2D { width: size[0], height: size[1] };
        let clear = [vk::ClearValue::default()];
        let begin = vk::RenderPassBeginInfo::default()
            .render_pass(self.pass)
            .framebuffer(framebuffer)
            .render_area(vk::Rect2D { offset: vk::Offset2D::default(), extent })
            .clear_values(&clear);
        let device = self.gpu.device();
        // SAFETY: pass and framebuffer fit together; the caller's command buffer is being recorded.
        unsafe { device.cmd_begin_render_pass(commands, &begin, vk::SubpassContents::INLINE) };
        let drawn = renderer.cmd_draw(commands, extent, pixels_per_point, shapes);
        // SAFETY: begun above.
        unsafe { device.cmd_end_render_pass(commands) };
        Ok(drawn?)
    }

    /// Forgets framebuffers of images that are about to be destroyed.
    ///
    /// # Errors
    /// The device was lost.
    pub fn forget_targets(&mut self) -> Result<(), PainterError> {
        self.gpu.wait_idle()?;
        for (_, framebuffer) in self.framebuffers.drain() {
            // SAFETY: the device is idle.
            unsafe { self.gpu.device().destroy_framebuffer(framebuffer, None) };
        }
        Ok(())
    }

    fn framebuffer(&mut self, image: vk::ImageView, size: [u32; 2]) -> Result<vk::Framebuffer, GpuError> {
        if let Some(framebuffer) = self.framebuffers.get(&(image, size)) {
            return Ok(*framebuffer);
        }
        let attachments = [image];
        let info = vk::FramebufferCreateInfo::default()
            .render_pass(self.pass)
            .attachments(&attachments)
            .width(size[0])
            .height(size[1])
            .layers(1);
        // SAFETY: pass and view are alive.
        let made = call(unsafe { self.gpu.device().create_framebuffer(&info, None) }, "vkCreateFramebuffer")?;
        self.framebuffers.insert((image, size), made);
        Ok(made)
    }
}

impl Drop for Painter {
    fn drop(&mut self) {
        if let Err(error) = self.forget_targets() {
            log::error!("{error}");
        }
        self.renderer = None;
        // SAFETY: the device is idle. Null handles are ignored.
        unsafe {
            self.gpu.device().destroy_command_pool(self.pool, None);
            self.gpu.device().destroy_render_pass(self.pass, None);
        }
    }
}

fn render_pass(
    gpu: &Gpu,
    format: vk::Format,
    before: Before,
    after: vk::ImageLayout,
) -> Result<vk::RenderPass, GpuError> {
    let (load, layout) = match before {
        Before::Picture(layout) => (vk::AttachmentLoadOp::LOAD, layout),
        Before::Nothing => (vk::AttachmentLoadOp::CLEAR, vk::ImageLayout::UNDEFINED),
    };
    let attachments = [vk::AttachmentDescription::default()
        .format(format)
        .samples(vk::SampleCountFlags::TYPE_1)
        .load_op(load)
        .store_op(vk::AttachmentStoreOp::STORE)
        .stencil_load_op(vk::AttachmentLoadOp::DONT_CARE)
        .stencil_store_op(vk::AttachmentStoreOp::DONT_CARE)
        .initial_layout(layout)
        .final_layout(after)];
    let color = [vk::AttachmentReference::default().layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)];
    let subpasses = [vk::SubpassDescription::default()
        .pipeline_bind_point(vk::PipelineBindPoint::GRAPHICS)
        .color_attachments(&color)];
    let output = vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT;
    let write = vk::AccessFlags::COLOR_ATTACHMENT_WRITE;
    let dependencies = [
        vk::SubpassDependency::default()
            .src_subpass(vk::SUBPASS_EXTERNAL)
            .dst_subpass(0)
            .src_stage_mask(output | vk::PipelineStageFlags::TRANSFER)
            .dst_stage_mask(output)
            .src_access_mask(write | vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(write | vk::AccessFlags::COLOR_ATTACHMENT_READ),
        vk::SubpassDependency::default()
            .src_subpass(0)
            .dst_subpass(vk::SUBPASS_EXTERNAL)
            .src_stage_mask(output)
            .dst_stage_mask(vk::PipelineStageFlags::TRANSFER | vk::PipelineStageFlags::BOTTOM_OF_PIPE)
            .src_access_mask(write)
            .dst_access_mask(vk::AccessFlags::TRANSFER_READ),
    ];
    let info = vk::RenderPassCreateInfo::default()
        .attachments(&attachments)
        .subpasses(&subpasses)
        .dependencies(&dependencies);
    // SAFETY: `info` is complete.
    call(unsafe { gpu.device().create_render_pass(&info, None) }, "vkCreateRenderPass")
}
