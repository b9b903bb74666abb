//! A stable radix sort on the device. Twin: `sort_count.comp`, `sort_scan.comp`, `sort_scatter.comp`, and their variants for
//! long runs.
//!
//! Least significant digit first, three dispatches a digit: every tile of keys (or long run) is counted, the counts become
//! places, and keys and values go there. No atomics, so equal input gives equal output; no subgroup operations, so their size
//! (8 on lavapipe, 64 or 128 on Adreno) does not matter; nothing is read back.

use crate::gpu::{Buffer, Capabilities, Gpu, GpuError};
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::modules;
use std::sync::Arc;

/// How the work is cut; specialisation constants of the shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SortShape {
    /// Invocations of a workgroup.
    pub group: u32,
    /// Keys of one invocation. From four times as many as there are digits on, runs are [long](SortShape::long); else
    /// `group · run` is below 2¹⁶.
    pub run: u32,
    /// Bits of a digit, `1 ..= 8`.
    pub digit_bits: u32,
}

impl SortShape {
    /// The shape for a device: processors do best with few long runs, graphics cards need many invocations, and the
    /// counters of a workgroup (16 KiB here) must fit into what every device has.
    pub fn of(capabilities: &Capabilities) -> Self {
        if capabilities.software {
            Self { group: 8, run: 4096, digit_bits: 8 }
        } else {
            Self { group: 128, run: 16, digit_bits: 6 }
        }
    }

    /// Whether each run has counters of its own in memory.
    pub fn long(self) -> bool {
        self.run >> self.digit_bits.min(31) >= 4
    }

    /// Bytes of a workgroup's shared memory.
    pub fn shared_bytes(self) -> u32 {
        let digits = 1 << self.digit_bits;
        if self.long() {
            4 * digits * self.group
        } else {
            4 * (digits / 2 * self.group + digits + self.group)
        }
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
        let columns =
            u64::from(self.tiles(keys).max(1)) * if self.long() { u64::from(self.group) } else { 1 };
        columns << self.digit_bits
    }

    fn check(self, gpu: &Gpu) -> Result<(), GpuError> {
        // SAFETY: the physical device belongs to the instance.
        let limits = unsafe { gpu.instance().get_physical_device_properties(gpu.physical()) }.limits;
        let most = limits.max_compute_work_group_invocations.min(limits.max_compute_work_group_size[0]);
        let most_keys = if self.long() { 1 << 31 } else { 1 << 16 };
        let shape = (1..=8).contains(&self.digit_bits)
            && (1..=4096).contains(&self.group)
            && self.run >= 1
            && self.group.checked_mul(self.run).is_some_and(|keys| keys < most_keys);
        let fits =
            shape && self.group <= most && self.shared_bytes() <= limits.max_compute_shared_memory_size;
        if fits {
            return Ok(());
        }
        Err(GpuError::Unsupported {
            wanted: format!("a sort with {self:?}"),
            device: gpu.capabilities.device.clone(),
            remedy: format!(
                "Digits have 1 to 8 bits, a group at most {most} invocations and 65535 keys (any number \
                 with runs of four times as many keys as there are digits), and its counters take at most {} bytes",
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
    pub flags: u32,
    pub first: u32,
    pub key: u32,
    pub rest: [f32; 3],
}

/// `SORT_VALUES_ARE_PLACES` of the shaders.
pub(crate) const VALUES_ARE_PLACES: u32 = 1;
/// `SORT_KEYS_ARE_DONE` of the shaders.
const KEYS_ARE_DONE: u32 = 2;

/// The pipelines of the sort.
pub(crate) struct RadixSort {
    gpu: Arc<Gpu>,
    pub shape: SortShape,
    pub set_layout: vk::DescriptorSetLayout,
    layout: vk::PipelineLayout,
    pipelines: [vk::Pipeline; 3],
}

impl RadixSort {
    pub fn new(gpu: &Arc<Gpu>, shape: SortShape) -> Result<Self, GpuError> {
        shape.check(gpu)?;
        let mut sort = Self {
            gpu: gpu.clone(),
            shape,
            set_layout: vk::DescriptorSetLayout::null(),
            layout: vk::PipelineLayout::null(),
            pipelines: [vk::Pipeline::null(); 3],
        };
        sort.set_layout = super::storage_layout(gpu, 6)?;
        sort.layout = super::compute_layout(gpu, &[sort.set_layout])?;
        let codes = if shape.long() {
            [modules::SORT_LONG_COUNT_COMP, modules::SORT_LONG_SCAN_COMP, modules::SORT_LONG_SCATTER_COMP]
        } else {
            [modules::SORT_COUNT_COMP, modules::SORT_SCAN_COMP, modules::SORT_SCATTER_COMP]
        };
        for (pipeline, code) in sort.pipelines.iter_mut().zip(codes) {
            *pipeline = super::compute_pipeline(gpu, sort.layout, code, &[], shape)?;
        }
        Ok(sort)
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
        &self,
        commands: vk::CommandBuffer,
        sets: [vk::DescriptorSet; 2],
        buffers: &RadixBuffers,
        sorted: &Buffer,
        job: RadixJob,
    ) {
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
        let device = self.gpu.device();
        let tiles = self.shape.tiles(job.count);
        let groups = [tiles, 1 << self.shape.digit_bits, tiles];
        for pass in 0..passes {
            let mut flags = 0;
            if pass == 0 && job.values_are_places {
                flags |= VALUES_ARE_PLACES;
            }
            if pass + 1 == passes {
                flags |= KEYS_ARE_DONE;
            }
            let shift = pass * self.shape.digit_bits;
            let push = Push { count: job.count, tiles, shift, flags, first: 0, key: 0, rest: [0.0; 3] };
            // SAFETY: sets and buffers live until the frame is done; the buffers hold `count` keys.
            unsafe {
                let compute = vk::PipelineBindPoint::COMPUTE;
                let set = [sets[pass as usize % 2]];
                device.cmd_bind_descriptor_sets(commands, compute, self.layout, 0, &set, &[]);
                let stages = vk::ShaderStageFlags::COMPUTE;
                device.cmd_push_constants(commands, self.layout, stages, 0, bytemuck::bytes_of(&push));
                for (pipeline, groups) in self.pipelines.iter().zip(groups) {
                    device.cmd_bind_pipeline(commands, compute, *pipeline);
                    device.cmd_dispatch(commands, groups, 1, 1);
                    super::compute_barrier(&self.gpu, commands);
                }
            }
        }
    }
}

/// What to sort.
#[derive(Clone, Copy)]
pub(crate) struct RadixJob {
    pub count: u32,
    pub key_bits: u32,
    /// Whether values are `0 ..`, and were not written.
    pub values_are_places: bool,
}

impl Drop for RadixSort {
    fn drop(&mut self) {
        let device = self.gpu.device();
        // SAFETY: whoever drops the sort has waited for the frames that use it. Null handles are ignored.
        unsafe {
            for pipeline in self.pipelines {
                device.destroy_pipeline(pipeline, None);
            }
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}
