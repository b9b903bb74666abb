//! The window's images: a surface, its swapchain, and the semaphores that go with them.

use std::sync::Arc;

use ash::vk;
use motes_renderer::gpu::{During, Gpu, GpuError};
use raw_window_handle::{RawDisplayHandle, RawWindowHandle};

/// Frames that may be under way at once, as in the renderer.
pub const FRAMES: usize = 2;

/// A surface and its swapchain.
pub struct Swapchain {
    gpu: Arc<Gpu>,
    surface_calls: ash::khr::surface::Instance,
    calls: ash::khr::swapchain::Device,
    surface: vk::SurfaceKHR,
    raw: vk::SwapchainKHR,
    images: Vec<vk::Image>,
    views: Vec<vk::ImageView>,
    /// Signalled when an image may be written, one a frame.
    free: Vec<vk::Semaphore>,
    /// Signalled when an image may be shown, one an image: it waits as long as the image is on the screen.
    drawn: Vec<vk::Semaphore>,
    format: vk::SurfaceFormatKHR,
    size: [u32; 2],
    paced: bool,
}

/// An image to draw into.
#[derive(Clone, Copy, Debug)]
pub struct Acquired {
    /// Its place in the swapchain.
    pub index: u32,
    /// The image.
    pub image: vk::Image,
    /// A view of it.
    pub view: vk::ImageView,
    /// To wait for before it is written.
    pub free: vk::Semaphore,
    /// To signal when it is done.
    pub drawn: vk::Semaphore,
}

impl Swapchain {
    /// A swapchain for a window. `paced`: waits for the screen, so that frames come at its rate.
    ///
    /// # Errors
    /// The window system's or the driver's.
    pub fn new(
        gpu: &Arc<Gpu>,
        display: RawDisplayHandle,
        window: RawWindowHandle,
        size: [u32; 2],
        paced: bool,
    ) -> Result<Self, GpuError> {
        // SAFETY: the caller's window outlives the swapchain.
        let surface =
            unsafe { ash_window::create_surface(gpu.entry(), gpu.instance(), display, window, None) };
        let surface = surface.during("vkCreateSurfaceKHR")?;
        let mut swapchain = Self {
            gpu: gpu.clone(),
            surface_calls: ash::khr::surface::Instance::new(gpu.entry(), gpu.instance()),
            calls: ash::khr::swapchain::Device::new(gpu.instance(), gpu.device()),
            surface,
            raw: vk::SwapchainKHR::null(),
            images: Vec::new(),
            views: Vec::new(),
            free: Vec::new(),
            drawn: Vec::new(),
            format: vk::SurfaceFormatKHR::default(),
            size,
            paced,
        };
        swapchain.choose_format()?;
        for _ in 0..FRAMES {
            let semaphore = swapchain.semaphore()?;
            swapchain.free.push(semaphore);
        }
        swapchain.resize(size)?;
        Ok(swapchain)
    }

    fn semaphore(&self) -> Result<vk::Semaphore, GpuError> {
        // SAFETY: the structure is complete.
        let made = unsafe { self.gpu.device().create_semaphore(&vk::SemaphoreCreateInfo::default(), None) };
        made.during("vkCreateSemaphore")
    }

    fn choose_format(&mut self) -> Result<(), GpuError> {
        let physical = self.gpu.physical();
        // SAFETY: surface and device are alive.
        let (supported, formats) = unsafe {
            (
                self.surface_calls.get_physical_device_surface_support(
                    physical,
                    self.gpu.queue_family(),
                    self.surface,
                ),
                self.surface_calls.get_physical_device_surface_formats(physical, self.surface),
            )
        };
        if !supported.during("vkGetPhysicalDeviceSurfaceSupportKHR")? {
            let name = &self.gpu.capabilities.device;
            return Err(GpuError::NoDevice(format!("{name} cannot show pictures in this window")));
        }
        // Values are written sRGB-encoded already, so the format must not encode them again.
        let plain = [vk::Format::B8G8R8A8_UNORM, vk::Format::R8G8B8A8_UNORM];
        let formats = formats.during("vkGetPhysicalDeviceSurfaceFormatsKHR")?;
        let found = formats.iter().find(|f| plain.contains(&f.format));
        self.format = *found.ok_or_else(|| {
            GpuError::NoDevice(format!("the window offers none of {plain:?}, only {formats:?}"))
        })?;
        Ok(())
    }

    /// Makes the images anew, for a window of this size. The device must be idle.
    ///
    /// # Errors
    /// The driver's.
    pub fn resize(&mut self, size: [u32; 2]) -> Result<(), GpuError> {
        self.forget_images();
        let physical = self.gpu.physical();
        // SAFETY: surface and device are alive.
        let (capabilities, modes) = unsafe {
            (
                self.surface_calls.get_physical_device_surface_capabilities(physical, self.surface),
                self.surface_calls.get_physical_device_surface_present_modes(physical, self.surface),
            )
        };
        let capabilities = capabilities.during("vkGetPhysicalDeviceSurfaceCapabilitiesKHR")?;
        let modes = modes.during("vkGetPhysicalDeviceSurfacePresentModesKHR")?;
        let (low, high) = (capabilities.min_image_extent, capabilities.max_image_extent);
        let extent = if capabilities.current_extent.width == u32::MAX {
            vk::Extent2D {
                width: size[0].clamp(low.width, high.width.max(low.width)),
                height: size[1].clamp(low.height, high.height.max(low.height)),
            }
        } else {
            capabilities.current_extent
        };
        self.size = [extent.width, extent.height];
        if extent.width == 0 || extent.height == 0 {
            return Ok(()); // minimised: nothing is shown until the window has a size again
        }
        let most = if capabilities.max_image_count == 0 { u32::MAX } else { capabilities.max_image_count };
        let mode = if !self.paced && modes.contains(&vk::PresentModeKHR::MAILBOX) {
            vk::PresentModeKHR::MAILBOX
        } else if !self.paced && modes.contains(&vk::PresentModeKHR::IMMEDIATE) {
            vk::PresentModeKHR::IMMEDIATE
        } else {
            vk::PresentModeKHR::FIFO
        };
        let old = self.raw;
        let alpha = if capabilities.supported_composite_alpha.contains(vk::CompositeAlphaFlagsKHR::OPAQUE) {
            vk::CompositeAlphaFlagsKHR::OPAQUE
        } else {
            vk::CompositeAlphaFlagsKHR::INHERIT
        };
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(self.surface)
            .min_image_count((capabilities.min_image_count + 1).min(most))
            .image_format(self.format.format)
            .image_color_space(self.format.color_space)
            .image_extent(extent)
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(capabilities.current_transform)
            .composite_alpha(alpha)
            .present_mode(mode)
            .clipped(true)
            .old_swapchain(old);
        // SAFETY: the old swapchain's images are not in use.
        unsafe {
            let made = self.calls.create_swapchain(&info, None).during("vkCreateSwapchainKHR");
            self.calls.destroy_swapchain(old, None);
            self.raw = vk::SwapchainKHR::null();
            self.raw = made?;
            self.images = self.calls.get_swapchain_images(self.raw).during("vkGetSwapchainImagesKHR")?;
        }
        for &image in &self.images {
            let info = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(self.format.format)
                .subresource_range(vk::ImageSubresourceRange {
                    aspect_mask: vk::ImageAspectFlags::COLOR,
                    base_mip_level: 0,
                    level_count: 1,
                    base_array_layer: 0,
                    layer_count: 1,
                });
            // SAFETY: the image is alive.
            let view = unsafe { self.gpu.device().create_image_view(&info, None) };
            self.views.push(view.during("vkCreateImageView")?);
            let semaphore = self.semaphore()?;
            self.drawn.push(semaphore);
        }
        Ok(())
    }

    /// Width and height, pixels; 0 while minimised.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Format of the images.
    pub fn format(&self) -> vk::Format {
        self.format.format
    }

    /// The next image, for the frame in a slot; nothing where the swapchain must be made anew.
    ///
    /// # Errors
    /// The surface or the device was lost.
    pub fn acquire(&self, slot: usize) -> Result<Option<Acquired>, GpuError> {
        if self.raw == vk::SwapchainKHR::null() {
            return Ok(None);
        }
        let free = self.free[slot % FRAMES];
        // SAFETY: the frame before in this slot is done, so its semaphore was waited for.
        match unsafe { self.calls.acquire_next_image(self.raw, u64::MAX, free, vk::Fence::null()) } {
            // A swapchain that fits badly still shows this frame; presenting tells again.
            Ok((index, _)) => {
                let i = index as usize;
                Ok(Some(Acquired {
                    index,
                    image: self.images[i],
                    view: self.views[i],
                    free,
                    drawn: self.drawn[i],
                }))
            }
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => Ok(None),
            Err(result) => Err(GpuError::Call { call: "vkAcquireNextImageKHR", result }),
        }
    }

    /// Shows an image. Returns whether the swapchain still fits its window.
    ///
    /// # Errors
    /// The surface or the device was lost.
    pub fn present(&self, acquired: &Acquired) -> Result<bool, GpuError> {
        let (swapchains, indices, waits) = ([self.raw], [acquired.index], [acquired.drawn]);
        let info = vk::PresentInfoKHR::default()
            .wait_semaphores(&waits)
            .swapchains(&swapchains)
            .image_indices(&indices);
        let queue = self.gpu.queue();
        // SAFETY: the image was acquired, and the semaphore is signalled by the frame that drew it.
        match unsafe { self.calls.queue_present(*queue, &info) } {
            Ok(suboptimal) => Ok(!suboptimal),
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => Ok(false),
            Err(result) => Err(GpuError::Call { call: "vkQueuePresentKHR", result }),
        }
    }

    fn forget_images(&mut self) {
        for view in self.views.drain(..) {
            // SAFETY: the device is idle.
            unsafe { self.gpu.device().destroy_image_view(view, None) };
        }
        for semaphore in self.drawn.drain(..) {
            // SAFETY: as above.
            unsafe { self.gpu.device().destroy_semaphore(semaphore, None) };
        }
        self.images.clear();
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        if let Err(error) = self.gpu.wait_idle() {
            log::error!("{error}");
        }
        self.forget_images();
        // SAFETY: the device is idle; the window is still alive. Null handles are ignored.
        unsafe {
            for semaphore in self.free.drain(..) {
                self.gpu.device().destroy_semaphore(semaphore, None);
            }
            self.calls.destroy_swapchain(self.raw, None);
            self.surface_calls.destroy_surface(self.surface, None);
        }
    }
}
