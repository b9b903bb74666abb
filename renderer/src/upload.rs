//! Brings data to the device through one staging buffer.

use crate::gpu::{Buffer, Gpu, GpuError};
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;

/// Usual size of the staging buffer, 32-bit words.
const STAGING_WORDS: usize = 4 << 20;

/// A staging buffer and the means to copy from it, waiting for each copy.
pub struct Uploader {
    gpu: Arc<Gpu>,
    staging: Buffer,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
}

impl Uploader {
    /// A new staging buffer.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, GpuError> {
        Self::with_words(gpu, STAGING_WORDS)
    }

    /// One of another size, 32-bit words.
    ///
    /// # Errors
    /// Out of memory.
    pub fn with_words(gpu: &Arc<Gpu>, words: usize) -> Result<Self, GpuError> {
        let bytes = 4 * words as u64;
        let staging =
            Buffer::new(gpu, "staging", bytes, vk::BufferUsageFlags::TRANSFER_SRC, MemoryLocation::CpuToGpu)?;
        let (pool, commands, fence) = crate::frame::command_pool(gpu)?;
        Ok(Self { gpu: gpu.clone(), staging, pool, commands, fence })
    }

    /// Fills a buffer with `words` words, in chunks that are multiples of `granule` words; `pack(at, chunk)` writes them.
    ///
    /// # Errors
    /// The driver's.
    pub fn fill(
        &mut self,
        target: &Buffer,
        words: usize,
        granule: usize,
        pack: impl FnMut(usize, &mut [u32]),
    ) -> Result<(), GpuError> {
        self.fill_from(target, 0, words, granule, pack)
    }

    /// As [`Uploader::fill`], but of a part of the buffer that begins at word `first`; `at` counts from there.
    ///
    /// # Errors
    /// The driver's.
    pub fn fill_from(
        &mut self,
        target: &Buffer,
        first: usize,
        words: usize,
        granule: usize,
        mut pack: impl FnMut(usize, &mut [u32]),
    ) -> Result<(), GpuError> {
        let staging_words = (self.staging.bytes() / 4) as usize;
        let per_chunk = staging_words / granule * granule;
        let mut at = 0;
        while at < words {
            let count = per_chunk.min(words - at);
            pack(at, &mut bytemuck::cast_slice_mut(self.staging.mapped_mut())[..count]);
            let copy =
                vk::BufferCopy { src_offset: 0, dst_offset: 4 * (first + at) as u64, size: 4 * count as u64 };
            let staging = self.staging.raw();
            // SAFETY: both buffers are alive and hold the region; the copy is waited for before staging is written again.
            crate::frame::submit_and_wait(&self.gpu, self.commands, self.fence, |device, commands| unsafe {
                device.cmd_copy_buffer(commands, staging, target.raw(), &[copy]);
                let barrier = vk::MemoryBarrier::default()
                    .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
                    .dst_access_mask(vk::AccessFlags::SHADER_READ);
                let stages = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::VERTEX_SHADER;
                device.cmd_pipeline_barrier(
                    commands,
                    vk::PipelineStageFlags::TRANSFER,
                    stages,
                    vk::DependencyFlags::empty(),
                    &[barrier],
                    &[],
                    &[],
                );
            })?;
            at += count;
        }
        Ok(())
    }
}

impl Drop for Uploader {
    fn drop(&mut self) {
        // SAFETY: every copy was waited for.
        unsafe {
            self.gpu.device().destroy_fence(self.fence, None);
            self.gpu.device().destroy_command_pool(self.pool, None);
        }
    }
}
