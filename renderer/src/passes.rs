//! Render passes and pipelines, made on first use and kept.

use crate::gpu::{During, Gpu, GpuError};
use crate::pipeline::{self, Depth, GraphicsPipeline, replaced};
use crate::pipeline_cache::{self, Kept};
use crate::render_pass::PassKey;
use crate::shader::Constants;
use ash::vk;
use motes_shaders::layout::Specialization;
use motes_shaders::modules;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The splats' pipelines differ by who makes the corners.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Stages {
    Precomputed,
    Instanced,
    Geometry,
}

/// The passes over a whole image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum FullScreen {
    /// Marks saturated pixels everywhere.
    Mark,
    /// Marks them in a list of tiles.
    MarkTiles,
    Resolve,
    /// Puts what compute passes blended where fragments would have blended it.
    ShowTiles,
}

/// The compute passes before drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Preparation {
    Project,
    Count,
    Plan,
    Emit,
    Schedule,
    /// Splats by tiles.
    TileSplats,
    TileScan,
    TileList,
    /// With or without counting layers.
    TileBlend(bool),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum PipelineKey {
    Splats(PassKey, Stages, Specialization),
    FullScreen(PassKey, FullScreen),
    Compute(Preparation, Specialization),
}

/// Everything that is made once and looked up by key.
pub(crate) struct Passes {
    gpu: Arc<Gpu>,
    pub set_layouts: [vk::DescriptorSetLayout; 4],
    pub layout: vk::PipelineLayout,
    cache: vk::PipelineCache,
    /// Where the cache is kept on disk.
    kept_in: Option<PathBuf>,
    /// Pipelines that there were when it was last written.
    saved: usize,
    passes: HashMap<PassKey, vk::RenderPass>,
    pipelines: HashMap<PipelineKey, vk::Pipeline>,
}

/// Storage buffers that a stage of a pipeline may see: of parts, of geometry, of harmonics, of motion, of a frame, of tiles.
pub(crate) const STORAGE_BUFFERS: u32 = 1 + 4 + 4 + 2 + 10 + 3;
/// Bytes of push constants that all pipelines share.
pub(crate) const PUSH_BYTES: u32 = 32;

impl Passes {
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, GpuError> {
        let mut made = Self {
            gpu: gpu.clone(),
            set_layouts: [vk::DescriptorSetLayout::null(); 4],
            layout: vk::PipelineLayout::null(),
            cache: vk::PipelineCache::null(),
            kept_in: None,
            saved: 0,
            passes: HashMap::new(),
            pipelines: HashMap::new(),
        };
        let device = gpu.device();
        let mut stages =
            vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT | vk::ShaderStageFlags::COMPUTE;
        if gpu.capabilities.geometry_shader {
            stages |= vk::ShaderStageFlags::GEOMETRY;
        }
        let binding = |binding, kind, count| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(binding)
                .descriptor_type(kind)
                .descriptor_count(count)
                .stage_flags(stages)
        };
        let image = |at, kind| binding(at, kind, 1).stage_flags(vk::ShaderStageFlags::FRAGMENT);
        let storage = vk::DescriptorType::STORAGE_BUFFER;
        let sets = [
            vec![binding(0, vk::DescriptorType::UNIFORM_BUFFER, 1), binding(1, storage, 1)],
            vec![binding(0, storage, 4), binding(1, storage, 4), binding(2, storage, 2)],
            vec![
                binding(0, storage, 1),
                binding(1, storage, 2),
                binding(2, storage, 1),
                binding(3, storage, 1),
                binding(4, storage, 1),
                binding(5, storage, 1),
                binding(6, storage, 1),
                binding(7, storage, 1),
                binding(8, storage, 1),
            ],
            vec![
                // The blended image within its pass; afterwards; and the frame before.
                image(0, vk::DescriptorType::INPUT_ATTACHMENT),
                image(1, vk::DescriptorType::COMBINED_IMAGE_SAMPLER),
                image(2, vk::DescriptorType::COMBINED_IMAGE_SAMPLER),
                // Splats by tiles: splats, lists, pixels.
                binding(3, storage, 1),
                binding(4, storage, 1),
                binding(5, storage, 1),
            ],
        ];
        let buffers = sets.iter().flatten().filter(|b| b.descriptor_type == storage);
        debug_assert_eq!(buffers.map(|b| b.descriptor_count).sum::<u32>(), STORAGE_BUFFERS);
        for (slot, bindings) in made.set_layouts.iter_mut().zip(&sets) {
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(bindings);
            // SAFETY: `info` is complete.
            *slot = unsafe { device.create_descriptor_set_layout(&info, None) }
                .during("vkCreateDescriptorSetLayout")?;
        }
        let push = [vk::PushConstantRange { stage_flags: stages, offset: 0, size: PUSH_BYTES }];
        let info = vk::PipelineLayoutCreateInfo::default()
            .set_layouts(&made.set_layouts)
            .push_constant_ranges(&push);
        // SAFETY: the set layouts were just made.
        made.layout =
            unsafe { device.create_pipeline_layout(&info, None) }.during("vkCreatePipelineLayout")?;
        // SAFETY: an empty cache.
        made.cache = unsafe { device.create_pipeline_cache(&vk::PipelineCacheCreateInfo::default(), None) }
            .during("vkCreatePipelineCache")?;
        Ok(made)
    }

    /// Makes pipelines from what is kept in a folder, and keeps them there when this goes.
    pub fn keep_in(&mut self, folder: &Path) -> Result<Kept, GpuError> {
        let (cache, kept) = pipeline_cache::load(&self.gpu, folder)?;
        // SAFETY: no pipeline is being made; those that were need their cache no more.
        unsafe {
            let merged = self.gpu.device().merge_pipeline_caches(cache, &[self.cache]);
            self.gpu.device().destroy_pipeline_cache(self.cache, None);
            self.cache = cache;
            merged.during("vkMergePipelineCaches")?;
        }
        self.kept_in = Some(folder.to_owned());
        Ok(kept)
    }

    /// Writes the cache where it is kept, if pipelines were made since it was read or written.
    pub fn save(&mut self) {
        if let Some(folder) = &self.kept_in
            && self.saved != self.pipelines.len()
        {
            pipeline_cache::store(&self.gpu, folder, self.cache);
            self.saved = self.pipelines.len();
        }
    }

    /// The cache that pipelines are made with.
    pub fn cache(&self) -> vk::PipelineCache {
        self.cache
    }

    /// Stages that see push constants.
    pub fn push_stages(&self) -> vk::ShaderStageFlags {
        let stages =
            vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT | vk::ShaderStageFlags::COMPUTE;
        if self.gpu.capabilities.geometry_shader { stages | vk::ShaderStageFlags::GEOMETRY } else { stages }
    }

    /// The render pass of a key.
    pub fn pass(&mut self, key: PassKey) -> Result<vk::RenderPass, GpuError> {
        if let Some(pass) = self.passes.get(&key) {
            return Ok(*pass);
        }
        let pass = key.make(&self.gpu)?;
        self.passes.insert(key, pass);
        Ok(pass)
    }

    /// The barrier that lets the marks be made from what has been blended so far.
    pub fn blended_to_marks(&self, commands: vk::CommandBuffer, key: PassKey) {
        let barrier = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::COLOR_ATTACHMENT_WRITE)
            .dst_access_mask(vk::AccessFlags::INPUT_ATTACHMENT_READ);
        // SAFETY: recorded inside subpass 0, whose self-dependency says the same.
        unsafe {
            self.gpu.device().cmd_pipeline_barrier(
                commands,
                vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT,
                vk::PipelineStageFlags::FRAGMENT_SHADER,
                key.by_region(),
                &[barrier],
                &[],
                &[],
            );
        }
    }

    /// A compute pipeline.
    pub fn compute(
        &mut self,
        what: Preparation,
        specialization: Specialization,
    ) -> Result<vk::Pipeline, GpuError> {
        let key = PipelineKey::Compute(what, specialization);
        if let Some(pipeline) = self.pipelines.get(&key) {
            return Ok(*pipeline);
        }
        let code = match what {
            Preparation::Project => modules::PROJECT_COMP,
            Preparation::Count => modules::COUNT_COMP,
            Preparation::Plan => modules::PLAN_COMP,
            Preparation::Emit => modules::EMIT_COMP,
            Preparation::Schedule => modules::SCHEDULE_COMP,
            Preparation::TileSplats => modules::TILE_SPLATS_COMP,
            Preparation::TileScan => modules::TILE_SCAN_COMP,
            Preparation::TileList => modules::TILE_LIST_COMP,
            Preparation::TileBlend(false) => modules::TILE_BLEND_COMP,
            Preparation::TileBlend(true) => modules::TILE_BLEND_COMP_COUNT,
        };
        let constants = Constants::from(&specialization);
        let pipeline = pipeline::compute(&self.gpu, self.cache, self.layout, code, &constants)?;
        self.pipelines.insert(key, pipeline);
        Ok(pipeline)
    }

    /// The pipeline that draws splats.
    pub fn splats(
        &mut self,
        pass: PassKey,
        stages: Stages,
        specialization: Specialization,
    ) -> Result<vk::Pipeline, GpuError> {
        let key = PipelineKey::Splats(pass, stages, specialization);
        if let Some(pipeline) = self.pipelines.get(&key) {
            return Ok(*pipeline);
        }
        let exact = specialization.projection == crate::Projection::Exact as u32;
        let multiview = pass.view_mask != 0;
        let vertex = match (stages, exact, multiview) {
            (Stages::Precomputed, false, false) => modules::SPLAT_VERT,
            (Stages::Precomputed, true, false) => modules::SPLAT_VERT_EXACT,
            (Stages::Precomputed, false, true) => modules::SPLAT_VERT_MULTIVIEW,
            (Stages::Precomputed, true, true) => modules::SPLAT_VERT_EXACT_MULTIVIEW,
            (Stages::Instanced, false, false) => modules::INSTANCED_VERT,
            (Stages::Instanced, true, false) => modules::INSTANCED_VERT_EXACT,
            (Stages::Instanced, false, true) => modules::INSTANCED_VERT_MULTIVIEW,
            (Stages::Instanced, true, true) => modules::INSTANCED_VERT_EXACT_MULTIVIEW,
            (Stages::Geometry, ..) => modules::POINT_VERT,
        };
        let vertex = match (pass.stochastic, exact, multiview) {
            (false, ..) => vertex,
            (true, false, false) => modules::SPLAT_VERT_STOCHASTIC,
            (true, true, false) => modules::SPLAT_VERT_EXACT_STOCHASTIC,
            (true, false, true) => modules::SPLAT_VERT_MULTIVIEW_STOCHASTIC,
            (true, true, true) => modules::SPLAT_VERT_EXACT_MULTIVIEW_STOCHASTIC,
        };
        let lens = specialization.lens != crate::Lens::Perspective as u32;
        let vertex = match (lens, exact) {
            (false, _) => vertex,
            (true, false) => modules::SPLAT_VERT_LENS,
            (true, true) => modules::SPLAT_VERT_EXACT_LENS,
        };
        let fragment = match (exact, pass.count) {
            (false, false) if lens => modules::SPLAT_FRAG_LENS,
            (true, false) if lens => modules::SPLAT_FRAG_EXACT_LENS,
            (false, true) if lens => modules::SPLAT_FRAG_LENS_COUNT,
            (true, true) if lens => modules::SPLAT_FRAG_EXACT_LENS_COUNT,
            (false, _) if pass.stochastic => modules::SPLAT_FRAG_STOCHASTIC,
            (true, _) if pass.stochastic => modules::SPLAT_FRAG_EXACT_STOCHASTIC,
            (false, false) => modules::SPLAT_FRAG,
            (true, false) => modules::SPLAT_FRAG_EXACT,
            (false, true) => modules::SPLAT_FRAG_COUNT,
            (true, true) => modules::SPLAT_FRAG_EXACT_COUNT,
        };
        let geometry = if exact { modules::SPLAT_GEOM_EXACT } else { modules::SPLAT_GEOM };
        let shaders = [
            (vk::ShaderStageFlags::VERTEX, vertex),
            (vk::ShaderStageFlags::FRAGMENT, fragment),
            (vk::ShaderStageFlags::GEOMETRY, geometry),
        ];
        let (shaders, topology) = match stages {
            Stages::Geometry => (&shaders[..], vk::PrimitiveTopology::POINT_LIST),
            Stages::Precomputed | Stages::Instanced => (&shaders[..2], vk::PrimitiveTopology::TRIANGLE_LIST),
        };
        // Premultiplied colours: over from behind, or under what is already there. Alpha sums what is covered, rather than
        // multiplying what comes through: where half floats are cut towards zero, errors of the sum and of the colours
        // cancel, while a product darkens with every layer (measured: FLIP to 32-bit sums 0.009 against 0.027, skull).
        let (source, destination) = if specialization.composite == COMPOSITE_BACK_TO_FRONT {
            (vk::BlendFactor::ONE, vk::BlendFactor::ONE_MINUS_SRC_ALPHA)
        } else {
            (vk::BlendFactor::ONE_MINUS_DST_ALPHA, vk::BlendFactor::ONE)
        };
        // Stochastic splats are opaque.
        let blend = replaced()
            .blend_enable(!pass.stochastic)
            .src_color_blend_factor(source)
            .dst_color_blend_factor(destination)
            .color_blend_op(vk::BlendOp::ADD)
            .src_alpha_blend_factor(source)
            .dst_alpha_blend_factor(destination)
            .alpha_blend_op(vk::BlendOp::ADD);
        // Counts add up; what leads to the median depth is not the splats' to write.
        let second = if pass.count {
            replaced()
                .blend_enable(true)
                .src_color_blend_factor(vk::BlendFactor::ONE)
                .dst_color_blend_factor(vk::BlendFactor::ONE)
        } else {
            vk::PipelineColorBlendAttachmentState::default()
        };
        // Splats lie at depth ½ everywhere, and a mark (0) stops them; stochastic ones at their distance, nearer is greater.
        let nearer = if pass.stochastic { vk::CompareOp::GREATER } else { vk::CompareOp::LESS };
        let pipeline = GraphicsPipeline {
            shaders,
            constants: &Constants::from(&specialization),
            input: vk::PipelineVertexInputStateCreateInfo::default(),
            topology,
            depth: pass.depth_format().map(|_| Depth { compare: nearer, write: pass.stochastic }),
            blends: &[blend, second][..pass.colours()],
            layout: self.layout,
            pass: self.pass(pass)?,
            subpass: 0,
        };
        let pipeline = pipeline.make(&self.gpu, self.cache)?;
        self.pipelines.insert(key, pipeline);
        Ok(pipeline)
    }

    /// A pipeline over the whole image.
    pub fn full_screen(&mut self, pass: PassKey, what: FullScreen) -> Result<vk::Pipeline, GpuError> {
        let key = PipelineKey::FullScreen(pass, what);
        if let Some(pipeline) = self.pipelines.get(&key) {
            return Ok(*pipeline);
        }
        let vertex = match (what, pass.view_mask) {
            (FullScreen::MarkTiles, 0) => modules::MARK_VERT,
            (FullScreen::MarkTiles, _) => modules::MARK_VERT_MULTIVIEW,
            (FullScreen::Mark | FullScreen::Resolve | FullScreen::ShowTiles, _) => modules::FULLSCREEN_VERT,
        };
        let mark = matches!(what, FullScreen::Mark | FullScreen::MarkTiles);
        let show = what == FullScreen::ShowTiles;
        let fragment = match (what, pass.view_mask, pass.count) {
            (FullScreen::Mark | FullScreen::MarkTiles, ..) => modules::MARK_FRAG,
            (FullScreen::Resolve, ..) => modules::RESOLVE_FRAG,
            (FullScreen::ShowTiles, 0, false) => modules::TILE_SHOW_FRAG,
            (FullScreen::ShowTiles, 0, true) => modules::TILE_SHOW_FRAG_COUNT,
            (FullScreen::ShowTiles, _, false) => modules::TILE_SHOW_FRAG_MULTIVIEW,
            (FullScreen::ShowTiles, _, true) => modules::TILE_SHOW_FRAG_MULTIVIEW_COUNT,
        };
        // A mark writes depth alone.
        let marked = [vk::PipelineColorBlendAttachmentState::default(); 2];
        let pipeline = GraphicsPipeline {
            shaders: &[(vk::ShaderStageFlags::VERTEX, vertex), (vk::ShaderStageFlags::FRAGMENT, fragment)],
            constants: &Constants::default(),
            input: vk::PipelineVertexInputStateCreateInfo::default(),
            topology: vk::PrimitiveTopology::TRIANGLE_LIST,
            depth: mark.then_some(Depth { compare: vk::CompareOp::LESS, write: true }),
            blends: match (mark, show) {
                (true, _) => &marked[..pass.colours()],
                (_, true) => &[replaced(); 2][..pass.colours()],
                _ => &[replaced()],
            },
            layout: self.layout,
            pass: self.pass(pass)?,
            subpass: u32::from(what == FullScreen::Resolve),
        };
        let pipeline = pipeline.make(&self.gpu, self.cache)?;
        self.pipelines.insert(key, pipeline);
        Ok(pipeline)
    }
}

/// `COMPOSITE_BACK_TO_FRONT` of the shaders.
pub(crate) const COMPOSITE_BACK_TO_FRONT: u32 = 1;

impl Drop for Passes {
    fn drop(&mut self) {
        if let Some(folder) = &self.kept_in {
            pipeline_cache::store(&self.gpu, folder, self.cache);
        }
        let device = self.gpu.device();
        // SAFETY: the renderer that owns this has waited for its frames.
        unsafe {
            for pipeline in self.pipelines.values() {
                device.destroy_pipeline(*pipeline, None);
            }
            for pass in self.passes.values() {
                device.destroy_render_pass(*pass, None);
            }
            device.destroy_pipeline_cache(self.cache, None);
            device.destroy_pipeline_layout(self.layout, None);
            for layout in self.set_layouts {
                device.destroy_descriptor_set_layout(layout, None);
            }
        }
    }
}
