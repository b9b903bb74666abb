//! What nobody sees of an eye's image, such as what lies behind the rim of a headset's lens: nothing is shaded there.
//!
//! Before the first splat, triangles over the hidden parts are drawn at the depth that stops every later fragment: the one
//! by which early stop closes pixels, or the nearest distance there is for stochastic transparency. Where a frame has no
//! depth attachment, everything is drawn. What is hidden shows the background.

use super::Renderer;
use crate::gpu::{Buffer, Gpu, GpuError};
use crate::passes::Passes;
use crate::pipeline::{Depth, GraphicsPipeline};
use crate::render_pass::PassKey;
use crate::shader::Constants;
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::modules;
use std::collections::HashMap;
use std::sync::Arc;

/// A corner of a triangle: across and down the image, −1 ..= 1, and which eye's image.
type Corner = [f32; 3];

/// The hidden parts, and the pipelines that close them.
pub(super) struct Hidden {
    gpu: Arc<Gpu>,
    corners: Option<Buffer>,
    count: u32,
    pipelines: HashMap<PassKey, vk::Pipeline>,
}

impl Hidden {
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: gpu.clone(), corners: None, count: 0, pipelines: HashMap::new() }
    }

    /// The pipeline for a pass; none where nothing is hidden or nothing can be closed.
    pub fn pipeline(&mut self, passes: &mut Passes, pass: PassKey) -> Result<Option<vk::Pipeline>, GpuError> {
        if self.count == 0 || pass.depth_format().is_none() {
            return Ok(None);
        }
        if let Some(pipeline) = self.pipelines.get(&pass) {
            return Ok(Some(*pipeline));
        }
        let pipeline = make(&self.gpu, passes, pass)?;
        self.pipelines.insert(pass, pipeline);
        Ok(Some(pipeline))
    }

    /// Records the closing of what is hidden, first of all in a pass.
    ///
    /// # Safety
    /// The commands are being recorded, in the first subpass of the pipeline's pass.
    pub unsafe fn record(
        &self,
        commands: vk::CommandBuffer,
        passes: &Passes,
        pipeline: vk::Pipeline,
        pass: PassKey,
        layer: u32,
    ) {
        let Some(corners) = &self.corners else { return };
        let device = self.gpu.device();
        // Splats lie at ½ and must be nearer; stochastic ones lie below 1 and must be greater.
        let depth = if pass.stochastic { 1.0f32 } else { 0.0 };
        let push = [layer, depth.to_bits()];
        // SAFETY: as the caller says; the buffer lives until it is replaced, which waits for the device.
        unsafe {
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::GRAPHICS, pipeline);
            device.cmd_bind_vertex_buffers(commands, 0, &[corners.raw()], &[0]);
            let stages = passes.push_stages();
            device.cmd_push_constants(commands, passes.layout, stages, 0, bytemuck::cast_slice(&push));
            device.cmd_draw(commands, self.count, 1, 0, 0);
        }
    }
}

impl Drop for Hidden {
    fn drop(&mut self) {
        for pipeline in self.pipelines.values() {
            // SAFETY: the renderer that owns this has waited for its frames.
            unsafe { self.gpu.device().destroy_pipeline(*pipeline, None) };
        }
    }
}

impl Renderer {
    /// Says what nobody sees of each eye's image, from the next frame on: corners of triangles, three each, across (to the
    /// right) and down the image, −1 ..= 1. Empty lists hide nothing. Waits for the device.
    ///
    /// # Errors
    /// The device was lost, or is out of memory.
    pub fn hide(&mut self, eyes: [&[[f32; 2]]; 2]) -> Result<(), GpuError> {
        self.gpu.wait_idle()?;
        let corners: Vec<Corner> = (0..2)
            .flat_map(|eye| {
                let whole = eyes[eye].len() / 3 * 3;
                eyes[eye][..whole].iter().map(move |&[x, y]| [x, y, eye as f32])
            })
            .collect();
        self.hidden.count = corners.len() as u32;
        self.hidden.corners = None;
        if corners.is_empty() {
            return Ok(());
        }
        let bytes: &[u8] = bytemuck::cast_slice(&corners);
        let usage = vk::BufferUsageFlags::VERTEX_BUFFER;
        let location = MemoryLocation::CpuToGpu;
        let mut buffer = Buffer::new(&self.gpu, "hidden parts", bytes.len() as u64, usage, location)?;
        buffer.mapped_mut()[..bytes.len()].copy_from_slice(bytes);
        self.hidden.corners = Some(buffer);
        Ok(())
    }
}

/// A pipeline that writes depth alone.
fn make(gpu: &Arc<Gpu>, passes: &mut Passes, pass: PassKey) -> Result<vk::Pipeline, GpuError> {
    let code = if pass.view_mask == 0 { modules::HIDDEN_VERT } else { modules::HIDDEN_VERT_MULTIVIEW };
    let bindings = [vk::VertexInputBindingDescription {
        binding: 0,
        stride: size_of::<Corner>() as u32,
        input_rate: vk::VertexInputRate::VERTEX,
    }];
    let attributes = [vk::VertexInputAttributeDescription {
        location: 0,
        binding: 0,
        format: vk::Format::R32G32B32_SFLOAT,
        offset: 0,
    }];
    let input = vk::PipelineVertexInputStateCreateInfo::default()
        .vertex_binding_descriptions(&bindings)
        .vertex_attribute_descriptions(&attributes);
    // No colour is written.
    let blends = [vk::PipelineColorBlendAttachmentState::default(); 2];
    let pipeline = GraphicsPipeline {
        shaders: &[(vk::ShaderStageFlags::VERTEX, code)],
        constants: &Constants::default(),
        input,
        topology: vk::PrimitiveTopology::TRIANGLE_LIST,
        depth: Some(Depth { compare: vk::CompareOp::ALWAYS, write: true }),
        blends: &blends[..pass.colours()],
        layout: passes.layout,
        pass: passes.pass(pass)?,
        subpass: 0,
    };
    pipeline.make(gpu, passes.cache())
}
