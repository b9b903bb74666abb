//! A request as the shaders see it: specialisation constants and uniforms.

use super::DrawRequest;
use super::upscale::Reduction;
use crate::config::{Composite, Expansion, OrderKey, RadiusRule, RenderConfig, Sorter, TargetFormat};
use crate::resolution::{Resolution, Sampling};
use crate::scene::SceneOnDevice;
use crate::view::View;
use ash::vk;
use glam::DVec3;
use motes_shaders::layout::{FrameData, MAX_BATCHES, Specialization, ViewData, WHOLE_SCENE};
use std::mem::offset_of;

pub(super) fn specialization(
    scene: &SceneOnDevice,
    views: usize,
    config: &RenderConfig,
    resolution: &Resolution,
    parts: bool,
) -> Specialization {
    Specialization {
        projection: config.projection as u32,
        low_pass: config.low_pass as u32,
        shape: config.shape as u32,
        radius: match config.radius {
            RadiusRule::OpacityAware => 0,
            RadiusRule::Sqrt8 => 1,
            RadiusRule::Full => 2,
            RadiusRule::Tiles => 3,
        },
        precision: scene.packing.precision as u32,
        sh_degree: u32::from(config.sh_degree.min(scene.packing.sh_degree)),
        sh_stored: u32::from(scene.packing.sh_degree),
        sh_precision: scene.packing.sh_precision as u32,
        geometry_slots: scene.geometry.buffers.len() as u32,
        sh_slots: scene.harmonics.buffers.len().max(1) as u32,
        motion: u32::from(scene.moving),
        views: views as u32,
        composite: match (config.sorter, config.composite) {
            (Sorter::Stochastic, _) => 2,
            (_, Composite::BackToFront) => 1,
            (_, Composite::FrontToBack | Composite::EarlyStop) => 0,
        },
        geometry_shift: scene.geometry.shift,
        sh_shift: scene.harmonics.shift,
        sampling: resolution.sampling as u32,
        lens: config.lens as u32,
        parts: u32::from(parts),
    }
}

/// Format of the blended image.
pub(super) fn blended_format(target: TargetFormat) -> vk::Format {
    match target {
        TargetFormat::Rgba16F => vk::Format::R16G16B16A16_SFLOAT,
        TargetFormat::Rgba8 => vk::Format::R8G8B8A8_UNORM,
        TargetFormat::Rgba32F => vk::Format::R32G32B32A32_SFLOAT,
        TargetFormat::Rgb10A2 => vk::Format::A2B10G10R10_UNORM_PACK32,
    }
}

pub(super) fn is_srgb(format: vk::Format) -> bool {
    matches!(format, vk::Format::R8G8B8A8_SRGB | vk::Format::B8G8R8A8_SRGB | vk::Format::A8B8G8R8_SRGB_PACK32)
}

pub(super) fn frame_data(
    request: &DrawRequest<'_>,
    reduction: &Reduction,
    ordered: u32,
    sample: u32,
) -> FrameData {
    let DrawRequest { scene, views, config, .. } = *request;
    let Reduction { resolution, past, reprojection, .. } = *reduction;
    let mut data = FrameData::default();
    // Interleaved samples are centres of shown pixels, and the low-pass filter is theirs; else that of the rendered ones.
    let filtered = match resolution.sampling {
        Sampling::Centers => resolution.rendered,
        Sampling::Interleaved | Sampling::Checkerboard => resolution.shown,
    };
    let row = |v: DVec3, rest: f32| v.as_vec3().extend(rest).to_array();
    let [width, height] = filtered.map(|s| s as f32);
    let covered = resolution.covered();
    let beyond = [0, 1].map(|i| covered[i] / f64::from(resolution.shown[i]));
    for (out, view) in data.views.iter_mut().zip(views) {
        let rows = view.rotation.transpose();
        let eye = view.eye - scene.origin;
        let rest = (eye - eye.as_vec3().as_dvec3()).as_vec3();
        let f = view.fov;
        let [fx, fy] = View { size: filtered, ..*view }.focal();
        let (right, down) = (f.left + (f.right - f.left) * beyond[0], f.up + (f.down - f.up) * beyond[1]);
        *out = ViewData {
            rotation: [row(rows.x_axis, rest.x), row(rows.y_axis, rest.y), row(rows.z_axis, rest.z)],
            eye: eye.as_vec3().extend(0.0).to_array(),
            tangents: [f.left as f32, right as f32, f.up as f32, down as f32],
            image: [fx as f32, fy as f32, width, height],
        };
    }
    if let [_] = views {
        // Whichever layer an eye by itself is drawn into.
        data.views[1] = data.views[0];
    }
    // Tiles stop by themselves, without batches.
    let early_stop = config.composite == Composite::EarlyStop && config.expansion != Expansion::Tiles;
    let odd = 0.5 * (resolution.step & 1) as f32;
    data.sort_center = (midpoint(views) - scene.origin).as_vec3().extend(odd).to_array();
    data.cull = [config.near, config.near_fade, config.min_opacity, config.min_contribution];
    data.filters = [0.3, config.max_radius * width.max(height), config.stop_below, config.time];
    let whole_scene = if ordered == scene.splats { WHOLE_SCENE } else { 0 };
    data.counts = [
        ordered,
        if early_stop { config.batches.min(MAX_BATCHES as u32) } else { 1 },
        config.shape.corners(),
        sample & (WHOLE_SCENE - 1) | whole_scene | u32::from(config.order == OrderKey::Depth) << 31,
    ];
    data.sampling = [resolution.pitch, resolution.step, past as u32, reduction.history_share.to_bits()];
    let [shown_width, shown_height] = resolution.shown.map(|s| s as f32);
    // One slope for both eyes: that of the wider pixels.
    let pixel = data.views[..views.len()].iter().fold(0.0f32, |p, v| p.max(1.0 / v.image[0]));
    let [rendered, filtered] = [resolution.rendered, filtered].map(|s| s[0] as f32 * s[1] as f32);
    data.shown = [shown_width, shown_height, resolution.largest_offset() as f32 * pixel, rendered / filtered];
    for (rows, matrix) in data.reprojection.chunks_exact_mut(3).zip(reprojection) {
        let columns = matrix.transpose();
        rows.copy_from_slice(&[row(columns.x_axis, 0.0), row(columns.y_axis, 0.0), row(columns.z_axis, 0.0)]);
    }
    data
}

/// The point between the eyes, from which the radial order is measured.
pub fn midpoint(views: &[View]) -> DVec3 {
    views.iter().map(|v| v.eye).sum::<DVec3>() / views.len().max(1) as f64
}

const _: () = assert!(offset_of!(FrameData, counts) == 240);
