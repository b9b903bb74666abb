//! Buffers that a frame works in, sized for a scene.

use crate::config::Projection;
use crate::gpu::{Buffer, Gpu, GpuError};
use crate::order::OrderRequest;
use crate::report::FrameReport;
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::{BLOCK, BLOCK_BYTES, DEPTH_TABLE_BYTES, DUE_BYTES, Plan, RECORD_WORDS, TILES};
use std::sync::Arc;

/// An order that was made on the device.
pub(crate) struct OrderOnDevice {
    /// Of which scene.
    pub scene: u64,
    pub request: OrderRequest,
    /// Whether it is one eye's own.
    pub own_eye: bool,
    /// Frames since it was made.
    pub age: u32,
}

/// The order of both eyes, or of one; made on first use.
pub(crate) struct Order {
    splats: u32,
    buffer: Option<Buffer>,
    /// Which of the processor's orders it holds; 0: none.
    pub id: u64,
    /// Which of the device's it holds.
    pub device_made: Option<OrderOnDevice>,
    /// Splats that it lists.
    pub count: u32,
}

impl Order {
    fn new(splats: u32) -> Self {
        Self { splats, buffer: None, id: 0, device_made: None, count: 0 }
    }

    pub fn buffer(&mut self, gpu: &Arc<Gpu>) -> Result<&Buffer, GpuError> {
        match &mut self.buffer {
            Some(buffer) => Ok(buffer),
            none => {
                let usage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_DST;
                let bytes = 4 * u64::from(self.splats.max(1));
                Ok(none.insert(Buffer::new(gpu, "order", bytes, usage, MemoryLocation::GpuOnly)?))
            }
        }
    }
}

/// Order, records, prefix sums and the plan of the draws.
pub(crate) struct Workspace {
    capacity: u32,
    /// Of a record.
    words: u32,
    /// The order of both eyes or the first, and the second eye's own.
    pub orders: [Order; 2],
    pub records: [Buffer; 2],
    /// The order in blocks.
    pub blocks: Buffer,
    /// Pixels of each splat of the scene.
    pub areas: Buffer,
    /// Where each of them lies in the image of each view.
    pub footprints: Buffer,
    /// Light that each step of the order takes from each tile of the image.
    pub depths: Buffer,
    /// Tiles that are marked after each batch.
    pub due: Buffer,
    pub visible: Buffer,
    pub plan: Buffer,
    /// The plan of each frame, read back after it is done.
    plans: Vec<Buffer>,
}

impl Workspace {
    pub fn new(gpu: &Arc<Gpu>, splats: u32, projection: Projection, frames: usize) -> Result<Self, GpuError> {
        let n = u64::from(splats.max(1));
        let words = u64::from(RECORD_WORDS[projection as usize]);
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
                    2 * plan_bytes,
                    vk::BufferUsageFlags::TRANSFER_DST,
                    MemoryLocation::GpuToCpu,
                )
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            capacity: splats,
            words: words as u32,
            orders: [Order::new(splats), Order::new(splats)],
            records: [
                buffer("records of view 0", record_bytes, storage)?,
                buffer("records of view 1", record_bytes, storage)?,
            ],
            blocks: buffer("blocks", u64::from(BLOCK_BYTES) * blocks, storage)?,
            areas: buffer("areas", 4 * n, storage)?,
            footprints: buffer("footprints", 8 * n, storage)?,
            depths: buffer(
                "optical depths",
                DEPTH_TABLE_BYTES,
                storage | vk::BufferUsageFlags::TRANSFER_DST,
            )?,
            due: buffer("tiles to mark", DUE_BYTES, storage)?,
            visible: buffer("visible splats", 4 * n, storage)?,
            plan: buffer("plan", plan_bytes, plan_usage)?,
            plans,
        })
    }

    pub fn fits(&self, splats: u32, projection: Projection) -> bool {
        self.capacity >= splats && self.words >= RECORD_WORDS[projection as usize]
    }

    /// Copies the plan where the processor can read it once the frame is done. Nothing waits for it. `part` is 1 for
    /// the second eye of a frame that prepares each eye by itself.
    pub fn copy_plan(&mut self, gpu: &Gpu, commands: vk::CommandBuffer, frame: usize, part: usize) {
        let size = size_of::<Plan>() as u64;
        let copy = vk::BufferCopy { src_offset: 0, dst_offset: part as u64 * size, size };
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

    /// Reads the plans of a frame's parts, and sums them up. `marked_by_plan`: marks went where the plan says.
    pub fn read_plan(&self, frame: usize, parts: usize, marked_by_plan: bool, report: &mut FrameReport) {
        for bytes in self.plans[frame].mapped().chunks_exact(size_of::<Plan>()).take(parts) {
            let plan: Plan = bytemuck::pod_read_unaligned(bytes);
            report.visible += plan.visible;
            report.predicted_fragments += plan.area;
            report.predicted_unhidden += plan.unhidden;
            report.fragments += u64::from(plan.blended);
            if marked_by_plan {
                let tile = report.pixels as f64 / f64::from(report.views * TILES);
                report.full_screen_fragments += (f64::from(plan.marked) * tile).round() as u64;
            }
        }
    }
}
