//! Buffers that a frame works in, sized for a scene.

use crate::gpu::{Buffer, Gpu, GpuError};
use crate::report::FrameReport;
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::{BLOCK, Plan, RECORD_WORDS, RECORD_WORDS_EXACT};
use std::sync::Arc;

/// Order, records, prefix sums and the plan of the draws.
pub(crate) struct Workspace {
    capacity: u32,
    exact: bool,
    pub order: Buffer,
    /// Which order the buffer holds; 0: none.
    pub order_id: u64,
    pub records: [Buffer; 2],
    pub blocks: Buffer,
    pub flags: Buffer,
    pub offsets: Buffer,
    pub visible: Buffer,
    pub plan: Buffer,
    /// The plan of each frame, read back after it is done.
    plans: Vec<Buffer>,
}

impl Workspace {
    pub fn new(gpu: &Arc<Gpu>, splats: u32, exact: bool, frames: usize) -> Result<Self, GpuError> {
        let n = u64::from(splats.max(1));
        let words = u64::from(if exact { RECORD_WORDS_EXACT } else { RECORD_WORDS });
        let limit = gpu.capabilities.max_storage_range;
        let record_bytes = 4 * words * n;
        if record_bytes > limit {
            let fits = limit / (4 * words);
            return Err(GpuError::SceneTooLarge {
                splats: splats as usize,
                stream: "records of one view",
                needed: record_bytes,
                available: limit,
                fits,
            });
        }
        let storage = vk::BufferUsageFlags::STORAGE_BUFFER;
        let buffer = |name, bytes, usage| Buffer::new(gpu, name, bytes, usage, MemoryLocation::GpuOnly);
        let blocks = n.div_ceil(u64::from(BLOCK));
        let plan_usage = storage | vk::BufferUsageFlags::INDIRECT_BUFFER | vk::BufferUsageFlags::TRANSFER_SRC;
        let plan_bytes = size_of::<Plan>() as u64;
        let plans = (0..frames)
            .map(|_| {
                Buffer::new(
                    gpu,
                    "plan read-back",
                    plan_bytes,
                    vk::BufferUsageFlags::TRANSFER_DST,
                    MemoryLocation::GpuToCpu,
                )
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            capacity: splats,
            exact,
            order: buffer("order", 4 * n, storage | vk::BufferUsageFlags::TRANSFER_DST)?,
            order_id: 0,
            records: [
                buffer("records of view 0", record_bytes, storage)?,
                buffer("records of view 1", record_bytes, storage)?,
            ],
            blocks: buffer("block sums", 8 * blocks, storage)?,
            flags: buffer("visibility flags", 4 * n, storage)?,
            offsets: buffer("block offsets", 4 * blocks, storage)?,
            visible: buffer("visible splats", 4 * n, storage)?,
            plan: buffer("plan", plan_bytes, plan_usage)?,
            plans,
        })
    }

    pub fn fits(&self, splats: u32, exact: bool) -> bool {
        self.capacity >= splats && (self.exact || !exact)
    }

    /// Copies the plan where the processor can read it once the frame is done. Nothing waits for it.
    pub fn copy_plan(&mut self, gpu: &Gpu, commands: vk::CommandBuffer, frame: usize) {
        let copy = vk::BufferCopy { src_offset: 0, dst_offset: 0, size: size_of::<Plan>() as u64 };
        let barrier = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ);
        // SAFETY: both buffers hold a plan; the barrier after the compute passes made it readable.
        unsafe {
            gpu.device().cmd_copy_buffer(commands, self.plan.raw(), self.plans[frame].raw(), &[copy]);
            gpu.device().cmd_pipeline_barrier(
                commands,
                vk::PipelineStageFlags::TRANSFER,
                vk::PipelineStageFlags::HOST,
                vk::DependencyFlags::empty(),
                &[barrier],
                &[],
                &[],
            );
        }
    }

    pub fn read_plan(&self, frame: usize, report: &mut FrameReport) {
        if let Some(bytes) = self.plans[frame].mapped().get(..size_of::<Plan>()) {
            let plan: Plan = bytemuck::pod_read_unaligned(bytes);
            report.visible = plan.visible;
            report.predicted_fragments = plan.area;
        }
    }
}
