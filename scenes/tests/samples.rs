//! Every sample file of the formats read here: its counts and statistics as other programs found them
//! (MANIFEST.md, from PlayCanvas's splat-transform and gsparse), and the same scene in two formats.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail them")]

mod common;

use std::collections::HashMap;

use common::{angle, defect, difference, samples};
use motes_scenes::{DropReason, Format, LoadOptions, SH_C0, Scene, Splats, load};

fn load_sample(name: &str) -> Scene {
    let scene = load(&samples().join(name), &LoadOptions::default()).unwrap();
    assert_eq!(defect(&scene.splats), None, "{name}");
    assert_eq!(scene.report.kept, scene.splats.len(), "{name}");
    assert_eq!(scene.report.read, scene.report.kept + scene.report.dropped_total(), "{name}");
    scene
}

/// What MANIFEST.md says of a file.
struct Stated {
    name: &'static str,
    format: Format,
    count: usize,
    sh_degree: u8,
    /// Smallest and largest coordinates.
    bounds: [[f32; 3]; 2],
    /// Smallest, largest and median scale, all axes together.
    scale: [f32; 3],
    /// Smallest, largest and median opacity.
    opacity: [f32; 3],
    /// Opacities of exactly 0 or 1.
    exact: usize,
}

const STATED: [Stated; 10] = [
    Stated {
        name: "static/skull_sh3.compressed.ply",
        format: Format::CompressedPly,
        count: 94_936,
        sh_degree: 3,
        bounds: [[-0.5319, -1.094, -0.7176], [0.488, 0.035, 0.7935]],
        scale: [2.06e-9, 0.1377, 0.00362],
        opacity: [0.0157, 1.0, 0.165],
        exact: 6,
    },
    Stated {
        name: "static/biker.compressed.ply",
        format: Format::CompressedPly,
        count: 152_746,
        sh_degree: 0,
        bounds: [[-0.6213, -3.18, -0.5323], [0.4144, 0.0, 0.6133]],
        scale: [1.3e-5, 0.3955, 0.00311],
        opacity: [0.00392, 1.0, 0.169],
        exact: 198,
    },
    Stated {
        name: "static/guitar.compressed.ply",
        format: Format::CompressedPly,
        count: 90_854,
        sh_degree: 0,
        bounds: [[-0.655, -4.292, -0.5276], [0.8216, 0.0861, 0.9247]],
        scale: [3.71e-9, 0.4057, 0.00357],
        opacity: [0.00392, 1.0, 0.235],
        exact: 667,
    },
    Stated {
        name: "static/fruit_drops_minimal.ply",
        format: Format::Ply,
        count: 4_721,
        sh_degree: 3,
        bounds: [[0.4861, -0.0116, -2.249], [1.002, 0.2497, -2.02]],
        scale: [1.87e-5, 0.2447, 0.0021],
        opacity: [0.00377, 0.9971, 0.0599],
        exact: 0,
    },
    Stated {
        name: "static/plant.splat",
        format: Format::Splat,
        count: 113_648,
        sh_degree: 0,
        bounds: [[-0.2586, -0.5, -0.3049], [0.2586, 0.5, 0.3049]],
        scale: [5.83e-5, 0.1576, 0.00135],
        opacity: [0.0, 0.9922, 0.196],
        exact: 199,
    },
    Stated {
        name: "static/plant_l1.ksplat",
        format: Format::KSplat,
        count: 113_449,
        sh_degree: 0,
        bounds: [[-0.2586, -0.5, -0.3049], [0.2586, 0.5, 0.3049]],
        scale: [5.83e-5, 0.1576, 0.00135],
        opacity: [0.00392, 0.9922, 0.196],
        exact: 0,
    },
    Stated {
        name: "static/lucy_100k.splat",
        format: Format::Splat,
        count: 100_000,
        sh_degree: 0,
        bounds: [[-0.291, -0.4998, -0.1671], [0.291, 0.5, 0.1668]],
        scale: [0.000713, 0.002851, 0.00285],
        opacity: [1.0, 1.0, 1.0],
        exact: 100_000,
    },
    Stated {
        name: "static/parking_lot.splat",
        format: Format::Splat,
        count: 108_844,
        sh_degree: 0,
        bounds: [[-20.26, -16.67, -18.39], [52.49, 9.701, 42.05]],
        scale: [4.93e-10, 3.065, 0.00853],
        opacity: [0.0, 0.9961, 0.275],
        exact: 4_704,
    },
    Stated {
        name: "photos_snowmiku/snowmiku_sh3.ply",
        format: Format::Ply,
        count: 69_955,
        sh_degree: 3,
        bounds: [[-14.03, -7.665, -13.28], [13.45, 16.44, 20.97]],
        scale: [5.58e-5, 3.407, 0.0201],
        opacity: [0.00362, 1.0, 0.29],
        // A logit above 17.3: its opacity rounds to 1.
        exact: 1,
    },
    Stated {
        name: "4d/spinach_4.splatv",
        format: Format::SplatV,
        count: 62_442,
        sh_degree: 0,
        bounds: [[-26.98, -39.95, 3.896], [20.33, 15.87, 62.22]],
        scale: [5.96e-8, 579.5, 0.0265],
        opacity: [0.0, 0.9961, 0.384],
        exact: 378,
    },
];

/// Smallest, largest, median.
fn spread(mut values: Vec<f32>) -> [f32; 3] {
    values.sort_by(f32::total_cmp);
    [values[0], values[values.len() - 1], values[values.len() / 2]]
}

/// Where a scene is not what was stated of it, to the four digits that were.
fn contradiction(splats: &Splats, stated: &Stated) -> Option<String> {
    if (splats.len(), splats.sh_degree) != (stated.count, stated.sh_degree) {
        return Some(format!("{} splats of degree {}", splats.len(), splats.sh_degree));
    }
    let near = |found: f32, stated: f32| (found - stated).abs() <= 6e-3 * stated.abs() + 6e-5;
    for k in 0..3 {
        let [low, high, _] = spread(splats.means.iter().map(|m| m[k]).collect());
        if !(near(low, stated.bounds[0][k]) && near(high, stated.bounds[1][k])) {
            return Some(format!("axis {k} reaches from {low} to {high}"));
        }
    }
    let scale = spread(splats.log_scales.as_flattened().iter().map(|v| v.exp()).collect());
    // Tiny scales need a relative measure.
    if scale.iter().zip(stated.scale).any(|(a, b)| !((a / b - 1.0).abs() < 6e-3)) {
        return Some(format!("scales {scale:?}"));
    }
    let opacity = spread(splats.opacities.clone());
    if opacity.iter().zip(stated.opacity).any(|(a, b)| !near(*a, b)) {
        return Some(format!("opacities {opacity:?}"));
    }
    let exact = splats.opacities.iter().filter(|a| **a == 0.0 || **a == 1.0).count();
    (exact != stated.exact).then(|| format!("{exact} opacities of 0 or 1"))
}

#[test]
fn statistics_are_those_that_other_programs_found() {
    for stated in &STATED {
        let scene = load_sample(stated.name);
        assert_eq!(scene.sources[0].format, stated.format, "{}", stated.name);
        assert_eq!(scene.report.dropped_total(), 0, "{}", stated.name);
        assert_eq!(contradiction(&scene.splats, stated), None, "{}", stated.name);
    }
    // Negative control: a scene is not another one, and one with y negated is not itself.
    let mut guitar = load_sample("static/guitar.compressed.ply").splats;
    assert!(contradiction(&guitar, &STATED[1]).is_some());
    guitar.means.iter_mut().for_each(|m| m[1] *= -1.0);
    assert!(contradiction(&guitar, &STATED[2]).is_some());
}

/// Counted by reading the files' bytes with another program: `(read, dropped for their mean, for a zero rotation,
/// scales of zero, endless widths)`.
#[test]
fn dirty_scenes_load_and_their_defects_are_counted() {
    for (name, read, means, rotations, scales, widths) in [
        ("4d/yellow_clip3.splatv", 61_837, 146, 20_314, 15, 271),
        ("4d/coffee10.splatv", 11_926, 24, 11_307, 7, 4),
    ] {
        let report = load_sample(name).report;
        assert_eq!(report.read, read, "{name}");
        let dropped = [(DropReason::Mean, means), (DropReason::ZeroRotation, rotations)];
        assert_eq!(report.dropped, dropped.into(), "{name}");
        assert_eq!((report.raised_scales, report.bounded_widths), (scales, widths), "{name}");
    }
}

#[test]
fn spinach_is_the_same_in_both_formats() {
    let splatv = load_sample("4d/spinach_4.splatv").splats;
    let scene = load_sample("4d/spinach_stg_lite.ply");
    assert_eq!(scene.sources[0].format, Format::SpacetimePly);
    let ply = scene.splats;
    assert_eq!(ply.len(), 62_442);
    assert_eq!(ply.means, splatv.means);
    assert!(difference(ply.rotations.as_flattened(), splatv.rotations.as_flattened()) < 2e-7);
    assert!(difference(ply.log_scales.as_flattened(), splatv.log_scales.as_flattened()) < 2e-6);
    // The PLY's logits stop at ±13.8155.
    assert!(difference(&ply.opacities, &splatv.opacities) < 1.1e-6);
    assert!(difference(ply.sh.as_flattened(), splatv.sh.as_flattened()) < 1e-6 / SH_C0);
    let (a, b) = (ply.motion.unwrap(), splatv.motion.unwrap());
    assert_eq!(a.centers, b.centers);
    assert_eq!(a.polynomials, b.polynomials);
    assert!(difference(a.omegas.as_flattened(), b.omegas.as_flattened()) < 1e-6);
    let mut endless = 0;
    for (a, b) in a.widths.iter().zip(&b.widths) {
        if *b == f32::MAX {
            // The PLY holds the logarithm of the largest half.
            assert!((a / 65_504.0 - 1.0).abs() < 1e-5, "{a}");
            endless += 1;
        } else {
            assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
        }
    }
    assert_eq!(endless, 821);
}

#[test]
fn plant_is_the_same_in_splat_and_ksplat() {
    let splat = load_sample("static/plant.splat").splats;
    let ksplat = load_sample("static/plant_l1.ksplat").splats;
    let bytes = |s: &Splats, i: usize| -> [u8; 4] {
        let [r, g, b] = s.sh[i].map(|dc| ((0.5 + SH_C0 * dc) * 255.0).round() as u8);
        [r, g, b, (s.opacities[i] * 255.0).round() as u8]
    };
    // The converter dropped invisible splats and sorted the others into buckets: colours tell them apart.
    let mut by_color: HashMap<[u8; 4], Vec<usize>> = HashMap::new();
    for i in (0..splat.len()).filter(|&i| splat.opacities[i] > 0.0) {
        by_color.entry(bytes(&splat, i)).or_default().push(i);
    }
    let (mut worst_mean, mut worst_angle, mut worst_scale) = (0.0_f32, 0.0_f64, 0.0_f32);
    for j in 0..ksplat.len() {
        let candidates = by_color.get_mut(&bytes(&ksplat, j)).unwrap();
        let distance = |i: usize| difference(&splat.means[i], &ksplat.means[j]);
        let nearest = (0..candidates.len())
            .min_by(|a, b| distance(candidates[*a]).total_cmp(&distance(candidates[*b])))
            .unwrap();
        let i = candidates.swap_remove(nearest);
        worst_mean = worst_mean.max(distance(i));
        worst_angle = worst_angle.max(angle(splat.rotations[i], ksplat.rotations[j]));
        worst_scale = worst_scale.max(difference(&splat.log_scales[i], &ksplat.log_scales[j]));
    }
    assert!(by_color.values().all(Vec::is_empty), "each has its counterpart");
    // Half a step of 2.5 / 32767; halves that were cut, not rounded; and the converter read the rotation's bytes in the other way, which makes
    // 0.006 per component.
    assert!(worst_mean < 4e-5, "means differ by {worst_mean}");
    assert!(worst_scale < 1e-3, "log-scales differ by {worst_scale}");
    assert!(worst_angle < 2.5e-2, "rotations differ by {worst_angle}");
}
