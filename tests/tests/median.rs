//! The depth that a headset's compositor is given: the median of each pixel's splats, against the reference's own.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_renderer::reference::{self, ReferenceOptions, ReferenceOrder};
use motes_renderer::{
    Composite, DepthMap, Expansion, Fov, Offscreen, OrderKey, Packing, Precision, RenderConfig,
    SceneOnDevice, ShPrecision, Stereo, View, midpoint,
};
use motes_scenes::Splats;
use motes_scenes::synthetic::Random;
use motes_tests::TestGpu;
use std::sync::Mutex;

const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// A wall 4 m ahead, a ball 2 m ahead before it, and a thin mist between eye and wall that takes less than half of the light
/// (y down, z forward).
fn scene() -> Splats {
    let mut random = Random::new(7);
    let (wall, ball, mist) = (9000, 5000, 6000);
    let mut splats = Splats::zeroed(wall + ball + mist, 0, false);
    for i in 0..splats.len() {
        let mut any = |low, high| random.uniform(low, high);
        let (mean, size, opacity) = if i < wall {
            ([any(-4.5, 4.5), any(-4.5, 4.5), 4.0 + any(-0.01, 0.01)], 0.06, any(0.5, 0.95))
        } else if i < wall + ball {
            let (z, turn) = (any(-1.0, 1.0), any(0.0, std::f32::consts::TAU));
            let across = (1.0f32 - z * z).sqrt();
            let at = [across * turn.cos(), across * turn.sin(), z].map(|v| 0.6 * v);
            ([at[0] + 0.2, at[1], at[2] + 2.0], 0.015, any(0.5, 0.95))
        } else {
            ([any(-2.0, 2.0), any(-2.0, 2.0), any(0.6, 3.8)], 0.02, any(0.05, 0.3))
        };
        splats.means[i] = mean;
        splats.log_scales[i] = [f32::ln(size); 3];
        splats.rotations[i] = [0.0, 0.0, 0.0, 1.0];
        splats.opacities[i] = opacity;
        splats.sh[i] = [0.5; 3];
    }
    splats
}

/// Two eyes 64 mm apart with mirrored asymmetric fields of view, as a headset has them.
fn eyes() -> [View; 2] {
    let look = |x: f64, fov| {
        let eye = DVec3::new(x, 0.1, 0.0);
        View::look_at(eye, eye + DVec3::new(0.1, 0.0, 1.0), DVec3::NEG_Y, fov, [96, 80])
    };
    let left = Fov { left: -1.2, right: 0.8, up: -0.8, down: 1.0 };
    let right = Fov { left: -0.8, right: 1.2, up: -0.8, down: 1.0 };
    [look(-0.032, left), look(0.032, right)]
}

fn options(views: &[View], config: &RenderConfig) -> ReferenceOptions {
    let order = match config.order {
        OrderKey::Radial => ReferenceOrder::Radial(Some(midpoint(views))),
        OrderKey::Depth => ReferenceOrder::Depth,
    };
    ReferenceOptions { order, ..ReferenceOptions::of_config(config) }
}

/// The reference's own median depth.
fn truth(splats: &Splats, view: &View, options: &ReferenceOptions) -> DepthMap {
    let image = reference::render(splats, view, options).unwrap();
    DepthMap { size: view.size, depths: image.pixels.iter().map(|p| p.median_depth as f32).collect() }
}

/// For control: the depth whose closeness is the mean of the layers', by their visible weight.
fn mean(splats: &Splats, view: &View, options: &ReferenceOptions) -> DepthMap {
    let depths = Mutex::new(vec![f32::INFINITY; (view.size[0] * view.size[1]) as usize]);
    reference::trace(splats, view, options, |[x, y], layers| {
        let mut sums = [0.0; 2];
        for layer in layers {
            let mean = glam::Vec3::from_array(splats.means[layer.splat as usize]).as_dvec3();
            sums[0] += layer.weight();
            sums[1] += layer.weight() / view.to_eye(mean).z;
        }
        depths.lock().unwrap()[(y * view.size[0] + x) as usize] = (sums[0] / sums[1]) as f32;
    })
    .unwrap();
    DepthMap { size: view.size, depths: depths.into_inner().unwrap() }
}

/// Differences of closeness over the truth's, sorted; infinite where only one of both knows a depth.
fn errors(found: &DepthMap, truth: &DepthMap) -> Vec<f32> {
    assert_eq!(found.size, truth.size);
    let mut errors: Vec<f32> = found
        .depths
        .iter()
        .zip(&truth.depths)
        .map(|(f, t)| match (f.is_finite(), t.is_finite()) {
            (true, true) => (t / f - 1.0).abs(),
            (false, false) => 0.0,
            _ => f32::INFINITY,
        })
        .collect();
    errors.sort_by(f32::total_cmp);
    errors
}

/// The bounds, as measured with a fifth to spare: 90, 95 and 99 % of the pixels.
const BOUNDS: [(f64, f32); 3] = [(0.9, 0.048), (0.95, 0.075), (0.99, 0.15)];

/// The errors at the bounds' shares, and whether all hold.
fn judge(found: &DepthMap, truth: &DepthMap) -> (Vec<f32>, bool) {
    let errors = errors(found, truth);
    let at: Vec<f32> =
        BOUNDS.iter().map(|(part, _)| errors[((errors.len() - 1) as f64 * part) as usize]).collect();
    let held = at.iter().zip(&BOUNDS).all(|(error, (_, bound))| error <= bound);
    (at, held)
}

#[test]
fn depth_is_the_references_median() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PACKING).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let eyes = eyes();
    for order in [OrderKey::Radial, OrderKey::Depth] {
        let config = RenderConfig { order, ..Default::default() };
        let (pictures, plain) = offscreen.render(&on_device, &eyes, &config).unwrap();
        let (maps, report) = offscreen.depths(&on_device, &eyes, &config).unwrap();
        // Eight looks at 32 batches, and the pass that writes them down.
        assert_eq!((report.draws, report.passes), (plain.draws + 9, plain.passes + 1));
        assert_eq!(report.fragments, plain.fragments);
        let (again, further) = offscreen.render(&on_device, &eyes, &config).unwrap();
        assert_eq!((again, further.draws), (pictures, plain.draws), "nothing of it is left");
        let options = options(&eyes, &config);
        let truths = [0, 1].map(|eye| truth(&splats, &eyes[eye], &options));
        for eye in 0..2 {
            let (at, held) = judge(&maps[eye], &truths[eye]);
            println!("{order}, eye {eye}: {at:?} at {BOUNDS:?}");
            assert!(held, "{order}, eye {eye}: {at:?}");
            // Controls: the other eye's depth, and means, which lie where nothing is.
            let (at, held) = judge(&maps[eye], &truths[1 - eye]);
            assert!(!held, "the other eye's depth must not pass: {at:?}");
            let (at, held) = judge(&mean(&splats, &eyes[eye], &options), &truths[eye]);
            println!("    mean instead of median: {at:?}");
            assert!(!held, "a mean must not pass: {at:?}");
        }
    }
}

#[test]
fn depth_outlives_a_reduced_resolution_and_is_refused_where_nobody_knows_it() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PACKING).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let eyes = eyes();
    let config = RenderConfig { resolution_scale: 0.75, ..Default::default() };
    let (maps, _) = offscreen.depths(&on_device, &eyes, &config).unwrap();
    let truth = truth(&splats, &eyes[0], &options(&eyes, &config));
    let errors = errors(&maps[0], &truth);
    let middle = errors[errors.len() / 2];
    let far = errors[errors.len() * 8 / 10];
    println!("at 75 %: median {middle}, 80th percentile {far}");
    assert!(maps[0].size == eyes[0].size && middle < 0.03 && far < 0.1);
    for config in [
        RenderConfig { composite: Composite::FrontToBack, ..Default::default() },
        RenderConfig { expansion: Expansion::Instanced, ..Default::default() },
        RenderConfig { sort_per_eye: true, ..Default::default() },
    ] {
        assert!(!config.knows_depth());
        let error = offscreen.depths(&on_device, &eyes, &config).unwrap_err().to_string();
        assert!(error.contains("depth is known to frames of composite early-stop"), "{error}");
    }
    let config = RenderConfig::default();
    offscreen.set_stereo(Stereo::TwoPass);
    assert!(offscreen.depths(&on_device, &eyes, &config).is_err(), "both eyes are drawn in one pass");
    // One eye alone is the same as both together.
    let (alone, _) = offscreen.depths(&on_device, &eyes[..1], &config).unwrap();
    let (held, good) = judge(&alone[0], &self::truth(&splats, &eyes[0], &options(&eyes[..1], &config)));
    assert!(good, "{held:?}");
}
