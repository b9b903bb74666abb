//! Small deterministic scenes and views that hard cases are made of.

use glam::{DMat3, DQuat, DVec3, Quat, Vec3};
use motes_renderer::{Fov, View};
use motes_scenes::{SH_C0, Splats};

/// One splat, in the terms in which cases are thought of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    /// Mean, metres.
    pub mean: [f32; 3],
    /// Rotation, splat to scene axes.
    pub rotation: Quat,
    /// Standard deviations along its axes, metres.
    pub scales: [f32; 3],
    /// Opacity at the centre, `0 ..= 1`.
    pub opacity: f32,
    /// Colour from every direction, sRGB-encoded.
    pub colour: [f32; 3],
}

impl Default for Gaussian {
    /// A ball of 10 cm, two metres ahead of an eye at the origin that looks along +z.
    fn default() -> Self {
        Self {
            mean: [0.0, 0.0, 2.0],
            rotation: Quat::IDENTITY,
            scales: [0.1; 3],
            opacity: 0.9,
            colour: [0.9, 0.6, 0.1],
        }
    }
}

impl Gaussian {
    /// A splat with three different axes, none along the scene's.
    pub fn tilted() -> Self {
        let rotation = Quat::from_axis_angle(Vec3::new(0.48, -0.6, 0.64), 1.1);
        Self { rotation, scales: [0.16, 0.05, 0.09], ..Self::default() }
    }

    /// The same at another place.
    pub fn at(self, mean: [f32; 3]) -> Self {
        Self { mean, ..self }
    }
}

/// A scene of these splats, in this order, without view-dependent colour.
pub fn scene(gaussians: &[Gaussian]) -> Splats {
    let mut splats = Splats::zeroed(gaussians.len(), 0, false);
    for (i, g) in gaussians.iter().enumerate() {
        splats.means[i] = g.mean;
        splats.rotations[i] = g.rotation.to_array();
        splats.log_scales[i] = g.scales.map(f32::ln);
        splats.opacities[i] = g.opacity;
        splats.sh[i] = g.colour.map(|c| (c - 0.5) / SH_C0);
    }
    splats
}

/// An eye at the origin that looks along +z (y down) with a full vertical angle in degrees.
pub fn ahead(size: [u32; 2], degrees: f64) -> View {
    let fov = Fov::vertical(degrees.to_radians(), size);
    View { rotation: DMat3::IDENTITY, eye: DVec3::ZERO, fov, size }
}

/// Two eyes 64 mm apart at the origin that look along +z with a headset's mirrored asymmetric fields of view, more
/// than 100° wide each.
pub fn eyes(size: [u32; 2]) -> [View; 2] {
    let view = |x: f64, fov| View { rotation: DMat3::IDENTITY, eye: DVec3::new(x, 0.0, 0.0), fov, size };
    let left = Fov { left: -1.5, right: 1.0, up: -1.0, down: 1.2 };
    let right = Fov { left: -1.0, right: 1.5, up: -1.0, down: 1.2 };
    [view(-0.032, left), view(0.032, right)]
}

/// Moves a scene and views together: a similarity that must not change a picture. Planar low-pass filters are in
/// pixels, so they scale along.
pub fn moved(splats: &Splats, views: &[View], turn: DQuat, scale: f64, shift: DVec3) -> (Splats, Vec<View>) {
    let mut splats = splats.clone();
    let turn32 = turn.as_quat();
    for i in 0..splats.len() {
        let mean = DVec3::from_array(splats.means[i].map(f64::from));
        splats.means[i] = (turn * mean * scale).as_vec3().to_array();
        splats.rotations[i] = (turn32 * Quat::from_array(splats.rotations[i])).normalize().to_array();
        splats.log_scales[i] = splats.log_scales[i].map(|s| s + scale.ln() as f32);
    }
    let origin = DVec3::from_array(splats.origin);
    splats.origin = (turn * origin * scale + shift).to_array();
    let views = views
        .iter()
        .map(|v| View {
            rotation: v.rotation * DMat3::from_quat(turn.inverse()),
            eye: turn * v.eye * scale + shift,
            ..*v
        })
        .collect();
    (splats, views)
}
