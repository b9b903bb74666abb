//! Takes pictures of a scene without a window: on the device, or by the reference renderer.

use std::sync::Arc;

use motes_renderer::gpu::{Gpu, GpuOptions, Plain};
use motes_renderer::reference::{self, ReferenceOptions, ReferenceOrder};
use motes_renderer::{
    FrameReport, Offscreen, OrderKey, Packing, RenderConfig, SceneOnDevice, View, midpoint,
};
use motes_scenes::Splats;

use crate::error::CommandError;
use crate::measure::Picture;

/// Which device.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Device")]
pub struct DeviceArgs {
    /// A device whose name contains this
    #[arg(long, value_name = "NAME")]
    pub device: Option<String>,
    /// Turn the validation layer on; what it says makes the command fail
    #[arg(long)]
    pub validation: bool,
}

impl DeviceArgs {
    /// The device, for drawing offscreen.
    ///
    /// # Errors
    /// There is none.
    pub fn offscreen(&self) -> Result<Arc<Gpu>, CommandError> {
        let way = Plain { device: self.device.clone(), ..Plain::default() };
        Ok(Gpu::new(&way, &GpuOptions { validation: self.validation })?)
    }
}

/// Fails where the validation layer said something.
///
/// # Errors
/// What it said.
pub fn no_complaints(gpu: &Gpu) -> Result<(), CommandError> {
    let messages = gpu.messages();
    if messages.is_empty() { Ok(()) } else { Err(CommandError::Validation(messages.join("\n"))) }
}

/// A scene on a device, ready to be drawn.
pub struct Studio {
    scene: SceneOnDevice,
    offscreen: Offscreen,
}

impl Studio {
    /// Uploads a scene in the precision that the configuration asks for.
    ///
    /// # Errors
    /// The scene does not fit, or the driver's.
    pub fn new(gpu: &Arc<Gpu>, splats: &Splats, config: &RenderConfig) -> Result<Self, CommandError> {
        let scene = SceneOnDevice::new(gpu, splats, Packing::of_config(config))?;
        Ok(Self { scene, offscreen: Offscreen::new(gpu)? })
    }

    /// The scene on the device.
    pub fn scene(&self) -> &SceneOnDevice {
        &self.scene
    }

    /// One picture a view.
    ///
    /// # Errors
    /// A choice that the device does not allow, or the driver's.
    pub fn take(
        &mut self,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<Picture>, FrameReport), CommandError> {
        let (pictures, report) = self.offscreen.render(&self.scene, views, config)?;
        Ok((pictures.iter().map(picture_of).collect::<Result<_, _>>()?, report))
    }
}

/// A picture of the device's as one to measure and save.
///
/// # Errors
/// It has no pixels.
pub fn picture_of(picture: &motes_renderer::Picture) -> Result<Picture, CommandError> {
    let rgb: Vec<u8> = picture.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    Ok(Picture::from_rgb8(picture.size, &rgb)?)
}

/// One picture a view by the reference renderer. `trainers`: with their early stop.
///
/// # Errors
/// The view or the options make no sense.
pub fn reference_pictures(
    splats: &Splats,
    views: &[View],
    config: &RenderConfig,
    trainers: bool,
) -> Result<Vec<Picture>, CommandError> {
    let mut options = ReferenceOptions::of_config(config);
    if trainers {
        options.stop_below = ReferenceOptions::inria().stop_below;
    }
    if config.order == OrderKey::Radial {
        options.order = ReferenceOrder::Radial(Some(midpoint(views)));
    }
    let take = |view: &View| {
        let image = reference::render(splats, view, &options)?;
        Ok(Picture::new(image.size, image.to_rgb_f32())?)
    };
    views.iter().map(take).collect()
}

/// Pictures of one size side by side.
///
/// # Errors
/// There is none, or their sizes differ.
pub fn side_by_side(pictures: &[Picture]) -> Result<Picture, CommandError> {
    let [width, height] = pictures.first().map_or([0, 0], Picture::size);
    let row = |p: &Picture, y: u32| {
        let start = y as usize * width as usize;
        p.pixels().get(start..start + width as usize).unwrap_or_default().to_vec()
    };
    let pixels = (0..height).flat_map(|y| pictures.iter().flat_map(move |p| row(p, y))).collect();
    Ok(Picture::new([width * pictures.len() as u32, height], pixels)?)
}
