//! Buffers and images that free themselves, each with a name.

use super::error::During;
use super::{Gpu, GpuError};
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use std::sync::Arc;

/// A buffer and its memory.
pub struct Buffer {
    gpu: Arc<Gpu>,
    raw: vk::Buffer,
    allocation: Option<Allocation>,
    bytes: u64,
}

impl Buffer {
    /// A buffer of at least one word, so that it can always be bound.
    ///
    /// # Errors
    /// Out of memory; the error says for what.
    pub fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Self, GpuError> {
        let bytes = bytes.max(16);
        let info =
            vk::BufferCreateInfo::default().size(bytes).usage(usage).sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: `info` is complete.
        let raw = unsafe { gpu.device().create_buffer(&info, None) }.during("vkCreateBuffer")?;
        // The handle is owned from here on: whatever fails below, dropping frees it.
        let mut buffer = Self { gpu: gpu.clone(), raw, allocation: None, bytes };
        // SAFETY: `raw` was just made.
        let requirements = unsafe { gpu.device().get_buffer_memory_requirements(raw) };
        let allocation = gpu
            .allocator()
            .allocate(&AllocationCreateDesc {
                name,
                requirements,
                location,
                linear: true,
                allocation_scheme: AllocationScheme::GpuAllocatorManaged,
            })
            .map_err(|e| GpuError::Memory { name: name.to_owned(), bytes, problem: e.to_string() })?;
        // SAFETY: memory and offset come from the allocator, for this buffer's requirements.
        unsafe { gpu.device().bind_buffer_memory(raw, allocation.memory(), allocation.offset()) }
            .during("vkBindBufferMemory")?;
        buffer.allocation = Some(allocation);
        gpu.name(raw, name);
        Ok(buffer)
    }

    /// The handle.
    pub fn raw(&self) -> vk::Buffer {
        self.raw
    }

    /// Size in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The mapped memory of a host-visible buffer; empty for others.
    pub fn mapped(&self) -> &[u8] {
        self.allocation.as_ref().and_then(|a| a.mapped_slice()).unwrap_or_default()
    }

    /// The mapped memory of a host-visible buffer; empty for others.
    pub fn mapped_mut(&mut self) -> &mut [u8] {
        self.allocation.as_mut().and_then(|a| a.mapped_slice_mut()).unwrap_or_default()
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: whoever drops a buffer has waited for the frames that use it.
        unsafe { self.gpu.device().destroy_buffer(self.raw, None) };
        if let Some(allocation) = self.allocation.take()
            && let Err(e) = self.gpu.allocator().free(allocation)
        {
            log::error!("freeing a buffer: {e}");
        }
    }
}

/// What an image is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageDescription {
    /// Format.
    pub format: vk::Format,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Array layers (views).
    pub layers: u32,
    /// What it is used for.
    pub usage: vk::ImageUsageFlags,
    /// Colour or depth.
    pub aspect: vk::ImageAspectFlags,
}

/// An image, its memory, a view of all its layers and one of each.
pub struct Image {
    gpu: Arc<Gpu>,
    raw: vk::Image,
    view: vk::ImageView,
    layer_views: Vec<vk::ImageView>,
    array_view: vk::ImageView,
    allocation: Option<Allocation>,
    description: ImageDescription,
}

impl Image {
    /// A new image of undefined content.
    ///
    /// # Errors
    /// Out of memory, or a size beyond the device's.
    pub fn new(gpu: &Arc<Gpu>, name: &str, description: ImageDescription) -> Result<Self, GpuError> {
        let [width, height] = description.size;
        let most = gpu.capabilities.max_image_side;
        if width == 0 || height == 0 || width > most || height > most {
            return Err(GpuError::Unsupported {
                wanted: format!("an image of {width} x {height} pixels ({name})"),
                device: gpu.capabilities.device.clone(),
                remedy: format!("Choose 1 to {most} pixels a side"),
            });
        }
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(description.format)
            .extent(vk::Extent3D { width, height, depth: 1 })
            .mip_levels(1)
            .array_layers(description.layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(description.usage)
            .sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: `info` is complete.
        let raw = unsafe { gpu.device().create_image(&info, None) }.during("vkCreateImage")?;
        let mut image = Self {
            gpu: gpu.clone(),
            raw,
            view: vk::ImageView::null(),
            layer_views: Vec::new(),
            array_view: vk::ImageView::null(),
            allocation: None,
            description,
        };
        // SAFETY: `raw` was just made.
        let requirements = unsafe { gpu.device().get_image_memory_requirements(raw) };
        let allocation = gpu
            .allocator()
            .allocate(&AllocationCreateDesc {
                name,
                requirements,
                location: MemoryLocation::GpuOnly,
                linear: false,
                allocation_scheme: AllocationScheme::GpuAllocatorManaged,
            })
            .map_err(|e| GpuError::Memory {
                name: name.to_owned(),
                bytes: requirements.size,
                problem: e.to_string(),
            })?;
        // SAFETY: memory and offset come from the allocator, for this image's requirements.
        unsafe { gpu.device().bind_image_memory(raw, allocation.memory(), allocation.offset()) }
            .during("vkBindImageMemory")?;
        image.allocation = Some(allocation);
        gpu.name(raw, name);
        let viewable = vk::ImageUsageFlags::SAMPLED
            | vk::ImageUsageFlags::STORAGE
            | vk::ImageUsageFlags::COLOR_ATTACHMENT
            | vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT
            | vk::ImageUsageFlags::INPUT_ATTACHMENT;
        if description.usage.intersects(viewable) {
            let kind = |layers| {
                if layers > 1 { vk::ImageViewType::TYPE_2D_ARRAY } else { vk::ImageViewType::TYPE_2D }
            };
            image.view = image.make_view(kind(description.layers), 0, description.layers)?;
            for layer in 0..description.layers {
                let view = image.make_view(kind(1), layer, 1)?;
                image.layer_views.push(view);
            }
            if description.usage.contains(vk::ImageUsageFlags::SAMPLED) {
                image.array_view =
                    image.make_view(vk::ImageViewType::TYPE_2D_ARRAY, 0, description.layers)?;
            }
        }
        Ok(image)
    }

    fn make_view(&self, kind: vk::ImageViewType, first: u32, count: u32) -> Result<vk::ImageView, GpuError> {
        let info = vk::ImageViewCreateInfo::default()
            .image(self.raw)
            .view_type(kind)
            .format(self.description.format)
            .subresource_range(vk::ImageSubresourceRange {
                aspect_mask: self.description.aspect,
                base_mip_level: 0,
                level_count: 1,
                base_array_layer: first,
                layer_count: count,
            });
        // SAFETY: the image is alive and has these layers.
        unsafe { self.gpu.device().create_image_view(&info, None) }.during("vkCreateImageView")
    }

    /// The handle.
    pub fn raw(&self) -> vk::Image {
        self.raw
    }

    /// A view of all layers.
    pub fn view(&self) -> vk::ImageView {
        self.view
    }

    /// A view of all layers as an array, however many there are; of sampled images only.
    pub fn array_view(&self) -> vk::ImageView {
        self.array_view
    }

    /// A view of one layer.
    pub fn layer_view(&self, layer: u32) -> vk::ImageView {
        self.layer_views.get(layer as usize).copied().unwrap_or(self.view)
    }

    /// What it is.
    pub fn description(&self) -> ImageDescription {
        self.description
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        // SAFETY: whoever drops an image has waited for the frames that use it. Null handles are ignored.
        unsafe {
            for view in self.layer_views.drain(..) {
                self.gpu.device().destroy_image_view(view, None);
            }
            self.gpu.device().destroy_image_view(self.view, None);
            self.gpu.device().destroy_image_view(self.array_view, None);
            self.gpu.device().destroy_image(self.raw, None);
        }
        if let Some(allocation) = self.allocation.take()
            && let Err(e) = self.gpu.allocator().free(allocation)
        {
            log::error!("freeing an image: {e}");
        }
    }
}
