//! What the shaders read: descriptor sets of one frame.

use super::{FRAME_DATA_STRIDE, Renderer, call};
use crate::gpu::{Buffer, GpuError};
use crate::scene::SceneOnDevice;
use ash::vk;
use motes_shaders::layout::FrameData;

impl Renderer {
    pub(super) fn allocate_set(&self, slot: usize, set: usize) -> Result<vk::DescriptorSet, GpuError> {
        let layouts = [self.passes.set_layouts[set]];
        let info = vk::DescriptorSetAllocateInfo::default()
            .descriptor_pool(self.slots[slot].descriptors)
            .set_layouts(&layouts);
        // SAFETY: the pool was reset when the frame began and is large enough for a frame.
        Ok(call(unsafe { self.gpu.device().allocate_descriptor_sets(&info) }, "vkAllocateDescriptorSets")?[0])
    }

    /// The sets of a part of a frame: the one part, or one of two eyes that are prepared each by itself.
    pub(super) fn scene_sets(
        &mut self,
        slot: usize,
        scene: &SceneOnDevice,
        part: usize,
    ) -> Result<[vk::DescriptorSet; 3], GpuError> {
        let sets = [self.allocate_set(slot, 0)?, self.allocate_set(slot, 1)?, self.allocate_set(slot, 2)?];
        let Some(workspace) = &mut self.workspace else { return Ok(sets) };
        let whole =
            |b: &Buffer| vk::DescriptorBufferInfo { buffer: b.raw(), offset: 0, range: vk::WHOLE_SIZE };
        let uniform = [vk::DescriptorBufferInfo {
            buffer: self.slots[slot].uniform.raw(),
            offset: part as u64 * FRAME_DATA_STRIDE,
            range: size_of::<FrameData>() as u64,
        }];
        // A stream of fewer bindings fills the rest with the scene's geometry: they are never read, and a scene
        // without an attribute has no buffer for it.
        let stream = |buffers: &[Buffer], slots: usize| -> Vec<_> {
            (0..slots).map(|i| whole(buffers.get(i).unwrap_or(&scene.geometry.buffers[0]))).collect()
        };
        let geometry = stream(&scene.geometry.buffers, 4);
        let harmonics = stream(&scene.harmonics.buffers, 4);
        let motion = stream(&scene.motion.buffers, 2);
        let order = [whole(workspace.orders[part].buffer(&self.gpu)?)];
        let records = [whole(&workspace.records[0]), whole(&workspace.records[1])];
        let singles = [
            &workspace.blocks,
            &workspace.footprints,
            &workspace.offsets,
            &workspace.plan,
            &workspace.visible,
            &workspace.depths,
        ]
        .map(|b| [whole(b)]);
        let write = |set: usize, binding: u32, kind, infos| {
            vk::WriteDescriptorSet { dst_set: sets[set], ..Default::default() }
                .dst_binding(binding)
                .descriptor_type(kind)
                .buffer_info(infos)
        };
        let storage = vk::DescriptorType::STORAGE_BUFFER;
        let mut writes = vec![
            write(0, 0, vk::DescriptorType::UNIFORM_BUFFER, &uniform[..]),
            write(1, 0, storage, &geometry),
            write(1, 1, storage, &harmonics),
            write(1, 2, storage, &motion),
            write(2, 0, storage, &order),
            write(2, 1, storage, &records),
        ];
        for (binding, info) in (2..).zip(&singles) {
            writes.push(write(2, binding, storage, info));
        }
        // SAFETY: sets and buffers are alive and not in use by the device.
        unsafe { self.gpu.device().update_descriptor_sets(&writes, &[]) };
        Ok(sets)
    }

    pub(super) fn input_set(
        &self,
        slot: usize,
        view: vk::ImageView,
        layout: vk::ImageLayout,
    ) -> Result<vk::DescriptorSet, GpuError> {
        let set = self.allocate_set(slot, 3)?;
        let infos = [vk::DescriptorImageInfo {
            sampler: vk::Sampler::null(),
            image_view: view,
            image_layout: layout,
        }];
        let write = vk::WriteDescriptorSet { dst_set: set, ..Default::default() }
            .dst_binding(0)
            .descriptor_type(vk::DescriptorType::INPUT_ATTACHMENT)
            .image_info(&infos);
        // SAFETY: set and view are alive and not in use by the device.
        unsafe { self.gpu.device().update_descriptor_sets(&[write], &[]) };
        Ok(set)
    }
}
