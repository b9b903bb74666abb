//! The render pass: batches of splats, marks between them, the resolve.

use super::frame_data::is_srgb;
use super::median::FOLLOWED_BATCHES;
use super::upscale::Reduction;
use super::{Attachments, DrawRequest, Renderer};
use crate::config::{Composite, Expansion, TILES_STOP};
use crate::gpu::{Buffer, GpuError, Image, ImageDescription};
use crate::passes::{FullScreen, PUSH_BYTES, Stages};
use crate::render_pass::{PassKey, SECOND_FORMAT};
use ash::vk;
use gpu_allocator::MemoryLocation;
use motes_shaders::layout::{Draw, MarkDraw, Plan, QUADS_PER_INSTANCE, Specialization};
use std::mem::offset_of;

impl Renderer {
    #[allow(clippy::too_many_arguments)]
    pub(super) fn record_pass(
        &mut self,
        slot: usize,
        request: &DrawRequest<'_>,
        pass: PassKey,
        layer: Option<usize>,
        specialization: Specialization,
        batches: u32,
        corners: u32,
        indices: vk::Buffer,
        sets: &[vk::DescriptorSet; 3],
        reduction: &Reduction,
    ) -> Result<(), GpuError> {
        let DrawRequest { target, config, .. } = *request;
        let rendered = reduction.resolution.rendered;
        let splats = match config.expansion {
            Expansion::Precomputed => self.passes.splats(pass, Stages::Precomputed, specialization)?,
            Expansion::Instanced => self.passes.splats(pass, Stages::Instanced, specialization)?,
            Expansion::Geometry => self.passes.splats(pass, Stages::Geometry, specialization)?,
            Expansion::Tiles => self.passes.full_screen(pass, FullScreen::ShowTiles)?,
        };
        let resolve = match pass.output {
            Some(_) => Some(self.passes.full_screen(pass, FullScreen::Resolve)?),
            None => None,
        };
        let due = config.marks_due();
        let mark = match (pass.early_stop, due) {
            (false, _) => None,
            (true, false) => Some(self.passes.full_screen(pass, FullScreen::Mark)?),
            (true, true) => Some(self.passes.full_screen(pass, FullScreen::MarkTiles)?),
        };
        let hidden = self.hidden.pipeline(&mut self.passes, pass)?;
        let render_pass = self.passes.pass(pass)?;
        let output = layer.map_or(target.all, |l| target.layers[l]);
        let density = target.density.filter(|_| pass.density);
        let (framebuffer, [blended_view, second_view]) =
            self.framebuffer(render_pass, pass, (output, density), rendered)?;
        let follow = self.follow_median(slot, pass, specialization, [blended_view, second_view])?;
        let read_layout = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        let mark_layout = vk::ImageLayout::GENERAL;
        let input_sets = [
            self.input_set(slot, blended_view, mark_layout)?,
            self.input_set(slot, blended_view, read_layout)?,
        ];

        let [width, height] = rendered;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let viewport = vk::Viewport {
            x: 0.0,
            y: 0.0,
            width: width as f32,
            height: height as f32,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        // Colours first (the blended image, and the output where it has one), then depth, then the second one's.
        let colours = if pass.output.is_some() { 2 } else { 1 };
        let has_depth = pass.depth_format().is_some();
        let mut clear = [vk::ClearValue::default(); 4];
        if has_depth {
            let depth = if pass.stochastic { 0.0 } else { 1.0 };
            clear[colours].depth_stencil = vk::ClearDepthStencilValue { depth, stencil: 0 };
        }
        let clear = &clear[..colours + usize::from(has_depth) + pass.colours() - 1];
        let begin = vk::RenderPassBeginInfo::default()
            .render_pass(render_pass)
            .framebuffer(framebuffer)
            .render_area(area)
            .clear_values(clear);
        let layout = self.passes.layout;
        let push_stages = self.passes.push_stages();
        let gpu = self.gpu.clone();
        let device = gpu.device();
        let commands = self.slots[slot].commands;
        let plan = self.workspace.as_ref().map(|w| w.plan.raw()).unwrap_or_default();
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        let layer_index = layer.unwrap_or(0) as u32;
        // An eye that is drawn by itself is the only view of its part.
        let view = if request.views.len() == 1 { 0 } else { layer_index };
        let tiles = match config.expansion {
            Expansion::Tiles => {
                let views = if pass.view_mask == 0 { view..view + 1 } else { 0..2 };
                let early = config.composite == Composite::EarlyStop;
                let stop_below = if early { TILES_STOP * config.stop_below } else { 0.0 };
                Some(self.record_tiles(slot, views, rendered, stop_below, specialization, sets)?)
            }
            _ => None,
        };
        let marks = if pass.early_stop { batches - 1 } else { 0 };
        let report = &mut self.slots[slot].report;
        let follows = if follow.is_some() { batches.div_ceil(FOLLOWED_BATCHES) } else { 0 };
        report.draws +=
            batches + marks + follows + u32::from(resolve.is_some()) + u32::from(hidden.is_some());
        report.passes += 1;
        // SAFETY: every handle is alive until the frame is done; the records and draws were written before.
        unsafe {
            device.cmd_begin_render_pass(commands, &begin, vk::SubpassContents::INLINE);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_bind_descriptor_sets(commands, graphics, layout, 0, sets, &[]);
            device.cmd_bind_index_buffer(commands, indices, 0, vk::IndexType::UINT16);
            if let Some(hidden) = hidden {
                self.hidden.record(commands, &self.passes, hidden, pass, layer_index);
            }
            let counted = if pass.view_mask == 0 { 1 } else { 2 };
            for batch in 0..batches {
                device.cmd_bind_pipeline(commands, graphics, splats);
                if let Some((set, push)) = &tiles {
                    device.cmd_bind_descriptor_sets(commands, graphics, layout, 3, &[*set], &[]);
                    device.cmd_push_constants(commands, layout, push_stages, 0, bytemuck::cast_slice(push));
                    device.cmd_draw(commands, 3, 1, 0, 0);
                    break;
                }
                self.slots[slot].queries.begin_statistics(commands, counted);
                let [first, last] = [batch, batch + 1]
                    .map(|b| (u64::from(self.ordered) * u64::from(b) / u64::from(batches)) as u32);
                let push = [batch, view, first, last];
                device.cmd_push_constants(commands, layout, push_stages, 0, bytemuck::cast_slice(&push));
                match config.expansion {
                    Expansion::Precomputed => {
                        let offset = u64::from(batch) * size_of::<Draw>() as u64;
                        device.cmd_draw_indexed_indirect(commands, plan, offset, 1, size_of::<Draw>() as u32);
                    }
                    Expansion::Instanced => {
                        let instances = (last - first).div_ceil(QUADS_PER_INSTANCE);
                        device.cmd_draw_indexed(
                            commands,
                            (corners - 2) * 3 * QUADS_PER_INSTANCE,
                            instances,
                            0,
                            0,
                            0,
                        );
                    }
                    Expansion::Geometry => device.cmd_draw(commands, last - first, 1, 0, 0),
                    // Blended already.
                    Expansion::Tiles => {}
                }
                self.slots[slot].queries.end_statistics(commands, counted);
                let mark = mark.filter(|_| batch + 1 < batches);
                let due_now = (batch + 1) % FOLLOWED_BATCHES == 0 || batch + 1 == batches;
                let follow = follow.filter(|_| due_now);
                if mark.is_some() || follow.is_some() {
                    self.passes.blended_to_marks(commands, pass);
                }
                if let Some(follow) = follow {
                    self.record_follow(commands, follow, batch, view, rendered);
                }
                if let Some(mark) = mark {
                    device.cmd_bind_descriptor_sets(commands, graphics, layout, 3, &input_sets[..1], &[]);
                    device.cmd_bind_pipeline(commands, graphics, mark);
                    if due {
                        let offset =
                            (offset_of!(Plan, marks) + batch as usize * size_of::<MarkDraw>()) as u64;
                        device.cmd_draw_indirect(commands, plan, offset, 1, size_of::<MarkDraw>() as u32);
                    } else {
                        device.cmd_draw(commands, 3, 1, 0, 0);
                    }
                }
            }
            let Some(resolve) = resolve else {
                device.cmd_end_render_pass(commands);
                return self.record_upscale(slot, request, reduction, pass.view_mask, layer, sets[0]);
            };
            device.cmd_next_subpass(commands, vk::SubpassContents::INLINE);
            // A multiview subpass begins with nothing bound.
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_bind_descriptor_sets(commands, graphics, layout, 0, sets, &[]);
            device.cmd_bind_descriptor_sets(commands, graphics, layout, 3, &input_sets[1..], &[]);
            device.cmd_bind_pipeline(commands, graphics, resolve);
            let b = config.background;
            let decode = u32::from(is_srgb(target.format));
            let push =
                [b[0].to_bits(), b[1].to_bits(), b[2].to_bits(), target.background_alpha.to_bits(), decode];
            device.cmd_push_constants(commands, layout, push_stages, 0, bytemuck::cast_slice(&push));
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_render_pass(commands);
        }
        const { assert!(PUSH_BYTES >= 20) };
        Ok(())
    }

    /// The framebuffer for an output, and the views of the blended and the second image in it.
    pub(super) fn framebuffer(
        &mut self,
        render_pass: vk::RenderPass,
        pass: PassKey,
        (output, density): (vk::ImageView, Option<vk::ImageView>),
        size: [u32; 2],
    ) -> Result<(vk::Framebuffer, [vk::ImageView; 2]), GpuError> {
        let layers = if pass.view_mask == 0 { 1 } else { 2 };
        let description = ImageDescription {
            format: pass.blended,
            size,
            layers,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT
                | vk::ImageUsageFlags::INPUT_ATTACHMENT
                | if pass.output.is_some() {
                    vk::ImageUsageFlags::empty()
                } else {
                    vk::ImageUsageFlags::SAMPLED
                },
            aspect: vk::ImageAspectFlags::COLOR,
        };
        let second = pass.second().map(|_| ImageDescription {
            format: SECOND_FORMAT,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT
                | if pass.median {
                    vk::ImageUsageFlags::INPUT_ATTACHMENT | vk::ImageUsageFlags::SAMPLED
                } else {
                    vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::SAMPLED
                },
            ..description
        });
        let fits = self.attachments.as_ref().is_some_and(|a| {
            a.blended.description() == description
                && pass
                    .depth_format()
                    .is_none_or(|f| a.marks.as_ref().is_some_and(|m| m.description().format == f))
                && second.is_none_or(|wanted| a.second.as_ref().is_some_and(|s| s.description() == wanted))
        });
        if !fits {
            self.forget_targets()?;
            self.attachments = None;
            let blended = Image::new(&self.gpu, "blended", description)?;
            let marks = ImageDescription {
                format: pass.depth_format().unwrap_or_default(),
                usage: vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT,
                aspect: vk::ImageAspectFlags::DEPTH,
                ..description
            };
            let marks = match pass.depth_format() {
                Some(_) => Some(Image::new(&self.gpu, "marks or distances", marks)?),
                None => None,
            };
            let second = second.map(|d| Image::new(&self.gpu, "layer counts or median", d)).transpose()?;
            self.attachments = Some(Attachments { blended, marks, second });
        }
        let Some(Attachments { blended, marks, second }) = &self.attachments else {
            return Err(GpuError::NoDevice("no image to blend into".into()));
        };
        let none = vk::ImageView::null();
        let views = [blended.view(), second.as_ref().map_or(none, Image::view)];
        let attached = [
            views[0],
            pass.output.map_or(none, |_| output),
            marks.as_ref().filter(|_| pass.depth_format().is_some()).map_or(none, Image::view),
            if pass.second().is_some() { views[1] } else { none },
            density.unwrap_or(none),
        ];
        Ok((self.framebuffers.of(render_pass, attached, size)?, views))
    }

    /// Indices of one instance: every polygon as a strip that zigzags from corner 0. After those of octagons, those of squares.
    pub(super) fn index_buffer(&mut self, corners: u32) -> Result<vk::Buffer, GpuError> {
        if let Some(buffer) = self.indices.get(&corners) {
            return Ok(buffer.raw());
        }
        let strip = |j: u32| {
            if j == 0 {
                0
            } else if j % 2 == 1 {
                j.div_ceil(2)
            } else {
                corners - j / 2
            }
        };
        let mut words: Vec<u16> = Vec::new();
        for quad in 0..QUADS_PER_INSTANCE {
            for triangle in 0..corners - 2 {
                words.extend((0..3).map(|k| (quad * corners + strip(triangle + k)) as u16));
            }
        }
        if corners == 8 {
            // Of each second corner: what adaptive polygons that are small make a square of.
            for quad in 0..QUADS_PER_INSTANCE {
                words.extend([0, 2, 6, 2, 6, 4].map(|corner| (quad * 8 + corner) as u16));
            }
        }
        let mut buffer = Buffer::new(
            &self.gpu,
            "indices",
            2 * words.len() as u64,
            vk::BufferUsageFlags::INDEX_BUFFER,
            MemoryLocation::CpuToGpu,
        )?;
        buffer.mapped_mut()[..2 * words.len()].copy_from_slice(bytemuck::cast_slice(&words));
        let raw = buffer.raw();
        self.indices.insert(corners, buffer);
        Ok(raw)
    }
}
