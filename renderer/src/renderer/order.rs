//! A frame's order: brought to the device, or made there.

use super::{DrawRequest, Renderer};
use crate::config::Sorter;
use crate::gpu::{Buffer, GpuError};
use crate::order::OrderRequest;
use crate::order::device::DeviceSort;
use crate::workspace::OrderOnDevice;
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::Specialization;

impl Renderer {
    /// Makes sure that the order buffer of an eye (of both, where `own_eye` is none) is right for the request, and
    /// says how many splats it lists. `sets` are the frame's and the scene's.
    pub(super) fn order(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        own_eye: Option<usize>,
        sets: [vk::DescriptorSet; 2],
        specialization: Specialization,
    ) -> Result<u32, GpuError> {
        // The frame before may still read the old order, and records that this frame writes.
        self.wait_for_readers(slot);
        let count = match request.config.sorter {
            Sorter::Cpu => self.upload_order(slot, request, own_eye)?,
            Sorter::Gpu => self.sort_on_device(slot, request, own_eye, sets, specialization)?,
            Sorter::Stochastic => self.parts.as_ref().map_or(request.scene.splats, |p| p.splats()),
        };
        self.wait_for_readers(slot);
        Ok(count)
    }

    /// Everything that was recorded so far ends before what reads or writes orders and records next.
    fn wait_for_readers(&self, slot: usize) {
        let mut readers = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::VERTEX_SHADER;
        if self.gpu.capabilities.geometry_shader {
            readers |= vk::PipelineStageFlags::GEOMETRY_SHADER;
        }
        let transfer = vk::PipelineStageFlags::TRANSFER;
        let barrier = vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE | vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(
                vk::AccessFlags::SHADER_READ
                    | vk::AccessFlags::SHADER_WRITE
                    | vk::AccessFlags::TRANSFER_WRITE,
            );
        // SAFETY: recorded outside any render pass.
        unsafe {
            self.gpu.device().cmd_pipeline_barrier(
                self.slots[slot].commands,
                readers | transfer | vk::PipelineStageFlags::DRAW_INDIRECT,
                readers | transfer,
                vk::DependencyFlags::empty(),
                &[barrier],
                &[],
                &[],
            );
        }
    }

    /// Copies an order that the processor made, unless it is there already.
    fn upload_order(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        own_eye: Option<usize>,
    ) -> Result<u32, GpuError> {
        let eye = own_eye.unwrap_or(0);
        let Some(workspace) = &mut self.workspace else { return Ok(0) };
        let slot = &mut self.slots[slot];
        let indices = match own_eye {
            Some(eye) => request.order.of_eye(eye),
            None => &request.order.indices,
        };
        // An order of another, larger scene would reach beyond the buffers.
        let indices = &indices[..indices.len().min(request.scene.splats as usize)];
        let order = &mut workspace.orders[eye];
        if order.id != request.order.id && !indices.is_empty() {
            let bytes = 4 * indices.len() as u64;
            let staging = &mut slot.order_staging[eye];
            if staging.as_ref().is_none_or(|b| b.bytes() < bytes) {
                *staging = None;
                let usage = vk::BufferUsageFlags::TRANSFER_SRC;
                *staging =
                    Some(Buffer::new(&self.gpu, "order staging", bytes, usage, MemoryLocation::CpuToGpu)?);
            }
            if let Some(staging) = staging {
                staging.mapped_mut()[..bytes as usize].copy_from_slice(bytemuck::cast_slice(indices));
                let copy = vk::BufferCopy { src_offset: 0, dst_offset: 0, size: bytes };
                let (from, to) = (staging.raw(), order.buffer(&self.gpu)?.raw());
                // SAFETY: both buffers hold the region; readers of the old order are waited for.
                unsafe { self.gpu.device().cmd_copy_buffer(slot.commands, from, to, &[copy]) };
                slot.report.uploaded_bytes += bytes;
            }
        }
        order.id = request.order.id;
        order.device_made = None;
        order.count = indices.len() as u32;
        Ok(order.count)
    }

    /// Sorts on the device, unless the last order still serves: it is not yet this frame's turn, or nothing that the
    /// order depends on has changed.
    fn sort_on_device(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        own_eye: Option<usize>,
        sets: [vk::DescriptorSet; 2],
        specialization: Specialization,
    ) -> Result<u32, GpuError> {
        let scene = request.scene;
        let parts = self.parts.clone();
        let wanted = OrderRequest {
            parts: parts.as_ref().map_or(0, |p| p.id()),
            ..OrderRequest::new(request.views, request.config)
        };
        let eye = own_eye.unwrap_or(0);
        let Some(workspace) = &mut self.workspace else { return Ok(0) };
        let order = &mut workspace.orders[eye];
        if let Some(made) = &mut order.device_made {
            made.age += 1;
            let same_kind = made.scene == scene.id
                && made.own_eye == own_eye.is_some()
                && made.request.key == wanted.key
                && made.request.bits == wanted.bits
                && made.request.time_cull == wanted.time_cull
                && made.request.parts == wanted.parts;
            if same_kind && (made.request == wanted || made.age < request.config.sort_interval) {
                return Ok(order.count);
            }
        }
        let sorter = match &mut self.device_sort {
            Some(sorter) => sorter,
            none => {
                let [frame, scene, ..] = self.passes.set_layouts;
                none.insert(DeviceSort::new(&self.gpu, [frame, scene])?)
            }
        };
        sorter.prepare(scene.splats)?;
        let sort_sets = sorter.allocate(self.slots[slot].descriptors)?;
        let commands = self.slots[slot].commands;
        let buffer = order.buffer(&self.gpu)?;
        let parts = parts.as_deref();
        order.count =
            sorter.record(commands, sort_sets, scene, sets, specialization, buffer, &wanted, parts)?;
        self.slots[slot].report.dispatches += sorter.dispatches(wanted.bits);
        order.id = 0;
        order.device_made =
            Some(OrderOnDevice { scene: scene.id, request: wanted, own_eye: own_eye.is_some(), age: 0 });
        Ok(order.count)
    }

    /// The next frame that is drawn with the device's sort sorts anew, whatever the interval says.
    pub fn expire_order(&mut self) {
        if let Some(workspace) = &mut self.workspace {
            for order in &mut workspace.orders {
                order.device_made = None;
            }
        }
    }
}
