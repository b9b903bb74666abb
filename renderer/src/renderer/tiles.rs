//! Splats by tiles of the image: compute passes list every tile's splats in order and blend them pixel by pixel, in registers
//! and in full precision, until all pixels of the tile are finished. The rasteriser only shows the outcome.
//!
//! Made for drivers that render on the processor, where a triangle costs more than what it covers.

use super::Renderer;
use crate::config::Projection;
use crate::gpu::{Buffer, Capabilities, Gpu, GpuError};
use crate::passes::{PUSH_BYTES, Preparation};
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::{Specialization, TILE_LANES, TILE_PIXELS, TILE_RUNS, TILE_SPLAT_WORDS};
use std::ops::Range;
use std::sync::Arc;

/// Dispatches of one picture, or of both: splats, scan, list, blend.
const TILE_DISPATCHES: u32 = 4;
/// Entries of lists that there is room for: a splat's share, and some for small scenes; fewer where the device's buffers end.
/// Beyond it tiles do without lists.
const ENTRIES_PER_SPLAT: u64 = 32;
const LEAST_ENTRIES: u64 = 1 << 16;

/// What tiles are blended for.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Room {
    splats: u32,
    /// Of what a tile needs to know of a splat.
    words: u32,
    views: u32,
    size: [u32; 2],
    count: bool,
}

impl Room {
    fn tiles(&self) -> [u32; 2] {
        self.size.map(|side| side.div_ceil(TILE_PIXELS))
    }

    /// Where the lists begin: a word for each view, tile and run.
    fn ends(&self) -> u64 {
        let [columns, rows] = self.tiles().map(u64::from);
        u64::from(self.views) * columns * rows * u64::from(TILE_RUNS)
    }

    /// Bytes of the splats, the lists' least, and the pixels.
    fn least_bytes(&self) -> [u64; 3] {
        let views = u64::from(self.views);
        let pixels = self.size.map(u64::from).iter().product::<u64>() * if self.count { 2 } else { 1 };
        let splats = 4 * views * u64::from(self.splats) * u64::from(self.words);
        [splats, 4 * (self.ends() + LEAST_ENTRIES), 16 * views * pixels]
    }
}

/// Whether a device's buffers hold what tiles need for so many splats and views of a size, even where layers are counted.
pub(crate) fn tiles_fit(
    capabilities: &Capabilities,
    projection: Projection,
    splats: u32,
    views: u32,
    size: [u32; 2],
) -> bool {
    let words = TILE_SPLAT_WORDS[projection as usize];
    let room = Room { splats, words, views, size, count: true };
    room.least_bytes().iter().all(|bytes| *bytes <= capabilities.max_storage_range)
}

/// What the passes hand on to each other.
struct Buffers {
    room: Room,
    splats: Buffer,
    lists: Buffer,
    pixels: Buffer,
}

impl Buffers {
    fn new(gpu: &Arc<Gpu>, room: Room) -> Result<Self, GpuError> {
        let limit = gpu.capabilities.max_storage_range;
        let [splats, least, pixels] = room.least_bytes();
        if splats.max(least).max(pixels) > limit {
            let [width, height] = room.size;
            return Err(GpuError::Unsupported {
                wanted: format!(
                    "{} splats by tiles in {} view(s) of {width} x {height} pixels, in buffers of {limit} bytes",
                    room.splats, room.views
                ),
                device: gpu.capabilities.device.clone(),
                remedy: "Choose expansion precomputed".into(),
            });
        }
        let lists = (4 * (room.ends() + ENTRIES_PER_SPLAT * u64::from(room.splats))).clamp(least, limit);
        let sizes = [("splats of tiles", splats), ("lists of tiles", lists), ("pixels of tiles", pixels)];
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_DST;
        let [splats, lists, pixels] =
            sizes.map(|(name, bytes)| Buffer::new(gpu, name, bytes, usage, MemoryLocation::GpuOnly));
        Ok(Self { room, splats: splats?, lists: lists?, pixels: pixels? })
    }
}

/// Buffers of splats by tiles, made on first use.
pub(super) struct Tiles {
    gpu: Arc<Gpu>,
    buffers: Option<Buffers>,
}

impl Tiles {
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: gpu.clone(), buffers: None }
    }

    fn prepare(&mut self, room: Room) -> Result<&Buffers, GpuError> {
        let fits =
            |b: &Buffers| Room { splats: b.room.splats, ..room } == b.room && b.room.splats >= room.splats;
        if !self.buffers.as_ref().is_some_and(fits) {
            self.gpu.wait_idle()?;
            self.buffers = None;
        }
        match &mut self.buffers {
            Some(buffers) => Ok(buffers),
            none => Ok(none.insert(Buffers::new(&self.gpu, room)?)),
        }
    }
}

impl Renderer {
    /// Blends all splats of one view, or of both, outside of a render pass. Says what shows them: the set of their pixels, and
    /// push constants.
    pub(super) fn record_tiles(
        &mut self,
        slot: usize,
        views: Range<u32>,
        size: [u32; 2],
        stop_below: f32,
        specialization: Specialization,
        sets: &[vk::DescriptorSet; 3],
    ) -> Result<(vk::DescriptorSet, [u32; 8]), GpuError> {
        let count = self.count_layers;
        let words = TILE_SPLAT_WORDS[specialization.projection as usize];
        let room = Room { splats: self.ordered.max(1), words, views: views.len() as u32, size, count };
        let splats = self.passes.compute(Preparation::TileSplats, specialization)?;
        let scan = self.passes.compute(Preparation::TileScan, specialization)?;
        let list = self.passes.compute(Preparation::TileList, specialization)?;
        let blend = self.passes.compute(Preparation::TileBlend(count), specialization)?;
        let set = self.allocate_set(slot, 3)?;
        let buffers = self.tiles.prepare(room)?;
        let room = buffers.room;
        let whole =
            |b: &Buffer| [vk::DescriptorBufferInfo { buffer: b.raw(), offset: 0, range: vk::WHOLE_SIZE }];
        let infos = [whole(&buffers.splats), whole(&buffers.lists), whole(&buffers.pixels)];
        let writes: [_; 3] = std::array::from_fn(|i| {
            vk::WriteDescriptorSet { dst_set: set, ..Default::default() }
                .dst_binding(3 + i as u32)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .buffer_info(&infos[i])
        });
        let [columns, rows] = room.tiles();
        let [width, height] = size;
        let push = [views.start, room.views, columns, rows, room.splats, stop_below.to_bits(), width, height];
        const { assert!(PUSH_BYTES == 32) };
        let (ends, lists) = (4 * room.ends(), buffers.lists.raw());

        let commands = self.slots[slot].commands;
        self.slots[slot].report.dispatches += TILE_DISPATCHES;
        let device = self.gpu.device();
        let (layout, stages) = (self.passes.layout, self.passes.push_stages());
        let compute = vk::PipelineStageFlags::COMPUTE_SHADER;
        let fragments = vk::PipelineStageFlags::FRAGMENT_SHADER;
        let transfer = vk::PipelineStageFlags::TRANSFER;
        let none = vk::DependencyFlags::empty();
        let memory = |from, to| [vk::MemoryBarrier::default().src_access_mask(from).dst_access_mask(to)];
        let (read, write) = (vk::AccessFlags::SHADER_READ, vk::AccessFlags::SHADER_WRITE);
        let cleared = vk::AccessFlags::TRANSFER_WRITE;
        let steps = [
            (splats, [TILE_RUNS / TILE_LANES, room.views, 1]),
            (scan, [1, 1, 1]),
            (list, [TILE_RUNS / TILE_LANES, room.views, 1]),
            (blend, [columns, rows, room.views]),
        ];
        // SAFETY: pipelines and sets match the layout; buffers are sized for these splats and this image.
        unsafe {
            device.update_descriptor_sets(&writes, &[]);
            let bind = vk::PipelineBindPoint::COMPUTE;
            // The picture before has been shown, and the records are there.
            let before = memory(read | write, read | write | cleared);
            device.cmd_pipeline_barrier(
                commands,
                compute | fragments,
                compute | transfer,
                none,
                &before,
                &[],
                &[],
            );
            device.cmd_fill_buffer(commands, lists, 0, ends, 0);
            let [frame, scene, work] = *sets;
            device.cmd_bind_descriptor_sets(commands, bind, layout, 0, &[frame, scene, work, set], &[]);
            device.cmd_push_constants(commands, layout, stages, 0, bytemuck::cast_slice(&push));
            for (pipeline, [x, y, z]) in steps {
                let written = memory(write | cleared, read | write);
                device.cmd_pipeline_barrier(commands, compute | transfer, compute, none, &written, &[], &[]);
                device.cmd_bind_pipeline(commands, bind, pipeline);
                device.cmd_dispatch(commands, x, y, z);
            }
            // The pixels to what shows them, the plan to its copy.
            let after = memory(write, read | vk::AccessFlags::TRANSFER_READ);
            device.cmd_pipeline_barrier(commands, compute, fragments | transfer, none, &after, &[], &[]);
        }
        Ok((set, push))
    }
}
