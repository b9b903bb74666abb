//! Command buffers: made, submitted, waited for.

use crate::gpu::{During, Gpu, GpuError};
use ash::vk;
use std::sync::Arc;

/// A pool with one primary command buffer, and an unsignalled fence. The caller destroys pool and fence.
pub(crate) fn command_pool(
    gpu: &Arc<Gpu>,
) -> Result<(vk::CommandPool, vk::CommandBuffer, vk::Fence), GpuError> {
    let info = vk::CommandPoolCreateInfo::default()
        .queue_family_index(gpu.queue_family())
        .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
    // SAFETY: the device is alive; what was made is destroyed if a later step fails.
    unsafe {
        let pool = gpu.device().create_command_pool(&info, None).during("vkCreateCommandPool")?;
        let info = vk::CommandBufferAllocateInfo::default()
            .command_pool(pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        let commands = gpu.device().allocate_command_buffers(&info).during("vkAllocateCommandBuffers");
        let fence = gpu.device().create_fence(&vk::FenceCreateInfo::default(), None).during("vkCreateFence");
        match (commands, fence) {
            (Ok(commands), Ok(fence)) => Ok((pool, commands[0], fence)),
            (commands, fence) => {
                if let Ok(fence) = &fence {
                    gpu.device().destroy_fence(*fence, None);
                }
                gpu.device().destroy_command_pool(pool, None);
                commands.and(fence.map(|_| ())).and(Err(GpuError::Call {
                    call: "vkCreateCommandPool",
                    result: vk::Result::ERROR_UNKNOWN,
                }))
            }
        }
    }
}

/// Records, submits, and waits until the device is done.
pub(crate) fn submit_and_wait(
    gpu: &Gpu,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    record: impl FnOnce(&ash::Device, vk::CommandBuffer),
) -> Result<(), GpuError> {
    let device = gpu.device();
    let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
    // SAFETY: the command buffer is not in flight: every use of it is waited for here.
    unsafe {
        device.begin_command_buffer(commands, &begin).during("vkBeginCommandBuffer")?;
        record(device, commands);
        device.end_command_buffer(commands).during("vkEndCommandBuffer")?;
        let buffers = [commands];
        let submit = vk::SubmitInfo::default().command_buffers(&buffers);
        {
            let queue = gpu.queue();
            device.queue_submit(*queue, &[submit], fence).during("vkQueueSubmit")?;
        }
        device.wait_for_fences(&[fence], true, u64::MAX).during("vkWaitForFences")?;
        device.reset_fences(&[fence]).during("vkResetFences")
    }
}
