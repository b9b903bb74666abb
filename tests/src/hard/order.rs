//! Hard orders: keys that starve, tie, or are no numbers; counts around the sizes of blocks.

use glam::DVec3;
use motes_renderer::{Expansion, KeyBits, OrderKey, Projection, RenderConfig, View};
use motes_scenes::Splats;

use super::cases::{Case, Found, PIXELS, STEPS, rows};
use super::colour::between;
use super::rig::{FloatPicture, PLAIN, Rig, every_layer};
use super::scene::{Gaussian, ahead, eyes, scene};

pub(super) fn cases() -> Vec<Case> {
    let case = rows("order");
    vec![
        case(
            "a_far_splat_starves_no_key",
            "linear key starved by one far splat",
            "neighbours 1 % apart keep their order beside a splat at 10⁶ m, with 16 bits too",
            0.0,
            "swapped pairs",
            starved,
        ),
        case(
            "equal_keys_keep_the_scenes_order",
            "equal keys flicker",
            "splats at one distance stay in the scene's order from frame to frame, and while the head turns",
            0.0,
            "changes",
            equal_keys,
        ),
        case(
            "no_number_as_depth",
            "NaN depth",
            "sorted last, drawn never: the picture of the others, bit for bit",
            0.0,
            PIXELS,
            nan_depth,
        ),
        case(
            "counts_around_block_sizes",
            "n = 0, 1, 255, 256, 257, block ± 1; two-pass counts that disagree",
            "precomputed = instanced to rounding, with some splats culled; the counts agree",
            1.5,
            STEPS,
            block_sizes,
        ),
    ]
}

fn starved(rig: &mut Rig) -> Found {
    let mut gaussians: Vec<Gaussian> =
        (0..200).map(|i| Gaussian::default().at([0.0, 0.0, 1.01f32.powi((i * 37) % 200)])).collect();
    gaussians.push(Gaussian::default().at([0.0, 0.0, 1e6]));
    let splats = scene(&gaussians);
    let on_device = rig.upload(&splats, PLAIN);
    let swapped = |indices: &[u32]| {
        let z = |i: &u32| gaussians[*i as usize].mean[2];
        indices.windows(2).filter(|w| z(&w[0]) > z(&w[1])).count() as f64
    };
    let mut worst = 0.0f64;
    for key in [OrderKey::Radial, OrderKey::Depth] {
        for bits in [KeyBits::B32, KeyBits::B16] {
            let config = RenderConfig { order: key, key_bits: bits, ..every_layer(Projection::Tangent) };
            let order = rig.order(&on_device, &[ahead([4, 4], 60.0)], &config);
            worst = worst.max(swapped(&order.indices));
        }
    }
    // Control: a linear 16-bit key over the same range.
    let mut linear: Vec<u32> = (0..gaussians.len() as u32).collect();
    linear.sort_by_key(|i| (gaussians[*i as usize].mean[2] / 1e6 * 65535.0) as u16);
    Found::new(worst, "radial and depth, 32 and 16 bits", swapped(&linear))
}

fn equal_keys(rig: &mut Rig) -> Found {
    // Corners of a cube around the eye: all at one distance exactly, again and again.
    let gaussians: Vec<Gaussian> = (0..600)
        .map(|i| {
            let side = |bit: i32| if i >> bit & 1 == 0 { 1.0f32 } else { -1.0 };
            Gaussian {
                colour: [(i % 7) as f32 / 7.0, 0.5, (i % 3) as f32 / 3.0],
                opacity: 0.3,
                ..Default::default()
            }
            .at([side(0), side(1), side(2)])
        })
        .collect();
    let on_device = rig.upload(&scene(&gaussians), PLAIN);
    let mut changes = 0.0;
    let expected: Vec<u32> = (0..600).collect();
    let config = every_layer(Projection::Tangent);
    for turn in 0..8 {
        let rotation = glam::DMat3::from_rotation_y(0.7 * f64::from(turn));
        let view = View { rotation, ..ahead([8, 8], 90.0) };
        let order = rig.order(&on_device, &[view], &config);
        changes += order.indices.iter().zip(&expected).filter(|(a, b)| a != b).count() as f64;
    }
    let moved = View { eye: DVec3::new(0.1, 0.0, 0.0), ..ahead([8, 8], 90.0) };
    let order = rig.order(&on_device, &[moved], &config);
    let control = order.indices.iter().zip(&expected).filter(|(a, b)| a != b).count() as f64;
    Found::new(changes, "8 head turns", control)
}

#[allow(clippy::panic, reason = "only tests call it")]
fn draw(rig: &mut Rig, splats: &Splats, views: &[View], config: &RenderConfig) -> (Vec<FloatPicture>, u32) {
    let on_device = rig.upload(splats, PLAIN);
    let (pictures, report) = rig.draw(&on_device, views, config).unwrap_or_else(|e| panic!("{e}"));
    (pictures, report.visible)
}

fn differing(a: &[FloatPicture], b: &[FloatPicture]) -> f64 {
    let pairs = a.iter().zip(b).flat_map(|(a, b)| a.pixels.iter().zip(&b.pixels));
    pairs.filter(|(a, b)| a != b).count() as f64
}

/// Not sanitised, as a reader with a mistake would hand them over.
fn nan_depth(rig: &mut Rig) -> Found {
    let clean: Vec<Gaussian> =
        (0..20).map(|i| Gaussian::tilted().at([0.0, 0.0, 2.0 + 0.1 * i as f32])).collect();
    let mut dirty = Vec::new();
    for (i, g) in clean.iter().enumerate() {
        dirty.push(*g);
        dirty.push(g.at([
            [f32::NAN, 0.0, 2.0],
            [0.0, f32::NAN, 2.0],
            [f32::NAN; 3],
            [0.0, 0.0, f32::INFINITY],
        ][i % 4]));
    }
    let views = eyes([24, 20]);
    let mut worst = 0.0;
    for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
        for expansion in [Expansion::Precomputed, Expansion::Instanced] {
            let config = RenderConfig { expansion, ..every_layer(projection) };
            let (wanted, _) = draw(rig, &scene(&clean), &views, &config);
            let (got, _) = draw(rig, &scene(&dirty), &views, &config);
            worst += differing(&wanted, &got);
        }
    }
    let config = every_layer(Projection::Tangent);
    let (wanted, _) = draw(rig, &scene(&clean), &views, &config);
    let (fewer, _) = draw(rig, &scene(&clean[1..]), &views, &config);
    Found::new(worst, "40 splats, half of them poisoned", differing(&wanted, &fewer))
}

fn block_sizes(rig: &mut Rig) -> Found {
    let views = eyes([24, 20]);
    let mut worst = (0.0, String::new());
    let mut control = f64::INFINITY;
    let mut config = every_layer(Projection::Tangent);
    for n in [0usize, 1, 2, 127, 128, 129, 255, 256, 257, 383, 385, 16_384, 16_385] {
        let gaussians: Vec<Gaussian> = (0..n)
            .map(|i| {
                let t = (i as f32 * 0.618_034).fract();
                // Every third lies behind the eyes.
                let z = if i % 3 == 1 { -2.0 } else { 2.0 + t };
                Gaussian { scales: [0.03; 3], opacity: 0.4, colour: [t, 1.0 - t, 0.5], ..Default::default() }
                    .at([2.0 * t - 1.0, (31.0 * t).sin(), z])
            })
            .collect();
        let splats = scene(&gaussians);
        config.expansion = Expansion::Precomputed;
        let (precomputed, visible) = draw(rig, &splats, &views, &config);
        config.expansion = Expansion::Instanced;
        let (instanced, _) = draw(rig, &splats, &views, &config);
        let seen = gaussians.iter().filter(|g| g.mean[2] > 0.0).count();
        let found = between(&precomputed, &instanced) + 100.0 * seen.abs_diff(visible as usize) as f64;
        if found >= worst.0 {
            worst = (found, format!("{n} splats, {visible} drawn"));
        }
        if (100..1000).contains(&n) {
            let (fewer, _) = draw(rig, &scene(&gaussians[..n - 100]), &views, &config);
            control = control.min(between(&precomputed, &fewer));
        }
    }
    Found::new(worst.0, worst.1, control)
}
