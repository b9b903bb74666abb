//! SOG, streamed SOG and SPZ: the sample scenes, whole.

#![allow(clippy::panic, clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::samples;
use motes_scenes::{Format, LoadOptions, Scene, Splats, load, load_many, sh_coefficients, streamed_levels};

fn scene(name: &str) -> Scene {
    load(&samples().join(name), &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// Least and greatest mean.
fn bounds(splats: &Splats) -> [[f64; 3]; 2] {
    let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for i in 0..splats.len() {
        for (k, v) in splats.mean_of(i).into_iter().enumerate() {
            bounds[0][k] = bounds[0][k].min(v);
            bounds[1][k] = bounds[1][k].max(v);
        }
    }
    bounds
}

/// Counts, degrees and bounds as other programs read them (the samples' manifest, four digits).
#[test]
fn every_sample_has_its_count_degree_and_bounds() {
    let expected: &[(&str, Format, usize, u8, [f64; 6])] = &[
        ("static/skull.sog", Format::Sog, 94_936, 3, [-0.5319, -1.094, -0.7176, 0.488, 0.035, 0.7935]),
        ("static/skull_sh3_v3.spz", Format::Spz, 94_936, 3, [-0.532, -1.094, -0.7175, 0.488, 0.0349, 0.7935]),
        ("static/biker.spz", Format::Spz, 152_746, 0, [-0.6213, 0.0, -0.6133, 0.4143, 3.18, 0.5322]),
        (
            "static/statues/st-peter.sog",
            Format::Sog,
            133_618,
            0,
            [-0.9113, -2.226, -0.7846, 0.9201, 2.433, 0.873],
        ),
        (
            "static/statues/narcissus.sog",
            Format::Sog,
            101_275,
            0,
            [-0.7872, -2.308, -0.8605, 0.7677, 1.495, 0.838],
        ),
        ("static/playcanvas-logo", Format::Sog, 307_128, 0, [-1.535, -2.782, -0.5768, 1.535, 0.2956, 0.5768]),
        ("static/playbot", Format::StreamedSog, 500_000, 2, [-1.031, -1.082, -1.038, 1.033, 0.0497, 1.041]),
        ("static/flowers_lod0", Format::Sog, 542_104, 2, [-0.3072, -0.2893, -0.3027, 0.2928, 0.1959, 0.2973]),
        ("static/lacadiere_lod3", Format::Sog, 746_973, 0, [-119.1, -27.37, -5.873, 93.18, 220.4, 27.94]),
        (
            "static/hq_garden_lod2",
            Format::Sog,
            851_756,
            0,
            [-1313.0, -1331.0, -845.4, 1356.0, 1265.0, 1329.0],
        ),
        ("static/hq_garden_lod1", Format::Sog, 3_382_239, 0, [-122.2, -139.5, -2.99, 73.01, 92.62, 96.21]),
        ("4d/flipbook_monkey", Format::Sog, 379_896, 0, [-1.329, -1.091, -1.514, 1.543, 1.129, 1.147]),
    ];
    for (name, format, count, degree, stated) in expected {
        let scene = scene(name);
        assert_eq!(scene.splats.len(), *count, "{name}");
        assert_eq!(scene.report.read, *count, "{name}");
        assert_eq!(scene.report.dropped_total(), 0, "{name}");
        assert_eq!(scene.splats.sh_degree, *degree, "{name}");
        assert!(scene.sources.iter().all(|source| source.format == *format), "{name}: {:?}", scene.sources);
        let found = bounds(&scene.splats).concat();
        for (found, stated) in found.iter().zip(stated) {
            // Half a unit of the last of four digits or decimals.
            let digits = 0.51 * 10f64.powf((stated.abs().log10().floor() - 3.0).max(-4.0));
            assert!((found - stated).abs() <= digits, "{name}: {found} where {stated} is stated");
        }
    }
}

#[test]
fn snapshots_of_a_training_load() {
    let mut counts = Vec::new();
    for iteration in [100, 250, 500, 1000, 1500, 2000, 2500, 3500] {
        let scene = scene(&format!("photos_snowmiku/snapshots/iteration_{iteration:05}.spz"));
        assert_eq!((scene.splats.sh_degree, scene.report.dropped_total()), (3, 0));
        counts.push(scene.splats.len());
    }
    assert_eq!((counts[0], counts[7]), (25_784, 69_944));
}

#[test]
fn bytes_on_disk_are_those_of_all_files() {
    for (name, bytes) in [
        ("static/skull.sog", 3_250_528),
        ("static/playcanvas-logo", 4_055_034),
        ("static/flowers_lod0", 13_086_323),
        ("static/hq_garden_lod2", 10_076_476),
    ] {
        let total: u64 = scene(name).sources.iter().map(|source| source.bytes).sum();
        assert_eq!(total, bytes, "{name}");
    }
}

#[test]
fn levels_of_a_streamed_scene_load_one_at_a_time() {
    let path = samples().join("static/playbot");
    let levels = streamed_levels(&path).unwrap();
    let counts: Vec<u64> = levels.iter().map(|level| level.splats).collect();
    assert_eq!(counts, [500_000, 250_000, 125_000, 31_000, 8_406, 3_000, 1_873]);
    assert!(levels.iter().enumerate().all(|(i, level)| level.level == i as u32 && level.files == 1));
    for (level, file) in [(2, "2_0"), (6, "6_0"), (99, "6_0")] {
        let options = LoadOptions { level, ..Default::default() };
        let streamed = load(&path.join("lod-meta.json"), &options).unwrap();
        let alone = load(&path.join(file).join("meta.json"), &LoadOptions::default()).unwrap();
        assert_eq!(streamed.splats, alone.splats, "level {level}");
    }
    let error = streamed_levels(&samples().join("static/skull.sog")).unwrap_err().to_string();
    assert!(error.contains("skull.sog"), "{error}");
}

#[test]
fn a_folder_of_pieces_is_their_sum() {
    let folder = scene("static/hq_garden_lod2");
    let parts = ["2_0/meta.json", "2_1/meta.json", "environment.sog"]
        .map(|part| samples().join(format!("static/hq_garden_lod2/{part}")));
    let listed = load_many(&parts, &LoadOptions::default()).unwrap();
    assert_eq!(folder.splats, listed.splats);
    assert_eq!(folder.sources.len(), 3);
    assert_eq!(folder.sources[2].splats.len(), 8_688);
}

/// The largest difference of two scenes with the same splats in the same order.
#[derive(Debug, Default)]
struct Difference {
    mean: f32,
    log_scale: f32,
    opacity: f32,
    /// Angle between the rotations, radians.
    angle: f32,
    constant: f32,
    higher: f32,
}

/// Compares splat by splat; log-scales at least `floor`, where one format has such a floor.
fn difference(a: &Splats, b: &Splats, floor: f32) -> Difference {
    assert_eq!((a.len(), a.sh_degree), (b.len(), b.sh_degree));
    let mut d = Difference::default();
    let worst = |worst: &mut f32, a: &[f32], b: &[f32]| {
        for (a, b) in a.iter().zip(b) {
            *worst = worst.max((a - b).abs());
        }
    };
    for i in 0..a.len() {
        worst(&mut d.mean, &a.means[i], &b.means[i]);
        let [s, t] = [a, b].map(|scene| scene.log_scales[i].map(|v| v.max(floor)));
        worst(&mut d.log_scale, &s, &t);
        worst(&mut d.opacity, &[a.opacities[i]], &[b.opacities[i]]);
        let dot: f64 =
            a.rotations[i].iter().zip(b.rotations[i]).map(|(p, q)| f64::from(*p) * f64::from(q)).sum();
        d.angle = d.angle.max((2.0 * dot.abs().min(1.0).acos()) as f32);
        let (p, q) = (a.sh_of(i), b.sh_of(i));
        worst(&mut d.constant, &p[0], &q[0]);
        worst(&mut d.higher, p[1..].as_flattened(), q[1..].as_flattened());
    }
    d
}

/// The same scene in SOG and in SPZ 3, made from it by another program: equal within SPZ's quantisation.
#[test]
fn one_scene_in_two_formats_agrees_within_the_quantisation() {
    let sog = scene("static/skull.sog").splats;
    let spz = scene("static/skull_sh3_v3.spz").splats;
    // SPZ's smallest log-scale is −10, its constant band ends at ±½ / 0.15, and its higher bands at ±1.
    let clamp = |mut splats: Splats| {
        let coefficients = sh_coefficients(splats.sh_degree);
        for (k, sh) in splats.sh.iter_mut().enumerate() {
            let [low, high] =
                if k % coefficients == 0 { [-0.5 / 0.15, 0.5 / 0.15] } else { [-1.0, 127.0 / 128.0] };
            *sh = sh.map(|v| v.clamp(low, high));
        }
        splats
    };
    let sog = clamp(sog);
    let d = difference(&sog, &spz, -10.0);
    println!("{d:?}");
    assert!(d.mean <= 0.5 / 4096.0 + 1e-6, "{d:?}");
    assert!(d.log_scale <= 0.5 / 16.0 + 1e-6, "{d:?}");
    assert!(d.opacity <= 1e-6, "{d:?}");
    // Half a step in three components, and what follows for the largest: at most √12 of it, twice.
    assert!(d.angle <= 3.47 / 511.0 * 0.7072, "{d:?}");
    assert!(d.constant <= 0.5 / 255.0 / 0.15 + 1e-6, "{d:?}");
    // Rounded to a byte, then to four bits.
    assert!(d.higher <= 8.5 / 128.0 + 1e-6, "{d:?}");

    // Negative control: the comparison sees one neighbour in another's place.
    let mut wrong = spz.clone();
    wrong.means.swap(5, 6);
    assert!(difference(&sog, &wrong, -10.0).mean > 1e-3);
    let mut wrong = spz.clone();
    wrong.rotations[7] = [1.0, 0.0, 0.0, 0.0];
    assert!(difference(&sog, &wrong, -10.0).angle > 0.1);
}
