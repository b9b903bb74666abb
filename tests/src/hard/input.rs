//! Hard input: what files hold that no picture can be made of, or only with care.

use glam::{DVec3, Quat, Vec3};
use motes_renderer::{Axis, LowPass, Projection, RenderConfig, View};
use motes_scenes::{DropReason, LoadOptions, Splats, sanitise};

use super::cases::{Case, Found, PIXELS, STEPS, rows};
use super::rig::{Deviation, FloatPicture, PLAIN, Rig, deviation, every_layer, truth};
use super::scene::{Gaussian, ahead, eyes, moved, scene};

pub(super) fn cases() -> Vec<Case> {
    let case = rows("input");
    vec![
        case(
            "poison_never_reaches_the_device",
            "NaN or infinity in any field",
            "every poisoned splat is dropped and counted; the picture is that of the others, bit for bit",
            0.0,
            PIXELS,
            poison,
        ),
        case(
            "quaternions_of_any_length",
            "unnormalised or zero quaternion",
            "normalised or dropped; the picture is the reference's of unit quaternions",
            1.0,
            STEPS,
            quaternions,
        ),
        case(
            "conventions_survive_files",
            "quaternion order, logarithmic scale, SH order",
            "an anisotropic, coloured scene written to .ply, .splat and .spz looks the same",
            6.0,
            STEPS,
            conventions,
        ),
        case(
            "scales_whose_exponential_overflows",
            "log-scale or opacity whose exp overflows",
            "log-scales of ±40 and beyond: bounded or dropped; the reference's picture",
            1.5,
            STEPS,
            overflow,
        ),
        case(
            "enormous_splats_are_capped_with_their_covariance",
            "enormous splats",
            "a splat above max-radius is a smaller splat, not a cut one",
            1.5,
            STEPS,
            enormous,
        ),
        case(
            "scale_zero_on_one_two_three_axes",
            "zero scale on one, two, three axes",
            "the reference's picture under every filter",
            1.5,
            STEPS,
            zero_scale,
        ),
        case(
            "far_from_the_origin",
            "far from the origin (10⁶ m)",
            "recentred: the same picture as near the origin",
            0.6,
            STEPS,
            far,
        ),
        case(
            "real_dirty_files",
            "yellow_clip3, coffee10, parking_lot, lucy_100k, the environment of hq_garden",
            "load with counts; finite, and the reference's picture (mean of all pixels)",
            0.6,
            "1/255, mean",
            dirty_files,
        ),
    ]
}

/// A row of distinct splats.
fn row(count: usize) -> Vec<Gaussian> {
    (0..count)
        .map(|i| {
            let t = i as f32 / (count - 1).max(1) as f32;
            Gaussian {
                mean: [1.6 * t - 0.8, 0.5 * (7.0 * t).sin(), 2.0 + t],
                rotation: Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 5.0 * t),
                scales: [0.12, 0.03, 0.06],
                opacity: 0.95 - 0.5 * t,
                colour: [0.9 - 0.8 * t, 0.4, 0.1 + 0.9 * t],
            }
        })
        .collect()
}

#[allow(clippy::panic, reason = "only tests call it")]
fn draw(rig: &mut Rig, splats: &Splats, projection: Projection) -> FloatPicture {
    let scene = rig.upload(splats, PLAIN);
    let views = [ahead([48, 36], 60.0)];
    match rig.draw(&scene, &views, &every_layer(projection)) {
        Ok((mut pictures, _)) => pictures.remove(0),
        Err(e) => panic!("{e}"),
    }
}

fn differing(a: &FloatPicture, b: &FloatPicture) -> f64 {
    a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a != b).count() as f64
}

/// Each field of each splat in turn becomes NaN, ±∞ or huge.
fn poison(rig: &mut Rig) -> Found {
    let mut clean = scene(&row(8));
    // Lengths of quaternions are made 1 to the last bit, poisoned or not.
    sanitise(&mut clean);
    let mut poisoned = clean.clone();
    let mut expected = 0;
    let mut add = |change: &dyn Fn(&mut Splats, usize)| {
        let at = poisoned.len();
        poisoned.means.push(clean.means[0]);
        poisoned.rotations.push(clean.rotations[0]);
        poisoned.log_scales.push(clean.log_scales[0]);
        poisoned.opacities.push(clean.opacities[0]);
        poisoned.sh.push(clean.sh[0]);
        change(&mut poisoned, at);
        expected += 1;
    };
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38] {
        for axis in 0..3 {
            add(&|s, i| s.means[i][axis] = bad);
            add(&|s, i| s.sh[i][axis] = bad);
            if bad != f32::NEG_INFINITY {
                add(&|s, i| s.log_scales[i][axis] = bad);
            }
        }
        if bad.abs() != 1e38 {
            add(&|s, i| s.rotations[i][2] = bad);
        }
    }
    add(&|s, i| s.opacities[i] = f32::NAN);
    add(&|s, i| s.rotations[i] = [0.0; 4]);
    let done = sanitise(&mut poisoned);
    let dropped: usize = done.dropped.values().sum();
    let wanted = draw(rig, &clean, Projection::Tangent);
    let got = draw(rig, &poisoned, Projection::Tangent);
    let missing = expected - dropped.min(expected);
    let control = draw(rig, &scene(&row(8)[..7]), Projection::Tangent);
    let unseen = f64::from(u8::from(!got.is_sound())) + missing as f64;
    Found::new(differing(&wanted, &got) + unseen, format!("{dropped} dropped"), differing(&wanted, &control))
}

fn quaternions(rig: &mut Rig) -> Found {
    let unit = scene(&row(8));
    let stretched = |by: &dyn Fn(usize) -> f32| {
        let mut splats = unit.clone();
        for (i, q) in splats.rotations.iter_mut().enumerate() {
            *q = q.map(|v| v * by(i));
        }
        splats
    };
    let mut any = stretched(&|i| [1e-2, 0.5, 3.0, -1.0, 1e10, 1e18, -0.1, 17.0][i]);
    // And one without any rotation, to be dropped.
    any.means.push([0.0, 0.0, 1.0]);
    any.rotations.push([0.0, 1e-9, 0.0, 0.0]);
    any.log_scales.push([-1.0; 3]);
    any.opacities.push(1.0);
    any.sh.push([1.0; 3]);
    let done = sanitise(&mut any);
    let dropped = done.dropped.get(&DropReason::ZeroRotation).copied().unwrap_or_default();
    let views = [ahead([48, 36], 60.0)];
    let config = every_layer(Projection::Tangent);
    let wanted = truth(&unit, &views, &config);
    let got = deviation(&[draw(rig, &any, Projection::Tangent)], &wanted);
    let raw = stretched(&|i| if i % 2 == 0 { 1.5 } else { 0.6 });
    let control = deviation(&[draw(rig, &raw, Projection::Tangent)], &wanted);
    let worst = if dropped == 1 { got.worst } else { f64::INFINITY };
    Found::new(worst, format!("{dropped} dropped"), control.worst)
}

#[allow(clippy::panic, reason = "only tests call it")]
fn conventions(rig: &mut Rig) -> Found {
    let splats = scene(&row(8));
    let views = [ahead([48, 36], 60.0)];
    let wanted = truth(&splats, &views, &every_layer(Projection::Tangent));
    let folder = std::env::temp_dir().join(format!("motes-conventions-{}", std::process::id()));
    let mut worst = (0.0, "");
    let mut control = f64::INFINITY;
    for name in ["a.ply", "a.splat", "a.spz"] {
        let loaded = std::fs::create_dir_all(&folder)
            .map_err(|e| e.to_string())
            .and_then(|()| motes_scenes::save(&folder.join(name), &splats).map_err(|e| e.to_string()))
            .and_then(|()| {
                motes_scenes::load(&folder.join(name), &LoadOptions::default()).map_err(|e| e.to_string())
            });
        let mut loaded = loaded.unwrap_or_else(|e| panic!("{name}: {e}")).splats;
        let found = deviation(&[draw(rig, &loaded, Projection::Tangent)], &wanted).worst;
        if found >= worst.0 {
            worst = (found, name);
        }
        // Control: components in another order are another rotation.
        for q in &mut loaded.rotations {
            q.rotate_right(1);
        }
        control = control.min(deviation(&[draw(rig, &loaded, Projection::Tangent)], &wanted).worst);
    }
    // What is left behind in a temporary folder is of no matter.
    let _ = std::fs::remove_dir_all(folder);
    Found::new(worst.0, worst.1, control)
}

fn overflow(rig: &mut Rig) -> Found {
    let mut splats = scene(&row(8));
    splats.log_scales = vec![
        [-3.0, -2.0, 40.0],
        [-f32::INFINITY, -2.5, -3.0],
        [-200.0, -200.0, -200.0],
        [40.0, 40.0, 40.0],
        [-2.0, -40.0, -3.0],
        [39.0, -40.0, -3.0],
        [88.8, 0.0, 0.0], // exp overflows in the shader's square: dropped
        [-2.0, -3.0, -2.5],
    ];
    splats.opacities = vec![0.9, 1.0, f32::INFINITY, 0.05, -f32::INFINITY, 0.4, 1.0, 0.999_999_9];
    let dropped = sanitise(&mut splats).dropped.get(&DropReason::Scale).copied().unwrap_or_default();
    let views = eyes([40, 32]);
    let (found, place) = rig.measure_all(&splats, &views, |_| {});
    splats.log_scales[0][2] = -2.0;
    let scene = rig.upload(&splats, PLAIN);
    let control = control(rig, &scene, &truth_of(&splats, &views[..1], |s| s.log_scales[0][2] = 40.0));
    let worst = if dropped == 1 { found.worst } else { f64::INFINITY };
    Found::new(worst, place, control)
}

/// The reference's picture of a changed scene, tangent.
fn truth_of(
    splats: &Splats,
    views: &[View],
    change: impl Fn(&mut Splats),
) -> (Vec<View>, Vec<motes_renderer::reference::ReferenceImage>) {
    let mut splats = splats.clone();
    change(&mut splats);
    (views.to_vec(), truth(&splats, views, &every_layer(Projection::Tangent)))
}

#[allow(clippy::panic, reason = "only tests call it")]
fn control(
    rig: &mut Rig,
    scene: &motes_renderer::SceneOnDevice,
    (views, wanted): &(Vec<View>, Vec<motes_renderer::reference::ReferenceImage>),
) -> f64 {
    match rig.draw(scene, views, &every_layer(Projection::Tangent)) {
        Ok((pictures, _)) => deviation(&pictures, wanted).worst,
        Err(e) => panic!("{e}"),
    }
}

/// A ball that fills the view, capped to a third of it, is the ball that is as large as the cap.
#[allow(clippy::panic, reason = "only tests call it")]
fn enormous(rig: &mut Rig) -> Found {
    let giant = Gaussian { scales: [3.0; 3], opacity: 0.95, ..Default::default() };
    let views = [ahead([48, 48], 60.0)];
    let scene = rig.upload(&super::scene::scene(&[giant]), PLAIN);
    let mut worst = (Deviation::default(), String::new());
    let mut control = f64::INFINITY;
    for &projection in &[Projection::Affine, Projection::Tangent] {
        let plain = every_layer(projection);
        let config = RenderConfig { max_radius: 1.0 / 3.0, ..plain.clone() };
        // The cap is on the radius of k standard deviations, in pixels; the filter is already in it.
        let k = (2.0 * (255.0 * f64::from(giant.opacity)).ln()).sqrt();
        let [focal, _] = views[0].focal();
        let sigma = ((16.0 / k).powi(2) - 0.3).sqrt() * 2.0 / focal;
        let small = Gaussian { scales: [sigma as f32; 3], ..giant };
        let wanted = truth(&super::scene::scene(&[small]), &views, &plain);
        let (capped, report) = rig.draw(&scene, &views, &config).unwrap_or_else(|e| panic!("{e}"));
        let found = deviation(&capped, &wanted);
        if found.worst >= worst.0.worst {
            worst = (found, format!("{projection}, {} fragments", report.fragments));
        }
        let (whole, _) = rig.draw(&scene, &views, &plain).unwrap_or_else(|e| panic!("{e}"));
        control = control.min(deviation(&whole, &wanted).worst);
    }
    Found::new(worst.0.worst, worst.1, control)
}

#[allow(clippy::panic, reason = "only tests call it")]
fn zero_scale(rig: &mut Rig) -> Found {
    let mut splats = scene(&row(9));
    for (i, s) in splats.log_scales.iter_mut().enumerate() {
        for (axis, v) in s.iter_mut().enumerate() {
            // Each single axis, each pair, all three, and two that are left as they are.
            let flat = match i {
                0..=2 => axis == i,
                3..=5 => axis != i - 3,
                6 => true,
                _ => false,
            };
            if flat {
                *v = f32::NEG_INFINITY;
            }
        }
    }
    let raised = sanitise(&mut splats).raised_scales;
    let views = [ahead([48, 36], 60.0)];
    let mut worst = (0.0, String::new());
    let on_device = rig.upload(&splats, PLAIN);
    for &low_pass in LowPass::ALL {
        for &projection in Projection::ALL {
            let config = RenderConfig { low_pass, ..every_layer(projection) };
            let (pictures, _) = rig.draw(&on_device, &views, &config).unwrap_or_else(|e| panic!("{e}"));
            let found = deviation(&pictures, &truth(&splats, &views, &config)).worst;
            if found >= worst.0 {
                worst = (found, format!("{low_pass}, {projection}"));
            }
        }
    }
    if raised != 3 + 6 + 3 {
        worst.0 = f64::INFINITY;
    }
    let scene = rig.upload(&splats, PLAIN);
    let control = control(rig, &scene, &truth_of(&splats, &views, |s| s.log_scales[0][0] = -3.0));
    Found::new(worst.0, worst.1, control)
}

fn far(rig: &mut Rig) -> Found {
    let near = scene(&row(8));
    let views = eyes([40, 32]);
    let shift = DVec3::new(4.1e5, 5.3e6, -123.456);
    let (away, away_views) = moved(&near, &views, glam::DQuat::IDENTITY, 1.0, shift);
    let (found, place) = rig.measure_all(&away, &away_views, |_| {});
    // Control: without an origin of its own the scene falls apart.
    let mut raw = near.clone();
    for m in &mut raw.means {
        *m = (DVec3::from_array(m.map(f64::from)) + shift).as_vec3().to_array();
    }
    let scene = rig.upload(&raw, PLAIN);
    let wanted = truth(&away, &away_views[..1], &every_layer(Projection::Tangent));
    let control = control(rig, &scene, &(away_views[..1].to_vec(), wanted));
    Found::new(found.worst, place, control)
}

/// Files as they are found, from a camera that sees their middle: every projection, against the reference.
#[allow(clippy::panic, reason = "only tests call it")]
fn dirty_files(rig: &mut Rig) -> Found {
    let mut worst = (0.0, String::new());
    let mut control = f64::INFINITY;
    for name in [
        "4d/yellow_clip3.splatv",
        "4d/coffee10.splatv",
        "static/parking_lot.splat",
        "static/lucy_100k.splat",
        "static/hq_garden_lod2/environment.sog",
    ] {
        let file = crate::sample(name);
        let loaded = motes_scenes::load(&file, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let splats = thinned(&loaded.splats, 4000);
        let mut view = ahead([24, 18], 75.0);
        view.eye = DVec3::from_array(splats.origin) + middle(&splats) - 0.6 * DVec3::Z * spread(&splats);
        let views = [view];
        let scene = rig.upload(&splats, PLAIN);
        let mut config = RenderConfig { time: 0.4, near: 0.05, ..every_layer(Projection::Affine) };
        for &projection in Projection::ALL {
            config.projection = projection;
            let (pictures, report) = rig.draw(&scene, &views, &config).unwrap_or_else(|e| panic!("{e}"));
            let wanted = truth(&splats, &views, &config);
            let found = deviation(&pictures, &wanted);
            let found = if pictures[0].is_sound() && report.visible > 0 { found.mean } else { f64::INFINITY };
            println!("  {name}, {projection}: mean {found:.3}, {} of {} drawn", report.visible, splats.len());
            if found >= worst.0 {
                worst = (found, format!("{name}, {projection}"));
            }
            if projection == Projection::Tangent {
                let later = truth(
                    &splats,
                    &[View { eye: views[0].eye + 0.02 * spread(&splats), ..views[0] }],
                    &config,
                );
                control = control.min(deviation(&pictures, &later).mean);
            }
        }
    }
    Found::new(worst.0, worst.1, control)
}

/// Every n-th splat, so that the reference stays affordable; defects are spread evenly.
fn thinned(splats: &Splats, most: usize) -> Splats {
    let step = splats.len().div_ceil(most).max(1);
    let mut thin = splats.clone();
    thin.retain(|i| i % step == 0);
    thin
}

fn middle(splats: &Splats) -> DVec3 {
    let median = |k: usize| {
        let mut values: Vec<f32> = splats.means.iter().map(|m| m[k]).collect();
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied().map_or(0.0, f64::from)
    };
    DVec3::new(median(0), median(1), median(2))
}

/// The radius in which half of the splats lie.
fn spread(splats: &Splats) -> f64 {
    let middle = middle(splats);
    let distance = |m: &[f32; 3]| (DVec3::from_array(m.map(f64::from)) - middle).length();
    let mut distances: Vec<f64> = splats.means.iter().map(distance).collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied().unwrap_or(1.0)
}
