//! What the shaders read: descriptor sets of one frame.

use super::{FRAME_DATA_STRIDE, Renderer};
use crate::gpu::{Buffer, During, GpuError};
use crate::scene::SceneOnDevice;
use ash::vk;
use motes_shaders::layout::FrameData;

impl Renderer {
    pub(super) fn allocate_set(&self, slot: usize, set: usize) -> Result<vk::DescriptorSet, GpuError> {
        self.allocate_set_of(slot, self.passes.set_layouts[set])
    }

    pub(super) fn allocate_set_of(
        &self,
        slot: usize,
        layout: vk::DescriptorSetLayout,
    ) -> Result<vk::DescriptorSet, GpuError> {
        let layouts = [layout];
        let info = vk::DescriptorSetAllocateInfo::default()
            .descriptor_pool(self.slots[slot].descriptors)
            .set_layouts(&layouts);
        let mut made = vk::DescriptorSet::null();
        let device = self.gpu.device();
        // By the bare call: the wrapper returns a vector, and a frame allocates nothing.
        // SAFETY: the pool was reset when the frame began and is large enough for a frame; one set is written.
        let result =
            unsafe { (device.fp_v1_0().allocate_descriptor_sets)(device.handle(), &info, &mut made) };
        result.result().during("vkAllocateDescriptorSets")?;
        Ok(made)
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
        let parts = [whole(&self.slots[slot].part_list)];
        // A stream of fewer bindings fills the rest with the scene's geometry: they are never read, and a scene
        // without an attribute has no buffer for it.
        let first = &scene.geometry.buffers[0];
        let binding = |buffers: &[Buffer], i: usize| whole(buffers.get(i).unwrap_or(first));
        let geometry: [_; 4] = std::array::from_fn(|i| binding(&scene.geometry.buffers, i));
        let harmonics: [_; 4] = std::array::from_fn(|i| binding(&scene.harmonics.buffers, i));
        let motion: [_; 2] = std::array::from_fn(|i| binding(&scene.motion.buffers, i));
        let order = [whole(workspace.orders[part].buffer(&self.gpu)?)];
        let records = [whole(&workspace.records[0]), whole(&workspace.records[1])];
        let singles = [
            &workspace.blocks,
            &workspace.footprints,
            &workspace.areas,
            &workspace.plan,
            &workspace.visible,
            &workspace.depths,
            &workspace.due,
        ]
        .map(|b| [whole(b)]);
        let write = |set: usize, binding: u32, kind, infos| {
            vk::WriteDescriptorSet { dst_set: sets[set], ..Default::default() }
                .dst_binding(binding)
                .descriptor_type(kind)
                .buffer_info(infos)
        };
        let storage = vk::DescriptorType::STORAGE_BUFFER;
        let [blocks, footprints, areas, plan, visible, depths, due] = &singles;
        // Arrays: a frame allocates nothing.
        let writes = [
            write(0, 0, vk::DescriptorType::UNIFORM_BUFFER, &uniform[..]),
            write(0, 1, storage, &parts),
            write(1, 0, storage, &geometry),
            write(1, 1, storage, &harmonics),
            write(1, 2, storage, &motion),
            write(2, 0, storage, &order),
            write(2, 1, storage, &records),
            write(2, 2, storage, blocks),
            write(2, 3, storage, footprints),
            write(2, 4, storage, areas),
            write(2, 5, storage, plan),
            write(2, 6, storage, visible),
            write(2, 7, storage, depths),
            write(2, 8, storage, due),
        ];
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

    /// Images that a pass samples, clamped to the edge, at bindings 1 and up of set 3.
    pub(super) fn sampled_set<const N: usize>(
        &self,
        slot: usize,
        views: [vk::ImageView; N],
    ) -> Result<vk::DescriptorSet, GpuError> {
        let set = self.allocate_set(slot, 3)?;
        let infos = views.map(|image_view| {
            [vk::DescriptorImageInfo {
                sampler: self.upscaler.sampler(),
                image_view,
                image_layout: vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
            }]
        });
        let writes: [_; N] = std::array::from_fn(|i| {
            vk::WriteDescriptorSet { dst_set: set, ..Default::default() }
                .dst_binding(1 + i as u32)
                .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
                .image_info(&infos[i])
        });
        // SAFETY: set, views and sampler are alive and not in use by the device.
        unsafe { self.gpu.device().update_descriptor_sets(&writes, &[]) };
        Ok(set)
    }
}
