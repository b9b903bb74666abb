//! Before drawing: the compute passes that write the records.

use super::{FRAMES, Renderer};
use crate::config::Projection;
use crate::gpu::GpuError;
use crate::passes::Preparation;
use crate::scene::SceneOnDevice;
use crate::workspace::Workspace;
use ash::vk;
use motes_shaders::layout::{BLOCK, Specialization, WORKGROUP};

/// Dispatches that prepare a frame: project, count, plan, emit, schedule.
pub(super) const PREPARATION_DISPATCHES: u32 = 5;

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
        let groups = splats.div_ceil(WORKGROUP);
        let mut steps = [
            (Preparation::Project, groups),
            (Preparation::Count, splats.div_ceil(BLOCK * WORKGROUP)),
            (Preparation::Plan, 1),
            (Preparation::Emit, groups),
            (Preparation::Schedule, 1),
        ]
        .map(|(step, groups)| (step, groups, vk::Pipeline::null()));
        for (step, _, pipeline) in &mut steps {
            *pipeline = self.passes.compute(*step, specialization)?;
        }
        let depths = self.workspace.as_ref().map(|w| w.depths.raw()).unwrap_or_default();
        let device = self.gpu.device();
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
            let mut before = compute | vk::PipelineStageFlags::TRANSFER;
            for (i, (_, groups, pipeline)) in steps.into_iter().enumerate() {
                if i > 0 {
                    let seen = if before == compute { between } else { filled };
                    device.cmd_pipeline_barrier(commands, before, compute, none, &[seen], &[], &[]);
                    before = compute;
                }
                device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline);
                device.cmd_dispatch(commands, groups, 1, 1);
            }
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
