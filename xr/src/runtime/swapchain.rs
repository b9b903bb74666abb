//! Images that the compositor shows: a swapchain of two layers for the eyes, of one for a quad.

use super::{Runtime, foveation};
use crate::XrError;
use crate::error::During;
use ash::vk::{self, Handle as _};
use motes_renderer::gpu::{Gpu, GpuError};
use motes_renderer::{DepthTarget, Target};
use openxr as xr;
use openxr::sys;
use std::sync::Arc;

/// Formats that can be drawn into, best first: sRGB-encoded, since compositors read linear values through them.
const FORMATS: [vk::Format; 4] = [
    vk::Format::R8G8B8A8_SRGB,
    vk::Format::B8G8R8A8_SRGB,
    vk::Format::R8G8B8A8_UNORM,
    vk::Format::B8G8R8A8_UNORM,
];

/// Formats of depth, best first. What they hold is 1 close by and 0 far away, in even steps of closeness, as displacements
/// of pixels are: 16 bits from 5 cm on are 0.0003 / m.
const DEPTH_FORMATS: [vk::Format; 2] = [vk::Format::D16_UNORM, vk::Format::D32_SFLOAT];

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
    /// With fragment density maps.
    pub foveated: bool,
}

/// An image of the swapchain, with a view of all layers and one of each, and of all layers of its density map.
struct Viewed {
    image: vk::Image,
    views: [vk::ImageView; 3],
    density: Option<vk::ImageView>,
}

/// A swapchain.
pub(super) struct Images {
    gpu: Arc<Gpu>,
    pub swapchain: xr::Swapchain<xr::Vulkan>,
    images: Vec<Viewed>,
    pub format: vk::Format,
    aspect: vk::ImageAspectFlags,
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
        let made = Self::of_format(runtime, gpu, session, wish, (format, vk::ImageAspectFlags::COLOR))?;
        if wish.layers == 2 {
            made.announce("eye images");
        }
        Ok(made)
    }

    /// Depth images for both eyes; none where the runtime has no format for them, which is announced.
    pub fn depth(
        runtime: &Runtime,
        gpu: &Arc<Gpu>,
        session: &xr::Session<xr::Vulkan>,
        size: [u32; 2],
    ) -> Result<Option<Self>, XrError> {
        let offered = session.enumerate_swapchain_formats().during("xrEnumerateSwapchainFormats")?;
        let Some(format) = depth_format(&offered) else {
            log::warn!(
                "the runtime takes none of the depth formats {DEPTH_FORMATS:?}: the compositor is not told how far away \
                 pixels are"
            );
            return Ok(None);
        };
        let wish = Wish { size, layers: 2, still: false, foveated: false };
        let made = Self::of_format(runtime, gpu, session, &wish, (format, vk::ImageAspectFlags::DEPTH))?;
        made.announce("depth images");
        Ok(Some(made))
    }

    fn announce(&self, what: &str) {
        let ([width, height], format) = (self.size, self.format);
        log::info!("{what}: {} of {width} x {height}, 2 layers, {format:?}", self.images.len());
    }

    fn of_format(
        runtime: &Runtime,
        gpu: &Arc<Gpu>,
        session: &xr::Session<xr::Vulkan>,
        wish: &Wish,
        (format, aspect): (vk::Format, vk::ImageAspectFlags),
    ) -> Result<Self, XrError> {
        let Wish { size, layers, still, foveated } = *wish;
        let mut usage_flags = xr::SwapchainUsageFlags::SAMPLED
            | if aspect == vk::ImageAspectFlags::DEPTH {
                xr::SwapchainUsageFlags::DEPTH_STENCIL_ATTACHMENT
            } else {
                xr::SwapchainUsageFlags::COLOR_ATTACHMENT
            };
        if still {
            usage_flags |= xr::SwapchainUsageFlags::TRANSFER_DST;
        } else if runtime.options.readable {
            usage_flags |= xr::SwapchainUsageFlags::TRANSFER_SRC;
        }
        let create_flags =
            if still { xr::SwapchainCreateFlags::STATIC_IMAGE } else { xr::SwapchainCreateFlags::EMPTY };
        let info = sys::SwapchainCreateInfo {
            ty: sys::SwapchainCreateInfo::TYPE,
            next: std::ptr::null(),
            create_flags,
            usage_flags,
            format: i64::from(format.as_raw()),
            sample_count: 1,
            width: size[0],
            height: size[1],
            face_count: 1,
            array_size: layers,
            mip_count: 1,
        };
        let (swapchain, raw) =
            if foveated { foveated_swapchain(session, info)? } else { plain_swapchain(session, &info)? };
        let images = Vec::new();
        let mut made = Self { gpu: gpu.clone(), swapchain, images, format, aspect, size, acquired: None };
        for [image, density] in raw {
            made.add(vk::Image::from_raw(image), vk::Image::from_raw(density), layers)?;
        }
        Ok(made)
    }

    fn add(&mut self, image: vk::Image, density: vk::Image, layers: u32) -> Result<(), XrError> {
        // Pushed first: whatever fails below, dropping destroys what was made.
        self.images.push(Viewed { image, views: [vk::ImageView::null(); 3], density: None });
        let Some(viewed) = self.images.last_mut() else { return Ok(()) };
        let gpu = &self.gpu;
        let make = |image, kind, format, aspect_mask, (first, count)| {
            let range = vk::ImageSubresourceRange {
                aspect_mask,
                base_mip_level: 0,
                level_count: 1,
                base_array_layer: first,
                layer_count: count,
            };
            let info = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(kind)
                .format(format)
                .subresource_range(range);
            // SAFETY: the runtime's image has these layers and this format and lives as long as the swapchain.
            let made = unsafe { gpu.device().create_image_view(&info, None) };
            made.map_err(|result| GpuError::Call { call: "vkCreateImageView", result })
        };
        let views: &[(u32, u32)] = if layers == 2 { &[(0, 2), (0, 1), (1, 1)] } else { &[(0, 1)] };
        for (view, &(first, count)) in viewed.views.iter_mut().zip(views) {
            let kind = if count > 1 { vk::ImageViewType::TYPE_2D_ARRAY } else { vk::ImageViewType::TYPE_2D };
            *view = make(image, kind, self.format, self.aspect, (first, count))?;
        }
        if density != vk::Image::null() {
            let array = vk::ImageViewType::TYPE_2D_ARRAY;
            let (format, aspect) = (vk::Format::R8G8_UNORM, vk::ImageAspectFlags::COLOR);
            viewed.density = Some(make(density, array, format, aspect, (0, layers))?);
        }
        Ok(())
    }

    /// The image to draw into; the same until it is released.
    pub fn acquire(&mut self) -> Result<Target, XrError> {
        let [all, left, right] = self.acquire_views()?;
        let density = self.acquired.and_then(|index| self.images[index].density);
        Ok(Target {
            all,
            layers: [left, right],
            format: self.format,
            size: self.size,
            layout: vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
            background_alpha: 1.0,
            depth: None,
            density,
        })
    }

    /// The depth image to write into; the same until it is released.
    pub fn acquire_depth(&mut self) -> Result<DepthTarget, XrError> {
        let [all, left, right] = self.acquire_views()?;
        Ok(DepthTarget {
            all,
            layers: [left, right],
            format: self.format,
            size: self.size,
            layout: vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL,
        })
    }

    fn acquire_views(&mut self) -> Result<[vk::ImageView; 3], XrError> {
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
        Ok(self.images[index].views)
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
        for viewed in self.images.drain(..) {
            for view in viewed.views.into_iter().chain(viewed.density) {
                // SAFETY: the device is idle. Null handles are ignored.
                unsafe { self.gpu.device().destroy_image_view(view, None) };
            }
        }
    }
}

type Made = (xr::Swapchain<xr::Vulkan>, Vec<[u64; 2]>);

fn plain_swapchain(
    session: &xr::Session<xr::Vulkan>,
    info: &sys::SwapchainCreateInfo,
) -> Result<Made, XrError> {
    let swapchain = session
        .create_swapchain(&xr::SwapchainCreateInfo {
            create_flags: info.create_flags,
            usage_flags: info.usage_flags,
            format: info.format as u32,
            sample_count: info.sample_count,
            width: info.width,
            height: info.height,
            face_count: info.face_count,
            array_size: info.array_size,
            mip_count: info.mip_count,
        })
        .during("xrCreateSwapchain")?;
    let images = swapchain.enumerate_images().during("xrEnumerateSwapchainImages")?;
    Ok((swapchain, images.into_iter().map(|image| [image, 0]).collect()))
}

fn foveated_swapchain(
    session: &xr::Session<xr::Vulkan>,
    info: sys::SwapchainCreateInfo,
) -> Result<Made, XrError> {
    let calls = session.instance().fp();
    // SAFETY: the session is alive, and what is made is owned by what is returned.
    unsafe {
        let raw = foveation::create_swapchain(calls.create_swapchain, session.as_raw(), info);
        let swapchain = xr::Swapchain::from_raw(session.clone(), raw.during("xrCreateSwapchain")?);
        let images = foveation::images(calls.enumerate_swapchain_images, swapchain.as_raw());
        Ok((swapchain, images.during("xrEnumerateSwapchainImages")?))
    }
}

/// The best depth format of those that a runtime offers.
fn depth_format(offered: &[u32]) -> Option<vk::Format> {
    DEPTH_FORMATS.into_iter().find(|f| offered.contains(&(f.as_raw() as u32)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_runtime_without_a_format_of_depth_alone_gets_none() {
        let offer = |formats: &[vk::Format]| formats.iter().map(|f| f.as_raw() as u32).collect::<Vec<_>>();
        let (rgba, both) = (vk::Format::R8G8B8A8_SRGB, vk::Format::D24_UNORM_S8_UINT);
        assert_eq!(depth_format(&offer(&[rgba, both])), None);
        let float = vk::Format::D32_SFLOAT;
        assert_eq!(depth_format(&offer(&[rgba, float])), Some(float));
        assert_eq!(depth_format(&offer(&[float, vk::Format::D16_UNORM])), Some(vk::Format::D16_UNORM));
    }
}
