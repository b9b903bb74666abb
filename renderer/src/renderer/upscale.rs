//! From a frame of reduced resolution to the shown image: a pass of its own, which samples the rendered image. The same
//! pass averages the samples of stochastic transparency over frames.

use super::framebuffers::Framebuffers;
use super::full_screen::{Bindings, FullScreenKey, FullScreenPass, FullScreenPasses};
use super::{DrawRequest, Renderer};
use crate::config::{RenderConfig, Sorter, Upscale};
use crate::gpu::{During, Gpu, GpuError, Image, ImageDescription};
use crate::order::Positions;
use crate::passes::PUSH_BYTES;
use crate::resolution::{CYCLE, Resolution, Sampling};
use crate::view::View;
use ash::vk;
use glam::{DMat3, DVec3};
use motes_shaders::modules;
use std::sync::{Arc, Weak};

use super::frame_data::is_srgb;

/// `constant_id`s of `upscale.frag`.
const SAMPLING: u32 = 15;
const SHARPEN: u32 = 18;

/// What the pass and its pipeline depend on.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct UpscaleKey {
    output: vk::Format,
    output_layout: vk::ImageLayout,
    view_mask: u32,
    sampling: Sampling,
    /// Whether random samples are averaged.
    mean: bool,
    /// Whether what is shown is sharpened.
    sharpen: bool,
    /// Format of the history, where frames are kept.
    kept: Option<vk::Format>,
}

/// How a frame of the temporal form stands to the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Past {
    /// There is none, or of something else.
    None = 0,
    /// It showed the same: what was not sampled now was sampled then.
    Still = 1,
    /// Eye or scene moved: it is turned to this frame's view, and held within what this frame sampled.
    Moving = 2,
}

/// What a frame showed.
struct Shown {
    scene: Weak<Positions>,
    views: Vec<View>,
    config: RenderConfig,
}

impl Shown {
    fn of(request: &DrawRequest<'_>) -> Self {
        let mut config = request.config.clone();
        if !request.scene.moving {
            config.time = 0.0;
        }
        Self { scene: Arc::downgrade(&request.scene.positions), views: request.views.to_vec(), config }
    }

    fn past_of(&self, next: &Self) -> Past {
        let same = |a: &RenderConfig, b: &RenderConfig| *a == RenderConfig { time: a.time, ..b.clone() };
        if !Weak::ptr_eq(&self.scene, &next.scene)
            || self.views.len() != next.views.len()
            || !same(&self.config, &next.config)
        {
            Past::None
        } else if self.views == next.views && self.config.time == next.config.time {
            Past::Still
        } else {
            Past::Moving
        }
    }

    /// How much of the history is worth keeping in motion. Turning is followed exactly. Walking is not, as splats have
    /// no depth: what is 1 m away has moved by `parallax` pixels. Motion of the scene itself may be anywhere.
    fn share_of(&self, next: &Self) -> f32 {
        let parallax = self.views.iter().zip(&next.views).fold(0.0f64, |most, (before, now)| {
            let [fx, fy] = now.focal();
            most.max((now.eye - before.eye).length() * fx.max(fy))
        });
        let turned = 0.5 / (1.0 + parallax * parallax);
        (if self.config.time == next.config.time { turned } else { 0.5 * turned }) as f32
    }
}

/// From the shown image of a view (`0 ..= 1`, `0 ..= 1`, 1) to that of a view before: homogeneous, exact for turns of the
/// head, and what is far away.
pub(super) fn reprojection(now: &View, before: &View) -> DMat3 {
    let rays = |v: &View| {
        let f = v.fov;
        DMat3::from_cols(
            DVec3::new(f.right - f.left, 0.0, 0.0),
            DVec3::new(0.0, f.down - f.up, 0.0),
            DVec3::new(f.left, f.up, 1.0),
        )
    };
    rays(before).inverse() * before.rotation * now.rotation.transpose() * rays(now)
}

/// The frames before, full size and without background: one is read, the other written.
struct History {
    images: [Image; 2],
    /// Which one the last frame wrote.
    newest: usize,
    /// What it showed; `None` before the first frame.
    shown: Option<Shown>,
    /// Random samples: how many frames it is worth.
    gathered: f32,
    /// Frames that showed the same, one after the other.
    still: u32,
}

/// The pass, its pipelines, and the history of the temporal form.
pub(super) struct Upscaler {
    gpu: Arc<Gpu>,
    sampler: vk::Sampler,
    passes: FullScreenPasses<UpscaleKey>,
    history: Option<History>,
    step: u32,
    /// Frames that would still add something to the last picture.
    pub lacks: u32,
    /// Whether the random samples of stochastic transparency are averaged over frames.
    pub average_samples: bool,
}

/// How this frame is reduced, and how it stands to the one before.
#[derive(Clone, Copy)]
pub(super) struct Reduction {
    pub resolution: Resolution,
    pub past: Past,
    /// Weight of the history where eye or scene moved, `0 ..= 1`; where random samples are averaged also where neither did.
    pub history_share: f32,
    /// One a view.
    pub reprojection: [DMat3; 2],
    /// Whether rendered and shown image differ, or the shown one is sharpened: both take the further pass.
    pub further_pass: bool,
}

impl Upscaler {
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, GpuError> {
        let info = vk::SamplerCreateInfo::default()
            .mag_filter(vk::Filter::LINEAR)
            .min_filter(vk::Filter::LINEAR)
            .address_mode_u(vk::SamplerAddressMode::CLAMP_TO_EDGE)
            .address_mode_v(vk::SamplerAddressMode::CLAMP_TO_EDGE)
            .address_mode_w(vk::SamplerAddressMode::CLAMP_TO_EDGE);
        // SAFETY: `info` is complete.
        let sampler = unsafe { gpu.device().create_sampler(&info, None) }.during("vkCreateSampler")?;
        Ok(Self {
            gpu: gpu.clone(),
            sampler,
            passes: FullScreenPasses::new(gpu),
            history: None,
            step: 0,
            lacks: 0,
            average_samples: false,
        })
    }

    /// A sampler that clamps to the edge.
    pub fn sampler(&self) -> vk::Sampler {
        self.sampler
    }

    /// Whether random samples are averaged over frames.
    fn means(&self, config: &RenderConfig) -> bool {
        self.average_samples && config.sorter == Sorter::Stochastic && config.samples > 1
    }

    /// Whether frames are kept for the next one.
    fn keeps(&self, config: &RenderConfig, resolution: &Resolution) -> bool {
        temporal(config, resolution) || self.means(config)
    }

    /// How a request's frame is reduced.
    pub fn reduction(&self, request: &DrawRequest<'_>) -> Reduction {
        let resolution = Resolution::of(request.config, request.target.size, self.step);
        let mut reduction = Reduction {
            resolution,
            past: Past::None,
            history_share: 0.0,
            reprojection: [DMat3::IDENTITY; 2],
            further_pass: resolution.reduced() || request.config.sharpen > 0.0 || self.means(request.config),
        };
        if self.keeps(request.config, &resolution)
            && let Some(History { images, shown: Some(shown), gathered, .. }) = &self.history
            && images[0].description().size == request.target.size
        {
            let next = Shown::of(request);
            reduction.past = shown.past_of(&next);
            reduction.history_share = shown.share_of(&next);
            if self.means(request.config) {
                // A mean of all frames so far, up to as many as were asked for; in motion what little motion leaves of it,
                // since noise is worse than a little blur.
                let most = gathered.min(request.config.samples as f32 - 1.0);
                let moving = (1.7 * reduction.history_share).min(0.85);
                let share = most / (most + 1.0);
                reduction.history_share = match reduction.past {
                    Past::None => 0.0,
                    Past::Still => share,
                    Past::Moving => share.min(moving),
                };
            }
            for (out, (now, before)) in
                reduction.reprojection.iter_mut().zip(request.views.iter().zip(&shown.views))
            {
                *out = reprojection(now, before);
            }
        }
        reduction
    }

    /// Makes the history fit; called once a frame, before its first pass.
    pub fn begin(
        &mut self,
        request: &DrawRequest<'_>,
        reduction: &Reduction,
        format: vk::Format,
        framebuffers: &mut Framebuffers,
    ) -> Result<(), GpuError> {
        if !self.keeps(request.config, &reduction.resolution) {
            return Ok(());
        }
        // A mean needs finer steps than what is averaged.
        let format = if self.means(request.config) { vk::Format::R16G16B16A16_SFLOAT } else { format };
        let description = ImageDescription {
            format,
            size: request.target.size,
            layers: request.views.len() as u32,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::SAMPLED,
            aspect: vk::ImageAspectFlags::COLOR,
        };
        if self.history.as_ref().is_none_or(|h| h.images[0].description() != description) {
            self.gpu.wait_idle()?;
            framebuffers.forget();
            self.history = None;
            let images = [
                Image::new(&self.gpu, "history 0", description)?,
                Image::new(&self.gpu, "history 1", description)?,
            ];
            self.history = Some(History { images, newest: 0, shown: None, gathered: 0.0, still: 0 });
        }
        Ok(())
    }

    /// After a frame's last pass: the next one follows it.
    pub fn end(&mut self, request: &DrawRequest<'_>, reduction: &Reduction) {
        self.lacks = 0;
        let cycle = if temporal(request.config, &reduction.resolution) { CYCLE } else { 0 };
        let samples = if self.means(request.config) { request.config.samples } else { 0 };
        if self.keeps(request.config, &reduction.resolution)
            && let Some(history) = &mut self.history
        {
            history.still = if reduction.past == Past::Still { history.still.saturating_add(1) } else { 1 };
            self.lacks = cycle.max(samples).saturating_sub(history.still);
            history.gathered = 1.0 / (1.0 - reduction.history_share);
            history.newest = 1 - history.newest;
            history.shown = Some(Shown::of(request));
            self.step = self.step.wrapping_add(1);
        }
    }

    /// Forgets what frames showed: the next one is the first of its cycle.
    pub fn forget_history(&mut self) {
        self.step = 0;
        if let Some(history) = &mut self.history {
            history.shown = None;
        }
    }
}

impl FullScreenKey for UpscaleKey {
    fn describe(self) -> FullScreenPass {
        let kept = self.kept.map(|format| (format, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL));
        let color = vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT;
        let fragment = vk::PipelineStageFlags::FRAGMENT_SHADER;
        let transfer = vk::PipelineStageFlags::TRANSFER;
        let (write, read) = (vk::AccessFlags::COLOR_ATTACHMENT_WRITE, vk::AccessFlags::SHADER_READ);
        FullScreenPass {
            outputs: std::iter::once((self.output, self.output_layout)).chain(kept).collect(),
            depth: false,
            view_mask: self.view_mask,
            // What was rendered, and the frame before, are read; the frame before that, and its reader, are over.
            before: [(color | fragment | transfer, write), (color | fragment, write | read)],
            after: [
                (color, write),
                (
                    transfer | fragment | vk::PipelineStageFlags::BOTTOM_OF_PIPE,
                    vk::AccessFlags::TRANSFER_READ | read,
                ),
            ],
            fragment: match (self.sampling, self.kept.is_some(), self.view_mask != 0) {
                (_, _, false) if self.mean => modules::UPSCALE_MEAN_FRAG,
                (_, _, true) if self.mean => modules::UPSCALE_MEAN_FRAG_MULTIVIEW,
                (Sampling::Centers, _, false) => modules::UPSCALE_BILINEAR_FRAG,
                (Sampling::Centers, _, true) => modules::UPSCALE_BILINEAR_FRAG_MULTIVIEW,
                (_, false, false) => modules::UPSCALE_INTERLEAVED_FRAG,
                (_, false, true) => modules::UPSCALE_INTERLEAVED_FRAG_MULTIVIEW,
                (_, true, false) => modules::UPSCALE_TEMPORAL_FRAG,
                (_, true, true) => modules::UPSCALE_TEMPORAL_FRAG_MULTIVIEW,
            },
            constants: [(SAMPLING, self.sampling as u32), (SHARPEN, u32::from(self.sharpen))]
                .into_iter()
                .collect(),
        }
    }
}

fn temporal(config: &RenderConfig, resolution: &Resolution) -> bool {
    config.upscale == Upscale::InterleavedTemporal && resolution.interleaved()
}

impl Renderer {
    /// Records the pass from the rendered image to an output of the target.
    pub(super) fn record_upscale(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        reduction: &Reduction,
        view_mask: u32,
        layer: Option<usize>,
        frame_set: vk::DescriptorSet,
    ) -> Result<(), GpuError> {
        let DrawRequest { target, config, .. } = *request;
        let keeps = self.upscaler.keeps(config, &reduction.resolution);
        let rendered = self.attachments.as_ref().map_or(vk::ImageView::null(), |a| a.blended.array_view());
        let (read, written, kept) = match (&self.upscaler.history, keeps) {
            (Some(h), true) => {
                let [read, written] = [&h.images[h.newest], &h.images[1 - h.newest]];
                let written = layer.map_or(written.view(), |l| written.layer_view(l as u32));
                // What no frame has written yet is bound as what was rendered: it is not read.
                let read = if h.shown.is_some() { read.array_view() } else { rendered };
                (read, Some(written), Some(h.images[0].description().format))
            }
            _ => (rendered, None, None),
        };
        let key = UpscaleKey {
            output: target.format,
            output_layout: target.layout,
            view_mask,
            sampling: reduction.resolution.sampling,
            mean: self.upscaler.means(config),
            sharpen: config.sharpen > 0.0,
            kept,
        };
        let output = layer.map_or(target.all, |l| target.layers[l]);
        let set = self.sampled_set(slot, [rendered, read])?;
        let b = config.background;
        let push = [
            b[0].to_bits(),
            b[1].to_bits(),
            b[2].to_bits(),
            target.background_alpha.to_bits(),
            u32::from(is_srgb(target.format)),
            config.sharpen.to_bits(),
            layer.unwrap_or(0) as u32,
        ];
        const { assert!(PUSH_BYTES >= 28) };
        let bindings = Bindings {
            views: [output, written.unwrap_or_default()],
            size: target.size,
            sets: &[(0, frame_set), (3, set)],
            push: &push,
        };
        let slot = &mut self.slots[slot];
        self.upscaler.passes.record(slot, &self.passes, &mut self.framebuffers, key, &bindings)
    }
}

impl Drop for Upscaler {
    fn drop(&mut self) {
        // SAFETY: the renderer that owns this has waited for its frames.
        unsafe { self.gpu.device().destroy_sampler(self.sampler, None) };
    }
}
