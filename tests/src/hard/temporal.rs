//! What changes from one picture to the next: shimmer of thin and distant splats, and orders that are some frames old.

use glam::{DMat3, DVec3, Quat, Vec3};
use motes_renderer::{LowPass, OrderKey, Projection, RenderConfig, Stereo, View};
use motes_scenes::Splats;
use motes_scenes::synthetic::Recipe;

use super::rig::{Deviation, FloatPicture, PLAIN, Rig, deviation, every_layer, truth};
use super::scene::{Gaussian, ahead, scene};

/// Frames a second of a headset.
pub const RATE: f64 = 72.0;

/// Thin and distant splats: wires across the view, and a field of specks of a tenth of a pixel.
pub fn thin_and_distant() -> Splats {
    let mut gaussians: Vec<Gaussian> = (0..6)
        .map(|i| Gaussian {
            mean: [0.0, 0.3 * i as f32 - 0.75, 3.0],
            rotation: Quat::from_rotation_z(0.15 * i as f32),
            scales: [0.6, 1e-4, 1e-4],
            colour: [0.95, 0.9, 0.9],
            ..Default::default()
        })
        .collect();
    gaussians.extend((0..80).map(|i| {
        let t = (i as f32 * 0.618_034).fract();
        Gaussian {
            mean: [40.0 * t - 20.0, (i as f32 * 0.37).sin() * 16.0, 60.0],
            scales: [0.05; 3],
            colour: [0.9, 0.95, 0.8],
            ..Default::default()
        }
    }));
    scene(&gaussians)
}

/// What a slow path showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shimmer {
    /// Energy's largest deviation from its mean over the path, relative.
    pub energy: f64,
    /// Largest change of a pixel from frame to frame that the f64 reference does not have, 8-bit steps.
    pub pixel: f64,
    /// Largest change of a pixel from frame to frame, 8-bit steps.
    pub change: f64,
}

/// A path of an eighth of a pixel a frame, at the distance of the wires.
///
/// # Panics
/// Where the device refuses.
#[allow(clippy::panic, reason = "only tests call it")]
pub fn shimmer(rig: &mut Rig, projection: Projection, low_pass: LowPass, frames: usize) -> Shimmer {
    let splats = thin_and_distant();
    let on_device = rig.upload(&splats, PLAIN);
    let config = RenderConfig { low_pass, ..every_layer(projection) };
    let view = ahead([64, 48], 50.0);
    let step = 3.0 / view.focal()[0] / 8.0;
    let mut energies = Vec::new();
    let (mut pixel, mut change) = (0.0f64, 0.0f64);
    let mut before: Option<(FloatPicture, Vec<[f64; 3]>)> = None;
    for frame in 0..frames {
        let t = step * frame as f64;
        let views = [View { eye: DVec3::new(t, 0.7 * t, 0.0), ..view }];
        let (mut pictures, _) = rig.draw(&on_device, &views, &config).unwrap_or_else(|e| panic!("{e}"));
        let picture = pictures.remove(0);
        let wanted: Vec<[f64; 3]> =
            truth(&splats, &views, &config)[0].pixels.iter().map(|p| p.colour).collect();
        energies.push(picture.energy());
        if let Some((old, old_wanted)) = &before {
            for i in 0..picture.pixels.len() {
                for c in 0..3 {
                    let got = f64::from(picture.pixels[i][c] - old.pixels[i][c]);
                    change = change.max(255.0 * got.abs());
                    pixel = pixel.max(255.0 * (got - (wanted[i][c] - old_wanted[i][c])).abs());
                }
            }
        }
        before = Some((picture, wanted));
    }
    let mean = energies.iter().sum::<f64>() / energies.len() as f64;
    let energy = energies.iter().map(|e| (e / mean - 1.0).abs()).fold(0.0, f64::max);
    Shimmer { energy, pixel, change }
}

/// How a viewer moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Movement {
    /// Sideways at 1.4 m/s.
    Walk,
    /// The head turns by 180° a second.
    Turn,
    /// Both.
    Both,
}

impl Movement {
    /// Every movement.
    pub const ALL: [Self; 3] = [Self::Walk, Self::Turn, Self::Both];

    /// The view `frames` ago of one that is at the origin of time.
    pub fn view(self, frames: u32) -> View {
        let t = -f64::from(frames) / RATE;
        let walk = if self == Self::Turn { 0.0 } else { 1.4 * t };
        let turn = if self == Self::Walk { 0.0 } else { std::f64::consts::PI * t };
        let view = ahead([48, 40], 80.0);
        View { eye: DVec3::new(walk, 0.0, -1.0), rotation: DMat3::from_rotation_y(turn), ..view }
    }
}

/// A dense scene around and before the viewer, whose order matters.
pub fn crowd() -> Splats {
    let mut splats =
        Recipe { count: 500, seed: 9, bounds: 1.5, log_scales: [-3.5, -1.5], ..Default::default() }.still();
    // A lattice of overlapping panes, one behind the other.
    let panes: Vec<Gaussian> = (0..40)
        .map(|i| {
            let a = i as f32;
            Gaussian {
                mean: [(a * 0.61).sin() * 0.5, (a * 1.3).cos() * 0.4, -0.2 + 0.03 * a],
                rotation: Quat::from_axis_angle(Vec3::Y, (a * 0.9).sin()),
                scales: [0.3, 0.25, 0.002],
                opacity: 0.8,
                colour: [(a * 0.37).fract(), (a * 0.71).fract(), (a * 0.13).fract()],
            }
        })
        .collect();
    let panes = scene(&panes);
    splats.means.extend(panes.means);
    splats.rotations.extend(panes.rotations);
    splats.log_scales.extend(panes.log_scales);
    splats.opacities.extend(panes.opacities);
    splats.sh.extend(panes.sh);
    splats
}

/// The picture in an order that is some frames old, against the picture in its own.
///
/// # Panics
/// Where the device refuses.
#[allow(clippy::panic, reason = "only tests call it")]
pub fn stale(rig: &mut Rig, movement: Movement, key: OrderKey, ages: &[u32]) -> Vec<Deviation> {
    let splats = crowd();
    let on_device = rig.upload(&splats, PLAIN);
    let config = RenderConfig { order: key, near: 0.05, near_fade: 0.05, ..every_layer(Projection::Tangent) };
    let now = [movement.view(0)];
    let wanted = truth(&splats, &now, &config);
    ages.iter()
        .map(|&age| {
            let order = rig.order(&on_device, &[movement.view(age)], &config);
            let drawn = rig.draw_in_order(&on_device, &order, &now, &config, Stereo::Multiview);
            let (pictures, _) = drawn.unwrap_or_else(|e| panic!("{e}"));
            deviation(&pictures, &wanted)
        })
        .collect()
}
