//! Pictures that are made once and shown on quads: the dark rim, and the ring of a landing place.

use super::Runtime;
use super::swapchain::{Images, Wish};
use crate::error::During;
use crate::{RIM_CLEAR, Surface, XrError};
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_app::headset::menu::MENU_SIZE;
use motes_renderer::Renderer;
use motes_renderer::gpu::{Buffer, Gpu};
use openxr as xr;
use std::sync::Arc;

/// Side of a picture, pixels: both are smooth.
const SIDE: u32 = 256;

/// The pictures of a session.
pub(super) struct Surfaces {
    rim: Images,
    landing: Images,
    panel: Images,
}

impl Surfaces {
    pub fn new(
        runtime: &Runtime,
        gpu: &Arc<Gpu>,
        session: &xr::Session<xr::Vulkan>,
    ) -> Result<Self, XrError> {
        Ok(Self {
            rim: still(runtime, gpu, session, rim)?,
            landing: still(runtime, gpu, session, landing)?,
            panel: Images::new(
                runtime,
                gpu,
                session,
                &Wish { size: MENU_SIZE, layers: 1, still: false, foveated: false },
            )?,
        })
    }

    /// The panel, to draw into.
    pub fn panel(&mut self) -> &mut Images {
        &mut self.panel
    }

    /// The picture of a surface, and its size.
    pub fn swapchain(&self, surface: Surface) -> &Images {
        match surface {
            Surface::Rim => &self.rim,
            Surface::Landing => &self.landing,
            Surface::Panel => &self.panel,
        }
    }
}

/// Light and opacity, `0 ..= 1`, premultiplied, at a distance from the middle in half sides.
type Paint = fn(f32) -> [f32; 2];

/// Black, clear in the middle.
fn rim(distance: f32) -> [f32; 2] {
    const SOFT: f32 = 0.4 * RIM_CLEAR;
    [0.0, ((distance - RIM_CLEAR) / SOFT + 0.5).clamp(0.0, 1.0)]
}

/// A white ring with a faint disc in it.
fn landing(distance: f32) -> [f32; 2] {
    let ring = 1.0 - ((distance - 0.85).abs() / 0.1).min(1.0);
    let disc = if distance < 0.85 { 0.15 } else { 0.0 };
    let opacity = ring.max(disc);
    [opacity, opacity]
}

fn still(
    runtime: &Runtime,
    gpu: &Arc<Gpu>,
    session: &xr::Session<xr::Vulkan>,
    paint: Paint,
) -> Result<Images, XrError> {
    let wish = Wish { size: [SIDE; 2], layers: 1, still: true, foveated: false };
    let mut images = Images::new(runtime, gpu, session, &wish)?;
    let mut bytes = Vec::with_capacity((4 * SIDE * SIDE) as usize);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let at = |i: u32| (i as f32 + 0.5) / (SIDE as f32 / 2.0) - 1.0;
            let [light, opacity] = paint(at(x).hypot(at(y))).map(|v| (v * 255.0).round() as u8);
            bytes.extend([light, light, light, opacity]);
        }
    }
    let mut buffer = Buffer::new(
        gpu,
        "picture of a quad",
        bytes.len() as u64,
        vk::BufferUsageFlags::TRANSFER_SRC,
        MemoryLocation::CpuToGpu,
    )?;
    buffer.mapped_mut()[..bytes.len()].copy_from_slice(&bytes);
    images.acquire()?;
    let Some(image) = images.current() else { return Ok(images) };
    // The renderer's frames are command buffers that are waited for: nothing else of it is used.
    let mut renderer = Renderer::new(gpu)?;
    let frame = renderer.begin()?;
    record_copy(gpu, frame.commands(), &buffer, image);
    renderer.finish(frame)?;
    images.release().map(|()| images)
}

fn record_copy(gpu: &Gpu, commands: vk::CommandBuffer, buffer: &Buffer, image: vk::Image) {
    use vk::{AccessFlags as Access, ImageLayout as Layout, PipelineStageFlags as Stage};
    let [target, drawn] = [Layout::TRANSFER_DST_OPTIMAL, Layout::COLOR_ATTACHMENT_OPTIMAL];
    let copied = (Stage::TRANSFER, Access::TRANSFER_WRITE);
    let copy = vk::BufferImageCopy {
        image_subresource: vk::ImageSubresourceLayers {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            mip_level: 0,
            base_array_layer: 0,
            layer_count: 1,
        },
        image_extent: vk::Extent3D { width: SIDE, height: SIDE, depth: 1 },
        ..Default::default()
    };
    let image_of = (image, 1);
    // SAFETY: the image is one layer of this size, acquired; the buffer holds it, and lives until the frame is done.
    unsafe {
        let free = (Stage::TOP_OF_PIPE, Access::empty());
        gpu.change_layout(commands, image_of, [Layout::UNDEFINED, target], free, copied);
        gpu.device().cmd_copy_buffer_to_image(commands, buffer.raw(), image, target, &[copy]);
        // Runtimes want images back in the layout for drawing.
        let read = (Stage::COLOR_ATTACHMENT_OUTPUT, Access::COLOR_ATTACHMENT_READ);
        gpu.change_layout(commands, image_of, [target, drawn], copied, read);
    }
}

/// What the runtime is told once when a session is there: clocks, and how many frames a second are wanted.
pub(super) fn tune(runtime: &Runtime, session: &xr::Session<xr::Vulkan>, refresh_rate: Option<f32>) {
    if let Some(calls) = &runtime.instance.exts().ext_performance_settings {
        for domain in [xr::sys::PerfSettingsDomainEXT::CPU, xr::sys::PerfSettingsDomainEXT::GPU] {
            let level = xr::sys::PerfSettingsLevelEXT::SUSTAINED_HIGH;
            // SAFETY: the session is alive.
            let result =
                unsafe { (calls.perf_settings_set_performance_level)(session.as_raw(), domain, level) };
            if result.into_raw() < 0 {
                log::warn!("xrPerfSettingsSetPerformanceLevelEXT: {result}");
            }
        }
    }
    if runtime.optional().refresh_rate {
        match session.enumerate_display_refresh_rates().during("xrEnumerateDisplayRefreshRatesFB") {
            Ok(rates) => {
                log::info!("display rates offered: {rates:?} Hz");
                if let Some((wanted, rate)) = refresh_rate.zip(refresh_rate.and_then(|r| nearest(&rates, r)))
                {
                    match session.request_display_refresh_rate(rate).during("xrRequestDisplayRefreshRateFB") {
                        Ok(()) => log::info!("display rate asked for: {rate} Hz, the nearest to {wanted}"),
                        Err(error) => log::warn!("{error}"),
                    }
                }
            }
            Err(error) => log::warn!("{error}"),
        }
    } else if let Some(wanted) = refresh_rate {
        log::warn!("{wanted} Hz cannot be asked for: the runtime chooses");
    }
}

/// The rate nearest to a wanted one; the greater of two that are as near.
fn nearest(rates: &[f32], wanted: f32) -> Option<f32> {
    let off = |rate: &f32| ((rate - wanted).abs(), -rate);
    rates.iter().copied().min_by(|a, b| off(a).partial_cmp(&off(b)).unwrap_or(std::cmp::Ordering::Equal))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_rate_is_asked_for() {
        let rates = [72.0, 80.0, 90.0, 120.0];
        for (wanted, rate) in [(90.0, 90.0), (60.0, 72.0), (100.0, 90.0), (105.0, 120.0), (500.0, 120.0)] {
            assert_eq!(nearest(&rates, wanted), Some(rate), "{wanted}");
        }
        assert_eq!(nearest(&[], 90.0), None);
    }

    #[test]
    fn the_rim_is_clear_in_the_middle_and_black_outside() {
        assert_eq!(rim(0.0), [0.0, 0.0]);
        assert_eq!(rim(1.4), [0.0, 1.0]);
        assert!((rim(RIM_CLEAR)[1] - 0.5).abs() < 1e-6);
        let [light, opacity] = landing(0.85);
        assert!(light <= opacity && opacity > 0.9, "premultiplied");
        assert_eq!(landing(1.0), [0.0, 0.0]);
    }
}
