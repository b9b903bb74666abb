//! Draws with every choice and measures the distance from the f64 reference, before anything is rounded to 8 bits.

use ash::vk;
use motes_renderer::gpu::{Buffer, GpuError, Image, ImageDescription};
use motes_renderer::order::{OrderRequest, SortBuffers, SplatOrder};
use motes_renderer::reference::{self, ReferenceImage, ReferenceOptions, ReferenceOrder};
use motes_renderer::{
    Axis, Composite, DrawRequest, Expansion, FrameReport, OrderKey, Packing, Precision, Projection,
    RadiusRule, RenderConfig, Renderer, SceneOnDevice, ShPrecision, Stereo, Target, View, midpoint,
};
use motes_scenes::Splats;

use crate::TestGpu;

/// Storage in single precision: only arithmetic can go wrong.
pub const PLAIN: Packing =
    Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };

/// Grey, so that neither a missing splat nor a NaN that became black goes unseen.
pub const BACKGROUND: [f32; 3] = [0.3, 0.3, 0.3];

/// A device, a renderer, and the way to read its pictures as floats.
pub struct Rig {
    renderer: Renderer,
    gpu: TestGpu,
}

/// A picture as the device blended it: half floats, `[r, g, b, a]` by rows.
#[derive(Clone, Debug, PartialEq)]
pub struct FloatPicture {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Pixels by rows from the upper left.
    pub pixels: Vec<[f32; 4]>,
}

impl FloatPicture {
    /// Whether every value is a finite number, and the background stands behind every pixel.
    pub fn is_sound(&self) -> bool {
        self.pixels.iter().all(|p| p.iter().all(|v| v.is_finite()) && (p[3] - 1.0).abs() < 2e-3)
    }

    /// Sum over all pixels of the distance from the background, all channels: how much is seen of a splat.
    pub fn energy(&self) -> f64 {
        let distance = |p: &[f32; 4]| (0..3).map(|c| f64::from((p[c] - BACKGROUND[c]).abs())).sum::<f64>();
        self.pixels.iter().map(distance).sum()
    }
}

/// How far a picture is from the truth, in steps of an 8-bit image (1/255). Colours are shown clamped, and are
/// compared so.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Largest over all pixels and channels. Infinite where a value is not finite.
    pub worst: f64,
    /// Mean over all pixels and channels.
    pub mean: f64,
}

impl Deviation {
    /// The larger of two, each figure by itself.
    pub fn max(self, other: Self) -> Self {
        Self { worst: self.worst.max(other.worst), mean: self.mean.max(other.mean) }
    }
}

/// Every layer counts, full reach, near plane at a micrometre: only projection, coverage and blending can differ.
pub fn every_layer(projection: Projection) -> RenderConfig {
    RenderConfig {
        projection,
        radius: RadiusRule::Full,
        composite: Composite::FrontToBack,
        near: 1e-6,
        near_fade: 0.0,
        min_opacity: 0.0,
        background: BACKGROUND,
        ..Default::default()
    }
}

/// The reference's options for one of the views of a frame.
pub fn options(config: &RenderConfig, views: &[View]) -> ReferenceOptions {
    ReferenceOptions {
        order: match config.order {
            OrderKey::Radial => ReferenceOrder::Radial(Some(midpoint(views))),
            OrderKey::Depth => ReferenceOrder::Depth,
        },
        ..ReferenceOptions::of_config(config)
    }
}

/// The reference's pictures of a frame.
///
/// # Panics
/// Where the reference refuses: the case itself is wrong.
#[allow(clippy::panic, reason = "only tests call it")]
pub fn truth(splats: &Splats, views: &[View], config: &RenderConfig) -> Vec<ReferenceImage> {
    let options = options(config, views);
    let render = |view| reference::render(splats, view, &options).unwrap_or_else(|e| panic!("{e}"));
    views.iter().map(render).collect()
}

/// The distance between pictures and what they should be.
pub fn deviation(pictures: &[FloatPicture], truth: &[ReferenceImage]) -> Deviation {
    let (mut worst, mut sum, mut count) = (0.0f64, 0.0, 0usize);
    for (picture, image) in pictures.iter().zip(truth) {
        for (got, wanted) in picture.pixels.iter().zip(&image.pixels) {
            for (g, w) in got.iter().zip(wanted.colour) {
                let d = if g.is_finite() && w.is_finite() {
                    255.0 * (f64::from(g.clamp(0.0, 1.0)) - w.clamp(0.0, 1.0)).abs()
                } else {
                    f64::INFINITY
                };
                worst = worst.max(d);
                sum += d;
                count += 1;
            }
        }
    }
    Deviation { worst, mean: sum / count.max(1) as f64 }
}

/// The distance between two reference pictures.
pub fn apart(a: &[ReferenceImage], b: &[ReferenceImage]) -> Deviation {
    let as_float = |image: &ReferenceImage| FloatPicture {
        size: image.size,
        pixels: image
            .pixels
            .iter()
            .map(|p| [p.colour[0], p.colour[1], p.colour[2], 1.0].map(|c| c as f32))
            .collect(),
    };
    deviation(&a.iter().map(as_float).collect::<Vec<_>>(), b)
}

impl Rig {
    /// A device with validation, and a renderer.
    ///
    /// # Panics
    /// Without one.
    #[allow(clippy::panic, reason = "only tests call it")]
    #[allow(clippy::new_without_default, reason = "it can fail")]
    pub fn new() -> Self {
        let gpu = TestGpu::new();
        let renderer = Renderer::new(&gpu).unwrap_or_else(|e| panic!("{e}"));
        Self { renderer, gpu }
    }

    /// The device.
    pub fn gpu(&self) -> &TestGpu {
        &self.gpu
    }

    /// Uploads a scene.
    ///
    /// # Panics
    /// Where the device refuses.
    #[allow(clippy::panic, reason = "only tests call it")]
    pub fn upload(&self, splats: &Splats, packing: Packing) -> SceneOnDevice {
        SceneOnDevice::new(&self.gpu, splats, packing).unwrap_or_else(|e| panic!("{e}"))
    }

    /// The order that a frame of these views has.
    pub fn order(&self, scene: &SceneOnDevice, views: &[View], config: &RenderConfig) -> SplatOrder {
        let mut order = SplatOrder::default();
        let request = OrderRequest::new(views, config);
        order.sort(&scene.positions, &request, &mut SortBuffers::default());
        order
    }

    /// Draws views in their own order.
    ///
    /// # Errors
    /// The renderer's.
    pub fn draw(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<FloatPicture>, FrameReport), GpuError> {
        let order = self.order(scene, views, config);
        self.draw_in_order(scene, &order, views, config, Stereo::Multiview)
    }

    /// Draws views in a given order into half floats, and reads them back.
    ///
    /// # Errors
    /// The renderer's.
    pub fn draw_in_order(
        &mut self,
        scene: &SceneOnDevice,
        order: &SplatOrder,
        views: &[View],
        config: &RenderConfig,
        stereo: Stereo,
    ) -> Result<(Vec<FloatPicture>, FrameReport), GpuError> {
        let size = views.first().map_or([1, 1], |v| v.size);
        let layers = views.len().max(1) as u32;
        let description = ImageDescription {
            format: vk::Format::R16G16B16A16_SFLOAT,
            size,
            layers,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC,
            aspect: vk::ImageAspectFlags::COLOR,
        };
        let image = Image::new(&self.gpu, "float picture", description)?;
        let bytes = 8 * u64::from(size[0]) * u64::from(size[1]) * u64::from(layers);
        let usage = vk::BufferUsageFlags::TRANSFER_DST;
        let readback =
            Buffer::new(&self.gpu, "float read-back", bytes, usage, gpu_allocator::MemoryLocation::GpuToCpu)?;
        let target = Target {
            all: image.view(),
            layers: [image.layer_view(0), image.layer_view(1)],
            format: description.format,
            size,
            layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            background_alpha: 1.0,
            depth: None,
            density: None,
        };
        let frame = self.renderer.begin()?;
        let drawn =
            self.renderer.draw(&frame, &DrawRequest { scene, order, views, config, target: &target, stereo });
        if drawn.is_ok() {
            self.copy(frame.commands(), &image, &readback, size, layers);
        }
        // A frame that was begun must be finished, drawn or not.
        let report = self.renderer.finish(frame);
        self.renderer.forget_targets()?;
        drawn?;
        let report = report?;
        let values: Vec<f32> = readback.mapped()[..bytes as usize]
            .chunks_exact(2)
            .map(|h| half::f16::from_le_bytes([h[0], h[1]]).to_f32())
            .collect();
        let pixels: Vec<[f32; 4]> = values.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect();
        let count = (size[0] * size[1]) as usize;
        let pictures = pixels.chunks_exact(count).map(|p| FloatPicture { size, pixels: p.to_vec() });
        Ok((pictures.collect(), report))
    }

    fn copy(
        &self,
        commands: vk::CommandBuffer,
        image: &Image,
        readback: &Buffer,
        size: [u32; 2],
        layers: u32,
    ) {
        let copy = vk::BufferImageCopy {
            image_subresource: vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: 0,
                base_array_layer: 0,
                layer_count: layers,
            },
            image_extent: vk::Extent3D { width: size[0], height: size[1], depth: 1 },
            ..Default::default()
        };
        let barrier = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ);
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        // SAFETY: the pass left the image in this layout; the buffer holds all layers; both live until the frame is done.
        unsafe {
            let device = self.gpu.device();
            device.cmd_copy_image_to_buffer(commands, image.raw(), layout, readback.raw(), &[copy]);
            device.cmd_pipeline_barrier(
                commands,
                vk::PipelineStageFlags::TRANSFER,
                vk::PipelineStageFlags::HOST,
                vk::DependencyFlags::empty(),
                &[barrier],
                &[],
                &[],
            );
        }
    }

    /// Draws a scene and measures the distance from the reference.
    ///
    /// # Panics
    /// Where the device refuses.
    #[allow(clippy::panic, reason = "only tests call it")]
    pub fn measure(
        &mut self,
        splats: &Splats,
        packing: Packing,
        views: &[View],
        config: &RenderConfig,
    ) -> Deviation {
        let scene = self.upload(splats, packing);
        let (pictures, _) = self.draw(&scene, views, config).unwrap_or_else(|e| panic!("{e}"));
        deviation(&pictures, &truth(splats, views, config))
    }

    /// Every projection and expansion, mono (the first view) and, where there are two views, stereo: the largest
    /// deviation, and which choice had it.
    ///
    /// # Panics
    /// Where the device refuses.
    #[allow(clippy::panic, reason = "only tests call it")]
    pub fn measure_all(
        &mut self,
        splats: &Splats,
        views: &[View],
        change: impl Fn(&mut RenderConfig),
    ) -> (Deviation, String) {
        let scene = self.upload(splats, PLAIN);
        let mut worst = (Deviation::default(), String::new());
        for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
            for eyes in 1..=views.len() {
                let views = &views[..eyes];
                let mut config = every_layer(projection);
                change(&mut config);
                let truth = truth(splats, views, &config);
                for &expansion in Expansion::ALL {
                    if eyes == 2 && expansion == Expansion::Geometry {
                        continue; // one view only
                    }
                    config.expansion = expansion;
                    let (pictures, _) = self.draw(&scene, views, &config).unwrap_or_else(|e| panic!("{e}"));
                    let found = deviation(&pictures, &truth);
                    if found.worst >= worst.0.worst {
                        worst.1 = format!("{projection}, {expansion}, {eyes} view(s)");
                    }
                    worst.0 = worst.0.max(found);
                }
            }
        }
        worst
    }
}
