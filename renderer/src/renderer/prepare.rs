//! Before drawing: the order onto the device, and the compute passes that write the records.

use super::{DrawRequest, FRAMES, Renderer};
use crate::gpu::{Buffer, GpuError};
use crate::passes::Preparation;
use crate::scene::SceneOnDevice;
use crate::workspace::Workspace;
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::{BLOCK, Specialization};

/// Dispatches that prepare a frame: project, plan, emit.
pub(super) const PREPARATION_DISPATCHES: u32 = 3;

impl Renderer {
    pub(super) fn prepare_workspace(&mut self, scene: &SceneOnDevice, exact: bool) -> Result<(), GpuError> {
        if !self.workspace.as_ref().is_some_and(|w| w.fits(scene.splats, exact)) {
            self.gpu.wait_idle()?;
            self.workspace = None;
            self.workspace = Some(Workspace::new(&self.gpu, scene.splats, exact, FRAMES)?);
        }
        Ok(())
    }

    /// Brings a new order to the device, and waits there for the frame before to be done with the old one.
    pub(super) fn upload_order(&mut self, slot: usize, request: &DrawRequest<'_>) -> Result<(), GpuError> {
        let Some(workspace) = &mut self.workspace else { return Ok(()) };
        let slot = &mut self.slots[slot];
        let device = self.gpu.device();
        let readers = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::VERTEX_SHADER;
        let readers = if self.gpu.capabilities.geometry_shader {
            readers | vk::PipelineStageFlags::GEOMETRY_SHADER
        } else {
            readers
        };
        let indices = &request.order.indices;
        if workspace.order_id != request.order.id && !indices.is_empty() {
            let bytes = 4 * indices.len() as u64;
            if slot.order_staging.as_ref().is_none_or(|b| b.bytes() < bytes) {
                slot.order_staging = None;
                let staging = Buffer::new(
                    &self.gpu,
                    "order staging",
                    bytes,
                    vk::BufferUsageFlags::TRANSFER_SRC,
                    MemoryLocation::CpuToGpu,
                )?;
                slot.order_staging = Some(staging);
            }
            if let Some(staging) = &mut slot.order_staging {
                staging.mapped_mut()[..bytes as usize].copy_from_slice(bytemuck::cast_slice(indices));
                let copy = vk::BufferCopy { src_offset: 0, dst_offset: 0, size: bytes };
                let before = vk::MemoryBarrier::default();
                // SAFETY: both buffers hold the region; readers of the old order are waited for.
                unsafe {
                    let none = vk::DependencyFlags::empty();
                    device.cmd_pipeline_barrier(
                        slot.commands,
                        readers,
                        vk::PipelineStageFlags::TRANSFER,
                        none,
                        &[before],
                        &[],
                        &[],
                    );
                    device.cmd_copy_buffer(slot.commands, staging.raw(), workspace.order.raw(), &[copy]);
                }
            }
            workspace.order_id = request.order.id;
            slot.report.uploaded_bytes += bytes;
        }
        // The frame before still draws from the records that this one writes.
        let barrier = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE | vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
        // SAFETY: recorded outside any render pass.
        unsafe {
            device.cmd_pipeline_barrier(
                slot.commands,
                readers | vk::PipelineStageFlags::TRANSFER | vk::PipelineStageFlags::DRAW_INDIRECT,
                readers,
                vk::DependencyFlags::empty(),
                &[barrier],
                &[],
                &[],
            );
        }
        Ok(())
    }

    /// Projects, plans and lists what is drawn: [`PREPARATION_DISPATCHES`].
    pub(super) fn record_preparation(
        &mut self,
        commands: vk::CommandBuffer,
        splats: u32,
        sets: &[vk::DescriptorSet; 3],
        specialization: Specialization,
    ) -> Result<(), GpuError> {
        let project = self.passes.compute(Preparation::Project, specialization)?;
        let plan = self.passes.compute(Preparation::Plan, specialization)?;
        let emit = self.passes.compute(Preparation::Emit, specialization)?;
        let device = self.gpu.device();
        let groups = splats.div_ceil(BLOCK);
        let between = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
        let after =
            vk::MemoryBarrier::default().src_access_mask(vk::AccessFlags::SHADER_WRITE).dst_access_mask(
                vk::AccessFlags::SHADER_READ
                    | vk::AccessFlags::INDIRECT_COMMAND_READ
                    | vk::AccessFlags::TRANSFER_READ,
            );
        let compute = vk::PipelineStageFlags::COMPUTE_SHADER;
        // SAFETY: pipelines and sets match the layout; buffers are sized for `splats`.
        unsafe {
            let none = vk::DependencyFlags::empty();
            device.cmd_bind_descriptor_sets(
                commands,
                vk::PipelineBindPoint::COMPUTE,
                self.passes.layout,
                0,
                sets,
                &[],
            );
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, project);
            device.cmd_dispatch(commands, groups, 1, 1);
            device.cmd_pipeline_barrier(commands, compute, compute, none, &[between], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, plan);
            device.cmd_dispatch(commands, 1, 1, 1);
            device.cmd_pipeline_barrier(commands, compute, compute, none, &[between], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, emit);
            device.cmd_dispatch(commands, groups, 1, 1);
            device.cmd_pipeline_barrier(
                commands,
                compute,
                vk::PipelineStageFlags::VERTEX_SHADER
                    | vk::PipelineStageFlags::DRAW_INDIRECT
                    | vk::PipelineStageFlags::TRANSFER,
                none,
                &[after],
                &[],
                &[],
            );
        }
        Ok(())
    }
}
