//! Images that the compositor shows: a swapchain of two layers for the eyes, of one for a quad.

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

/// What images are wanted.
pub(super) struct Wish {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// One, or two for both eyes.
    pub layers: u32,
    /// Filled once by a copy, and not drawn into.
    pub still: bool,
}

/// An image of the swapchain, with a view of all layers and one of each.
struct Viewed {
    image: vk::Image,
    views: [vk::ImageView; 3],
}

/// A swapchain.
pub(super) struct Images {
    gpu: Arc<Gpu>,
    pub swapchain: xr::Swapchain<xr::Vulkan>,
    images: Vec<Viewed>,
    pub format: vk::Format,
    pub size: [u32; 2],
    /// The image that is drawn into now.
    acquired: Option<usize>,
}

impl Images {
    pub fn new(
        runtime: &Runtime,
        gpu: &Arc<Gpu>,
        session: &xr::Session<xr::Vulkan>,
        wish: &Wish,
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
        let Wish { size, layers, still } = *wish;
        let mut usage_flags = xr::SwapchainUsageFlags::COLOR_ATTACHMENT | xr::SwapchainUsageFlags::SAMPLED;
        if still {
            usage_flags |= xr::SwapchainUsageFlags::TRANSFER_DST;
        } else if runtime.options.readable {
            usage_flags |= xr::SwapchainUsageFlags::TRANSFER_SRC;
        }
        let swapchain = session
            .create_swapchain(&xr::SwapchainCreateInfo {
                create_flags: if still {
                    xr::SwapchainCreateFlags::STATIC_IMAGE
                } else {
                    xr::SwapchainCreateFlags::EMPTY
                },
                usage_flags,
                format: format.as_raw() as u32,
                sample_count: 1,
                width: size[0],
                height: size[1],
                face_count: 1,
                array_size: layers,
                mip_count: 1,
            })
            .during("xrCreateSwapchain")?;
        let raw = swapchain.enumerate_images().during("xrEnumerateSwapchainImages")?;
        let mut made = Self { gpu: gpu.clone(), swapchain, images: Vec::new(), format, size, acquired: None };
        for image in raw {
            made.add(vk::Image::from_raw(image), layers)?;
        }
        if layers == 2 {
            log::info!(
                "eye images: {} of {} x {}, 2 layers, {format:?}",
                made.images.len(),
                size[0],
                size[1]
            );
        }
        Ok(made)
    }

    fn add(&mut self, image: vk::Image, layers: u32) -> Result<(), XrError> {
        // Pushed first: whatever fails below, dropping destroys what was made.
        self.images.push(Viewed { image, views: [vk::ImageView::null(); 3] });
        let Some(viewed) = self.images.last_mut() else { return Ok(()) };
        let views: &[(u32, u32)] = if layers == 2 { &[(0, 2), (0, 1), (1, 1)] } else { &[(0, 1)] };
        for (view, &(first, count)) in viewed.views.iter_mut().zip(views) {
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
            // SAFETY: the runtime's image has these layers and this format and lives as long as the swapchain.
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
        let viewed = &self.images[index];
        Ok(Target {
            all: viewed.views[0],
            layers: [viewed.views[1], viewed.views[2]],
            format: self.format,
            size: self.size,
            layout: vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
            background_alpha: 1.0,
            depth: None,
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

impl Drop for Images {
    fn drop(&mut self) {
        if let Err(e) = self.gpu.wait_idle() {
            log::error!("{e}");
        }
        for view in self.images.drain(..).flat_map(|viewed| viewed.views) {
            // SAFETY: the device is idle. Null handles are ignored.
            unsafe { self.gpu.device().destroy_image_view(view, None) };
        }
    }
}
