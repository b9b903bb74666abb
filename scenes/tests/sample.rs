//! The embedded sample is the scene that it says it is.

#![cfg(feature = "sample")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::{angle, difference, samples};
use motes_scenes::{LoadOptions, Splats, load, sample};

/// Why the sample is not the original within the quantisation of `.spz`, if it is not.
fn mismatch(found: &Splats, original: &Splats) -> Option<String> {
    if found.len() != original.len() {
        return Some(format!("{} splats", found.len()));
    }
    let angles = found.rotations.iter().zip(&original.rotations).map(|(a, b)| angle(*a, *b));
    let worst = [
        ("means", difference(found.means.as_flattened(), original.means.as_flattened()), 0.501 / 65536.0),
        (
            "log-scales",
            difference(found.log_scales.as_flattened(), original.log_scales.as_flattened()),
            0.501 / 16.0,
        ),
        ("opacities", difference(&found.opacities, &original.opacities), 1e-6),
        ("colours", difference(found.sh.as_flattened(), original.sh.as_flattened()), 0.501 / 255.0 / 0.15),
        ("rotations", angles.fold(0.0, f64::max) as f32, 3.47 / 511.0 * 0.7072),
    ];
    worst
        .into_iter()
        .find(|(_, off, allowed)| !(off <= allowed))
        .map(|(what, off, allowed)| format!("{what} differ by {off}, allowed {allowed}"))
}

#[test]
fn the_embedded_sample_is_the_plant_within_the_quantisation() {
    let scene = sample(&LoadOptions::default()).unwrap();
    assert_eq!((scene.splats.len(), scene.report.dropped_total()), (113_648, 0));
    let original = load(&samples().join("static/plant.splat"), &LoadOptions::default()).unwrap();
    assert_eq!(mismatch(&scene.splats, &original.splats), None);

    // Negative controls.
    let mut wrong = scene.splats.clone();
    wrong.means[9][1] += 1e-4;
    assert!(mismatch(&wrong, &original.splats).unwrap().starts_with("means"));
    let mut wrong = scene.splats.clone();
    wrong.rotations[9].rotate_left(1);
    assert!(mismatch(&wrong, &original.splats).unwrap().starts_with("rotations"));
}

#[test]
fn attribution_names_author_licence_and_changes() {
    for words in ["Marcel Padilla", "CC BY 4.0", "creativecommons.org/licenses/by/4.0", "Changes:", "113,648"]
    {
        assert!(sample::ATTRIBUTION.contains(words), "{words}");
    }
}

#[test]
fn the_sample_s_settings_put_the_pot_on_the_floor() {
    let splats = sample(&LoadOptions::default()).unwrap().splats;
    let world = sample::settings().scene_to_world();
    let mut heights: Vec<f64> =
        (0..splats.len()).map(|i| world.transform_point3(glam::DVec3::from(splats.mean_of(i))).y).collect();
    heights.sort_by(f64::total_cmp);
    assert!(heights[0].abs() < 1e-3 && heights[heights.len() - 1] > 0.9, "{} …", heights[0]);
}

#[test]
fn the_moving_sample_moves_and_is_written_and_read() {
    let still = sample::sample(&LoadOptions::default()).unwrap().splats;
    let moving = sample::moving(&LoadOptions::default()).unwrap().splats;
    let motion = moving.motion.as_ref().unwrap();
    assert_eq!(moving.len(), still.len());
    let fleeting = motion.widths.iter().filter(|w| **w < 1.0).count() as f64 / moving.len() as f64;
    assert!((0.19..0.21).contains(&fleeting), "{fleeting}");
    let fastest =
        motion.polynomials.iter().map(|p| p[0].iter().map(|v| v * v).sum::<f32>()).fold(0.0, f32::max);
    assert!(fastest.sqrt() > 0.1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("moving.ply");
    motes_scenes::save(&path, &moving).unwrap();
    let read = load(&path, &LoadOptions::default()).unwrap().splats;
    let read_motion = read.motion.as_ref().unwrap();
    assert_eq!((&read.means, &read_motion.centers), (&moving.means, &motion.centers));
    assert_eq!(read_motion.polynomials, motion.polynomials);
}
