//! The device's sort by itself: for tests, and to measure it.

use super::DescriptorPool;
use super::radix::{RadixBuffers, RadixJob, RadixSort, SortShape};
use crate::gpu::{Buffer, Gpu, GpuError};
use crate::upload::Uploader;
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;

/// Sorts keys that are given, and reads the result back.
pub struct KeySorter {
    gpu: Arc<Gpu>,
    sort: RadixSort,
    /// For so many keys, kept from one sort to the next, as a renderer keeps its own.
    buffers: Option<(usize, KeyBuffers)>,
    uploader: Uploader,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
}

struct KeyBuffers {
    radix: RadixBuffers,
    sorted: Buffer,
    back: Buffer,
}

impl KeyBuffers {
    fn new(gpu: &Arc<Gpu>, shape: SortShape, keys: usize) -> Result<Self, GpuError> {
        let buffer = |name, usage, location| Buffer::new(gpu, name, 4 * keys as u64, usage, location);
        let sorted = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_SRC;
        let back = vk::BufferUsageFlags::TRANSFER_DST;
        Ok(Self {
            radix: RadixBuffers::new(gpu, shape, keys as u32)?,
            sorted: buffer("sorted", sorted, MemoryLocation::GpuOnly)?,
            back: buffer("sorted, read", back, MemoryLocation::GpuToCpu)?,
        })
    }
}

impl KeySorter {
    /// With a shape.
    ///
    /// # Errors
    /// The driver's, or a shape that the device cannot have.
    pub fn new(gpu: &Arc<Gpu>, shape: SortShape) -> Result<Self, GpuError> {
        let sort = RadixSort::new(gpu, shape)?;
        let uploader = Uploader::new(gpu)?;
        let (pool, commands, fence) = crate::frame::command_pool(gpu)?;
        Ok(Self { gpu: gpu.clone(), sort, buffers: None, uploader, pool, commands, fence })
    }

    /// The places `0 ..` of the keys in ascending order of the keys, whose bits from `key_bits` on are 0.
    ///
    /// # Errors
    /// The driver's.
    pub fn sort(&mut self, keys: &[u32], key_bits: u32) -> Result<Vec<u32>, GpuError> {
        self.load(keys, key_bits)?;
        self.run(keys.len(), key_bits)?;
        self.places(keys.len())
    }

    /// Brings keys to the device, before each [`KeySorter::run`].
    ///
    /// # Errors
    /// The driver's.
    pub fn load(&mut self, keys: &[u32], key_bits: u32) -> Result<(), GpuError> {
        let n = keys.len();
        if self.buffers.as_ref().is_none_or(|(keys, _)| *keys != n) {
            // Every sort has been waited for.
            self.buffers = None;
            self.buffers = Some((n, KeyBuffers::new(&self.gpu, self.sort.shape, n)?));
        }
        let Some((_, buffers)) = &self.buffers else { return Ok(()) };
        let [keys_in, _] = self.sort.inputs(&buffers.radix, &buffers.sorted, key_bits);
        self.uploader.fill(keys_in, n, 1, |at, chunk| chunk.copy_from_slice(&keys[at..at + chunk.len()]))
    }

    /// Sorts so many keys, and waits until that is done.
    ///
    /// # Errors
    /// The driver's.
    pub fn run(&mut self, keys: usize, key_bits: u32) -> Result<(), GpuError> {
        let Some((_, buffers)) = &self.buffers else { return Ok(()) };
        let pool = DescriptorPool::new(&self.gpu, 2, 12)?;
        let sets = [pool.allocate(self.sort.set_layout)?, pool.allocate(self.sort.set_layout)?];
        let job = RadixJob { count: keys as u32, key_bits, values: keys as u32, values_are_places: true };
        let sort = &mut self.sort;
        let mut recorded = Ok(());
        crate::frame::submit_and_wait(&self.gpu, self.commands, self.fence, |_, commands| {
            recorded = sort.record(commands, sets, &buffers.radix, &buffers.sorted, job);
        })?;
        recorded
    }

    /// The order that the last [`KeySorter::run`] has found.
    ///
    /// # Errors
    /// The driver's.
    pub fn places(&mut self, keys: usize) -> Result<Vec<u32>, GpuError> {
        let Some((_, KeyBuffers { sorted, back, .. })) = &self.buffers else { return Ok(Vec::new()) };
        if keys == 0 {
            return Ok(Vec::new());
        }
        let bytes = 4 * keys as u64;
        crate::frame::submit_and_wait(&self.gpu, self.commands, self.fence, |device, commands| {
            let copy = vk::BufferCopy { src_offset: 0, dst_offset: 0, size: bytes };
            // SAFETY: both buffers hold the region; the sort was waited for.
            unsafe { device.cmd_copy_buffer(commands, sorted.raw(), back.raw(), &[copy]) };
        })?;
        let words = back.mapped().get(..bytes as usize).unwrap_or_default();
        Ok(words.chunks_exact(4).map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]])).collect())
    }
}

impl Drop for KeySorter {
    fn drop(&mut self) {
        if let Err(e) = self.gpu.wait_idle() {
            log::error!("{e}");
        }
        // SAFETY: the device is idle.
        unsafe {
            self.gpu.device().destroy_fence(self.fence, None);
            self.gpu.device().destroy_command_pool(self.pool, None);
        }
    }
}
