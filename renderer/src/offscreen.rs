//! Pictures without a window: an image, a frame drawn into it, its pixels read back.

use crate::gpu::{Buffer, Gpu, GpuError, Image, ImageDescription};
use crate::order::{OrderRequest, SortBuffers, SplatOrder};
use crate::renderer::{DepthTarget, DrawRequest, Renderer, Stereo, Target};
use crate::report::FrameReport;
use crate::scene::SceneOnDevice;
use crate::{RenderConfig, Sorter, View};
use ash::vk;
use gpu_allocator::MemoryLocation;
use half::f16;
use std::sync::Arc;

/// An image of 8-bit sRGB-encoded values, rows from the top, `[r, g, b, a]` a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// `width · height` pixels.
    pub pixels: Vec<[u8; 4]>,
}

/// How many layers each rendered pixel took.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMap {
    /// Width and height of the rendered image (smaller than the shown one at a reduced resolution), pixels.
    pub size: [u32; 2],
    /// Fragments that were shaded, a pixel; exact up to 2048.
    pub shaded: Vec<f32>,
    /// Of those, the ones whose opacity was at least 1/255 and that were blended.
    pub blended: Vec<f32>,
}

impl LayerMap {
    /// Mean of the shaded layers.
    pub fn mean_shaded(&self) -> f64 {
        self.shaded.iter().map(|&l| f64::from(l)).sum::<f64>() / self.shaded.len().max(1) as f64
    }

    /// Mean of the blended layers.
    pub fn mean_blended(&self) -> f64 {
        self.blended.iter().map(|&l| f64::from(l)).sum::<f64>() / self.blended.len().max(1) as f64
    }
}

/// How far away each shown pixel is.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Median depth of the splats along the view axis, scene units; infinite where they never take half of the light.
    pub depths: Vec<f32>,
}

/// What is read back of a frame.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Read {
    Nothing,
    Picture,
    Layers,
    Depth,
}

/// Renders pictures offscreen and waits for each.
pub struct Offscreen {
    renderer: Renderer,
    image: Option<Image>,
    /// Of the median depth, where it was asked for.
    depth: Option<Image>,
    readback: Option<Buffer>,
    buffers: SortBuffers,
    order: SplatOrder,
    /// Scene of the order.
    order_of: u64,
    /// Frames since the order was made.
    order_age: u32,
    stereo: Option<Stereo>,
}

impl Offscreen {
    /// For a device.
    ///
    /// # Errors
    /// The driver's.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, GpuError> {
        Ok(Self {
            renderer: Renderer::new(gpu)?,
            image: None,
            depth: None,
            readback: None,
            buffers: SortBuffers::default(),
            order: SplatOrder::default(),
            order_of: 0,
            order_age: 0,
            stereo: None,
        })
    }

    /// The renderer inside.
    pub fn renderer(&mut self) -> &mut Renderer {
        &mut self.renderer
    }

    /// Chooses how stereo is drawn. Without a choice: in one pass where the device can and both eyes share an order.
    pub fn set_stereo(&mut self, stereo: Stereo) {
        self.stereo = Some(stereo);
    }

    /// Sorts for these views, unless the last order still serves for a frame or more ([`RenderConfig::sort_interval`]).
    /// Done by [`Offscreen::render`] too; on its own to tell sorting from drawing. Where the device sorts it does so
    /// within the frame.
    pub fn sort(&mut self, scene: &SceneOnDevice, views: &[View], config: &RenderConfig) {
        if config.sorter != Sorter::Cpu {
            return;
        }
        let request = OrderRequest::new(views, config).of_parts(&scene.positions);
        let same_kind = self.order.made_for.is_some_and(|made| {
            made.key == request.key
                && made.bits == request.bits
                && made.second.is_some() == request.second.is_some()
                && made.time_cull == request.time_cull
                && made.parts == request.parts
        });
        self.order_age += 1;
        if self.order_of == scene.id && same_kind && self.order_age < config.sort_interval {
            return;
        }
        self.order.sort(&scene.positions, &request, &mut self.buffers);
        self.order_of = scene.id;
        self.order_age = 0;
    }

    /// How stereo is drawn: as was chosen, else in one pass where the device can and both eyes share an order.
    fn stereo_for(&self, config: &RenderConfig) -> Stereo {
        self.stereo.unwrap_or({
            if self.renderer.gpu().capabilities.multiview && !config.sort_per_eye {
                Stereo::Multiview
            } else {
                Stereo::TwoPass
            }
        })
    }

    /// Draws one frame of one or two views in the order of the last [`Offscreen::sort`], without reading it back.
    ///
    /// # Errors
    /// The driver's, or a choice that the device does not allow.
    pub fn draw(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<FrameReport, GpuError> {
        let mut whole = None::<FrameReport>;
        for (views, config) in parts(views, config)? {
            let report = self.record(scene, &views, &config, Read::Nothing)?;
            match &mut whole {
                None => whole = Some(report),
                Some(whole) => whole.add(&report),
            }
        }
        Ok(whole.unwrap_or_default())
    }

    /// Renders one or two views: sorts, draws, reads back.
    ///
    /// # Errors
    /// The driver's, or a choice that the device does not allow.
    pub fn render(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<Picture>, FrameReport), GpuError> {
        self.sort(scene, views, config);
        self.picture(scene, views, config)
    }

    /// As [`Offscreen::render`], in the order of the last [`Offscreen::sort`]. Stochastic transparency is averaged over
    /// [`RenderConfig::samples`] frames; the report is the last one's.
    ///
    /// # Errors
    /// The driver's, or a choice that the device does not allow.
    pub fn picture(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<Picture>, FrameReport), GpuError> {
        if config.sorter != Sorter::Stochastic {
            let mut parts = parts(views, config)?.into_iter();
            let Some((first, config)) = parts.next() else { return self.one_picture(scene, views, config) };
            let (mut pictures, mut report) = self.one_picture(scene, &first, &config)?;
            for (views, config) in parts {
                let (further, of_part) = self.one_picture(scene, &views, &config)?;
                report.add(&of_part);
                for (picture, right) in pictures.iter_mut().zip(&further) {
                    let pixels = beside(&picture.pixels, &right.pixels, picture.size, right.size);
                    *picture = Picture { size: wider(picture.size, right.size), pixels };
                }
            }
            return Ok((pictures, report));
        }
        let mut sums: Vec<Vec<[u32; 4]>> = Vec::new();
        let mut size = [0, 0];
        let mut report = FrameReport::default();
        for sample in 0..config.samples {
            self.renderer.set_sample(sample);
            let (pictures, of_sample) = self.one_picture(scene, views, config)?;
            report = of_sample;
            sums.resize_with(pictures.len(), Vec::new);
            for (sums, picture) in sums.iter_mut().zip(&pictures) {
                size = picture.size;
                sums.resize(picture.pixels.len(), [0; 4]);
                for (sum, pixel) in sums.iter_mut().zip(&picture.pixels) {
                    *sum = std::array::from_fn(|c| sum[c] + u32::from(pixel[c]));
                }
            }
        }
        let n = config.samples.max(1);
        let mean = |sum: &[u32; 4]| sum.map(|v| ((v + n / 2) / n) as u8);
        let pictures = sums.iter().map(|s| Picture { size, pixels: s.iter().map(mean).collect() }).collect();
        Ok((pictures, report))
    }

    /// One frame, as a window would show it, in the order of the last [`Offscreen::sort`]: of stochastic transparency one
    /// sample, or the mean so far ([`Renderer::average_samples`]).
    ///
    /// # Errors
    /// The driver's, or a choice that the device does not allow.
    pub fn frame(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<Picture>, FrameReport), GpuError> {
        self.one_picture(scene, views, config)
    }

    fn one_picture(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<Picture>, FrameReport), GpuError> {
        let report = self.record(scene, views, config, Read::Picture)?;
        let size = views.first().map_or([0, 0], |v| v.size);
        let count = (size[0] * size[1]) as usize;
        let bytes = self.readback.as_ref().map(Buffer::mapped).unwrap_or_default();
        let pictures = bytes
            .chunks_exact(4 * count)
            .take(views.len())
            .map(|layer| Picture {
                size,
                pixels: layer.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect(),
            })
            .collect();
        Ok((pictures, report))
    }

    /// Renders one or two views and counts the layers of each pixel instead of reading the pictures back.
    ///
    /// # Errors
    /// As [`Offscreen::render`]; a device without independent blending, or two views in two passes.
    pub fn layers(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<LayerMap>, FrameReport), GpuError> {
        if views.len() == 2 && self.stereo_for(config) == Stereo::TwoPass {
            let one_by_one = "layers of two views are counted in one pass (multiview), or view by view";
            return Err(GpuError::Config(crate::ConfigError(one_by_one.into())));
        }
        self.sort(scene, views, config);
        let mut whole = None::<(Vec<LayerMap>, FrameReport)>;
        for (views, config) in parts(views, config)? {
            let (further, of_part) = self.layers_of_part(scene, &views, &config)?;
            let Some((maps, report)) = &mut whole else {
                whole = Some((further, of_part));
                continue;
            };
            report.add(&of_part);
            for (map, right) in maps.iter_mut().zip(&further) {
                *map = LayerMap {
                    size: wider(map.size, right.size),
                    shaded: beside(&map.shaded, &right.shaded, map.size, right.size),
                    blended: beside(&map.blended, &right.blended, map.size, right.size),
                };
            }
        }
        Ok(whole.unwrap_or_default())
    }

    /// Renders one or two views and reads the depth of their pixels back instead of the pictures.
    ///
    /// # Errors
    /// As [`Offscreen::render`]; a configuration that does not [know depth](RenderConfig::knows_depth).
    pub fn depths(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<DepthMap>, FrameReport), GpuError> {
        self.sort(scene, views, config);
        let report = self.record(scene, views, config, Read::Depth)?;
        let size = views.first().map_or([0, 0], |v| v.size);
        let count = ((size[0] * size[1]) as usize).max(1);
        let bytes = self.readback.as_ref().map(Buffer::mapped).unwrap_or_default();
        let depth = |p: &[u8]| config.near / f32::from_le_bytes([p[0], p[1], p[2], p[3]]);
        let maps = bytes
            .chunks_exact(4 * count)
            .take(views.len())
            .map(|layer| DepthMap { size, depths: layer.chunks_exact(4).map(depth).collect() })
            .collect();
        Ok((maps, report))
    }

    fn layers_of_part(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
    ) -> Result<(Vec<LayerMap>, FrameReport), GpuError> {
        self.renderer.count_layers(true)?;
        let report = self.record(scene, views, config, Read::Layers);
        self.renderer.count_layers(false)?;
        let report = report?;
        let size = self.renderer.layer_counts().map_or([0, 0], |counts| counts.description().size);
        let count = ((size[0] * size[1]) as usize).max(1);
        let bytes = self.readback.as_ref().map(Buffer::mapped).unwrap_or_default();
        let at = |p: &[u8], i: usize| f16::from_le_bytes([p[2 * i], p[2 * i + 1]]).to_f32();
        let maps = bytes
            .chunks_exact(4 * count)
            .take(views.len())
            .map(|layer| LayerMap {
                size,
                shaded: layer.chunks_exact(4).map(|p| at(p, 0)).collect(),
                blended: layer.chunks_exact(4).map(|p| at(p, 1)).collect(),
            })
            .collect();
        Ok((maps, report))
    }

    fn record(
        &mut self,
        scene: &SceneOnDevice,
        views: &[View],
        config: &RenderConfig,
        read: Read,
    ) -> Result<FrameReport, GpuError> {
        let Some(first) = views.first() else {
            return Err(GpuError::Config(crate::ConfigError("a frame needs one view or two".into())));
        };
        if views.iter().any(|v| v.size != first.size) {
            return Err(GpuError::Config(crate::ConfigError(
                "the views of a frame must be of one size".into(),
            )));
        }
        let gpu = self.renderer.gpu().clone();
        let description = ImageDescription {
            format: vk::Format::R8G8B8A8_UNORM,
            size: first.size,
            layers: views.len() as u32,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC,
            aspect: vk::ImageAspectFlags::COLOR,
        };
        if self.image.as_ref().is_none_or(|i| i.description() != description) {
            self.renderer.forget_targets()?;
            self.image = None;
            self.depth = None;
            self.readback = None;
            self.image = Some(Image::new(&gpu, "picture", description)?);
            let bytes = 4 * u64::from(first.size[0]) * u64::from(first.size[1]) * views.len() as u64;
            self.readback = Some(Buffer::new(
                &gpu,
                "read-back",
                bytes,
                vk::BufferUsageFlags::TRANSFER_DST,
                MemoryLocation::GpuToCpu,
            )?);
        }
        if read == Read::Depth && self.depth.is_none() {
            let format = vk::Format::D32_SFLOAT;
            let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC;
            let aspect = vk::ImageAspectFlags::DEPTH;
            self.depth =
                Some(Image::new(&gpu, "depth", ImageDescription { format, usage, aspect, ..description })?);
        }
        let (Some(image), Some(readback)) = (&self.image, &self.readback) else {
            return Err(GpuError::NoDevice("no image to draw into".into()));
        };
        let target = Target {
            all: image.view(),
            layers: [image.layer_view(0), image.layer_view(1)],
            format: description.format,
            size: first.size,
            layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            background_alpha: 1.0,
            density: None,
            depth: self.depth.as_ref().filter(|_| read == Read::Depth).map(|depth| DepthTarget {
                all: depth.view(),
                layers: [depth.layer_view(0), depth.layer_view(1)],
                format: depth.description().format,
                size: first.size,
                layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            }),
        };
        let stereo = self.stereo_for(config);
        let frame = self.renderer.begin()?;
        self.renderer.draw(
            &frame,
            &DrawRequest { scene, order: &self.order, views, config, target: &target, stereo },
        )?;
        let source = match read {
            Read::Nothing => None,
            Read::Picture => Some(image),
            Read::Layers => self.renderer.layer_counts(),
            Read::Depth => self.depth.as_ref(),
        };
        if let Some(source) = source {
            let read_size = source.description().size;
            let copy = vk::BufferImageCopy {
                image_subresource: vk::ImageSubresourceLayers {
                    aspect_mask: source.description().aspect,
                    mip_level: 0,
                    base_array_layer: 0,
                    layer_count: views.len() as u32,
                },
                image_extent: vk::Extent3D { width: read_size[0], height: read_size[1], depth: 1 },
                ..Default::default()
            };
            let barrier = vk::MemoryBarrier::default()
                .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
                .dst_access_mask(vk::AccessFlags::HOST_READ);
            // SAFETY: the pass left the image in the layout for copies; the buffer holds all layers.
            unsafe {
                gpu.device().cmd_copy_image_to_buffer(
                    frame.commands(),
                    source.raw(),
                    vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
                    readback.raw(),
                    &[copy],
                );
                gpu.device().cmd_pipeline_barrier(
                    frame.commands(),
                    vk::PipelineStageFlags::TRANSFER,
                    vk::PipelineStageFlags::HOST,
                    vk::DependencyFlags::empty(),
                    &[barrier],
                    &[],
                    &[],
                );
            }
        }
        self.renderer.finish(frame)
    }
}

/// What a picture is drawn in, from left to right: itself, or the halves of what goes round the eye, with the
/// configuration that means the same in each.
fn parts(views: &[View], config: &RenderConfig) -> Result<Vec<(Vec<View>, RenderConfig)>, GpuError> {
    let whole = || Ok(vec![(views.to_vec(), config.clone())]);
    let [view] = views else { return whole() };
    config.lens.check(view)?;
    let parts = config.lens.parts(view);
    if parts.len() == 1 {
        return whole();
    }
    let larger = |size: [u32; 2]| size[0].max(size[1]) as f32;
    let part = |part: View| {
        let max_radius = config.max_radius * larger(view.size) / larger(part.size);
        (vec![part], RenderConfig { max_radius, ..config.clone() })
    };
    Ok(parts.into_iter().map(part).collect())
}

fn wider(left: [u32; 2], right: [u32; 2]) -> [u32; 2] {
    [left[0] + right[0], left[1]]
}

/// Two images of one height side by side.
fn beside<T: Copy>(left: &[T], right: &[T], left_size: [u32; 2], right_size: [u32; 2]) -> Vec<T> {
    let rows = |pixels: &[T], size: [u32; 2]| -> Vec<Vec<T>> {
        pixels.chunks_exact((size[0] as usize).max(1)).map(<[T]>::to_vec).collect()
    };
    rows(left, left_size)
        .into_iter()
        .zip(rows(right, right_size))
        .flat_map(|(l, r)| [l, r].concat())
        .collect()
}
