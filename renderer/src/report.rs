//! What a frame took: device times of whole passes, counts, and what the device itself predicted.

use crate::gpu::{During, Gpu, GpuError};
use ash::vk;
use motes_shaders::layout::MAX_BATCHES;
use std::sync::Arc;

/// What one frame took.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FrameReport {
    /// Views.
    pub views: u32,
    /// Rendered pixels of all views.
    pub pixels: u64,
    /// Shown pixels of all views: more, where the resolution is reduced.
    pub shown_pixels: u64,
    /// Device time of the order, uploaded or sorted, ns. 0 where the device has no timestamps.
    pub upload_ns: f64,
    /// Device time of the compute passes before drawing, ns.
    pub prepare_ns: f64,
    /// Device time of drawing and resolving, ns.
    pub draw_ns: f64,
    /// Vertex-stage invocations.
    pub vertices: u64,
    /// Primitives that reached the rasteriser.
    pub primitives: u64,
    /// Fragment-stage invocations of splats; some drivers leave out fragments that end early. By tiles, pixels that splats
    /// were blended into.
    pub fragments: u64,
    /// Pixels of the marks between batches, over whole images or in the tiles that are due.
    pub full_screen_fragments: u64,
    /// Splats drawn (precomputed expansion).
    pub visible: u32,
    /// Pixels of all polygons, as predicted before drawing (precomputed expansion).
    pub predicted_fragments: f32,
    /// Of those, pixels that early stop is predicted to leave.
    pub predicted_unhidden: f32,
    /// Draw calls, full-screen ones among them.
    pub draws: u32,
    /// Compute dispatches.
    pub dispatches: u32,
    /// Render passes.
    pub passes: u32,
    /// Bytes brought to the device for this frame.
    pub uploaded_bytes: u64,
}

impl FrameReport {
    /// Device time of everything, ns.
    pub fn device_ns(&self) -> f64 {
        self.upload_ns + self.prepare_ns + self.draw_ns
    }

    /// Adds what another part of the same picture took.
    pub(crate) fn add(&mut self, part: &Self) {
        self.pixels += part.pixels;
        self.shown_pixels += part.shown_pixels;
        self.upload_ns += part.upload_ns;
        self.prepare_ns += part.prepare_ns;
        self.draw_ns += part.draw_ns;
        self.vertices += part.vertices;
        self.primitives += part.primitives;
        self.fragments += part.fragments;
        self.full_screen_fragments += part.full_screen_fragments;
        self.visible += part.visible;
        self.predicted_fragments += part.predicted_fragments;
        self.predicted_unhidden += part.predicted_unhidden;
        self.draws += part.draws;
        self.dispatches += part.dispatches;
        self.passes += part.passes;
        self.uploaded_bytes += part.uploaded_bytes;
    }

    /// Fragments of splats per rendered pixel.
    pub fn layers(&self) -> f64 {
        self.fragments as f64 / self.pixels.max(1) as f64
    }
}

const STAMPS: u32 = 4;
/// Statistics of a frame: each batch of each view by itself, so that the marks between batches are not among them.
const MOST_STATISTICS: u32 = 2 * MAX_BATCHES as u32;
/// Queries that one measurement takes. One would do, outside of multiview passes; but lavapipe (seen in 25.0.7) goes
/// on counting one per view of the pass before, and writes past the pool's end.
const SPACING: u32 = 2;

/// Timestamps between passes, and statistics of the drawing.
pub(crate) struct Queries {
    gpu: Arc<Gpu>,
    stamps: vk::QueryPool,
    statistics: vk::QueryPool,
    /// Stamps that were written in this frame.
    stamped: u32,
    /// Statistics that were taken in it.
    counted: u32,
}

impl Queries {
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, GpuError> {
        let mut queries = Self {
            gpu: gpu.clone(),
            stamps: vk::QueryPool::null(),
            statistics: vk::QueryPool::null(),
            stamped: 0,
            counted: 0,
        };
        if gpu.capabilities.timestamp_period > 0.0 {
            let info = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(STAMPS * SPACING);
            // SAFETY: `info` is complete.
            queries.stamps =
                unsafe { gpu.device().create_query_pool(&info, None) }.during("vkCreateQueryPool")?;
        }
        if gpu.capabilities.pipeline_statistics {
            let what = vk::QueryPipelineStatisticFlags::VERTEX_SHADER_INVOCATIONS
                | vk::QueryPipelineStatisticFlags::CLIPPING_PRIMITIVES
                | vk::QueryPipelineStatisticFlags::FRAGMENT_SHADER_INVOCATIONS;
            let info = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::PIPELINE_STATISTICS)
                .query_count(MOST_STATISTICS)
                .pipeline_statistics(what);
            // SAFETY: `info` is complete.
            queries.statistics =
                unsafe { gpu.device().create_query_pool(&info, None) }.during("vkCreateQueryPool")?;
        }
        Ok(queries)
    }

    pub fn reset(&mut self, commands: vk::CommandBuffer) {
        self.stamped = 0;
        self.counted = 0;
        // SAFETY: recorded outside any render pass, before any use of the queries.
        unsafe {
            if self.stamps != vk::QueryPool::null() {
                self.gpu.device().cmd_reset_query_pool(commands, self.stamps, 0, STAMPS * SPACING);
            }
            if self.statistics != vk::QueryPool::null() {
                self.gpu.device().cmd_reset_query_pool(commands, self.statistics, 0, MOST_STATISTICS);
            }
        }
    }

    pub fn stamp(&mut self, commands: vk::CommandBuffer, index: u32) {
        self.stamped += 1;
        if self.stamps != vk::QueryPool::null() {
            // SAFETY: each stamp is written once a frame, outside render passes.
            unsafe {
                self.gpu.device().cmd_write_timestamp(
                    commands,
                    vk::PipelineStageFlags::BOTTOM_OF_PIPE,
                    self.stamps,
                    index * SPACING,
                );
            }
        }
    }

    /// Begins counting for the views of a pass; inside the subpass that draws splats. A multiview pass takes one query a
    /// view.
    pub fn begin_statistics(&mut self, commands: vk::CommandBuffer, views: u32) {
        let first = self.counted;
        self.counted += views;
        if self.statistics != vk::QueryPool::null() {
            // SAFETY: ended by `end_statistics` in the same subpass.
            unsafe {
                self.gpu.device().cmd_begin_query(
                    commands,
                    self.statistics,
                    first,
                    vk::QueryControlFlags::empty(),
                );
            }
        }
    }

    /// Ends what [`Queries::begin_statistics`] began.
    pub fn end_statistics(&self, commands: vk::CommandBuffer, views: u32) {
        let first = self.counted - views;
        if self.statistics != vk::QueryPool::null() {
            // SAFETY: begun by `begin_statistics`.
            unsafe { self.gpu.device().cmd_end_query(commands, self.statistics, first) };
        }
    }

    /// Reads the results of a frame that is done. A frame that drew nothing has none.
    pub fn read(&self, report: &mut FrameReport) -> Result<(), GpuError> {
        if self.stamped < STAMPS {
            return Ok(());
        }
        let device = self.gpu.device();
        if self.stamps != vk::QueryPool::null() {
            let mut ticks = [0u64; STAMPS as usize];
            for (i, tick) in (0..).zip(&mut ticks) {
                let tick = std::slice::from_mut(tick);
                let flags = vk::QueryResultFlags::TYPE_64;
                // SAFETY: all stamps were written by the frame, which is done.
                let read = unsafe { device.get_query_pool_results(self.stamps, i * SPACING, tick, flags) };
                read.during("vkGetQueryPoolResults")?;
            }
            let period = f64::from(self.gpu.capabilities.timestamp_period);
            let ns = |a: usize, b: usize| ticks[b].saturating_sub(ticks[a]) as f64 * period;
            report.upload_ns = ns(0, 1);
            report.prepare_ns = ns(1, 2);
            report.draw_ns = ns(2, 3);
        }
        if self.statistics != vk::QueryPool::null() && self.counted > 0 {
            let mut counts = [[0u64; 3]; MOST_STATISTICS as usize];
            let counts = &mut counts[..self.counted.min(MOST_STATISTICS) as usize];
            let flags = vk::QueryResultFlags::TYPE_64;
            // SAFETY: as above, and as many queries were ended.
            let read = unsafe { device.get_query_pool_results(self.statistics, 0, counts, flags) };
            read.during("vkGetQueryPoolResults")?;
            for [vertices, primitives, fragments] in counts {
                report.vertices += *vertices;
                report.primitives += *primitives;
                report.fragments += *fragments;
            }
        }
        Ok(())
    }
}

impl Drop for Queries {
    fn drop(&mut self) {
        // SAFETY: the renderer has waited for its frames. Null handles are ignored.
        unsafe {
            self.gpu.device().destroy_query_pool(self.stamps, None);
            self.gpu.device().destroy_query_pool(self.statistics, None);
        }
    }
}
