//! Scenes, views and choices made of troublesome numbers, through the whole renderer: a picture of finite numbers, or an
//! error that says what is wrong. Nothing in between, and nothing from the validation layer.

use glam::{DMat3, DVec3};
use motes_renderer::gpu::GpuError;
use motes_renderer::order::{SortBuffers, float_key, radix_sort};
use motes_renderer::{
    Axis, Composite, Expansion, Fov, LowPass, Packing, Precision, Projection, RadiusRule, RenderConfig,
    ShPrecision, View,
};
use motes_scenes::{Splats, sanitise};
use motes_tests::hard::rig::{BACKGROUND, Rig};
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

/// NaN, infinities, zeros, subnormals, the ends of the range, and the thresholds that the code compares with.
fn poison() -> impl Strategy<Value = f32> {
    let values = vec![
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        0.0,
        -0.0,
        1e-45,
        -1e-45,
        f32::MIN_POSITIVE,
        1e-38,
        1e-20,
        1e-10,
        1e-6,
        -1e-3,
        1.0 / 255.0,
        0.05,
        0.1,
        0.5,
        0.99,
        1.0,
        -1.0,
        2.0,
        8.0,
        -24.0,
        12.0,
        40.0,
        -40.0,
        88.8,
        255.0,
        1e3,
        -1e3,
        65504.0,
        65536.0,
        1e6,
        -1e6,
        1e10,
        1e15,
        -1e15,
        1e20,
        1e30,
        1e38,
        f32::MAX,
        f32::MIN,
    ];
    prop_oneof![3 => select(values), 5 => -3.0f32..3.0]
}

fn splats(count: usize) -> impl Strategy<Value = Splats> {
    let one = (
        prop::array::uniform3(poison()),
        prop::array::uniform4(poison()),
        prop::array::uniform3(poison()),
        poison(),
        prop::collection::vec(prop::array::uniform3(poison()), 4),
    );
    prop::collection::vec(one, 1..count).prop_map(|all| {
        let mut splats = Splats::zeroed(all.len(), 1, false);
        for (i, (mean, rotation, scales, opacity, sh)) in all.into_iter().enumerate() {
            splats.means[i] = mean;
            splats.rotations[i] = rotation;
            splats.log_scales[i] = scales;
            splats.opacities[i] = opacity;
            splats.sh[4 * i..4 * i + 4].copy_from_slice(&sh);
        }
        splats
    })
}

fn view() -> impl Strategy<Value = View> {
    let tangent = prop_oneof![4 => 0.1f64..2.0, 1 => select(vec![f64::NAN, f64::INFINITY, 0.0, -1.0, 1e-12, 1e3, 1e9, 1e300])];
    let place = prop_oneof![4 => -2.0f64..2.0, 1 => select(vec![f64::NAN, f64::INFINITY, 1e6, -1e15, 1e18, 1e300, 5e-324])];
    let turn = prop_oneof![6 => 0.0f64..6.3, 1 => Just(f64::NAN)];
    (prop::array::uniform4(tangent), prop::array::uniform3(place), turn).prop_map(
        |([l, r, u, d], eye, turn)| View {
            rotation: DMat3::from_rotation_y(turn),
            eye: DVec3::from_array(eye),
            fov: Fov { left: -l, right: r, up: -u, down: d },
            size: [13, 9],
        },
    )
}

/// Few pipelines: choices that are specialisation constants stay what they are, numbers vary.
fn config() -> impl Strategy<Value = RenderConfig> {
    let number = || prop_oneof![3 => 0.0f32..1.0, 1 => poison()];
    (select(Projection::ALL), number(), number(), number(), number(), number(), any::<bool>()).prop_map(
        |(projection, near, fade, cap, opacity, contribution, early)| RenderConfig {
            projection,
            expansion: Expansion::Precomputed,
            low_pass: LowPass::Planar,
            radius: RadiusRule::OpacityAware,
            composite: if early { Composite::EarlyStop } else { Composite::FrontToBack },
            near,
            near_fade: fade,
            max_radius: cap * 4.0,
            min_opacity: opacity * 0.1,
            min_contribution: contribution * 0.1,
            background: BACKGROUND,
            ..Default::default()
        },
    )
}

/// The same cases every time.
fn runner(cases: u32) -> TestRunner {
    let config = Config { cases, failure_persistence: None, ..Config::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
}

#[test]
fn poison_through_the_whole_renderer() {
    let rig = std::cell::RefCell::new(Rig::new());
    let (drawn, refused) = (std::cell::Cell::new(0), std::cell::Cell::new(0));
    let cases = std::env::var("MOTES_POISON_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(400);
    let result = runner(cases).run(
        &(splats(12), view(), config(), any::<bool>()),
        |(mut splats, view, config, half)| {
            sanitise(&mut splats);
            let mut rig = rig.borrow_mut();
            let precision = if half { Precision::F16 } else { Precision::F32 };
            let scene =
                rig.upload(&splats, Packing { precision, sh_precision: ShPrecision::F16, sh_degree: 1 });
            match rig.draw(&scene, &[view], &config) {
                Ok((pictures, report)) => {
                    prop_assert!(pictures[0].is_sound(), "a number that is none: {:?}", pictures[0].pixels);
                    prop_assert!(
                        report.predicted_fragments.is_finite() && report.visible as usize <= splats.len()
                    );
                    drawn.set(drawn.get() + 1);
                }
                Err(GpuError::Config(e)) => {
                    prop_assert!(e.to_string().len() > 20, "{e}");
                    refused.set(refused.get() + 1);
                }
                Err(e) => prop_assert!(false, "{e}"),
            }
            Ok(())
        },
    );
    println!("{} drawn, {} refused", drawn.get(), refused.get());
    result.unwrap();
    // Both ways out were taken, or nothing was tested.
    assert!(
        drawn.get() > cases / 10 && refused.get() > cases / 10,
        "{} drawn, {} refused",
        drawn.get(),
        refused.get()
    );
}

/// Control: a picture with a number that is none is noticed.
#[test]
fn unsound_pictures_are_noticed() {
    let picture = |v: f32, a: f32| motes_tests::hard::rig::FloatPicture {
        size: [1, 1],
        pixels: vec![[0.1, v, 0.2, a]],
    };
    assert!(picture(0.5, 1.0).is_sound());
    assert!(
        !picture(f32::NAN, 1.0).is_sound()
            && !picture(f32::INFINITY, 1.0).is_sound()
            && !picture(0.5, 0.7).is_sound()
    );
}

/// Any keys, any number of them.
#[test]
fn radix_sort_is_the_stable_sort() {
    let keys =
        prop::collection::vec(prop_oneof![any::<u32>(), 0u32..4, poison().prop_map(float_key)], 0..3000);
    runner(200)
        .run(&keys, |keys| {
            let mut buffers = SortBuffers::default();
            buffers.set(keys.iter().copied().zip(0..));
            radix_sort(&mut buffers, 32);
            let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
            expected.sort_by_key(|p| p.0);
            prop_assert_eq!(buffers.pairs().collect::<Vec<_>>(), expected);
            Ok(())
        })
        .unwrap();
}
