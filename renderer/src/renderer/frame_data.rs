//! A request as the shaders see it: specialisation constants and uniforms.

use super::DrawRequest;
use crate::config::{Composite, RadiusRule, RenderConfig, TargetFormat};
use crate::scene::SceneOnDevice;
use crate::view::View;
use ash::vk;
use glam::DVec3;
use motes_shaders::layout::{FrameData, MAX_BATCHES, Specialization, ViewData};
use std::mem::offset_of;

pub(super) fn specialization(scene: &SceneOnDevice, views: usize, config: &RenderConfig) -> Specialization {
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
        sh_slots: scene.harmonics.buffers.len() as u32,
        motion: u32::from(scene.moving),
        views: views as u32,
        composite: u32::from(config.composite == Composite::BackToFront),
        geometry_shift: scene.geometry.shift,
        sh_shift: scene.harmonics.shift,
    }
}

/// Corners of the polygon.
pub(super) fn corners(config: &RenderConfig) -> u32 {
    if config.shape == crate::QuadShape::Octagon { 8 } else { 4 }
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

pub(super) fn frame_data(request: &DrawRequest<'_>) -> FrameData {
    let DrawRequest { scene, views, config, target, .. } = *request;
    let mut data = FrameData::default();
    let [width, height] = target.size.map(|s| s as f32);
    for (out, view) in data.views.iter_mut().zip(views) {
        let rows = view.rotation.transpose();
        let row = |v: DVec3| v.as_vec3().extend(0.0).to_array();
        let f = view.fov;
        let view_of_target = View { size: target.size, ..*view };
        let [fx, fy] = view_of_target.focal();
        *out = ViewData {
            rotation: [row(rows.x_axis), row(rows.y_axis), row(rows.z_axis)],
            eye: (view.eye - scene.origin).as_vec3().extend(0.0).to_array(),
            tangents: [f.left as f32, f.right as f32, f.up as f32, f.down as f32],
            image: [fx as f32, fy as f32, width, height],
        };
    }
    let early_stop = config.composite == Composite::EarlyStop;
    data.sort_center = (midpoint(views) - scene.origin).as_vec3().extend(0.0).to_array();
    data.cull = [config.near, config.near_fade, config.min_opacity, config.min_contribution];
    data.filters = [0.3, config.max_radius * width.max(height), config.stop_below, config.time];
    data.counts = [
        scene.splats,
        if early_stop { config.batches.min(MAX_BATCHES as u32) } else { 1 },
        corners(config),
        0,
    ];
    data
}

/// The point between the eyes, from which the radial order is measured.
pub fn midpoint(views: &[View]) -> DVec3 {
    views.iter().map(|v| v.eye).sum::<DVec3>() / views.len().max(1) as f64
}

const _: () = assert!(offset_of!(FrameData, counts) == 240);
