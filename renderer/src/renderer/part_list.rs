//! The parts that a frame draws, brought to the device.

use super::Renderer;
use crate::gpu::{Buffer, Gpu, GpuError};
use crate::scene::SceneOnDevice;
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;

/// Words before the first entry, and of an entry.
const WORDS: usize = 4;

/// Room for so many parts.
pub(super) fn buffer(gpu: &Arc<Gpu>, parts: usize) -> Result<Buffer, GpuError> {
    let bytes = 4 * (WORDS * (1 + parts.next_power_of_two())) as u64;
    Buffer::new(gpu, "parts", bytes, vk::BufferUsageFlags::STORAGE_BUFFER, MemoryLocation::CpuToGpu)
}

impl Renderer {
    /// Takes the scene's parts for this frame. The slot's last frame is done: its buffer may be replaced.
    pub(super) fn write_parts(&mut self, slot: usize, scene: &SceneOnDevice) -> Result<(), GpuError> {
        self.parts = scene.positions.parts();
        let Some(parts) = &self.parts else { return Ok(()) };
        let slot = &mut self.slots[slot];
        let bytes = 4 * WORDS * (1 + parts.list().len());
        if slot.part_list.bytes() < bytes as u64 {
            slot.part_list = buffer(&self.gpu, parts.list().len())?;
        }
        let words: &mut [u32] = bytemuck::cast_slice_mut(&mut slot.part_list.mapped_mut()[..bytes]);
        let (head, entries) = words.split_at_mut(WORDS);
        head[0] = parts.list().len() as u32;
        let mut place = 0;
        for (entry, part) in entries.chunks_exact_mut(WORDS).zip(parts.list()) {
            entry.copy_from_slice(&[part.first, place, part.splats, part.share.to_bits()]);
            place += part.splats;
        }
        slot.report.uploaded_bytes += bytes as u64;
        Ok(())
    }
}
