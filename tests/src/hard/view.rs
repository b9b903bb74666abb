//! Hard views: around and behind the eye, at the frustum's edges, too small and too large to project.

use glam::{Quat, Vec3};
use motes_renderer::{Expansion, LowPass, Projection, RenderConfig, Stereo};

use super::cases::{Case, Found, STEPS, rows};
use super::rig::{PLAIN, Rig, deviation, every_layer, truth};
use super::scene::{Gaussian, ahead, eyes, scene};

pub(super) fn cases() -> Vec<Case> {
    let case = rows("view");
    vec![
        case(
            "around_and_behind_the_eye",
            "z → 0, splat around or behind the eye, eye inside a splat",
            "the reference's picture, mono and stereo; nothing wraps",
            1.5,
            STEPS,
            around,
        ),
        case(
            "near_plane_fades",
            "near plane in metres with a fade",
            "the reference's picture across the fade",
            1.0,
            STEPS,
            near_plane,
        ),
        case(
            "frustum_edges_of_a_headset",
            "frustum edge, 110° and asymmetric per-eye frusta",
            "the reference's picture, per-side clamp included",
            1.5,
            STEPS,
            edges,
        ),
        case(
            "extent_is_culled_not_the_centre",
            "cull by centre only; over-cull in one eye",
            "splats whose centre no eye, or one eye, sees are drawn as the reference does",
            1.5,
            STEPS,
            extent,
        ),
        case(
            "each_eye_has_its_own_covariance",
            "one covariance for both eyes",
            "each eye's picture is its own reference's, and not the other's",
            1.5,
            STEPS,
            per_eye,
        ),
        case(
            "tiny_round_splats_stay",
            "round splats under 0.0162 px² vanish; 0/0 axis; λ2 slightly negative",
            "the reference's picture without a filter",
            1.5,
            STEPS,
            tiny,
        ),
        case(
            "needles",
            "needles (10⁶ : 1) and sub-pixel splats",
            "the reference's picture at every angle",
            1.5,
            STEPS,
            needles,
        ),
        case(
            "a_rotated_splat_fills_its_quad",
            "a mirrored axis makes a rotated splat a hollow diagonal",
            "the reference's picture; the mirrored one does not pass",
            1.5,
            STEPS,
            rotated,
        ),
    ]
}

#[allow(clippy::panic, reason = "only tests call it")]
fn against(rig: &mut Rig, drawn: &[Gaussian], wanted: &[Gaussian], config: &RenderConfig) -> f64 {
    let views = [ahead([48, 36], 60.0)];
    let on_device = rig.upload(&scene(drawn), PLAIN);
    let (pictures, _) = rig.draw(&on_device, &views, config).unwrap_or_else(|e| panic!("{e}"));
    deviation(&pictures, &truth(&scene(wanted), &views, config)).worst
}

/// From a tenth of a millimetre before the eye to two metres behind it, small and large, each in a picture of its own
/// so that none hides another.
fn around(rig: &mut Rig) -> Found {
    let views = eyes([32, 24]);
    let mut worst = (0.0, String::new());
    let mut control = 0.0f64;
    for z in [1e-4f32, 0.02, 0.3, 0.0, -1e-4, -0.05, -0.4, -2.0] {
        for size in [0.01f32, 0.4, 30.0] {
            let g = Gaussian { scales: [size, 0.4 * size, 0.7 * size], opacity: 0.8, ..Gaussian::tilted() };
            let splats = scene(&[g.at([0.03, 0.013, z])]);
            let (found, place) = rig.measure_all(&splats, &views, |_| {});
            if found.worst >= worst.0 {
                worst = (found.worst, format!("z {z} m, σ {size} m, {place}"));
            }
            if z < 0.0 {
                // Control: the same splat on the other side is another picture.
                let ahead = scene(&[g.at([0.03, 0.013, -z])]);
                let config = every_layer(Projection::Exact);
                let a = truth(&ahead, &views, &config);
                control = control.max(super::rig::apart(&a, &truth(&splats, &views, &config)).worst);
            }
        }
    }
    Found::new(worst.0, worst.1, control)
}

fn near_plane(rig: &mut Rig) -> Found {
    let gaussians: Vec<Gaussian> = (0..9)
        .map(|i| {
            let z = 0.04 + 0.01 * i as f32;
            Gaussian { scales: [0.004; 3], ..Default::default() }.at([0.05 * (i as f32 / 4.0 - 1.0), 0.0, z])
        })
        .collect();
    let fade = |c: &mut RenderConfig| (c.near, c.near_fade) = (0.05, 0.05);
    let (found, place) = rig.measure_all(&scene(&gaussians), &[ahead([64, 24], 40.0)], fade);
    let mut faded = every_layer(Projection::Tangent);
    let unfaded = faded.clone();
    fade(&mut faded);
    let views = [ahead([64, 24], 40.0)];
    let a = truth(&scene(&gaussians), &views, &faded);
    let control = super::rig::apart(&a, &truth(&scene(&gaussians), &views, &unfaded)).worst;
    Found::new(found.worst, place, control)
}

/// Splats all along the edges of two asymmetric frusta, inside and outside of them.
fn edge_splats(depth: f32, size: f32) -> Vec<Gaussian> {
    let mut gaussians = Vec::new();
    for i in 0..16 {
        let a = i as f32 / 16.0 * std::f32::consts::TAU;
        for reach in [0.95f32, 1.1, 1.5] {
            let slope = [1.5 * reach * a.cos(), 1.15 * reach * a.sin()];
            gaussians.push(Gaussian {
                mean: [slope[0] * depth, slope[1] * depth, depth],
                rotation: Quat::from_axis_angle(Vec3::new(0.36, 0.48, 0.8), a),
                scales: [size, 0.3 * size, 0.6 * size],
                opacity: 0.6,
                colour: [0.2 + 0.7 * reach.fract(), 0.9 - 0.05 * i as f32, 0.1 + 0.05 * i as f32],
            });
        }
    }
    gaussians
}

fn edges(rig: &mut Rig) -> Found {
    let splats = scene(&edge_splats(1.5, 0.25));
    let views = eyes([48, 40]);
    let (found, place) = rig.measure_all(&splats, &views, |_| {});
    // Control: a frustum that is clamped symmetrically is another picture.
    let mut symmetric = views;
    for v in &mut symmetric {
        v.fov.left = -1.5;
        v.fov.right = 1.5;
    }
    let config = every_layer(Projection::Affine);
    let control =
        super::rig::apart(&truth(&splats, &symmetric, &config), &truth(&splats, &views, &config)).worst;
    Found::new(found.worst, place, control)
}

#[allow(clippy::panic, reason = "only tests call it")]
fn extent(rig: &mut Rig) -> Found {
    // Only those whose centre lies outside; large, so that they reach in. Some are seen by one eye alone.
    let outside: Vec<Gaussian> = edge_splats(0.3, 0.12)
        .into_iter()
        .filter(|g| {
            let [x, y] = [g.mean[0] / g.mean[2], g.mean[1] / g.mean[2]];
            !((-1.5..1.0).contains(&x) && (-1.0..1.2).contains(&y))
        })
        .collect();
    let splats = scene(&outside);
    let views = eyes([48, 40]);
    let (found, place) = rig.measure_all(&splats, &views, |_| {});
    let config = every_layer(Projection::Tangent);
    let nothing = truth(&scene(&[]), &views, &config);
    let control = super::rig::apart(&nothing, &truth(&splats, &views, &config)).worst;
    Found::new(found.worst, format!("{place}; {} splats", outside.len()), control)
}

#[allow(clippy::panic, reason = "only tests call it")]
fn per_eye(rig: &mut Rig) -> Found {
    let g = Gaussian { scales: [0.05, 0.004, 0.02], ..Gaussian::tilted() };
    let splats = scene(&[g.at([0.0, 0.0, 0.15]), g.at([0.05, 0.05, 0.2]), g.at([-0.06, -0.03, 0.12])]);
    let views = eyes([48, 40]);
    let on_device = rig.upload(&splats, PLAIN);
    let mut worst = (0.0, String::new());
    let mut control = f64::INFINITY;
    for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
        for stereo in [Stereo::Multiview, Stereo::TwoPass] {
            for expansion in [Expansion::Precomputed, Expansion::Instanced] {
                let config = RenderConfig { expansion, ..every_layer(projection) };
                let order = rig.order(&on_device, &views, &config);
                let (pictures, _) = rig
                    .draw_in_order(&on_device, &order, &views, &config, stereo)
                    .unwrap_or_else(|e| panic!("{e}"));
                let mut wanted = truth(&splats, &views, &config);
                let found = deviation(&pictures, &wanted).worst;
                if found >= worst.0 {
                    worst = (found, format!("{projection}, {stereo:?}, {expansion}"));
                }
                wanted.swap(0, 1);
                control = control.min(deviation(&pictures, &wanted).worst);
            }
        }
    }
    Found::new(worst.0, worst.1, control)
}

/// Round, nearly round and thin splats of 0.02 to 0.5 px, on and beside pixels' centres.
fn tiny(rig: &mut Rig) -> Found {
    let view = ahead([64, 48], 60.0);
    let [focal, _] = view.focal();
    let mut gaussians = Vec::new();
    for (row, stretch) in [1.0f32, 1.000_001, 1.3, 8.0].into_iter().enumerate() {
        for (column, pixels) in [0.02f32, 0.05, 0.08, 0.12, 0.2, 0.5].into_iter().enumerate() {
            let sigma = pixels * 2.0 / focal as f32;
            let place = |at: usize, of: f32| ((at * 8 + 8) as f32 + 0.5 - of / 2.0) * 2.0 / focal as f32;
            gaussians.push(Gaussian {
                mean: [place(column, 64.0), place(row, 48.0) + 0.3 * sigma, 2.0],
                scales: [sigma * stretch, sigma, sigma],
                ..Gaussian::tilted()
            });
        }
    }
    let splats = scene(&gaussians);
    let (found, place) = rig.measure_all(&splats, &[view], |c| c.low_pass = LowPass::Off);
    // Control: what the trainers' formula would do, which loses round splats below 0.0162 px².
    let large: Vec<Gaussian> =
        gaussians.iter().copied().filter(|g| g.scales[0] > 0.13 * 2.0 / focal as f32).collect();
    let config = RenderConfig { low_pass: LowPass::Off, ..every_layer(Projection::Affine) };
    let lost = super::rig::apart(&truth(&scene(&large), &[view], &config), &truth(&splats, &[view], &config));
    Found::new(found.worst, place, lost.worst)
}

fn needles(rig: &mut Rig) -> Found {
    let mut worst = (0.0, String::new());
    let views = eyes([40, 32]);
    for ratio in [1e3f32, 1e6, 1e8] {
        let gaussians: Vec<Gaussian> = (0..12)
            .map(|i| {
                let a = i as f32 / 12.0 * std::f32::consts::PI + 1e-4;
                Gaussian {
                    mean: [0.8 * (5.0 * a).sin(), 0.6 * (3.0 * a).cos(), 1.5 + 0.1 * i as f32],
                    rotation: Quat::from_axis_angle(Vec3::Z, a) * Quat::from_axis_angle(Vec3::Y, 0.2 * a),
                    scales: [0.4, 0.4 / ratio, 0.4 / ratio],
                    opacity: 0.8,
                    colour: [0.1 + 0.07 * i as f32, 0.9 - 0.05 * i as f32, 0.5],
                }
            })
            .collect();
        let (found, place) = rig.measure_all(&scene(&gaussians), &views, |_| {});
        if found.worst >= worst.0 {
            worst = (found.worst, format!("{ratio} : 1, {place}"));
        }
    }
    let g = Gaussian { scales: [0.4, 1e-7, 1e-7], ..Default::default() };
    let turned = Gaussian { rotation: Quat::from_rotation_z(0.1), ..g };
    let control = against(rig, &[g], &[turned], &every_layer(Projection::Tangent));
    Found::new(worst.0, worst.1, control)
}

fn rotated(rig: &mut Rig) -> Found {
    let g = |turn: f32| Gaussian {
        rotation: Quat::from_rotation_z(turn),
        scales: [0.3, 0.04, 0.04],
        ..Default::default()
    };
    let mut worst = (0.0, String::new());
    let mut control = f64::INFINITY;
    for turn in [0.3f32, std::f32::consts::FRAC_PI_4, 2.5] {
        let (found, place) = rig.measure_all(&scene(&[g(turn)]), &eyes([40, 32]), |_| {});
        if found.worst >= worst.0 {
            worst = (found.worst, format!("{turn} rad, {place}"));
        }
        control = control.min(against(rig, &[g(turn)], &[g(-turn)], &every_layer(Projection::Tangent)));
    }
    Found::new(worst.0, worst.1, control)
}
