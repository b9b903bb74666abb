//! Draws a frame: uploads the order, prepares records on the device, blends, resolves.

mod blend;
mod descriptors;
mod frame_data;
mod framebuffers;
mod full_screen;
mod hidden;
mod median;
mod order;
mod part_list;
mod prepare;
mod readout;
mod tiles;
mod upscale;

pub use frame_data::midpoint;
pub(crate) use tiles::tiles_fit;

use crate::config::{Composite, Expansion, RenderConfig, Sorter};
use crate::gpu::{Buffer, During, Gpu, GpuError, Image};
use crate::order::SplatOrder;
use crate::order::device::DeviceSort;
use crate::parts::Parts;
use crate::passes::Passes;
use crate::pipeline_cache::Kept;
use crate::render_pass::PassKey;
use crate::report::{FrameReport, Queries};
use crate::scene::SceneOnDevice;
use crate::view::View;
use crate::workspace::Workspace;
use ash::vk;
use frame_data::{blended_format, frame_data, specialization};
use framebuffers::Framebuffers;
use full_screen::FullScreenPasses;
use gpu_allocator::MemoryLocation;
use hidden::Hidden;
use median::Median;
use motes_shaders::layout::FrameData;
use prepare::PREPARATION_DISPATCHES;
use readout::ReadoutKey;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use tiles::Tiles;
use upscale::{Reduction, Upscaler};

/// Frames that may be under way at once.
const FRAMES: usize = 2;

/// Distance of two parts' data in the uniform buffer: no device demands more alignment than 256 bytes.
const FRAME_DATA_STRIDE: u64 = (size_of::<FrameData>() as u64).next_multiple_of(256);

/// An image to draw into: an array of as many layers as views, owned by the caller (offscreen image, swapchain).
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// A view of all layers, as a 2-D array where there are two.
    pub all: vk::ImageView,
    /// A view of each layer; the second is unused in mono.
    pub layers: [vk::ImageView; 2],
    /// Format. sRGB formats are given linear values, others the sRGB-encoded ones.
    pub format: vk::Format,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Layout it is left in.
    pub layout: vk::ImageLayout,
    /// Opacity of the background: 1, or 0 where something is shown behind (passthrough).
    pub background_alpha: f32,
    /// Where the pixels' depth goes too; frames that do not [know it](RenderConfig::knows_depth) are refused then.
    pub depth: Option<DepthTarget>,
    /// A fragment density map for both eyes: where fragments may be coarse. It is used where both are drawn in one pass at
    /// full resolution; only with a device that has [them](crate::gpu::Capabilities::density_map).
    pub density: Option<vk::ImageView>,
}

/// A depth image to write into: an array of as many layers as views, owned by the caller. A pixel becomes
/// [`RenderConfig::near`] over the median depth of its splats, the eye depth at which they have taken half of its light: 1
/// is near, 0 infinitely far, or that they never do.
#[derive(Clone, Copy, Debug)]
pub struct DepthTarget {
    /// A view of all layers, as a 2-D array where there are two.
    pub all: vk::ImageView,
    /// A view of each layer; the second is unused in mono.
    pub layers: [vk::ImageView; 2],
    /// A format of depth alone.
    pub format: vk::Format,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Layout it is left in.
    pub layout: vk::ImageLayout,
}

/// How stereo is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stereo {
    /// One pass for both eyes.
    Multiview,
    /// One pass an eye.
    TwoPass,
}

/// One draw: what, from where, how, onto what.
#[derive(Clone, Copy)]
pub struct DrawRequest<'a> {
    /// The scene.
    pub scene: &'a SceneOnDevice,
    /// The order of its splats.
    pub order: &'a SplatOrder,
    /// One view, or two.
    pub views: &'a [View],
    /// How.
    pub config: &'a RenderConfig,
    /// Onto what.
    pub target: &'a Target,
    /// How two views are drawn.
    pub stereo: Stereo,
}

struct Slot {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    submitted: bool,
    descriptors: vk::DescriptorPool,
    uniform: Buffer,
    /// The parts that are drawn, where a scene is drawn in parts.
    part_list: Buffer,
    order_staging: [Option<Buffer>; 2],
    /// Parts of the frame: 2 where each eye is prepared by itself.
    parts: usize,
    /// Marks go where the plan says.
    marks_due: bool,
    queries: Queries,
    report: FrameReport,
}

/// A frame between [`Renderer::begin`] and [`Renderer::submit`].
#[derive(Debug)]
pub struct Frame {
    slot: usize,
    commands: vk::CommandBuffer,
}

impl Frame {
    /// The command buffer, for what a caller draws before or after the splats.
    pub fn commands(&self) -> vk::CommandBuffer {
        self.commands
    }
}

/// Images that a frame is drawn in, besides the caller's.
struct Attachments {
    blended: Image,
    /// Early stop's.
    marks: Option<Image>,
    /// Layers per pixel, where they are counted, or what leads to the median depth.
    second: Option<Image>,
}

/// Draws scenes. One for a device and thread.
pub struct Renderer {
    gpu: Arc<Gpu>,
    passes: Passes,
    slots: Vec<Slot>,
    next: usize,
    workspace: Option<Workspace>,
    device_sort: Option<DeviceSort>,
    /// Which of the random samples of stochastic transparency the next frame shows.
    sample: u32,
    /// Splats in the order of the part that is being recorded.
    ordered: u32,
    /// The parts that the frame draws; none for the whole scene.
    parts: Option<Arc<Parts>>,
    indices: HashMap<u32, Buffer>,
    attachments: Option<Attachments>,
    count_layers: bool,
    /// Layers are shown as colours, and so many are the hottest.
    shown_layers: Option<f32>,
    framebuffers: Framebuffers,
    background: [f32; 3],
    hidden: Hidden,
    median: Median,
    tiles: Tiles,
    readouts: FullScreenPasses<ReadoutKey>,
    upscaler: Upscaler,
    /// Of the newest frame that is done.
    finished: FrameReport,
}

impl Renderer {
    /// A renderer for a device.
    ///
    /// # Errors
    /// The driver's.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, GpuError> {
        let mut renderer = Self {
            gpu: gpu.clone(),
            passes: Passes::new(gpu)?,
            slots: Vec::new(),
            next: 0,
            workspace: None,
            device_sort: None,
            sample: 0,
            ordered: 0,
            parts: None,
            indices: HashMap::new(),
            attachments: None,
            count_layers: false,
            shown_layers: None,
            framebuffers: Framebuffers::new(gpu),
            background: [0.0; 3],
            hidden: Hidden::new(gpu),
            median: Median::new(gpu),
            tiles: Tiles::new(gpu),
            readouts: FullScreenPasses::new(gpu),
            upscaler: Upscaler::new(gpu)?,
            finished: FrameReport::default(),
        };
        for _ in 0..FRAMES {
            let slot = renderer.make_slot()?;
            renderer.slots.push(slot);
        }
        Ok(renderer)
    }

    fn make_slot(&self) -> Result<Slot, GpuError> {
        let gpu = &self.gpu;
        let uniform = Buffer::new(
            gpu,
            "frame data",
            2 * FRAME_DATA_STRIDE,
            vk::BufferUsageFlags::UNIFORM_BUFFER,
            MemoryLocation::CpuToGpu,
        )?;
        let queries = Queries::new(gpu)?;
        let sizes = [
            vk::DescriptorPoolSize { ty: vk::DescriptorType::UNIFORM_BUFFER, descriptor_count: 8 },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_BUFFER, descriptor_count: 128 },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::INPUT_ATTACHMENT, descriptor_count: 16 },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::COMBINED_IMAGE_SAMPLER, descriptor_count: 16 },
        ];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(32).pool_sizes(&sizes);
        // SAFETY: `info` is complete.
        let descriptors =
            unsafe { gpu.device().create_descriptor_pool(&info, None) }.during("vkCreateDescriptorPool")?;
        let (pool, commands, fence) = crate::frame::command_pool(gpu)?;
        Ok(Slot {
            pool,
            commands,
            fence,
            submitted: false,
            descriptors,
            uniform,
            part_list: part_list::buffer(gpu, 0)?,
            order_staging: [None, None],
            parts: 0,
            marks_due: false,
            queries,
            report: FrameReport::default(),
        })
    }

    /// The device.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// Makes pipelines from those kept in a folder ([`crate::pipeline_cache::default_folder`]), and keeps them there
    /// when the renderer goes. Says what was found.
    ///
    /// # Errors
    /// The driver's. What is wrong with the folder or a file in it is announced, and never an error.
    pub fn keep_pipelines(&mut self, folder: &Path) -> Result<Kept, GpuError> {
        self.passes.keep_in(folder)
    }

    /// Writes the pipelines that were made since to the folder of [`Renderer::keep_pipelines`], where there is one: for
    /// programs that may be ended before the renderer goes.
    pub fn save_pipelines(&mut self) {
        self.passes.save();
    }

    /// Begins a frame; waits until the frame before the last is done.
    ///
    /// # Errors
    /// The device was lost.
    pub fn begin(&mut self) -> Result<Frame, GpuError> {
        let index = self.next;
        self.next = (self.next + 1) % FRAMES;
        self.wait(index)?;
        let slot = &mut self.slots[index];
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the slot's last frame is done.
        unsafe {
            let device = self.gpu.device();
            device
                .reset_descriptor_pool(slot.descriptors, vk::DescriptorPoolResetFlags::empty())
                .during("vkResetDescriptorPool")?;
            // A frame that was refused half way is still being recorded.
            device
                .reset_command_buffer(slot.commands, vk::CommandBufferResetFlags::empty())
                .during("vkResetCommandBuffer")?;
            device.begin_command_buffer(slot.commands, &begin).during("vkBeginCommandBuffer")?;
        }
        slot.queries.reset(slot.commands);
        slot.queries.stamp(slot.commands, 0);
        slot.report = FrameReport::default();
        slot.parts = 0;
        Ok(Frame { slot: index, commands: slot.commands })
    }

    fn wait(&mut self, index: usize) -> Result<(), GpuError> {
        let slot = &mut self.slots[index];
        if slot.submitted {
            let device = self.gpu.device();
            // SAFETY: the fence was submitted.
            unsafe {
                device.wait_for_fences(&[slot.fence], true, u64::MAX).during("vkWaitForFences")?;
                device.reset_fences(&[slot.fence]).during("vkResetFences")?;
            }
            slot.submitted = false;
            slot.queries.read(&mut slot.report)?;
            if let Some(workspace) = &self.workspace {
                workspace.read_plan(index, slot.parts, slot.marks_due, &mut slot.report);
            }
            self.finished.clone_from(&slot.report);
        }
        Ok(())
    }

    /// Ends and submits a frame.
    ///
    /// # Errors
    /// The device was lost, or is out of memory.
    pub fn submit(
        &mut self,
        frame: Frame,
        wait: &[(vk::Semaphore, vk::PipelineStageFlags)],
        signal: &[vk::Semaphore],
    ) -> Result<(), GpuError> {
        let slot = &mut self.slots[frame.slot];
        let device = self.gpu.device();
        let semaphores: Vec<_> = wait.iter().map(|w| w.0).collect();
        let stages: Vec<_> = wait.iter().map(|w| w.1).collect();
        let buffers = [slot.commands];
        let submit = vk::SubmitInfo::default()
            .command_buffers(&buffers)
            .wait_semaphores(&semaphores)
            .wait_dst_stage_mask(&stages)
            .signal_semaphores(signal);
        // SAFETY: the command buffer is recorded and not in flight.
        unsafe {
            device.end_command_buffer(slot.commands).during("vkEndCommandBuffer")?;
            let queue = self.gpu.queue();
            device.queue_submit(*queue, &[submit], slot.fence).during("vkQueueSubmit")?;
        }
        slot.submitted = true;
        Ok(())
    }

    /// Submits a frame, waits for it, and says what it took.
    ///
    /// # Errors
    /// As [`Renderer::submit`].
    pub fn finish(&mut self, frame: Frame) -> Result<FrameReport, GpuError> {
        let index = frame.slot;
        self.submit(frame, &[], &[])?;
        self.wait(index)?;
        Ok(self.slots[index].report.clone())
    }

    /// What the most recent finished frame took.
    pub fn last_report(&self) -> &FrameReport {
        &self.finished
    }

    /// Forgets the frames before, which the temporal form of reduced resolution draws on: after a cut, or for pictures
    /// that must not depend on what was drawn earlier.
    pub fn forget_history(&mut self) {
        self.upscaler.forget_history();
    }

    /// Whether the frames from now on show the mean of the last [`RenderConfig::samples`] of stochastic transparency, turned
    /// to the newest view, instead of single noisy ones: for what is shown frame by frame.
    pub fn average_samples(&mut self, average: bool) {
        self.upscaler.average_samples = average;
    }

    /// How many further frames of the same add something to the last picture at most: where it is made from several, and what
    /// it shows stays as it is. 0: it is finished.
    pub fn lacks(&self) -> u32 {
        self.upscaler.lacks
    }

    /// Which sample of stochastic transparency the next frame shows; each frame after it shows the next one.
    pub fn set_sample(&mut self, sample: u32) {
        self.sample = sample & (u32::MAX >> 1);
    }

    /// Whether the frames from now on count layers per pixel: a measurement, which costs time itself.
    ///
    /// # Errors
    /// The device cannot blend attachments of one pass differently.
    pub fn count_layers(&mut self, count: bool) -> Result<(), GpuError> {
        if count && !self.gpu.capabilities.independent_blend {
            return Err(GpuError::Unsupported {
                wanted: "counting layers (independent blending)".into(),
                device: self.gpu.capabilities.device.clone(),
                remedy: "Use the statistics of whole passes".into(),
            });
        }
        self.count_layers = count;
        Ok(())
    }

    /// Shows how many layers each pixel took instead of its colour, from the next frame on or no longer: black for none, then
    /// blue, cyan, green, yellow, red, white for `most` and more. Counting costs time itself.
    ///
    /// # Errors
    /// As [`Renderer::count_layers`].
    pub fn show_layers(&mut self, most: Option<f32>) -> Result<(), GpuError> {
        self.count_layers(most.is_some())?;
        self.shown_layers = most;
        Ok(())
    }

    /// The layer counts of the last frame (16-bit floats: shaded, blended; one layer a view), left for copies.
    pub(crate) fn layer_counts(&self) -> Option<&Image> {
        self.attachments.as_ref().and_then(|a| a.second.as_ref())
    }

    /// Forgets framebuffers that refer to the caller's images. To be called before those are destroyed.
    ///
    /// # Errors
    /// The device was lost.
    pub fn forget_targets(&mut self) -> Result<(), GpuError> {
        self.gpu.wait_idle()?;
        self.framebuffers.forget();
        Ok(())
    }

    /// Draws a scene.
    ///
    /// # Errors
    /// A choice that the device or the scene does not allow, or the driver's.
    pub fn draw(&mut self, frame: &Frame, request: &DrawRequest<'_>) -> Result<(), GpuError> {
        let DrawRequest { views, config, target, stereo, .. } = *request;
        config.check(views.len(), &self.gpu.capabilities)?;
        for view in views {
            view.check()?;
            config.lens.check(view)?;
            if config.lens.splits(view) {
                let reason = "lens equirectangular: more than half of the way round is drawn in two halves (Offscreen)";
                return Err(GpuError::Config(crate::ConfigError(reason.into())));
            }
        }
        let multiview = views.len() == 2 && stereo == Stereo::Multiview;
        if multiview && !self.gpu.capabilities.multiview {
            return Err(GpuError::Unsupported {
                wanted: "stereo in one pass (multiview)".into(),
                device: self.gpu.capabilities.device.clone(),
                remedy: "Draw stereo in two passes".into(),
            });
        }
        if multiview && config.sort_per_eye {
            return Err(GpuError::Config(crate::ConfigError(
                "sort-per-eye: one pass draws both eyes in one order; draw stereo in two passes".into(),
            )));
        }
        if self.count_layers && config.sorter == Sorter::Stochastic {
            let reason = "sort stochastic blends no layers that could be counted";
            return Err(GpuError::Config(crate::ConfigError(reason.into())));
        }
        let blind = self.count_layers || !config.knows_depth() || views.len() == 2 && !multiview;
        if target.depth.is_some() && blind {
            let reason = "depth is known to frames of composite early-stop and expansion precomputed, sorted for both eyes, \
                          which are drawn in one pass, through lens perspective, and where layers are not counted; leave the \
                          depth image away";
            return Err(GpuError::Config(crate::ConfigError(reason.into())));
        }
        self.write_parts(frame.slot, request.scene)?;
        let reduction = self.upscaler.reduction(request);
        self.upscaler.begin(request, &reduction, blended_format(config.target), &mut self.framebuffers)?;
        if config.sort_per_eye && views.len() == 2 {
            for eye in 0..2 {
                let part = DrawRequest { views: &views[eye..=eye], ..*request };
                self.draw_part(frame, &part, &reduction, multiview, Some(eye))?;
            }
        } else {
            self.draw_part(frame, request, &reduction, multiview, None)?;
        }
        self.upscaler.end(request, &reduction);
        self.sample = self.sample.wrapping_add(1) & (u32::MAX >> 1);
        self.slots[frame.slot].queries.stamp(frame.commands, 3);
        let slot = &mut self.slots[frame.slot];
        slot.report.views = views.len() as u32;
        let [width, height] = reduction.resolution.rendered.map(u64::from);
        slot.report.pixels = width * height * views.len() as u64;
        let [width, height] = target.size.map(u64::from);
        slot.report.shown_pixels = width * height * views.len() as u64;
        let tiles = config.expansion == Expansion::Tiles;
        let batches = if config.composite == Composite::EarlyStop { config.batches } else { 1 };
        slot.marks_due = config.marks_due();
        slot.report.full_screen_fragments =
            if slot.marks_due || tiles { 0 } else { slot.report.pixels * u64::from(batches - 1) };
        Ok(())
    }

    /// Draws all views, or one eye by itself where each has its own order.
    fn draw_part(
        &mut self,
        frame: &Frame,
        request: &DrawRequest<'_>,
        reduction: &Reduction,
        multiview: bool,
        own_eye: Option<usize>,
    ) -> Result<(), GpuError> {
        let DrawRequest { scene, views, config, target, .. } = *request;
        let part = own_eye.unwrap_or(0);
        let in_parts = self.parts.is_some();
        let specialization = specialization(scene, views.len(), config, &reduction.resolution, in_parts);
        self.prepare_workspace(scene, config.projection)?;
        let sets = self.scene_sets(frame.slot, scene, part)?;
        self.ordered = self.order(frame.slot, request, own_eye, [sets[0], sets[1]], specialization)?;
        self.write_frame_data(frame.slot, request, reduction, part);
        let commands = frame.commands;
        if part == 0 {
            self.slots[frame.slot].queries.stamp(commands, 1);
        }
        // Tiles stop by themselves.
        let early_stop = config.composite == Composite::EarlyStop && config.expansion != Expansion::Tiles;
        let batches = if early_stop { config.batches } else { 1 };

        if config.expansion.writes_records() {
            self.record_preparation(commands, self.ordered, &sets, specialization)?;
            self.slots[frame.slot].report.dispatches += PREPARATION_DISPATCHES;
        }
        if part == 0 {
            self.slots[frame.slot].queries.stamp(commands, 2);
        }

        let corners = config.shape.corners();
        let indices = self.index_buffer(corners)?;
        let passes: &[(u32, Option<usize>)] = match (views.len(), multiview) {
            (1, _) => &[[(0, Some(0))], [(0, Some(1))]][part],
            (_, true) => &[(0b11, None)],
            (_, false) => &[(0, Some(0)), (0, Some(1))],
        };
        for &(view_mask, layer) in passes {
            let pass = PassKey {
                blended: blended_format(config.target),
                output: (!reduction.further_pass).then_some((target.format, target.layout)),
                view_mask,
                early_stop,
                stochastic: config.sorter == Sorter::Stochastic,
                count: self.count_layers,
                median: target.depth.is_some(),
                density: target.density.is_some()
                    && config.expansion != Expansion::Tiles
                    && self.gpu.capabilities.density_map
                    && view_mask != 0
                    && !reduction.further_pass,
            };
            self.record_pass(
                frame.slot,
                request,
                pass,
                layer,
                specialization,
                batches,
                corners,
                indices,
                &sets,
                reduction,
            )?;
            self.record_readouts(frame.slot, request, pass, layer, &reduction.resolution)?;
        }
        if let Some(workspace) = &mut self.workspace
            && config.expansion.writes_records()
        {
            workspace.copy_plan(&self.gpu, commands, frame.slot, part);
            self.slots[frame.slot].parts = part + 1;
        }
        Ok(())
    }

    fn write_frame_data(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        reduction: &Reduction,
        part: usize,
    ) {
        let data = frame_data(request, reduction, self.ordered, self.sample);
        self.background = request.config.background;
        let uniform = &mut self.slots[slot].uniform;
        let at = part * FRAME_DATA_STRIDE as usize;
        uniform.mapped_mut()[at..at + size_of::<FrameData>()].copy_from_slice(bytemuck::bytes_of(&data));
        self.slots[slot].report.uploaded_bytes += size_of::<FrameData>() as u64;
    }
}

impl Drop for Renderer {
    fn drop(&mut self) {
        if let Err(e) = self.forget_targets() {
            log::error!("{e}");
        }
        let device = self.gpu.device();
        for slot in &self.slots {
            // SAFETY: the device is idle.
            unsafe {
                device.destroy_fence(slot.fence, None);
                device.destroy_command_pool(slot.pool, None);
                device.destroy_descriptor_pool(slot.descriptors, None);
            }
        }
    }
}
