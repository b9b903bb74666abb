//! The images of both eyes: a swapchain of two layers.

use super::Runtime;
use crate::XrError;
use crate::error::During;
use ash::vk::{self, Handle as _};
use motes_renderer::Target;
use motes_renderer::gpu::Gpu;
use openxr as xr;
use std::sync::Arc;

/// Formats that can be drawn into, best first: sRGB-encoded, since compositors read linear values through them.
const FORMATS: [vk::Format; 4] = [
    vk::Format::R8G8B8A8_SRGB,
    vk::Format::B8G8R8A8_SRGB,
    vk::Format::R8G8B8A8_UNORM,
    vk::Format::B8G8R8A8_UNORM,
];

/// How long an image may be held back by the compositor before the session counts as hung.
const PATIENCE: std::time::Duration = std::time::Duration::from_secs(2);

/// An image of the swapchain, with a view of both layers and one of each.
struct Eyes {
    image: vk::Image,
    views: [vk::ImageView; 3],
}

/// A swapchain of two layers.
pub(super) struct EyeSwapchain {
    gpu: Arc<Gpu>,
    pub swapchain: xr::Swapchain<xr::Vulkan>,
    images: Vec<Eyes>,
    pub format: vk::Format,
    pub size: [u32; 2],
    /// The image that is drawn into now.
    acquired: Option<usize>,
}

impl EyeSwapchain {
    pub fn new(
        runtime: &Runtime,
        gpu: &Arc<Gpu>,
        session: &xr::Session<xr::Vulkan>,
        size: [u32; 2],
    ) -> Result<Self, XrError> {
        let offered = session.enumerate_swapchain_formats().during("xrEnumerateSwapchainFormats")?;
        let Some(format) = FORMATS.into_iter().find(|f| offered.contains(&(f.as_raw() as u32))) else {
            let offered: Vec<_> =
                offered.iter().map(|f| format!("{:?}", vk::Format::from_raw(*f as i32))).collect();
            return Err(XrError::Missing {
                runtime: runtime.name().to_owned(),
                wanted: format!("one of the image formats {FORMATS:?} (it offers {})", offered.join(", ")),
                remedy: "Report this with the name of the headset",
            });
        };
        let mut usage_flags = xr::SwapchainUsageFlags::COLOR_ATTACHMENT | xr::SwapchainUsageFlags::SAMPLED;
        if runtime.options.readable {
            usage_flags |= xr::SwapchainUsageFlags::TRANSFER_SRC;
        }
        let swapchain = session
            .create_swapchain(&xr::SwapchainCreateInfo {
                create_flags: xr::SwapchainCreateFlags::EMPTY,
                usage_flags,
                format: format.as_raw() as u32,
                sample_count: 1,
                width: size[0],
                height: size[1],
                face_count: 1,
                array_size: 2,
                mip_count: 1,
            })
            .during("xrCreateSwapchain")?;
        let raw = swapchain.enumerate_images().during("xrEnumerateSwapchainImages")?;
        let mut made = Self { gpu: gpu.clone(), swapchain, images: Vec::new(), format, size, acquired: None };
        for image in raw {
            made.add(vk::Image::from_raw(image))?;
        }
        log::info!("eye images: {} of {} x {}, 2 layers, {format:?}", made.images.len(), size[0], size[1]);
        Ok(made)
    }

    fn add(&mut self, image: vk::Image) -> Result<(), XrError> {
        // Pushed first: whatever fails below, dropping destroys what was made.
        self.images.push(Eyes { image, views: [vk::ImageView::null(); 3] });
        let Some(eyes) = self.images.last_mut() else { return Ok(()) };
        let layers = [(0, 2), (0, 1), (1, 1)];
        for (view, (first, count)) in eyes.views.iter_mut().zip(layers) {
            let kind = if count > 1 { vk::ImageViewType::TYPE_2D_ARRAY } else { vk::ImageViewType::TYPE_2D };
            let info = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(kind)
                .format(self.format)
                .subresource_range(vk::ImageSubresourceRange {
                    aspect_mask: vk::ImageAspectFlags::COLOR,
                    base_mip_level: 0,
                    level_count: 1,
                    base_array_layer: first,
                    layer_count: count,
                });
            // SAFETY: the runtime's image has two layers of this format and lives as long as the swapchain.
            let made = unsafe { self.gpu.device().create_image_view(&info, None) };
            *view = made.map_err(|result| motes_renderer::gpu::GpuError::Call {
                call: "vkCreateImageView",
                result,
            })?;
        }
        Ok(())
    }

    /// The image to draw into; the same until it is released.
    pub fn acquire(&mut self) -> Result<Target, XrError> {
        let index = match self.acquired {
            Some(index) => index,
            None => {
                let index = {
                    let _queue = self.gpu.queue();
                    self.swapchain.acquire_image().during("xrAcquireSwapchainImage")? as usize
                };
                let patience = xr::Duration::from_nanos(PATIENCE.as_nanos() as i64);
                self.swapchain.wait_image(patience).during("xrWaitSwapchainImage")?;
                self.acquired = Some(index);
                index
            }
        };
        let eyes = &self.images[index];
        Ok(Target {
            all: eyes.views[0],
            layers: [eyes.views[1], eyes.views[2]],
            format: self.format,
            size: self.size,
            layout: vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
            background_alpha: 1.0,
        })
    }

    /// The image that is drawn into now.
    pub fn current(&self) -> Option<vk::Image> {
        self.acquired.map(|index| self.images[index].image)
    }

    /// Gives the image to the compositor, where one was acquired.
    pub fn release(&mut self) -> Result<(), XrError> {
        if self.acquired.take().is_some() {
            let _queue = self.gpu.queue();
            self.swapchain.release_image().during("xrReleaseSwapchainImage")?;
        }
        Ok(())
    }
}

impl Drop for EyeSwapchain {
    fn drop(&mut self) {
        if let Err(e) = self.gpu.wait_idle() {
            log::error!("{e}");
        }
        for view in self.images.drain(..).flat_map(|eyes| eyes.views) {
            // SAFETY: the device is idle. Null handles are ignored.
            unsafe { self.gpu.device().destroy_image_view(view, None) };
        }
    }
}
