//! Draws a frame: uploads the order, prepares records on the device, blends, resolves.

use crate::config::{Composite, Expansion, RadiusRule, RenderConfig, TargetFormat};
use crate::gpu::{Buffer, Gpu, GpuError, Image, ImageDescription};
use crate::order::SplatOrder;
use crate::passes::{FullScreen, MARK_FORMAT, PUSH_BYTES, PassKey, Passes, Preparation, Stages};
use crate::report::{FrameReport, Queries};
use crate::scene::SceneOnDevice;
use crate::view::View;
use crate::workspace::Workspace;
use ash::vk;
use glam::DVec3;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::{
    BLOCK, Draw, FrameData, MAX_BATCHES, QUADS_PER_INSTANCE, Specialization, ViewData,
};
use std::collections::HashMap;
use std::mem::offset_of;
use std::sync::Arc;

/// Frames that may be under way at once.
const FRAMES: usize = 2;

fn call<T>(result: Result<T, vk::Result>, call: &'static str) -> Result<T, GpuError> {
    result.map_err(|result| GpuError::Call { call, result })
}

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
    order_staging: Option<Buffer>,
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

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct FramebufferKey {
    pass: vk::RenderPass,
    output: vk::ImageView,
    size: [u32; 2],
}

struct Framebuffer {
    raw: vk::Framebuffer,
}

/// Draws scenes. One for a device and thread.
pub struct Renderer {
    gpu: Arc<Gpu>,
    passes: Passes,
    slots: Vec<Slot>,
    next: usize,
    workspace: Option<Workspace>,
    indices: HashMap<u32, Buffer>,
    blended: Option<(Image, Option<Image>)>,
    framebuffers: HashMap<FramebufferKey, Framebuffer>,
    background: [f32; 3],
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
            indices: HashMap::new(),
            blended: None,
            framebuffers: HashMap::new(),
            background: [0.0; 3],
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
            size_of::<FrameData>() as u64,
            vk::BufferUsageFlags::UNIFORM_BUFFER,
            MemoryLocation::CpuToGpu,
        )?;
        let queries = Queries::new(gpu)?;
        let sizes = [
            vk::DescriptorPoolSize { ty: vk::DescriptorType::UNIFORM_BUFFER, descriptor_count: 4 },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_BUFFER, descriptor_count: 64 },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::INPUT_ATTACHMENT, descriptor_count: 8 },
        ];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(16).pool_sizes(&sizes);
        // SAFETY: `info` is complete.
        let descriptors =
            call(unsafe { gpu.device().create_descriptor_pool(&info, None) }, "vkCreateDescriptorPool")?;
        let (pool, commands, fence) = crate::frame::command_pool(gpu)?;
        Ok(Slot {
            pool,
            commands,
            fence,
            submitted: false,
            descriptors,
            uniform,
            order_staging: None,
            queries,
            report: FrameReport::default(),
        })
    }

    /// The device.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
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
            call(
                device.reset_descriptor_pool(slot.descriptors, vk::DescriptorPoolResetFlags::empty()),
                "vkResetDescriptorPool",
            )?;
            call(device.begin_command_buffer(slot.commands, &begin), "vkBeginCommandBuffer")?;
        }
        slot.queries.reset(slot.commands);
        slot.queries.stamp(slot.commands, 0);
        slot.report = FrameReport::default();
        Ok(Frame { slot: index, commands: slot.commands })
    }

    fn wait(&mut self, index: usize) -> Result<(), GpuError> {
        let slot = &mut self.slots[index];
        if slot.submitted {
            let device = self.gpu.device();
            // SAFETY: the fence was submitted.
            unsafe {
                call(device.wait_for_fences(&[slot.fence], true, u64::MAX), "vkWaitForFences")?;
                call(device.reset_fences(&[slot.fence]), "vkResetFences")?;
            }
            slot.submitted = false;
            slot.queries.read(&mut slot.report)?;
            if let Some(workspace) = &self.workspace {
                workspace.read_plan(index, &mut slot.report);
            }
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
            call(device.end_command_buffer(slot.commands), "vkEndCommandBuffer")?;
            let queue = self.gpu.queue();
            call(device.queue_submit(*queue, &[submit], slot.fence), "vkQueueSubmit")?;
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
        &self.slots[self.next].report
    }

    /// Forgets framebuffers that refer to the caller's images. To be called before those are destroyed.
    ///
    /// # Errors
    /// The device was lost.
    pub fn forget_targets(&mut self) -> Result<(), GpuError> {
        self.gpu.wait_idle()?;
        for (_, framebuffer) in self.framebuffers.drain() {
            // SAFETY: the device is idle.
            unsafe { self.gpu.device().destroy_framebuffer(framebuffer.raw, None) };
        }
        Ok(())
    }

    /// Draws a scene.
    ///
    /// # Errors
    /// A choice that the device or the scene does not allow, or the driver's.
    pub fn draw(&mut self, frame: &Frame, request: &DrawRequest<'_>) -> Result<(), GpuError> {
        let DrawRequest { scene, views, config, target, stereo, .. } = *request;
        config.check(views.len(), &self.gpu.capabilities)?;
        let multiview = views.len() == 2 && stereo == Stereo::Multiview;
        if multiview && !self.gpu.capabilities.multiview {
            return Err(GpuError::Unsupported {
                wanted: "stereo in one pass (multiview)".into(),
                device: self.gpu.capabilities.device.clone(),
                remedy: "Draw stereo in two passes".into(),
            });
        }
        let specialization = specialization(scene, views.len(), config);
        self.prepare_workspace(scene, specialization.projection == crate::Projection::Exact as u32)?;
        self.write_frame_data(frame.slot, request);
        self.upload_order(frame.slot, request)?;
        let slot = &self.slots[frame.slot];
        slot.queries.stamp(slot.commands, 1);
        let sets = self.scene_sets(frame.slot, scene)?;
        let commands = frame.commands;
        let early_stop = config.composite == Composite::EarlyStop;
        let batches = if early_stop { config.batches } else { 1 };

        if config.expansion == Expansion::Precomputed {
            self.record_preparation(commands, scene.splats, &sets, specialization)?;
        }
        self.slots[frame.slot].queries.stamp(commands, 2);

        let corners = corners(config);
        let indices = self.index_buffer(corners)?;
        let passes: &[(u32, Option<usize>)] = match (views.len(), multiview) {
            (1, _) => &[(0, Some(0))],
            (_, true) => &[(0b11, None)],
            (_, false) => &[(0, Some(0)), (0, Some(1))],
        };
        for &(view_mask, layer) in passes {
            let pass = PassKey {
                blended: blended_format(config.target),
                output: target.format,
                output_layout: target.layout,
                view_mask,
                early_stop,
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
            )?;
        }
        let queries = &self.slots[frame.slot].queries;
        queries.stamp(commands, 3);
        if let Some(workspace) = &mut self.workspace
            && config.expansion == Expansion::Precomputed
        {
            workspace.copy_plan(&self.gpu, commands, frame.slot);
        }
        let slot = &mut self.slots[frame.slot];
        slot.report.views = views.len() as u32;
        slot.report.pixels = u64::from(target.size[0]) * u64::from(target.size[1]) * views.len() as u64;
        slot.report.full_screen_fragments = slot.report.pixels * u64::from(batches - 1);
        Ok(())
    }

    fn prepare_workspace(&mut self, scene: &SceneOnDevice, exact: bool) -> Result<(), GpuError> {
        if !self.workspace.as_ref().is_some_and(|w| w.fits(scene.splats, exact)) {
            self.gpu.wait_idle()?;
            self.workspace = None;
            self.workspace = Some(Workspace::new(&self.gpu, scene.splats, exact, FRAMES)?);
        }
        Ok(())
    }

    fn write_frame_data(&mut self, slot: usize, request: &DrawRequest<'_>) {
        let data = frame_data(request);
        self.background = request.config.background;
        let uniform = &mut self.slots[slot].uniform;
        uniform.mapped_mut()[..size_of::<FrameData>()].copy_from_slice(bytemuck::bytes_of(&data));
    }

    /// Brings a new order to the device, and waits there for the frame before to be done with the old one.
    fn upload_order(&mut self, slot: usize, request: &DrawRequest<'_>) -> Result<(), GpuError> {
        let Some(workspace) = &mut self.workspace else { return Ok(()) };
        let slot = &mut self.slots[slot];
        let device = self.gpu.device();
        let readers = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::VERTEX_SHADER;
        let readers = if self.gpu.capabilities.geometry_shader {
            readers | vk::PipelineStageFlags::GEOMETRY_SHADER
        } else {
            readers
        };
        let indices = &request.order.indices;
        if workspace.order_id != request.order.id && !indices.is_empty() {
            let bytes = 4 * indices.len() as u64;
            if slot.order_staging.as_ref().is_none_or(|b| b.bytes() < bytes) {
                slot.order_staging = None;
                let staging = Buffer::new(
                    &self.gpu,
                    "order staging",
                    bytes,
                    vk::BufferUsageFlags::TRANSFER_SRC,
                    MemoryLocation::CpuToGpu,
                )?;
                slot.order_staging = Some(staging);
            }
            if let Some(staging) = &mut slot.order_staging {
                staging.mapped_mut()[..bytes as usize].copy_from_slice(bytemuck::cast_slice(indices));
                let copy = vk::BufferCopy { src_offset: 0, dst_offset: 0, size: bytes };
                let before = vk::MemoryBarrier::default();
                // SAFETY: both buffers hold the region; readers of the old order are waited for.
                unsafe {
                    let none = vk::DependencyFlags::empty();
                    device.cmd_pipeline_barrier(
                        slot.commands,
                        readers,
                        vk::PipelineStageFlags::TRANSFER,
                        none,
                        &[before],
                        &[],
                        &[],
                    );
                    device.cmd_copy_buffer(slot.commands, staging.raw(), workspace.order.raw(), &[copy]);
                }
            }
            workspace.order_id = request.order.id;
        }
        // The frame before still draws from the records that this one writes.
        let barrier = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE | vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
        // SAFETY: recorded outside any render pass.
        unsafe {
            device.cmd_pipeline_barrier(
                slot.commands,
                readers | vk::PipelineStageFlags::TRANSFER | vk::PipelineStageFlags::DRAW_INDIRECT,
                readers,
                vk::DependencyFlags::empty(),
                &[barrier],
                &[],
                &[],
            );
        }
        Ok(())
    }

    fn allocate_set(&self, slot: usize, set: usize) -> Result<vk::DescriptorSet, GpuError> {
        let layouts = [self.passes.set_layouts[set]];
        let info = vk::DescriptorSetAllocateInfo::default()
            .descriptor_pool(self.slots[slot].descriptors)
            .set_layouts(&layouts);
        // SAFETY: the pool was reset when the frame began and is large enough for a frame.
        Ok(call(unsafe { self.gpu.device().allocate_descriptor_sets(&info) }, "vkAllocateDescriptorSets")?[0])
    }

    fn scene_sets(&self, slot: usize, scene: &SceneOnDevice) -> Result<[vk::DescriptorSet; 3], GpuError> {
        let sets = [self.allocate_set(slot, 0)?, self.allocate_set(slot, 1)?, self.allocate_set(slot, 2)?];
        let Some(workspace) = &self.workspace else { return Ok(sets) };
        let whole =
            |b: &Buffer| vk::DescriptorBufferInfo { buffer: b.raw(), offset: 0, range: vk::WHOLE_SIZE };
        let uniform = [vk::DescriptorBufferInfo {
            buffer: self.slots[slot].uniform.raw(),
            offset: 0,
            range: size_of::<FrameData>() as u64,
        }];
        // A stream of fewer bindings fills the rest with its first: they are never read.
        let stream = |buffers: &[Buffer], slots: usize| -> Vec<_> {
            (0..slots).map(|i| whole(buffers.get(i).unwrap_or(&buffers[0]))).collect()
        };
        let geometry = stream(&scene.geometry.buffers, 4);
        let harmonics = stream(&scene.harmonics.buffers, 4);
        let motion = stream(&scene.motion.buffers, 2);
        let order = [whole(&workspace.order)];
        let records = [whole(&workspace.records[0]), whole(&workspace.records[1])];
        let singles =
            [&workspace.blocks, &workspace.flags, &workspace.offsets, &workspace.plan, &workspace.visible]
                .map(|b| [whole(b)]);
        let write = |set: usize, binding: u32, kind, infos| {
            vk::WriteDescriptorSet { dst_set: sets[set], ..Default::default() }
                .dst_binding(binding)
                .descriptor_type(kind)
                .buffer_info(infos)
        };
        let storage = vk::DescriptorType::STORAGE_BUFFER;
        let mut writes = vec![
            write(0, 0, vk::DescriptorType::UNIFORM_BUFFER, &uniform[..]),
            write(1, 0, storage, &geometry),
            write(1, 1, storage, &harmonics),
            write(1, 2, storage, &motion),
            write(2, 0, storage, &order),
            write(2, 1, storage, &records),
        ];
        for (binding, info) in (2..).zip(&singles) {
            writes.push(write(2, binding, storage, info));
        }
        // SAFETY: sets and buffers are alive and not in use by the device.
        unsafe { self.gpu.device().update_descriptor_sets(&writes, &[]) };
        Ok(sets)
    }

    fn record_preparation(
        &mut self,
        commands: vk::CommandBuffer,
        splats: u32,
        sets: &[vk::DescriptorSet; 3],
        specialization: Specialization,
    ) -> Result<(), GpuError> {
        let project = self.passes.compute(Preparation::Project, specialization)?;
        let plan = self.passes.compute(Preparation::Plan, specialization)?;
        let emit = self.passes.compute(Preparation::Emit, specialization)?;
        let device = self.gpu.device();
        let groups = splats.div_ceil(BLOCK);
        let between = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
        let after =
            vk::MemoryBarrier::default().src_access_mask(vk::AccessFlags::SHADER_WRITE).dst_access_mask(
                vk::AccessFlags::SHADER_READ
                    | vk::AccessFlags::INDIRECT_COMMAND_READ
                    | vk::AccessFlags::TRANSFER_READ,
            );
        let compute = vk::PipelineStageFlags::COMPUTE_SHADER;
        // SAFETY: pipelines and sets match the layout; buffers are sized for `splats`.
        unsafe {
            let none = vk::DependencyFlags::empty();
            device.cmd_bind_descriptor_sets(
                commands,
                vk::PipelineBindPoint::COMPUTE,
                self.passes.layout,
                0,
                sets,
                &[],
            );
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, project);
            device.cmd_dispatch(commands, groups, 1, 1);
            device.cmd_pipeline_barrier(commands, compute, compute, none, &[between], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, plan);
            device.cmd_dispatch(commands, 1, 1, 1);
            device.cmd_pipeline_barrier(commands, compute, compute, none, &[between], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, emit);
            device.cmd_dispatch(commands, groups, 1, 1);
            device.cmd_pipeline_barrier(
                commands,
                compute,
                vk::PipelineStageFlags::VERTEX_SHADER
                    | vk::PipelineStageFlags::DRAW_INDIRECT
                    | vk::PipelineStageFlags::TRANSFER,
                none,
                &[after],
                &[],
                &[],
            );
        }
        Ok(())
    }

    #[allow(clippy::too_many_arguments)]
    fn record_pass(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        pass: PassKey,
        layer: Option<usize>,
        specialization: Specialization,
        batches: u32,
        corners: u32,
        indices: vk::Buffer,
        sets: &[vk::DescriptorSet; 3],
    ) -> Result<(), GpuError> {
        let DrawRequest { scene, target, config, .. } = *request;
        let stages = match config.expansion {
            Expansion::Precomputed => Stages::Precomputed,
            Expansion::Instanced => Stages::Instanced,
            Expansion::Geometry => Stages::Geometry,
        };
        let splats = self.passes.splats(pass, stages, specialization)?;
        let resolve = self.passes.full_screen(pass, FullScreen::Resolve)?;
        let mark =
            if pass.early_stop { Some(self.passes.full_screen(pass, FullScreen::Mark)?) } else { None };
        let render_pass = self.passes.pass(pass)?;
        let output = layer.map_or(target.all, |l| target.layers[l]);
        let (framebuffer, blended_view) = self.framebuffer(render_pass, pass, output, target.size)?;
        let read_layout = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        let mark_layout = vk::ImageLayout::GENERAL;
        let input_sets = [
            self.input_set(slot, blended_view, mark_layout)?,
            self.input_set(slot, blended_view, read_layout)?,
        ];

        let [width, height] = target.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let viewport = vk::Viewport {
            x: 0.0,
            y: 0.0,
            width: width as f32,
            height: height as f32,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        let mut clear = [vk::ClearValue::default(); 3];
        clear[2].depth_stencil = vk::ClearDepthStencilValue { depth: 1.0, stencil: 0 };
        let begin = vk::RenderPassBeginInfo::default()
            .render_pass(render_pass)
            .framebuffer(framebuffer)
            .render_area(area)
            .clear_values(&clear[..if pass.early_stop { 3 } else { 2 }]);
        let layout = self.passes.layout;
        let push_stages = self.passes.push_stages();
        let gpu = self.gpu.clone();
        let device = gpu.device();
        let commands = self.slots[slot].commands;
        let plan = self.workspace.as_ref().map(|w| w.plan.raw()).unwrap_or_default();
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        let view = layer.unwrap_or(0) as u32;
        // SAFETY: every handle is alive until the frame is done; the records and draws were written before.
        unsafe {
            device.cmd_begin_render_pass(commands, &begin, vk::SubpassContents::INLINE);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_bind_descriptor_sets(commands, graphics, layout, 0, sets, &[]);
            device.cmd_bind_index_buffer(commands, indices, 0, vk::IndexType::UINT16);
            let counted = if pass.view_mask == 0 { 1 } else { 2 };
            self.slots[slot].queries.begin_statistics(commands, view, counted);
            for batch in 0..batches {
                device.cmd_bind_pipeline(commands, graphics, splats);
                let [first, last] = [batch, batch + 1]
                    .map(|b| (u64::from(scene.splats) * u64::from(b) / u64::from(batches)) as u32);
                let push = [batch, view, first, last];
                device.cmd_push_constants(commands, layout, push_stages, 0, bytemuck::cast_slice(&push));
                match config.expansion {
                    Expansion::Precomputed => {
                        let offset = u64::from(batch) * size_of::<Draw>() as u64;
                        device.cmd_draw_indexed_indirect(commands, plan, offset, 1, size_of::<Draw>() as u32);
                    }
                    Expansion::Instanced => {
                        let instances = (last - first).div_ceil(QUADS_PER_INSTANCE);
                        device.cmd_draw_indexed(
                            commands,
                            (corners - 2) * 3 * QUADS_PER_INSTANCE,
                            instances,
                            0,
                            0,
                            0,
                        );
                    }
                    Expansion::Geometry => device.cmd_draw(commands, last - first, 1, 0, 0),
                }
                if let Some(mark) = mark
                    && batch + 1 < batches
                {
                    self.passes.blended_to_marks(commands, pass);
                    device.cmd_bind_descriptor_sets(commands, graphics, layout, 3, &input_sets[..1], &[]);
                    device.cmd_bind_pipeline(commands, graphics, mark);
                    device.cmd_draw(commands, 3, 1, 0, 0);
                }
            }
            self.slots[slot].queries.end_statistics(commands, view);
            device.cmd_next_subpass(commands, vk::SubpassContents::INLINE);
            device.cmd_bind_descriptor_sets(commands, graphics, layout, 3, &input_sets[1..], &[]);
            device.cmd_bind_pipeline(commands, graphics, resolve);
            let b = config.background;
            let decode = u32::from(is_srgb(target.format));
            let push =
                [b[0].to_bits(), b[1].to_bits(), b[2].to_bits(), target.background_alpha.to_bits(), decode];
            device.cmd_push_constants(commands, layout, push_stages, 0, bytemuck::cast_slice(&push));
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_render_pass(commands);
        }
        const { assert!(PUSH_BYTES >= 20) };
        Ok(())
    }

    fn input_set(
        &self,
        slot: usize,
        view: vk::ImageView,
        layout: vk::ImageLayout,
    ) -> Result<vk::DescriptorSet, GpuError> {
        let set = self.allocate_set(slot, 3)?;
        let infos = [vk::DescriptorImageInfo {
            sampler: vk::Sampler::null(),
            image_view: view,
            image_layout: layout,
        }];
        let write = vk::WriteDescriptorSet { dst_set: set, ..Default::default() }
            .dst_binding(0)
            .descriptor_type(vk::DescriptorType::INPUT_ATTACHMENT)
            .image_info(&infos);
        // SAFETY: set and view are alive and not in use by the device.
        unsafe { self.gpu.device().update_descriptor_sets(&[write], &[]) };
        Ok(set)
    }

    /// The framebuffer for an output, and the blended image's view in it.
    fn framebuffer(
        &mut self,
        render_pass: vk::RenderPass,
        pass: PassKey,
        output: vk::ImageView,
        size: [u32; 2],
    ) -> Result<(vk::Framebuffer, vk::ImageView), GpuError> {
        let layers = if pass.view_mask == 0 { 1 } else { 2 };
        let description = ImageDescription {
            format: pass.blended,
            size,
            layers,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::INPUT_ATTACHMENT,
            aspect: vk::ImageAspectFlags::COLOR,
        };
        let fits = self.blended.as_ref().is_some_and(|(blended, marks)| {
            blended.description() == description && (marks.is_some() || !pass.early_stop)
        });
        if !fits {
            self.forget_targets()?;
            self.blended = None;
            let blended = Image::new(&self.gpu, "blended", description)?;
            let marks = ImageDescription {
                format: MARK_FORMAT,
                usage: vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT,
                aspect: vk::ImageAspectFlags::DEPTH,
                ..description
            };
            let marks = if pass.early_stop { Some(Image::new(&self.gpu, "marks", marks)?) } else { None };
            self.blended = Some((blended, marks));
        }
        let Some((blended, marks)) = &self.blended else {
            return Err(GpuError::NoDevice("no image to blend into".into()));
        };
        let key = FramebufferKey { pass: render_pass, output, size };
        if let Some(framebuffer) = self.framebuffers.get(&key) {
            return Ok((framebuffer.raw, blended.view()));
        }
        let mut attachments = vec![blended.view(), output];
        if let (Some(marks), true) = (marks, pass.early_stop) {
            attachments.push(marks.view());
        }
        let info = vk::FramebufferCreateInfo::default()
            .render_pass(render_pass)
            .attachments(&attachments)
            .width(size[0])
            .height(size[1])
            .layers(1);
        // SAFETY: pass and views are alive.
        let raw = call(unsafe { self.gpu.device().create_framebuffer(&info, None) }, "vkCreateFramebuffer")?;
        self.framebuffers.insert(key, Framebuffer { raw });
        Ok((raw, blended.view()))
    }

    /// Indices of one instance: every polygon as a strip that zigzags from corner 0.
    fn index_buffer(&mut self, corners: u32) -> Result<vk::Buffer, GpuError> {
        if let Some(buffer) = self.indices.get(&corners) {
            return Ok(buffer.raw());
        }
        let strip = |j: u32| {
            if j == 0 {
                0
            } else if j % 2 == 1 {
                j.div_ceil(2)
            } else {
                corners - j / 2
            }
        };
        let mut words: Vec<u16> = Vec::new();
        for quad in 0..QUADS_PER_INSTANCE {
            for triangle in 0..corners - 2 {
                words.extend((0..3).map(|k| (quad * corners + strip(triangle + k)) as u16));
            }
        }
        let mut buffer = Buffer::new(
            &self.gpu,
            "indices",
            2 * words.len() as u64,
            vk::BufferUsageFlags::INDEX_BUFFER,
            MemoryLocation::CpuToGpu,
        )?;
        buffer.mapped_mut()[..2 * words.len()].copy_from_slice(bytemuck::cast_slice(&words));
        let raw = buffer.raw();
        self.indices.insert(corners, buffer);
        Ok(raw)
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

/// Format of the blended image.
fn blended_format(target: TargetFormat) -> vk::Format {
    match target {
        TargetFormat::Rgba16F => vk::Format::R16G16B16A16_SFLOAT,
        TargetFormat::Rgba8 => vk::Format::R8G8B8A8_UNORM,
        TargetFormat::Rgb10A2 => vk::Format::A2B10G10R10_UNORM_PACK32,
    }
}

fn is_srgb(format: vk::Format) -> bool {
    matches!(format, vk::Format::R8G8B8A8_SRGB | vk::Format::B8G8R8A8_SRGB | vk::Format::A8B8G8R8_SRGB_PACK32)
}

/// Corners of the polygon.
fn corners(config: &RenderConfig) -> u32 {
    if config.shape == crate::QuadShape::Octagon { 8 } else { 4 }
}

fn specialization(scene: &SceneOnDevice, views: usize, config: &RenderConfig) -> Specialization {
    Specialization {
        projection: config.projection as u32,
        low_pass: config.low_pass as u32,
        shape: config.shape as u32,
        radius: match config.radius {
            RadiusRule::OpacityAware => 0,
            RadiusRule::Sqrt8 => 1,
            RadiusRule::Full => 2,
        },
        precision: scene.packing.precision as u32,
        sh_degree: u32::from(config.sh_degree.min(scene.packing.sh_degree)),
        sh_stored: u32::from(scene.packing.sh_degree),
        sh_precision: scene.packing.sh_precision as u32,
        geometry_slots: scene.geometry.buffers.len() as u32,
        sh_slots: scene.harmonics.buffers.len() as u32,
        motion: u32::from(scene.moving),
        views: views as u32,
        composite: u32::from(config.composite == Composite::BackToFront),
        geometry_shift: scene.geometry.shift,
        sh_shift: scene.harmonics.shift,
    }
}

/// The point between the eyes, from which the radial order is measured.
pub fn midpoint(views: &[View]) -> DVec3 {
    views.iter().map(|v| v.eye).sum::<DVec3>() / views.len().max(1) as f64
}

fn frame_data(request: &DrawRequest<'_>) -> FrameData {
    let DrawRequest { scene, views, config, target, .. } = *request;
    let mut data = FrameData::default();
    let [width, height] = target.size.map(|s| s as f32);
    for (out, view) in data.views.iter_mut().zip(views) {
        let rows = view.rotation.transpose();
        let row = |v: DVec3| v.as_vec3().extend(0.0).to_array();
        let f = view.fov;
        let view_of_target = View { size: target.size, ..*view };
        let [fx, fy] = view_of_target.focal();
        *out = ViewData {
            rotation: [row(rows.x_axis), row(rows.y_axis), row(rows.z_axis)],
            eye: (view.eye - scene.origin).as_vec3().extend(0.0).to_array(),
            tangents: [f.left as f32, f.right as f32, f.up as f32, f.down as f32],
            image: [fx as f32, fy as f32, width, height],
        };
    }
    let early_stop = config.composite == Composite::EarlyStop;
    data.sort_center = (midpoint(views) - scene.origin).as_vec3().extend(0.0).to_array();
    data.cull = [config.near, config.near_fade, config.min_opacity, config.min_contribution];
    data.filters = [0.3, config.max_radius * width.max(height), config.stop_below, config.time];
    data.counts = [
        scene.splats,
        if early_stop { config.batches.min(MAX_BATCHES as u32) } else { 1 },
        corners(config),
        0,
    ];
    data
}

const _: () = assert!(offset_of!(FrameData, counts) == 240);
