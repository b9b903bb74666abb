//! Before drawing: the compute passes that write the records.

use super::{FRAMES, Renderer};
use crate::config::Projection;
use crate::gpu::GpuError;
use crate::passes::Preparation;
use crate::scene::SceneOnDevice;
use crate::workspace::Workspace;
use ash::vk;
use motes_shaders::layout::{BLOCK, Specialization};

/// Dispatches that prepare a frame: project, plan, emit, schedule.
pub(super) const PREPARATION_DISPATCHES: u32 = 4;

impl Renderer {
    pub(super) fn prepare_workspace(
        &mut self,
        scene: &SceneOnDevice,
        projection: Projection,
    ) -> Result<(), GpuError> {
        if !self.workspace.as_ref().is_some_and(|w| w.fits(scene.splats, projection)) {
            self.gpu.wait_idle()?;
            self.workspace = None;
            self.workspace = Some(Workspace::new(&self.gpu, scene.splats, projection, FRAMES)?);
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
        let schedule = self.passes.compute(Preparation::Schedule, specialization)?;
        let depths = self.workspace.as_ref().map(|w| w.depths.raw()).unwrap_or_default();
        let device = self.gpu.device();
        let groups = splats.div_ceil(BLOCK);
        let between = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
        let filled = between.src_access_mask(vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE);
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
            device.cmd_fill_buffer(commands, depths, 0, vk::WHOLE_SIZE, 0);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, project);
            device.cmd_dispatch(commands, groups, 1, 1);
            let written = compute | vk::PipelineStageFlags::TRANSFER;
            device.cmd_pipeline_barrier(commands, written, compute, none, &[filled], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, plan);
            device.cmd_dispatch(commands, 1, 1, 1);
            device.cmd_pipeline_barrier(commands, compute, compute, none, &[between], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, emit);
            device.cmd_dispatch(commands, groups, 1, 1);
            device.cmd_pipeline_barrier(commands, compute, compute, none, &[between], &[], &[]);
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, schedule);
            device.cmd_dispatch(commands, 1, 1, 1);
            device.cmd_pipeline_barrier(
                commands,
                compute,
                vk::PipelineStageFlags::VERTEX_SHADER
                    | vk::PipelineStageFlags::FRAGMENT_SHADER
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
