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

/// `a`'s splats in the order of `b`'s: each goes to the nearest one that is free. Converters sort differently.
fn matched(a: &Splats, b: &Splats) -> Splats {
    let cell = |mean: &[f32; 3]| mean.map(|v| (v / CELL).floor() as i32);
    const CELL: f32 = 1.0 / 256.0;
    let mut grid = std::collections::HashMap::<[i32; 3], Vec<usize>>::new();
    for (i, mean) in a.means.iter().enumerate() {
        grid.entry(cell(mean)).or_default().push(i);
    }
    let mut out = Splats::zeroed(b.len(), b.sh_degree, false);
    let n = sh_coefficients(b.sh_degree);
    for (i, mean) in b.means.iter().enumerate() {
        let [x, y, z] = cell(mean);
        // Positions alone do not tell splats apart that lie on one another: opacity and scale do.
        let distance = |&j: &usize| -> f32 {
            let far: f32 = (0..3).map(|k| (a.means[j][k] - mean[k]).powi(2)).sum();
            let unlike: f32 = (0..3).map(|k| (a.log_scales[j][k] - b.log_scales[i][k]).powi(2)).sum();
            far * 1e6 + (a.opacities[j] - b.opacities[i]).powi(2) * 1e4 + unlike
        };
        let mut best: Option<([i32; 3], usize, f32)> = None;
        for near in (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]) {
            for j in grid.get(&near).into_iter().flatten() {
                let d = distance(j);
                if best.is_none_or(|(.., least)| d < least) {
                    best = Some((near, *j, d));
                }
            }
        }
        let (home, j, _) = best.unwrap_or_else(|| panic!("nothing lies near splat {i}, {mean:?}"));
        grid.get_mut(&home).unwrap().retain(|&k| k != j);
        out.means[i] = a.means[j];
        out.rotations[i] = a.rotations[j];
        out.log_scales[i] = a.log_scales[j];
        out.opacities[i] = a.opacities[j];
        out.sh[i * n..(i + 1) * n].copy_from_slice(a.sh_of(j));
    }
    out
}

/// SOG and compressed PLY of the same skull: chunks of 256 splats with 11, 10 and 11 bits a position.
#[test]
fn sog_and_compressed_ply_agree_within_the_quantisation() {
    let sog = scene("static/skull.sog").splats;
    let ply = scene("static/skull_sh3.compressed.ply").splats;
    let sog = matched(&sog, &ply);
    let d = difference(&sog, &ply, -20.0);
    println!("{d:?}");
    // Half a step of a chunk that is as large as the scene, in positions (1.51 units) and in logarithms of scales.
    assert!(d.mean <= 1.52 / 2.0 / 1023.0, "{d:?}");
    assert!(d.log_scale <= 18.1 / 2.0 / 1023.0, "{d:?}");
    assert!(d.opacity <= 1e-6, "{d:?}");
    // Bytes between a chunk's extremes of the colour (9.2 here), and 256 steps of 1/32.
    assert!(d.constant <= 9.2 / 2.0 / 255.0, "{d:?}");
    assert!(d.higher <= 1.01 / 64.0, "{d:?}");
    // 10 bits in place of 8 for three components.
    assert!(d.angle <= 3.47 * 0.7072 / 1023.0 * 2.0, "{d:?}");
}

/// The largest difference of two covariances, relative to the largest variance: unlike an angle, it does not mind how
/// a splat with two equal axes is turned about the third.
fn shape_difference(a: &Splats, b: &Splats) -> f32 {
    let covariance = |splats: &Splats, i: usize| {
        let rotation = glam::Mat3::from_quat(glam::Quat::from_array(splats.rotations[i]).normalize());
        let scales = glam::Vec3::from(splats.log_scales[i].map(|v| v.max(-10.0).exp()));
        let m = rotation * glam::Mat3::from_diagonal(scales);
        (m * m.transpose()).to_cols_array()
    };
    (0..a.len())
        .map(|i| {
            let (p, q) = (covariance(a, i), covariance(b, i));
            let largest = q[0].max(q[4]).max(q[8]);
            p.iter().zip(q).map(|(p, q)| (p - q).abs() / largest).fold(0.0, f32::max)
        })
        .fold(0.0, f32::max)
}

/// A capture in SPZ 4 (y up) and in compressed PLY (y down): equal once y and z are negated, rotations included.
#[test]
fn y_up_spz_is_the_y_down_ply_turned_about_x() {
    let mut spz = scene("static/biker.spz").splats;
    let ply = scene("static/biker.compressed.ply").splats;
    for mean in &mut spz.means {
        *mean = [mean[0], -mean[1], -mean[2]];
    }
    // A half turn about x is the quaternion (1, 0, 0, 0): (x, y, z, w) becomes (w, −z, y, −x).
    for q in &mut spz.rotations {
        *q = [q[3], -q[2], q[1], -q[0]];
    }
    let turned = matched(&spz, &ply);
    let d = difference(&turned, &ply, -10.0);
    println!("{d:?}, shape {}", shape_difference(&turned, &ply));
    assert!(d.mean <= 0.5 / 4096.0 + 3.2 / 2.0 / 1023.0, "{d:?}");
    assert!(d.log_scale <= 0.5 / 16.0 + 1e-3, "{d:?}");
    assert!(d.opacity <= 1e-6, "{d:?}");
    assert!(d.constant <= 0.5 / 255.0 / 0.15 + 1e-3, "{d:?}");
    // Half a step of SPZ's log-scales is 6.5 % in the square.
    assert!(shape_difference(&turned, &ply) <= 0.07);

    // Negative control: with the rotations as they were, the shapes are not the same.
    let mut wrong = turned.clone();
    for q in &mut wrong.rotations {
        *q = [-q[3], q[2], -q[1], q[0]];
    }
    assert!(shape_difference(&wrong, &ply) > 0.5);
}
