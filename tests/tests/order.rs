//! Orders: the processor's and the device's sorts against the standard library's stable sort, and frames drawn in them.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_renderer::order::device::{KeySorter, SortShape};
use motes_renderer::order::{SortBuffers, float_key, float_key_16, radix_sort};
use motes_renderer::{
    Axis, Composite, Expansion, Fov, KeyBits, Offscreen, OrderKey, Packing, Picture, Precision, RenderConfig,
    SceneOnDevice, ShPrecision, Sorter, Stereo, View,
};
use motes_scenes::Splats;
use motes_scenes::synthetic::{Animation, Random, Recipe};
use motes_tests::TestGpu;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use std::cell::RefCell;

const fn shape(group: u32, run: u32, digit_bits: u32) -> SortShape {
    SortShape { group, run, digit_bits, shuffled: false }
}

const fn shuffled(run: u32, digit_bits: u32) -> SortShape {
    SortShape { group: 8, run, digit_bits, shuffled: true }
}

/// Tiles of 8 to 63488 keys. Graphics cards get the fourth shape, processors the last.
const SHAPES: [SortShape; 12] = [
    shape(8, 8, 8),
    shape(10, 10, 3),
    shape(64, 8, 7),
    shape(128, 16, 6),
    shape(32, 128, 8),
    shape(8, 64, 4),
    shape(5, 129, 5),
    shape(8, 4096, 8),
    shuffled(1, 3),
    shuffled(9, 8),
    shuffled(3, 11),
    shuffled(7936, 11),
];

/// What the standard library says: the places of the keys, stably sorted.
fn stable(keys: &[u32]) -> Vec<u32> {
    let mut places: Vec<u32> = (0..keys.len() as u32).collect();
    places.sort_by_key(|&i| keys[i as usize]);
    places
}

fn on_processor(keys: &[u32], bits: u32) -> Vec<u32> {
    let mut buffers = SortBuffers::default();
    buffers.set(keys.iter().copied().zip(0..));
    radix_sort(&mut buffers, bits);
    buffers.pairs().map(|(_, i)| i).collect()
}

fn random(n: usize, seed: u64) -> Vec<u32> {
    let mut random = Random::new(seed);
    (0..n).map(|_| random.bits() as u32).collect()
}

/// Floats at which comparisons go wrong.
fn difficult_floats() -> Vec<f32> {
    let mut values = vec![
        0.0,
        -0.0,
        f32::NAN,
        -f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MIN_POSITIVE,
        f32::from_bits(1),
        -f32::from_bits(1),
        f32::from_bits(0x007f_ffff),
        f32::MAX,
        f32::MIN,
        1.0,
        f32::from_bits(0x3f80_0001),
    ];
    values.extend_from_within(..);
    values.rotate_left(5);
    values
}

fn hard_cases(tile: usize) -> Vec<Vec<u32>> {
    let mut cases = vec![difficult_floats().into_iter().map(float_key).collect()];
    for n in [0, 1, 2, 255, 256, 257, tile - 1, tile, tile + 1, 3 * tile - 1] {
        cases.push(random(n, n as u64));
        cases.push(random(n, n as u64).iter().map(|k| k & 3).collect());
        cases.push((0..n as u32).collect());
        cases.push((0..n as u32).rev().collect());
        cases.push(vec![0; n]);
        cases.push(vec![u32::MAX; n]);
    }
    cases
}

#[test]
fn both_sorts_agree_with_the_stable_sort() {
    let gpu = TestGpu::new();
    for shape in SHAPES {
        let mut device = KeySorter::new(&gpu, shape).unwrap();
        for keys in hard_cases((shape.group * shape.run) as usize) {
            let expected = stable(&keys);
            assert_eq!(on_processor(&keys, 32), expected);
            assert_eq!(device.sort(&keys, 32).unwrap(), expected, "{shape:?}, {} keys", keys.len());
            let short: Vec<u32> = keys.iter().map(|k| k >> 16).collect();
            let expected = stable(&short);
            assert_eq!(on_processor(&short, 16), expected);
            assert_eq!(device.sort(&short, 16).unwrap(), expected, "{shape:?}, 16 bits, {}", keys.len());
        }
    }
}

#[test]
fn a_million_keys_agree_and_repeat() {
    let gpu = TestGpu::new();
    let keys = random(1_000_000, 7);
    let expected = stable(&keys);
    assert_eq!(on_processor(&keys, 32), expected);
    let mut device = KeySorter::new(&gpu, SortShape::of(&gpu.capabilities)).unwrap();
    let first = device.sort(&keys, 32).unwrap();
    assert_eq!(first, expected);
    assert_eq!(device.sort(&keys, 32).unwrap(), first, "not deterministic");
    // Control: an order in which equal keys have changed places is told apart.
    let few: Vec<u32> = keys.iter().map(|k| k & 0xff).collect();
    let mut unstable = stable(&few);
    let equal = (1..).find(|&i| few[unstable[i] as usize] == few[unstable[i - 1] as usize]).unwrap();
    unstable.swap(equal - 1, equal);
    assert_ne!(device.sort(&few, 32).unwrap(), unstable);
}

#[test]
fn any_keys_agree() {
    let gpu = TestGpu::new();
    let devices: Vec<_> = SHAPES.iter().map(|&s| RefCell::new(KeySorter::new(&gpu, s).unwrap())).collect();
    let keys = prop_oneof![
        prop::collection::vec(any::<u32>(), 0..700),
        prop::collection::vec(0u32..5, 0..700),
        prop::collection::vec(any::<f32>().prop_map(float_key), 0..700),
    ];
    let mut runner = TestRunner::new(Config { cases: 40, failure_persistence: None, ..Config::default() });
    runner
        .run(&keys, |keys| {
            let expected = stable(&keys);
            prop_assert_eq!(on_processor(&keys, 32), expected.clone());
            for device in &devices {
                let mut device = device.borrow_mut();
                let sorted = device.sort(&keys, 32).map_err(|e| TestCaseError::fail(e.to_string()))?;
                prop_assert_eq!(sorted, expected.clone());
            }
            Ok(())
        })
        .unwrap();
}

proptest! {
    #[test]
    fn keys_are_ordered_as_floats_are(a: f32, b: f32) {
        if a < b {
            prop_assert!(float_key(a) < float_key(b));
            prop_assert!(float_key_16(a) <= float_key_16(b));
            // 16 bits tell neighbours apart that differ by 1 %.
            if a > 1e-30 && b > a * 1.01 {
                prop_assert!(float_key_16(a) < float_key_16(b));
            }
        }
    }
}

#[test]
fn shapes_that_cannot_be_are_refused() {
    let gpu = TestGpu::new();
    for shape in [
        shape(0, 8, 8),
        shape(256, 256, 8),
        shape(8, 65536, 9),
        shape(64, 4096, 8),
        shape(64, 8, 9),
        shape(8, 8, 12),
        shape(32, 0, 8),
        shape(1024, 8, 8),
        SortShape { shuffled: true, ..shape(16, 8, 8) },
        shuffled(8, 2),
    ] {
        assert!(KeySorter::new(&gpu, shape).is_err(), "{shape:?}");
    }
}

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 1 };

fn still() -> Splats {
    Recipe { count: 3000, sh_degree: 1, seed: 3, ..Default::default() }.still()
}

/// Far apart, so that each eye has an order of its own.
fn eyes() -> [View; 2] {
    let fov = Fov { left: -1.0, right: 1.0, up: -0.8, down: 0.8 };
    let look = |x: f64| View::look_at(DVec3::new(x, 0.1, -1.4), DVec3::ZERO, DVec3::NEG_Y, fov, [80, 64]);
    [look(-0.5), look(0.6)]
}

fn every_layer() -> RenderConfig {
    RenderConfig { composite: Composite::FrontToBack, ..Default::default() }
}

fn render(
    offscreen: &mut Offscreen,
    scene: &SceneOnDevice,
    views: &[View],
    config: &RenderConfig,
) -> Vec<Picture> {
    offscreen.render(scene, views, config).unwrap().0
}

#[test]
fn frames_are_the_same_whoever_sorts() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let moving = Recipe { count: 3000, sh_degree: 1, seed: 4, ..Default::default() };
    let brief = Animation { fleeting: 1.0, width: 0.05, ..Default::default() };
    let scenes = [still(), moving.moving(&Animation::default()), moving.moving(&brief)]
        .map(|s| SceneOnDevice::new(&gpu, &s, PLAIN).unwrap());
    assert!(scenes[2].positions.alive().is_some(), "the last is to be sorted by lists");
    let eyes = eyes();
    for scene in &scenes {
        for &order in OrderKey::ALL {
            for (views, sort_per_eye) in [(1, false), (2, false), (2, true)] {
                for expansion in [Expansion::Precomputed, Expansion::Instanced] {
                    let time = 0.3;
                    let mut config = RenderConfig { order, sort_per_eye, expansion, time, ..every_layer() };
                    let by_processor = render(&mut offscreen, scene, &eyes[..views], &config);
                    config.sorter = Sorter::Gpu;
                    let by_device = render(&mut offscreen, scene, &eyes[..views], &config);
                    assert!(by_processor == by_device, "{order} {views} {sort_per_eye} {expansion}");
                }
            }
        }
    }
    // Control: the order matters.
    let mut config = RenderConfig { sorter: Sorter::Gpu, ..every_layer() };
    let radial = render(&mut offscreen, &scenes[0], &eyes[..1], &config);
    config.order = OrderKey::Depth;
    assert!(render(&mut offscreen, &scenes[0], &eyes[..1], &config) != radial);
}

#[test]
fn short_keys_hardly_change_a_picture() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let scene = SceneOnDevice::new(&gpu, &still(), PLAIN).unwrap();
    let view = &eyes()[..1];
    let colours = |p: &Picture| p.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
    let full = render(&mut offscreen, &scene, view, &every_layer());
    let mut worst = f64::INFINITY;
    for sorter in [Sorter::Cpu, Sorter::Gpu] {
        let config = RenderConfig { sorter, key_bits: KeyBits::B16, ..every_layer() };
        let short = render(&mut offscreen, &scene, view, &config);
        assert!(short != full, "16 bits must make a difference somewhere");
        worst = worst.min(motes_tests::psnr(&colours(&short[0]), &colours(&full[0])));
    }
    println!("16-bit keys against 32-bit ones: {worst:.1} dB");
    assert!(worst > 35.0, "{worst:.1} dB");
}

#[test]
fn an_eye_with_its_own_order_sees_what_it_sees_alone() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let scene = SceneOnDevice::new(&gpu, &still(), PLAIN).unwrap();
    let eyes = eyes();
    for sorter in [Sorter::Cpu, Sorter::Gpu] {
        for composite in [Composite::FrontToBack, Composite::EarlyStop, Composite::BackToFront] {
            let mut config = RenderConfig { sorter, composite, sort_per_eye: true, ..Default::default() };
            let both = render(&mut offscreen, &scene, &eyes, &config);
            for eye in 0..2 {
                let alone = render(&mut offscreen, &scene, &eyes[eye..=eye], &config);
                assert!(both[eye] == alone[0], "{sorter} {composite}, eye {eye}");
            }
            // Control: one order from between the eyes is another.
            config.sort_per_eye = false;
            assert!(render(&mut offscreen, &scene, &eyes, &config) != both);
        }
    }
    offscreen.set_stereo(Stereo::Multiview);
    let config = RenderConfig { sort_per_eye: true, ..Default::default() };
    let refusal = offscreen.render(&scene, &eyes, &config).unwrap_err().to_string();
    assert!(refusal.contains("two passes"), "{refusal}");
}

#[test]
fn an_order_serves_for_as_many_frames_as_chosen() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let scene = SceneOnDevice::new(&gpu, &still(), PLAIN).unwrap();
    let look = |frame: u32| {
        let eye = DVec3::new(-1.2 + 0.4 * f64::from(frame), 0.3, -1.3);
        View::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, Fov::vertical(1.2, [64, 48]), [64, 48])
    };
    for sorter in [Sorter::Cpu, Sorter::Gpu] {
        let mut frames = |interval: u32| -> Vec<Picture> {
            let config = RenderConfig { sorter, sort_interval: interval, ..every_layer() };
            offscreen.renderer().expire_order();
            // A frame of another kind between two runs, so that each begins with an order of its own.
            let other = RenderConfig { order: OrderKey::Depth, ..config.clone() };
            render(&mut offscreen, &scene, &[look(0)], &other);
            (0..7).map(|f| render(&mut offscreen, &scene, &[look(f)], &config).remove(0)).collect()
        };
        let (always, third) = (frames(1), frames(3));
        for frame in 0..7 {
            let fresh = frame % 3 == 0;
            assert_eq!(always[frame] == third[frame], fresh, "{sorter}: frame {frame}");
        }
    }
    let config = RenderConfig { sort_interval: 0, ..Default::default() };
    assert!(config.check(1, &gpu.capabilities).is_err());
}

/// Nobody sorts: each sample shows one splat a pixel, and their mean is what the sorted splats show.
#[test]
fn stochastic_transparency_converges_to_the_sorted_picture() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let scene = SceneOnDevice::new(&gpu, &still(), PLAIN).unwrap();
    let eyes = eyes();
    let colours = |p: &Picture| p.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
    for order in [OrderKey::Radial, OrderKey::Depth] {
        let sorted = render(&mut offscreen, &scene, &eyes, &RenderConfig { order, ..every_layer() });
        let mut found = Vec::new();
        for samples in [16, 256] {
            let config = RenderConfig { order, sorter: Sorter::Stochastic, samples, ..every_layer() };
            let mean = render(&mut offscreen, &scene, &eyes, &config);
            let db = [0, 1].map(|e| motes_tests::psnr(&colours(&mean[e]), &colours(&sorted[e])));
            println!("{order}, {samples} samples: {db:.1?} dB");
            found.push(db[0].min(db[1]));
            let again = render(&mut offscreen, &scene, &eyes, &config);
            assert!(mean == again, "equal samples make equal pictures");
        }
        // The error of a mean of n samples of at most 1 is at most ½ / √n: 30.1 dB of 256.
        assert!(found[1] >= 30.1, "{order}: {found:.1?} dB");
        // A mean that goes astray stops converging: 16 times the samples are worth 12 dB.
        assert!(found[1] - found[0] > 10.0, "{order}: {found:.1?} dB");
        // Control: the other eye's picture.
        assert!(motes_tests::psnr(&colours(&sorted[0]), &colours(&sorted[1])) < found[0]);
    }
    let stochastic = RenderConfig { sorter: Sorter::Stochastic, ..every_layer() };
    let refused = [
        RenderConfig { composite: Composite::EarlyStop, ..stochastic.clone() },
        RenderConfig { composite: Composite::BackToFront, ..stochastic.clone() },
        RenderConfig { expansion: Expansion::Instanced, ..stochastic.clone() },
        RenderConfig { sort_per_eye: true, ..stochastic.clone() },
        RenderConfig { sort_interval: 2, ..stochastic.clone() },
        RenderConfig { key_bits: KeyBits::B16, ..stochastic.clone() },
        RenderConfig { resolution_scale: 0.7, ..stochastic.clone() },
        RenderConfig { samples: 0, ..stochastic.clone() },
    ];
    for config in refused {
        assert!(config.check(2, &gpu.capabilities).is_err(), "{config:?}");
    }
    assert!(offscreen.layers(&scene, &eyes[..1], &stochastic).is_err());
}

/// Frame by frame, as in a window: the mean of what was shown so far, turned with the head, and forgotten after a cut.
#[test]
fn stochastic_frames_are_averaged_and_follow_the_head() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let scene = SceneOnDevice::new(&gpu, &still(), PLAIN).unwrap();
    let eyes = eyes();
    let stochastic = RenderConfig { sorter: Sorter::Stochastic, samples: 16, ..every_layer() };
    let db = |shown: &[Picture], truth: &[Picture]| {
        let colours = |p: &Picture| p.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
        let of_eye = |e: usize| motes_tests::psnr(&colours(&shown[e]), &colours(&truth[e]));
        of_eye(0).min(of_eye(1))
    };
    let turned =
        |angle: f64| eyes.map(|v| View { rotation: glam::DMat3::from_rotation_y(angle) * v.rotation, ..v });
    let truth = |offscreen: &mut Offscreen, views: &[View]| render(offscreen, &scene, views, &every_layer());
    let sorted = truth(&mut offscreen, &eyes);
    let at_once = db(&render(&mut offscreen, &scene, &eyes, &stochastic), &sorted);

    let run = |offscreen: &mut Offscreen, average: bool| {
        offscreen.renderer().forget_history();
        offscreen.renderer().average_samples(average);
        offscreen.renderer().set_sample(100);
        let mut shown: Vec<f64> = Vec::new();
        for frame in 1..=16 {
            shown.push(db(&offscreen.frame(&scene, &eyes, &stochastic).unwrap().0, &sorted));
            let lacks = if average { 16 - frame } else { 0 };
            assert_eq!(offscreen.renderer().lacks(), lacks, "after frame {frame}");
        }
        shown
    };
    let single = run(&mut offscreen, false);
    let gathered = run(&mut offscreen, true);
    println!(
        "still: {:.1} dB first, {:.1} dB of 16 frames, {at_once:.1} dB at once",
        gathered[0], gathered[15]
    );
    assert!((gathered[0] - single[0]).abs() < 0.01, "the first frame has nothing to average");
    assert!(gathered[15] > at_once - 1.0 && gathered[15] > gathered[0] + 9.0, "{gathered:.1?}");
    // Control: frames that are not averaged stay as noisy as they are.
    assert!((single[15] - single[0]).abs() < 1.5, "{single:.1?}");

    // A head that turns.
    let mut last = 0.0;
    for i in 1..=24 {
        last = 0.01 * f64::from(i);
        offscreen.frame(&scene, &turned(last), &stochastic).unwrap();
        assert_eq!(offscreen.renderer().lacks(), 15, "a picture that moves is never finished");
    }
    let end = turned(last + 0.01);
    let moving = offscreen.frame(&scene, &end, &stochastic).unwrap().0;
    let moving = db(&moving, &truth(&mut offscreen, &end));
    // A cut to the other side: nothing of before is there.
    let back = eyes.map(|v| View::look_at(-v.eye, DVec3::ZERO, DVec3::NEG_Y, v.fov, v.size));
    let cut = offscreen.frame(&scene, &back, &stochastic).unwrap().0;
    let cut = db(&cut, &truth(&mut offscreen, &back));
    println!("turning: {moving:.1} dB; after a cut {cut:.1} dB; single frames {:.1} dB", single[0]);
    assert!(moving > single[0] + 4.0, "{moving:.1} dB while the head turns");
    assert!(cut > single[0] - 1.5, "{cut:.1} dB after a cut: a ghost");
}
