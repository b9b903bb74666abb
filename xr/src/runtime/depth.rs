//! How far away pixels are, for the compositor (`XR_KHR_composition_layer_depth`): an image of its own beside the eyes', which
//! it may shift the eyes' images by.

use super::Runtime;
use super::session::part;
use super::swapchain::Images;
use crate::XrError;
use motes_renderer::DepthTarget;
use motes_renderer::gpu::Gpu;
use openxr as xr;
use openxr::sys;
use std::sync::Arc;

/// The depth images of a session.
pub(super) struct Depth {
    images: Images,
    /// What depth 1 stands for in the image that is being written, metres.
    near: Option<f32>,
}

impl Depth {
    /// Where they are asked for and the runtime takes them.
    pub fn new(
        runtime: &Runtime,
        gpu: &Arc<Gpu>,
        session: &xr::Session<xr::Vulkan>,
        size: [u32; 2],
    ) -> Result<Option<Self>, XrError> {
        if !(runtime.options.depth_layer && runtime.optional().depth_layer) {
            return Ok(None);
        }
        if !gpu.capabilities.multiview {
            log::warn!("no multiview: the compositor is not told how far away pixels are");
            return Ok(None);
        }
        let images = Images::depth(runtime, gpu, session, size)?;
        Ok(images.map(|images| Self { images, near: None }))
    }

    /// The image to write into; `near`: what depth 1 stands for, metres.
    pub fn acquire(&mut self, near: f32) -> Result<DepthTarget, XrError> {
        self.near = Some(near);
        self.images.acquire_depth()
    }

    /// Gives the image to the compositor, where one was acquired: what depth 1 stands for then.
    pub fn release(&mut self) -> Result<Option<f32>, XrError> {
        self.images.release()?;
        Ok(self.near.take())
    }

    pub fn images(&self) -> &Images {
        &self.images
    }
}

/// What goes with each eye: depth 0 is infinitely far, 1 is near. (OpenXR 1.1, section 12.36: the value `minDepth` stands for
/// `nearZ` and `maxDepth` for `farZ`, either may be infinite, and reversed depth has the greater one as `nearZ`.)
pub(super) fn depth_infos(images: &Images, near: f32) -> [sys::CompositionLayerDepthInfoKHR; 2] {
    [0, 1].map(|eye| reversed(part(images, eye).into_raw(), near))
}

fn reversed(sub_image: sys::SwapchainSubImage, near: f32) -> sys::CompositionLayerDepthInfoKHR {
    sys::CompositionLayerDepthInfoKHR {
        ty: sys::CompositionLayerDepthInfoKHR::TYPE,
        next: std::ptr::null(),
        sub_image,
        min_depth: 0.0,
        max_depth: 1.0,
        near_z: f32::INFINITY,
        far_z: near,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use openxr::sys::Handle as _;

    /// The distance that a depth value stands for, as a compositor computes it: closeness is linear in the value between the
    /// planes' (a perspective projection's depth).
    fn distance(info: &sys::CompositionLayerDepthInfoKHR, value: f32) -> f32 {
        let part = (value - info.min_depth) / (info.max_depth - info.min_depth);
        1.0 / (1.0 / info.near_z + part * (1.0 / info.far_z - 1.0 / info.near_z))
    }

    #[test]
    fn a_compositor_reads_the_distance_that_was_written() {
        let image = sys::SwapchainSubImage {
            swapchain: sys::Swapchain::NULL,
            image_rect: xr::Rect2Di::default(),
            image_array_index: 1,
        };
        let info = reversed(image, 0.05);
        assert!(info.min_depth < info.max_depth && info.near_z != info.far_z && info.far_z > 0.0);
        for metres in [0.05f32, 0.3, 2.0, 700.0] {
            let read = distance(&info, 0.05 / metres);
            assert!((read / metres - 1.0).abs() < 1e-5, "{read} {metres}");
        }
        assert_eq!(distance(&info, 0.0), f32::INFINITY);
        // Control: the planes the other way round would be read wrongly.
        let swapped = sys::CompositionLayerDepthInfoKHR { near_z: info.far_z, far_z: info.near_z, ..info };
        assert!((distance(&swapped, 0.05 / 2.0) / 2.0 - 1.0).abs() > 0.5);
    }
}
