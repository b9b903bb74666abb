//! The order made on the device: keys from the scene's own buffers, then a radix sort, every n-th frame.

mod radix;
mod standalone;

pub use radix::SortShape;
pub use standalone::KeySorter;

use super::OrderRequest;
use crate::gpu::{Buffer, During, Gpu, GpuError};
use crate::parts::Parts;
use crate::pipeline;
use crate::scene::SceneOnDevice;
use crate::{KeyBits, OrderKey};
use ash::vk;
use motes_shaders::layout::Specialization;
use motes_shaders::modules;
use radix::{Push, RadixBuffers, RadixJob, RadixSort};
use std::collections::HashMap;
use std::sync::Arc;

// As in `sort_keys.comp`.
const KEY_DEPTH: u32 = 1;
const KEY_16: u32 = 2;
const KEY_LISTED: u32 = 4;
const KEY_PARTS: u32 = 8;
/// Invocations of a workgroup that makes keys.
const KEYS_GROUP: SortShape = SortShape { group: 64, run: 1, digit_bits: 1, shuffled: false };

/// Descriptor sets that one sort takes.
#[derive(Clone, Copy)]
pub(crate) struct SortSets {
    keys: vk::DescriptorSet,
    passes: [vk::DescriptorSet; 2],
}

/// Makes orders on the device.
pub(crate) struct DeviceSort {
    gpu: Arc<Gpu>,
    radix: RadixSort,
    keys_set_layout: vk::DescriptorSetLayout,
    keys_layout: vk::PipelineLayout,
    keys: HashMap<Specialization, vk::Pipeline>,
    buffers: Option<(u32, RadixBuffers)>,
}

impl DeviceSort {
    /// `scene_layouts`: those of the frame's and the scene's descriptor sets.
    pub fn new(gpu: &Arc<Gpu>, scene_layouts: [vk::DescriptorSetLayout; 2]) -> Result<Self, GpuError> {
        let mut sort = Self {
            gpu: gpu.clone(),
            radix: RadixSort::new(gpu, SortShape::of(&gpu.capabilities))?,
            keys_set_layout: vk::DescriptorSetLayout::null(),
            keys_layout: vk::PipelineLayout::null(),
            keys: HashMap::new(),
            buffers: None,
        };
        sort.keys_set_layout = storage_layout(gpu, 3)?;
        sort.keys_layout = compute_layout(gpu, &[scene_layouts[0], scene_layouts[1], sort.keys_set_layout])?;
        Ok(sort)
    }

    /// Makes room for a scene; waits for the device where that means new buffers.
    pub fn prepare(&mut self, splats: u32) -> Result<(), GpuError> {
        if self.buffers.as_ref().is_none_or(|(capacity, _)| *capacity < splats) {
            self.gpu.wait_idle()?;
            self.buffers = None;
            self.buffers = Some((splats, RadixBuffers::new(&self.gpu, self.radix.shape, splats)?));
        }
        Ok(())
    }

    /// Dispatches of one sort.
    pub fn dispatches(&self, bits: KeyBits) -> u32 {
        1 + 3 * self.radix.shape.passes(if bits == KeyBits::B16 { 16 } else { 32 })
    }

    /// The sets of one sort, from a pool that has room for three sets and fifteen buffers.
    pub fn allocate(&self, pool: vk::DescriptorPool) -> Result<SortSets, GpuError> {
        let one = |layout| allocate(&self.gpu, pool, layout);
        let passes = [one(self.radix.set_layout)?, one(self.radix.set_layout)?];
        Ok(SortSets { keys: one(self.keys_set_layout)?, passes })
    }

    /// Records keys and passes; says how many splats the order in `sorted` has. What still reads `sorted` has been
    /// waited for; what reads it next in a compute stage need not wait. The frame data hold the request's centre, and its
    /// direction as that of the first view; the frame's set holds the parts, where there are any.
    #[allow(clippy::too_many_arguments)]
    pub fn record(
        &mut self,
        commands: vk::CommandBuffer,
        sets: SortSets,
        scene: &SceneOnDevice,
        scene_sets: [vk::DescriptorSet; 2],
        specialization: Specialization,
        sorted: &Buffer,
        request: &OrderRequest,
        parts: Option<&Parts>,
    ) -> Result<u32, GpuError> {
        let pipeline = self.keys_pipeline(specialization)?;
        let Some((_, buffers)) = &self.buffers else { return Ok(0) };
        let key_bits = if request.bits == KeyBits::B16 { 16 } else { 32 };
        let listed = if parts.is_some() { None } else { scene.alive_at(request) };
        let of_list = listed.as_ref().map_or(scene.splats, |l| l.range.len() as u32);
        let count = parts.map_or(of_list, Parts::splats);
        if count == 0 {
            return Ok(0);
        }
        let [keys, values] = self.radix.inputs(buffers, sorted, key_bits);
        write_storage(&self.gpu, sets.keys, &[keys, values, listed.as_ref().map_or(keys, |l| l.entries)]);
        let mut key = 0;
        if request.key == OrderKey::Depth {
            key |= KEY_DEPTH;
        }
        if request.bits == KeyBits::B16 {
            key |= KEY_16;
        }
        if listed.is_some() {
            key |= KEY_LISTED;
        }
        if parts.is_some() {
            key |= KEY_PARTS;
        }
        let push = Push {
            count,
            tiles: 0,
            shift: 0,
            value_bits: 0,
            first: listed.as_ref().map_or(0, |l| l.range.start as u32),
            key,
            rest: super::two_parts(request.center - scene.origin).1.to_array(),
        };
        let device = self.gpu.device();
        // SAFETY: sets and buffers live until the frame is done, and hold `count` keys.
        unsafe {
            let compute = vk::PipelineBindPoint::COMPUTE;
            let all = [scene_sets[0], scene_sets[1], sets.keys];
            device.cmd_bind_pipeline(commands, compute, pipeline);
            device.cmd_bind_descriptor_sets(commands, compute, self.keys_layout, 0, &all, &[]);
            let stages = vk::ShaderStageFlags::COMPUTE;
            device.cmd_push_constants(commands, self.keys_layout, stages, 0, bytemuck::bytes_of(&push));
            device.cmd_dispatch(commands, count.div_ceil(KEYS_GROUP.group), 1, 1);
        }
        compute_barrier(&self.gpu, commands);
        let values_are_places = listed.is_none() && parts.is_none();
        let radix_job = RadixJob { count, key_bits, values: scene.splats, values_are_places };
        self.radix.record(commands, sets.passes, buffers, sorted, radix_job)?;
        Ok(count)
    }

    fn keys_pipeline(&mut self, specialization: Specialization) -> Result<vk::Pipeline, GpuError> {
        if let Some(pipeline) = self.keys.get(&specialization) {
            return Ok(*pipeline);
        }
        let constants = bytemuck::cast_slice(std::slice::from_ref(&specialization));
        let code = modules::SORT_KEYS_COMP;
        let made = compute_pipeline(&self.gpu, self.keys_layout, code, constants, KEYS_GROUP, 0)?;
        self.keys.insert(specialization, made);
        Ok(made)
    }
}

impl Drop for DeviceSort {
    fn drop(&mut self) {
        let device = self.gpu.device();
        // SAFETY: whoever drops the sort has waited for the frames that use it. Null handles are ignored.
        unsafe {
            for pipeline in self.keys.values() {
                device.destroy_pipeline(*pipeline, None);
            }
            device.destroy_pipeline_layout(self.keys_layout, None);
            device.destroy_descriptor_set_layout(self.keys_set_layout, None);
        }
    }
}

/// A set of storage buffers, bindings `0 ..`, for compute stages.
fn storage_layout(gpu: &Gpu, bindings: u32) -> Result<vk::DescriptorSetLayout, GpuError> {
    let bindings: Vec<_> = (0..bindings)
        .map(|binding| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(binding)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        })
        .collect();
    let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    // SAFETY: `info` is complete.
    let made = unsafe { gpu.device().create_descriptor_set_layout(&info, None) };
    made.during("vkCreateDescriptorSetLayout")
}

/// A pipeline layout with the sort's push constants.
fn compute_layout(gpu: &Gpu, sets: &[vk::DescriptorSetLayout]) -> Result<vk::PipelineLayout, GpuError> {
    let size = size_of::<Push>() as u32;
    let push = [vk::PushConstantRange { stage_flags: vk::ShaderStageFlags::COMPUTE, offset: 0, size }];
    let info = vk::PipelineLayoutCreateInfo::default().set_layouts(sets).push_constant_ranges(&push);
    // SAFETY: the set layouts are alive.
    unsafe { gpu.device().create_pipeline_layout(&info, None) }.during("vkCreatePipelineLayout")
}

/// A compute pipeline with the constants `0 ..`, the shape's, and what is done with keys and values.
fn compute_pipeline(
    gpu: &Arc<Gpu>,
    layout: vk::PipelineLayout,
    code: &'static [u32],
    constants: &[u32],
    shape: SortShape,
    flags: u32,
) -> Result<vk::Pipeline, GpuError> {
    let shape = [(100, shape.group), (101, shape.run), (102, shape.digit_bits), (103, flags)];
    let constants = (0..).zip(constants.iter().copied()).chain(shape).collect();
    pipeline::compute(gpu, vk::PipelineCache::null(), layout, code, &constants)
}

fn allocate(
    gpu: &Gpu,
    pool: vk::DescriptorPool,
    layout: vk::DescriptorSetLayout,
) -> Result<vk::DescriptorSet, GpuError> {
    let layouts = [layout];
    let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
    // SAFETY: pool and layout are alive.
    Ok(unsafe { gpu.device().allocate_descriptor_sets(&info) }.during("vkAllocateDescriptorSets")?[0])
}

/// Binds whole buffers at `0 ..`.
fn write_storage(gpu: &Gpu, set: vk::DescriptorSet, buffers: &[&Buffer]) {
    let infos: Vec<_> = buffers
        .iter()
        .map(|b| [vk::DescriptorBufferInfo { buffer: b.raw(), offset: 0, range: vk::WHOLE_SIZE }])
        .collect();
    let writes: Vec<_> = (0..)
        .zip(&infos)
        .map(|(binding, info)| {
            vk::WriteDescriptorSet { dst_set: set, ..Default::default() }
                .dst_binding(binding)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .buffer_info(info)
        })
        .collect();
    // SAFETY: set and buffers are alive, and the device does not use the set.
    unsafe { gpu.device().update_descriptor_sets(&writes, &[]) };
}

fn compute_barrier(gpu: &Gpu, commands: vk::CommandBuffer) {
    let barrier = vk::MemoryBarrier::default()
        .src_access_mask(vk::AccessFlags::SHADER_WRITE)
        .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
    let compute = vk::PipelineStageFlags::COMPUTE_SHADER;
    // SAFETY: recorded outside any render pass.
    unsafe {
        let none = vk::DependencyFlags::empty();
        gpu.device().cmd_pipeline_barrier(commands, compute, compute, none, &[barrier], &[], &[]);
    }
}

/// A pool of storage-buffer sets.
struct DescriptorPool {
    gpu: Arc<Gpu>,
    raw: vk::DescriptorPool,
}

impl DescriptorPool {
    fn new(gpu: &Arc<Gpu>, sets: u32, buffers: u32) -> Result<Self, GpuError> {
        let ty = vk::DescriptorType::STORAGE_BUFFER;
        let sizes = [vk::DescriptorPoolSize { ty, descriptor_count: buffers }];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(sets).pool_sizes(&sizes);
        // SAFETY: `info` is complete.
        let raw =
            unsafe { gpu.device().create_descriptor_pool(&info, None) }.during("vkCreateDescriptorPool")?;
        Ok(Self { gpu: gpu.clone(), raw })
    }

    fn allocate(&self, layout: vk::DescriptorSetLayout) -> Result<vk::DescriptorSet, GpuError> {
        allocate(&self.gpu, self.raw, layout)
    }
}

impl Drop for DescriptorPool {
    fn drop(&mut self) {
        // SAFETY: whoever drops the pool has waited for its sets' last use.
        unsafe { self.gpu.device().destroy_descriptor_pool(self.raw, None) };
    }
}
