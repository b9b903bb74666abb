//! Hard colours and opacities.

use glam::{DQuat, DVec3};
use motes_renderer::{
    Composite, Expansion, Packing, Precision, Projection, RenderConfig, ShPrecision, TargetFormat,
};
use motes_scenes::synthetic::Recipe;
use motes_scenes::{SH_C0, sh_coefficients};

use super::cases::{Case, Found, STEPS, rows};
use super::rig::{FloatPicture, PLAIN, Rig, apart, deviation, every_layer, truth};
use super::scene::{Gaussian, ahead, eyes, moved, scene};

pub(super) fn cases() -> Vec<Case> {
    let case = rows("colour");
    vec![
        case(
            "negative_harmonics_are_black",
            "negative SH colour → NaN in pow",
            "all channels at least 0 before anything else; the reference's picture",
            1.5,
            STEPS,
            negative,
        ),
        case(
            "colours_beyond_half_floats",
            "halves overflow at 65504",
            "colours up to 10³⁰ saturate; nothing is NaN, even behind opaque layers",
            1.5,
            STEPS,
            beyond_half,
        ),
        case(
            "opacity_zero_one_and_between",
            "opacity 0, 1, 1 − 2⁻²⁴; power > 0 by rounding",
            "the reference's picture; α ≤ 0.99",
            1.0,
            STEPS,
            opacities,
        ),
        case(
            "thousands_of_layers",
            "thousands of layers in one pixel",
            "as drawn by default (rgba16f, early stop), 1 to 10 000 layers, against f64",
            12.0,
            STEPS,
            layers,
        ),
        case(
            "a_similarity_changes_nothing",
            "the whole image under translation, rotation, uniform scale of scene and camera together",
            "the same picture, f32 and f16",
            2.5,
            STEPS,
            similarity,
        ),
    ]
}

fn negative(rig: &mut Rig) -> Found {
    let mut splats = scene(&[
        Gaussian::tilted().at([-0.3, 0.1, 2.0]),
        Gaussian::tilted().at([0.3, 0.1, 2.0]),
        Gaussian::tilted().at([0.0, -0.2, 2.0]),
    ]);
    splats.set_sh_degree(3);
    let n = sh_coefficients(3);
    for (k, c) in splats.sh.iter_mut().enumerate() {
        // One splat all negative, one in single channels, one by its higher bands only.
        *c = match (k / n, k % n) {
            (0, 0) => [-3.0, -300.0, -4.0],
            (1, 0) => [-5.0, 1.0, -5.0],
            (2, 0) => [0.5, 0.5, 0.5],
            (_, b) => [0.4, -2.0, 0.8].map(|v| if b % 2 == 0 { v } else { -v }),
        };
    }
    let (found, place) = rig.measure_all(&splats, &eyes([40, 32]), |_| {});
    // Control: what a clamp of one channel at 0.1 would show.
    let mut raised = splats.clone();
    raised.sh[0][0] = -1.4;
    let config = every_layer(Projection::Tangent);
    let views = eyes([40, 32]);
    let control = apart(&truth(&raised, &views, &config), &truth(&splats, &views, &config)).worst;
    Found::new(found.worst, place, control)
}

/// Bright as no trainer makes it, behind opaque layers, and beside dark ones.
#[allow(clippy::panic, reason = "only tests call it")]
fn beyond_half(rig: &mut Rig) -> Found {
    let plain = |z: f32| Gaussian { opacity: 1.0, scales: [0.2; 3], ..Gaussian::tilted() }.at([0.3, 0.0, z]);
    let mut splats = scene(&[
        Gaussian::tilted().at([-0.3, 0.1, 2.0]),
        plain(2.0),
        plain(2.1),
        plain(2.2),
        plain(2.3),
        plain(2.4),
        plain(2.5),
    ]);
    splats.sh[0] = [1e30, 1e6, -1e30];
    // What is left of the light behind the layers times such a colour is no number that can be compared.
    let mut behind = splats.clone();
    behind.sh[6] = [1e30, 3e5, -1e30];
    let views = eyes([40, 32]);
    // What is drawn is bounded by what half floats can blend; whatever lies behind that is white anyway.
    let mut bounded = splats.clone();
    for c in bounded.sh.iter_mut().flatten() {
        *c = c.clamp(-6e4 / SH_C0, 6e4 / SH_C0);
    }
    let on_device = rig.upload(&splats, PLAIN);
    let behind = rig.upload(&behind, PLAIN);
    let mut worst = (0.0, String::new());
    for expansion in [Expansion::Precomputed, Expansion::Instanced] {
        for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
            let config = RenderConfig { expansion, ..every_layer(projection) };
            let (pictures, _) = rig.draw(&on_device, &views, &config).unwrap_or_else(|e| panic!("{e}"));
            let found = deviation(&pictures, &truth(&bounded, &views, &config)).worst;
            let (brightest, _) = rig.draw(&behind, &views, &config).unwrap_or_else(|e| panic!("{e}"));
            let sound = pictures.iter().chain(&brightest).all(FloatPicture::is_sound);
            let found = if sound { found } else { f64::INFINITY };
            if found >= worst.0 {
                worst = (found, format!("{projection}, {expansion}"));
            }
        }
    }
    let mut without = splats.clone();
    without.sh[0] = [0.0; 3];
    let config = every_layer(Projection::Tangent);
    let control = apart(&truth(&without, &views, &config), &truth(&splats, &views, &config)).worst;
    Found::new(worst.0, worst.1, control)
}

fn opacities(rig: &mut Rig) -> Found {
    let values = [
        0.0,
        f32::MIN_POSITIVE,
        1e-40,
        (1.0f32 / 255.0).next_down(),
        1.0 / 255.0,
        (1.0f32 / 255.0).next_up(),
        0.0059,
        0.99,
        0.990_001,
        1.0 - 1.0 / 16_777_216.0,
        1.0,
    ];
    let gaussians: Vec<Gaussian> = values
        .iter()
        .enumerate()
        .map(|(i, &opacity)| {
            let mean = [-1.0 + 0.5 * (i % 5) as f32, -0.6 + 0.6 * (i / 5) as f32, 2.0];
            Gaussian { opacity, scales: [0.07; 3], ..Default::default() }.at(mean)
        })
        .collect();
    let splats = scene(&gaussians);
    let (found, place) = rig.measure_all(&splats, &eyes([48, 36]), |_| {});
    let mut opaque = splats.clone();
    opaque.opacities[10] = 0.97;
    let config = every_layer(Projection::Tangent);
    let views = eyes([48, 36]);
    let control = apart(&truth(&opaque, &views, &config), &truth(&splats, &views, &config)).worst;
    Found::new(found.worst, place, control)
}

/// Layers of one opacity in one pixel.
pub fn stack(count: usize, opacity: f32) -> Vec<Gaussian> {
    (0..count)
        .map(|i| {
            let t = (i as f32 * 0.618_034).fract();
            Gaussian {
                mean: [0.0, 0.0, 2.0 + i as f32 / count as f32],
                scales: [3.0; 3],
                opacity,
                colour: [t, 1.0 - t, 0.5 + 0.4 * (9.0 * t).sin()],
                ..Default::default()
            }
        })
        .collect()
}

/// Distance from f64 of a stack of layers blended into a target.
#[allow(clippy::panic, reason = "only tests call it")]
pub fn layer_error(
    rig: &mut Rig,
    count: usize,
    opacity: f32,
    target: TargetFormat,
    config: &RenderConfig,
) -> f64 {
    let splats = scene(&stack(count, opacity));
    let views = [ahead([4, 4], 20.0)];
    let on_device = rig.upload(&splats, PLAIN);
    let config = RenderConfig { target, ..config.clone() };
    let (pictures, _) = rig.draw(&on_device, &views, &config).unwrap_or_else(|e| panic!("{e}"));
    deviation(&pictures, &truth(&splats, &views, &config)).worst
}

fn layers(rig: &mut Rig) -> Found {
    let config = RenderConfig { composite: Composite::EarlyStop, ..every_layer(Projection::Tangent) };
    let mut worst = (0.0, String::new());
    for (count, opacity) in [(1, 0.5), (10, 0.3), (100, 0.05), (1000, 0.008), (1000, 0.2), (10_000, 0.0045)] {
        let found = layer_error(rig, count, opacity, TargetFormat::Rgba16F, &config);
        if found >= worst.0 {
            worst = (found, format!("{count} layers of {opacity}"));
        }
    }
    // Control: 8 bits lose most of what thin layers add.
    let control = layer_error(rig, 1000, 0.008, TargetFormat::Rgba8, &config);
    Found::new(worst.0, worst.1, control)
}

#[allow(clippy::panic, reason = "only tests call it")]
fn similarity(rig: &mut Rig) -> Found {
    let splats = Recipe { count: 120, sh_degree: 0, seed: 5, ..Default::default() }.still();
    let mut views = eyes([40, 32]).to_vec();
    for v in &mut views {
        v.eye.z -= 2.5;
    }
    let turn = DQuat::from_xyzw(0.3, -0.5, 0.1, 0.8).normalize();
    let moves = [
        (DQuat::IDENTITY, 1.0, DVec3::new(3e6, -2e6, 1.5e5)),
        (turn, 1.0, DVec3::ZERO),
        (DQuat::IDENTITY, 1e-3, DVec3::ZERO),
        (turn, 750.0, DVec3::new(1e4, 5.0, -1e5)),
    ];
    let mut worst = (0.0, String::new());
    let mut control = f64::INFINITY;
    for precision in [Precision::F32, Precision::F16] {
        let packing = Packing { precision, sh_precision: ShPrecision::F32, sh_degree: 3 };
        for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
            let config = every_layer(projection);
            let on_device = rig.upload(&splats, packing);
            let (still, _) = rig.draw(&on_device, &views, &config).unwrap_or_else(|e| panic!("{e}"));
            for (turn, scale, shift) in moves {
                let (other, other_views) = moved(&splats, &views, turn, scale, shift);
                let on_device = rig.upload(&other, packing);
                let near = RenderConfig { near: config.near * scale as f32, ..config.clone() };
                let (pictures, _) =
                    rig.draw(&on_device, &other_views, &near).unwrap_or_else(|e| panic!("{e}"));
                let found = between(&still, &pictures);
                if found >= worst.0 {
                    worst = (found, format!("{precision}, {projection}, turn {turn:.2}, scale {scale}"));
                }
                // Control: the scene moves alone.
                if scale == 1.0 && turn != DQuat::IDENTITY {
                    let (pictures, _) = rig.draw(&on_device, &views, &near).unwrap_or_else(|e| panic!("{e}"));
                    control = control.min(between(&still, &pictures));
                }
            }
        }
    }
    Found::new(worst.0, worst.1, control)
}

/// Worst difference of two sets of pictures, 8-bit steps.
pub fn between(a: &[super::rig::FloatPicture], b: &[super::rig::FloatPicture]) -> f64 {
    let pixels = |p: &[super::rig::FloatPicture]| p.iter().flat_map(|p| p.pixels.clone()).collect::<Vec<_>>();
    pixels(a)
        .iter()
        .flatten()
        .zip(pixels(b).iter().flatten())
        .map(|(a, b)| {
            let d = 255.0 * f64::from((a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).abs());
            if d.is_finite() { d } else { f64::INFINITY }
        })
        .fold(0.0, f64::max)
}
