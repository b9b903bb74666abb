//! Frames onto the window: the splats into an image of one layer an eye, copied side by side, and the panel over it.

use std::sync::Arc;

use ash::vk;
use egui::{ClippedPrimitive, TexturesDelta};
use motes_app::painter::{Before, Painter, PainterError};
use motes_app::viewer::{Figures, Viewer};
use motes_renderer::gpu::{Gpu, GpuError, Image, ImageDescription};
use motes_renderer::pipeline_cache;
use motes_renderer::{
    ConfigError, DrawRequest, Lens, Offscreen, RenderConfig, Renderer, SceneOnDevice, Stereo, Target, View,
};
use winit::raw_window_handle::{RawDisplayHandle, RawWindowHandle};

use super::swapchain::{Acquired, FRAMES, Swapchain};
use crate::error::CommandError;
use crate::measure::Picture;
use crate::studio::{picture_of, side_by_side};

/// Draws frames. Fields go in this order.
pub struct Screen {
    /// What the last frames took.
    pub figures: Figures,
    painter: Painter,
    eyes: Option<Image>,
    renderer: Renderer,
    /// Takes pictures for files; made with the first.
    offscreen: Option<Offscreen>,
    swapchain: Swapchain,
    gpu: Arc<Gpu>,
    /// The window's size, where the swapchain does not fit it any more.
    stale: Option<[u32; 2]>,
    frames: usize,
    /// Further frames that what is shown is not finished without, if nothing moves.
    pub lacks: usize,
    /// The last configuration that the device accepted.
    accepted: RenderConfig,
    /// Whether another expansion may take the default one's place where the device draws with it faster.
    pub suit_device: bool,
}

impl Screen {
    /// For a window that outlives it.
    ///
    /// # Errors
    /// The window system's or the driver's.
    pub fn new(
        gpu: &Arc<Gpu>,
        display: RawDisplayHandle,
        window: RawWindowHandle,
        size: [u32; 2],
        paced: bool,
    ) -> Result<Self, CommandError> {
        let swapchain = Swapchain::new(gpu, display, window, size, paced)?;
        let before = Before::Picture(vk::ImageLayout::TRANSFER_DST_OPTIMAL);
        let painter =
            Painter::new(gpu, swapchain.format(), before, vk::ImageLayout::PRESENT_SRC_KHR, FRAMES)?;
        let mut renderer = Renderer::new(gpu)?;
        renderer.average_samples(true);
        match pipeline_cache::default_folder() {
            Some(folder) => drop(renderer.keep_pipelines(&folder)?),
            None => log::warn!("the system names no cache folder: pipelines are made anew at every start"),
        }
        Ok(Self {
            figures: Figures::default(),
            painter,
            eyes: None,
            renderer,
            offscreen: None,
            swapchain,
            gpu: gpu.clone(),
            stale: None,
            frames: 0,
            lacks: 0,
            accepted: RenderConfig::default(),
            suit_device: false,
        })
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.swapchain.size()
    }

    /// The window has another size.
    pub fn resize(&mut self, size: [u32; 2]) {
        self.stale = Some(size);
    }

    fn fit(&mut self) -> Result<(), CommandError> {
        if let Some(size) = self.stale.take() {
            self.gpu.wait_idle()?;
            self.painter.forget_targets()?;
            self.swapchain.resize(size)?;
        }
        Ok(())
    }

    /// Draws a frame and shows it; `seconds` since the one before, where it followed without a pause.
    ///
    /// # Errors
    /// The device was lost, or is out of memory. Choices that it does not offer are the viewer's message, and the last
    /// ones that it took are drawn.
    pub fn draw(
        &mut self,
        viewer: &mut Viewer,
        seconds: Option<f64>,
        textures: TexturesDelta,
        shapes: &[ClippedPrimitive],
        pixels_per_point: f32,
    ) -> Result<(), CommandError> {
        self.lacks = 0;
        self.painter.update(textures)?;
        self.fit()?;
        let size = self.swapchain.size();
        if size.contains(&0) {
            return Ok(());
        }
        let views = viewer.views(size);
        let config = self.accept(viewer, &views);
        if viewer.stage.is_some() {
            self.fit_eyes(&views)?;
        }
        let frame = self.renderer.begin()?;
        let commands = frame.commands();
        self.figures.add(seconds, self.renderer.last_report());
        viewer.govern(&self.figures.report);
        self.frames += 1;
        let Some(acquired) = self.swapchain.acquire(self.frames)? else {
            self.stale = self.stale.or(Some(size));
            return Ok(self.renderer.submit(frame, &[], &[])?);
        };
        // A budget is that of a headset, which draws polygons.
        let suit_device = self.suit_device && viewer.governor.is_none();
        match (viewer.frame(&views, &config), &self.eyes) {
            (Some((scene, order)), Some(eyes)) => {
                let target = Target {
                    all: eyes.view(),
                    layers: [eyes.layer_view(0), eyes.layer_view(1)],
                    format: eyes.description().format,
                    size: eyes.description().size,
                    layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
                    background_alpha: 1.0,
                    depth: None,
                    density: None,
                };
                let one_pass = self.gpu.capabilities.multiview && !config.sort_per_eye;
                let stereo = if one_pass { Stereo::Multiview } else { Stereo::TwoPass };
                let config = suited(&self.gpu, suit_device, config, scene, &views);
                if self.figures.expansion.replace(config.expansion) != Some(config.expansion) {
                    log::info!("splats are drawn by {}", config.expansion);
                }
                let request =
                    DrawRequest { scene, order, views: &views, config: &config, target: &target, stereo };
                self.renderer.draw(&frame, &request)?;
                self.lacks = self.renderer.lacks() as usize;
                to_window(&self.gpu, commands, &acquired, Some(eyes), size, views.len());
            }
            _ => to_window(&self.gpu, commands, &acquired, None, size, 0),
        }
        self.painter.draw(commands, acquired.view, size, pixels_per_point, shapes)?;
        let wait = [(acquired.free, vk::PipelineStageFlags::TRANSFER)];
        self.renderer.submit(frame, &wait, &[acquired.drawn])?;
        if !self.swapchain.present(&acquired)? {
            self.stale = self.stale.or(Some(size));
        }
        Ok(())
    }

    /// The viewer's configuration where the device takes it, else the last one that it took.
    fn accept(&mut self, viewer: &mut Viewer, views: &[View]) -> RenderConfig {
        let config = viewer.frame_config();
        match for_screens(&config).and_then(|()| config.check(views.len(), &self.gpu.capabilities)) {
            Ok(()) => self.accepted.clone_from(&config),
            Err(error) => viewer.message = Some(error.to_string()),
        }
        self.accepted.clone()
    }

    fn fit_eyes(&mut self, views: &[View]) -> Result<(), GpuError> {
        let description = ImageDescription {
            format: self.swapchain.format(),
            size: views.first().map_or([1, 1], |v| v.size),
            layers: views.len() as u32,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC,
            aspect: vk::ImageAspectFlags::COLOR,
        };
        if self.eyes.as_ref().is_none_or(|i| i.description() != description) {
            self.renderer.forget_targets()?;
            self.eyes = None;
            self.eyes = Some(Image::new(&self.gpu, "eyes", description)?);
        }
        Ok(())
    }

    /// What is shown, without the panel, both eyes side by side.
    ///
    /// # Errors
    /// There is no scene yet, or the driver's.
    pub fn picture(&mut self, viewer: &mut Viewer) -> Result<Picture, CommandError> {
        side_by_side(&self.pictures(viewer, &viewer.views(self.swapchain.size()))?)
    }

    /// The scene that is shown, from these views.
    ///
    /// # Errors
    /// There is no scene yet, or the driver's.
    pub fn pictures(&mut self, viewer: &mut Viewer, views: &[View]) -> Result<Vec<Picture>, CommandError> {
        let config = self.accept(viewer, views);
        let Some(stage) = &viewer.stage else {
            return Err(CommandError::Usage("there is no scene to take a picture of yet".into()));
        };
        let offscreen = match &mut self.offscreen {
            Some(offscreen) => offscreen,
            none => none.insert(Offscreen::new(&self.gpu)?),
        };
        let suit_device = self.suit_device && viewer.governor.is_none();
        let config = suited(&self.gpu, suit_device, config, stage.shown(), views);
        let (pictures, _) = offscreen.render(stage.shown(), views, &config)?;
        pictures.iter().map(picture_of).collect()
    }
}

/// A configuration, with the expansion that suits the device where that is left to it.
fn suited(
    gpu: &Gpu,
    left: bool,
    config: RenderConfig,
    scene: &SceneOnDevice,
    views: &[View],
) -> RenderConfig {
    if left { config.on(&gpu.capabilities, scene.splats, views) } else { config }
}

/// Lenses other than perspective are for pictures.
fn for_screens(config: &RenderConfig) -> Result<(), ConfigError> {
    if config.lens == Lens::Perspective {
        return Ok(());
    }
    let lens = config.lens;
    Err(ConfigError(format!(
        "lens {lens}: a window shows perspective; take a picture by motes render --lens {lens}"
    )))
}

impl From<PainterError> for CommandError {
    fn from(error: PainterError) -> Self {
        match error {
            PainterError::Gpu(error) => Self::Gpu(error),
            PainterError::Panel(_) => Self::Failed(error.to_string()),
        }
    }
}

/// Brings the eyes' pictures onto the window's image, which is left as a copy's destination; without eyes it is grey.
pub fn to_window(
    gpu: &Gpu,
    commands: vk::CommandBuffer,
    acquired: &Acquired,
    eyes: Option<&Image>,
    size: [u32; 2],
    layers: usize,
) {
    let device = gpu.device();
    let range = vk::ImageSubresourceRange {
        aspect_mask: vk::ImageAspectFlags::COLOR,
        base_mip_level: 0,
        level_count: 1,
        base_array_layer: 0,
        layer_count: 1,
    };
    let transfer = vk::PipelineStageFlags::TRANSFER;
    let to = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
    let (free, write) = ((transfer, vk::AccessFlags::empty()), (transfer, vk::AccessFlags::TRANSFER_WRITE));
    let grey = vk::ClearColorValue { float32: [0.06, 0.06, 0.07, 1.0] };
    let covered = eyes.map_or([0, 0], |e| [e.description().size[0] * layers as u32, e.description().size[1]]);
    // SAFETY: the images are alive, and what is copied lies within both. The semaphore that the frame waits for at
    // this stage says when the window's image may be written.
    unsafe {
        gpu.change_layout(commands, (acquired.image, 1), [vk::ImageLayout::UNDEFINED, to], free, write);
        if covered != size {
            // An odd column at the side of two eyes, or no scene at all.
            device.cmd_clear_color_image(commands, acquired.image, to, &grey, &[range]);
            gpu.change_layout(commands, (acquired.image, 1), [to, to], write, write);
        }
        let Some(eyes) = eyes else { return };
        let [width, height] = eyes.description().size;
        let layer = |base_array_layer| vk::ImageSubresourceLayers {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            mip_level: 0,
            base_array_layer,
            layer_count: 1,
        };
        let copies: Vec<_> = (0..layers as u32)
            .map(|eye| {
                vk::ImageCopy::default()
                    .src_subresource(layer(eye))
                    .dst_subresource(layer(0))
                    .dst_offset(vk::Offset3D { x: (eye * width) as i32, y: 0, z: 0 })
                    .extent(vk::Extent3D {
                        width: width.min(size[0] - (eye * width).min(size[0])),
                        height: height.min(size[1]),
                        depth: 1,
                    })
            })
            .collect();
        device.cmd_copy_image(
            commands,
            eyes.raw(),
            vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            acquired.image,
            to,
            &copies,
        );
    }
}
