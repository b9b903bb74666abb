//! Framebuffers, made on first use and kept until what they refer to goes.

use crate::gpu::{During, Gpu, GpuError};
use ash::vk;
use std::collections::HashMap;
use std::sync::Arc;

/// Most attachments of a pass: blended image, output, marks or distances, layer counts or median, density map.
const MOST: usize = 5;

/// Framebuffers by pass, attachments and size.
pub(super) struct Framebuffers {
    gpu: Arc<Gpu>,
    made: HashMap<(vk::RenderPass, [vk::ImageView; MOST], [u32; 2]), vk::Framebuffer>,
}

impl Framebuffers {
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: gpu.clone(), made: HashMap::new() }
    }

    /// The framebuffer of a pass with attachments, in the pass's order; null views are left out.
    pub fn of<const N: usize>(
        &mut self,
        pass: vk::RenderPass,
        views: [vk::ImageView; N],
        size: [u32; 2],
    ) -> Result<vk::Framebuffer, GpuError> {
        const { assert!(N <= MOST) };
        // An array: a frame allocates nothing.
        let mut key = [vk::ImageView::null(); MOST];
        key[..N].copy_from_slice(&views);
        if let Some(framebuffer) = self.made.get(&(pass, key, size)) {
            return Ok(*framebuffer);
        }
        let attachments: Vec<_> = views.into_iter().filter(|view| *view != vk::ImageView::null()).collect();
        let info = vk::FramebufferCreateInfo::default()
            .render_pass(pass)
            .attachments(&attachments)
            .width(size[0])
            .height(size[1])
            .layers(1);
        // SAFETY: pass and views are alive.
        let made =
            unsafe { self.gpu.device().create_framebuffer(&info, None) }.during("vkCreateFramebuffer")?;
        self.made.insert((pass, key, size), made);
        Ok(made)
    }

    /// Destroys them all. The device must be idle.
    pub fn forget(&mut self) {
        for (_, framebuffer) in self.made.drain() {
            // SAFETY: the device is idle.
            unsafe { self.gpu.device().destroy_framebuffer(framebuffer, None) };
        }
    }
}

impl Drop for Framebuffers {
    fn drop(&mut self) {
        // The renderer that owns this has waited for its frames.
        self.forget();
    }
}
