//! A stable radix sort on the device. Twin: `sort_count.comp`, `sort_scan.comp`, `sort_scatter.comp`.
//!
//! Least significant digit first, three dispatches a digit: every tile of keys is counted, the counts become places, and
//! keys and values go there. No atomics, so equal input gives equal output; no subgroup operations, so their size (8 on
//! lavapipe, 64 or 128 on Adreno) does not matter, except where a [shape](SortShape::shuffled) asks for them; nothing is
//! read back.

use crate::gpu::{Buffer, Capabilities, Gpu, GpuError};
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::modules;
use std::collections::HashMap;
use std::sync::Arc;

/// How the work is cut; specialisation constants of the shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SortShape {
    /// Invocations of a workgroup.
    pub group: u32,
    /// Keys of one invocation; `group · run` is below 2¹⁶.
    pub run: u32,
    /// Bits of a digit, `1 ..= 11`.
    pub digit_bits: u32,
    /// Whether a workgroup is one vector of a processor, whose eight invocations take neighbouring keys and exchange their
    /// digits (`sort_shuffled_scatter.comp`). Needs [`Capabilities::subgroup_shuffle`], and digits of 3 bits at least.
    pub shuffled: bool,
}

impl SortShape {
    /// The shape for a device: processors do best with long runs and few passes, graphics cards need many invocations,
    /// and the counters of a workgroup (16 KiB) must fit into what every device has.
    pub fn of(capabilities: &Capabilities) -> Self {
        if capabilities.software {
            let shuffled = capabilities.subgroup_shuffle;
            Self { group: 8, run: 7936, digit_bits: if shuffled { 11 } else { 8 }, shuffled }
        } else {
            Self { group: 128, run: 16, digit_bits: 6, shuffled: false }
        }
    }

    /// Bytes of a workgroup's shared memory.
    pub fn shared_bytes(self) -> u32 {
        let digits = 1 << self.digit_bits;
        let columns = digits / 2 * self.group;
        4 * if self.shuffled { columns.max(digits) } else { columns + digits + self.group }
    }

    /// Digits of a key.
    pub(super) fn passes(self, key_bits: u32) -> u32 {
        key_bits.div_ceil(self.digit_bits)
    }

    fn tiles(self, keys: u32) -> u32 {
        keys.div_ceil(self.group * self.run)
    }

    /// Counters between the passes, for so many keys.
    fn counters(self, keys: u32) -> u64 {
        u64::from(self.tiles(keys).max(1)) << self.digit_bits
    }

    fn check(self, gpu: &Gpu) -> Result<(), GpuError> {
        // SAFETY: the physical device belongs to the instance.
        let limits = unsafe { gpu.instance().get_physical_device_properties(gpu.physical()) }.limits;
        let most = limits.max_compute_work_group_invocations.min(limits.max_compute_work_group_size[0]);
        let shape = (1..=11).contains(&self.digit_bits)
            && (1..=4096).contains(&self.group)
            && self.run >= 1
            && self.group.checked_mul(self.run).is_some_and(|keys| keys < 1 << 16);
        let exchange = self.group == motes_shaders::layout::TILE_LANES && self.digit_bits >= 3;
        let shape = shape && (!self.shuffled || exchange && gpu.capabilities.subgroup_shuffle);
        let fits =
            shape && self.group <= most && self.shared_bytes() <= limits.max_compute_shared_memory_size;
        if fits {
            return Ok(());
        }
        Err(GpuError::Unsupported {
            wanted: format!("a sort with {self:?}"),
            device: gpu.capabilities.device.clone(),
            remedy: format!(
                "Digits have 1 to 11 bits, a group at most {most} invocations and 65535 keys, and its counters take at \
                 most {} bytes; a shuffled sort has groups of 8 and digits of 3 bits at least, on a device that shuffles \
                 within subgroups",
                limits.max_compute_shared_memory_size
            ),
        })
    }
}

/// Keys and values, twice, and the counts between them; the last pass ends in the second values.
pub(crate) struct RadixBuffers {
    keys: [Buffer; 2],
    values: Buffer,
    counts: Buffer,
    totals: Buffer,
}

impl RadixBuffers {
    pub fn new(gpu: &Arc<Gpu>, shape: SortShape, capacity: u32) -> Result<Self, GpuError> {
        let storage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_DST;
        let buffer = |name, words| Buffer::new(gpu, name, 4 * words, storage, MemoryLocation::GpuOnly);
        let n = u64::from(capacity.max(1));
        let digits = 1u64 << shape.digit_bits;
        Ok(Self {
            keys: [buffer("sort keys", n)?, buffer("sort keys, other", n)?],
            values: buffer("sort values", n)?,
            counts: buffer("sort counts", shape.counters(capacity))?,
            totals: buffer("sort totals", digits)?,
        })
    }
}

/// As `Sort` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct Push {
    pub count: u32,
    pub tiles: u32,
    pub shift: u32,
    pub value_bits: u32,
    pub first: u32,
    pub key: u32,
    pub rest: [f32; 3],
}

// As in `sort.glsl`.
const VALUES_ARE_PLACES: u32 = 1;
const LAST: u32 = 2;
const PACK: u32 = 4;
const PACKED: u32 = 8;
const SHUFFLED: u32 = 16;

/// The pipelines of the sort.
pub(crate) struct RadixSort {
    gpu: Arc<Gpu>,
    pub shape: SortShape,
    pub set_layout: vk::DescriptorSetLayout,
    layout: vk::PipelineLayout,
    count: vk::Pipeline,
    scan: vk::Pipeline,
    /// By what is done with keys and values.
    scatter: HashMap<u32, vk::Pipeline>,
}

impl RadixSort {
    pub fn new(gpu: &Arc<Gpu>, shape: SortShape) -> Result<Self, GpuError> {
        shape.check(gpu)?;
        let mut sort = Self {
            gpu: gpu.clone(),
            shape,
            set_layout: vk::DescriptorSetLayout::null(),
            layout: vk::PipelineLayout::null(),
            count: vk::Pipeline::null(),
            scan: vk::Pipeline::null(),
            scatter: HashMap::new(),
        };
        sort.set_layout = super::storage_layout(gpu, 6)?;
        sort.layout = super::compute_layout(gpu, &[sort.set_layout])?;
        sort.count = sort.pipeline(modules::SORT_COUNT_COMP, 0)?;
        sort.scan = sort.pipeline(modules::SORT_SCAN_COMP, 0)?;
        Ok(sort)
    }

    fn pipeline(&self, code: &'static [u32], flags: u32) -> Result<vk::Pipeline, GpuError> {
        let flags = if self.shape.shuffled { flags | SHUFFLED } else { flags };
        super::compute_pipeline(&self.gpu, self.layout, code, &[], self.shape, flags)
    }

    fn scatter(&mut self, flags: u32) -> Result<vk::Pipeline, GpuError> {
        if let Some(pipeline) = self.scatter.get(&flags) {
            return Ok(*pipeline);
        }
        let shuffled = self.shape.shuffled;
        let code = if shuffled { modules::SORT_SHUFFLED_SCATTER_COMP } else { modules::SORT_SCATTER_COMP };
        let made = self.pipeline(code, flags)?;
        self.scatter.insert(flags, made);
        Ok(made)
    }

    /// The two buffers that keys are written to, and values that are not places, before [`RadixSort::record`]. Which
    /// ones depends on the number of passes: the last must end in `sorted`.
    pub fn inputs<'a>(
        &self,
        buffers: &'a RadixBuffers,
        sorted: &'a Buffer,
        key_bits: u32,
    ) -> [&'a Buffer; 2] {
        let side = self.shape.passes(key_bits) as usize % 2;
        // An odd number of passes begins on the other side.
        [&buffers.keys[1 - side], [sorted, &buffers.values][side]]
    }

    /// Records the passes. `sets` are two of [`RadixSort::set_layout`], not in use; `sorted` gets the values.
    pub fn record(
        &mut self,
        commands: vk::CommandBuffer,
        sets: [vk::DescriptorSet; 2],
        buffers: &RadixBuffers,
        sorted: &Buffer,
        job: RadixJob,
    ) -> Result<(), GpuError> {
        let side = |i: usize| (&buffers.keys[i], [&buffers.values, sorted][i]);
        let passes = self.shape.passes(job.key_bits);
        let begin = 1 - passes as usize % 2;
        for (i, set) in sets.into_iter().enumerate() {
            // The first set goes from where the keys are to the other side, the second comes back.
            let (keys_in, values_in) = side(begin ^ i);
            let (keys_out, values_out) = side(1 ^ begin ^ i);
            let all = [keys_in, values_in, keys_out, values_out, &buffers.counts, &buffers.totals];
            super::write_storage(&self.gpu, set, &all);
        }
        let tiles = self.shape.tiles(job.count);
        let digits = 1 << self.shape.digit_bits;
        let scans = if self.shape.shuffled { digits / self.shape.group } else { digits };
        let value_bits = job.values.max(2).next_power_of_two().trailing_zeros();
        let mut shift = 0;
        let mut packed = false;
        for pass in 0..passes {
            let left = job.key_bits.saturating_sub((pass + 1) * self.shape.digit_bits);
            let last = pass + 1 == passes;
            let pack = !packed && !last && left + value_bits <= 32;
            let flag = |set: bool, flag: u32| if set { flag } else { 0 };
            let flags = flag(pass == 0 && job.values_are_places, VALUES_ARE_PLACES)
                | flag(last, LAST)
                | flag(pack, PACK)
                | flag(packed, PACKED);
            let push = Push { count: job.count, tiles, shift, value_bits, first: 0, key: 0, rest: [0.0; 3] };
            let dispatches = [(self.count, tiles), (self.scan, scans), (self.scatter(flags)?, tiles)];
            let device = self.gpu.device();
            packed |= pack;
            shift = if pack { value_bits } else { shift + self.shape.digit_bits };
            // SAFETY: sets and buffers live until the frame is done; the buffers hold `count` keys.
            unsafe {
                let compute = vk::PipelineBindPoint::COMPUTE;
                let set = [sets[pass as usize % 2]];
                device.cmd_bind_descriptor_sets(commands, compute, self.layout, 0, &set, &[]);
                let stages = vk::ShaderStageFlags::COMPUTE;
                device.cmd_push_constants(commands, self.layout, stages, 0, bytemuck::bytes_of(&push));
                for (pipeline, groups) in dispatches {
                    device.cmd_bind_pipeline(commands, compute, pipeline);
                    device.cmd_dispatch(commands, groups, 1, 1);
                    super::compute_barrier(&self.gpu, commands);
                }
            }
        }
        Ok(())
    }
}

/// What to sort.
#[derive(Clone, Copy)]
pub(crate) struct RadixJob {
    pub count: u32,
    /// Of a key, from the lowest on; the others are 0.
    pub key_bits: u32,
    /// One more than the greatest value.
    pub values: u32,
    /// Whether values are `0 ..`, and were not written.
    pub values_are_places: bool,
}

impl Drop for RadixSort {
    fn drop(&mut self) {
        let device = self.gpu.device();
        // SAFETY: whoever drops the sort has waited for the frames that use it. Null handles are ignored.
        unsafe {
            for pipeline in self.scatter.drain().map(|(_, p)| p).chain([self.count, self.scan]) {
                device.destroy_pipeline(pipeline, None);
            }
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}
