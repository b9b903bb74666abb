//! The fuzz targets (`fuzz/`) on stable Rust: a fixed corpus and a fixed number of mutations. `MOTES_FUZZ_CORPUS=DIR`
//! writes the corpus for libFuzzer instead: `cargo +nightly fuzz run TARGET DIR/TARGET`.
#![allow(clippy::panic, clippy::unwrap_used, reason = "a test may")]

mod common;
#[path = "../../fuzz/harness.rs"]
mod harness;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use common::encode::{self, Encoding};
use common::pack;
use motes_scenes::labels::{Class, Labels, class_colour};
use motes_scenes::levels::{self, LevelFile, NewLevel, Storage};
use motes_scenes::synthetic::{Animation, Random, Recipe};

const CAMERAS: &str = r#"[{"id": 0, "img_name": "a", "width": 640, "height": 480, "position": [0.5, -1, 2],
"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 500.5, "fy": 500.5}]"#;
const NERF: &str = r#"{"camera_angle_x": 0.7, "w": 640, "h": 480, "frames": [{"file_path": "a.png",
"transform_matrix": [[1, 0, 0, 0.5], [0, 1, 0, 1], [0, 0, 1, 2], [0, 0, 0, 1]]}]}"#;
const COLMAP: &str = "# Image list\n1 1 0 0 0 0.5 -1 2 1 a.png\n\n";
const SETTINGS: &str = r#"{"version": 1, "up": "-y", "scale": 1.5, "floor": -1.2, "first_view": {"position": [0, 0, -2],
"rotation": [0, 0, 0, 1]}, "views": [{"name": "window", "position": [1, 0, 0], "rotation": [0, 0, 0, 1], "vertical_fov": 55}]}"#;

const LABELS: [&str; 3] = [
    r#"{"version": 1, "classes": [{"id": 1, "name": "cup", "colour": [255, 0, 9]}], "labels": [0, 1, 1, 2]}"#,
    "[0, 3, 65535]",
    r#"{"objects": [{"point_annotations": [1, 2, 2]}]}"#,
];

/// Two levels of two classes in cubes.
fn level_file(storage: Storage) -> Vec<u8> {
    let level = |name: &str, step, count| {
        let mut splats = Recipe { count, ..Recipe::default() }.still();
        splats.labels = Some((0..splats.len()).map(|i| 1 + (i % 2) as u16).collect());
        NewLevel { name: name.to_owned(), step, splats }
    };
    let classes = [1u16, 2].map(|id| Class { id, name: format!("class {id}"), colour: class_colour(id) });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mlod");
    levels::save(&path, &[level("fine", 2.0, 8), level("coarse", 1.0, 3)], &classes, Some(4.0), storage)
        .unwrap();
    std::fs::read(&path).unwrap()
}

/// Small sound files of every kind.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let still = |sh_degree, count| {
        let mut splats = Recipe { count, sh_degree, ..Recipe::default() }.still();
        // Few distinct values, as the palettes of a SOG need them.
        let coarse = |v: &mut f32| *v = (*v * 8.0).round() / 8.0;
        splats.log_scales.as_flattened_mut().iter_mut().for_each(coarse);
        splats.sh.as_flattened_mut().iter_mut().for_each(coarse);
        splats
    };
    let moving = Recipe { count: 6, ..Recipe::default() }.moving(&Animation::default());
    match target {
        "ply" => {
            let mut disordered = encode::columns(&still(1, 5));
            encode::disorder(&mut disordered, 5);
            vec![
                encode::plain_ply(&still(3, 4)),
                encode::plain_ply(&moving),
                encode::ply(&encode::columns(&still(0, 6)), Encoding::Big, false),
                encode::ply(&encode::columns(&still(0, 5)), Encoding::Ascii, false),
                encode::ply(&disordered, Encoding::Little, true),
                encode::ply(&disordered, Encoding::Ascii, true),
            ]
        }
        "compressed_ply" => {
            vec![encode::compressed_ply(&still(0, 260)), encode::compressed_ply(&still(3, 20))]
        }
        "splat" => vec![encode::splat(&still(0, 9))],
        "splatv" => vec![encode::splatv(&moving)],
        "ksplat" => (0..3).map(|level| encode::ksplat(&still(level as u8 + 1, 7), level)).collect(),
        "sog" => [1, 2].iter().map(|v| pack::zip(&pack::sog(&still(0, 60), *v), "", *v == 1)).collect(),
        "spz" => (1..=4).map(|version| pack::spz(&still(2, 12), version)).collect(),
        "levels" => [Storage::Spz, Storage::Ply].iter().map(|storage| level_file(*storage)).collect(),
        "labels" => LABELS.iter().map(|t| t.as_bytes().to_vec()).collect(),
        "cameras" => [CAMERAS, NERF, COLMAP].iter().map(|t| t.as_bytes().to_vec()).collect(),
        "settings" => vec![SETTINGS.as_bytes().to_vec()],
        other => panic!("no corpus for {other}"),
    }
}

/// One of the ways in which fuzzers change bytes.
fn mutate(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    let at = random.below(bytes.len().max(1) as u64) as usize;
    match random.below(7) {
        0 if !bytes.is_empty() => bytes[at] = random.bits() as u8,
        1 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
        2 => bytes.truncate(at),
        3 => bytes.insert(at, random.bits() as u8),
        4 => {
            let value =
                [0u32, 1, u32::MAX, 1 << 31, 0x7f80_0000, 0x7fc0_0000, 1 << 24][random.below(7) as usize];
            for (i, b) in value.to_le_bytes().into_iter().enumerate() {
                if let Some(place) = bytes.get_mut(at + i) {
                    *place = b;
                }
            }
        }
        5 => {
            // A piece of another file.
            let from = random.below(other.len() as u64) as usize;
            let piece = &other[from..(from + random.below(40) as usize).min(other.len())];
            let end = (at + piece.len()).min(bytes.len());
            bytes.splice(at.min(bytes.len())..end, piece.iter().copied());
        }
        _ => {
            // Another digit or sign, where text has some.
            let from = at.min(bytes.len());
            if let Some(digit) = bytes[from..].iter_mut().find(|b| b.is_ascii_digit()) {
                *digit = b"0123456789-.e"[random.below(13) as usize];
            }
        }
    }
}

#[test]
fn every_target_survives_its_mutated_corpus() {
    let write = std::env::var_os("MOTES_FUZZ_CORPUS");
    let count: u64 = std::env::var("MOTES_FUZZ_RUNS").ok().and_then(|n| n.parse().ok()).unwrap_or(2000);
    for (name, run) in harness::TARGETS {
        let files = corpus(name);
        if let Some(folder) = &write {
            let folder = Path::new(folder).join(name);
            std::fs::create_dir_all(&folder).unwrap();
            for (i, bytes) in files.iter().enumerate() {
                std::fs::write(folder.join(format!("seed-{i}")), bytes).unwrap();
            }
            continue;
        }
        for bytes in &files {
            run(bytes);
        }
        for seed in 0..count {
            let mut random = Random::new(seed);
            let pick = |random: &mut Random| files[random.below(files.len() as u64) as usize].clone();
            let (mut bytes, other) = (pick(&mut random), pick(&mut random));
            for _ in 0..=random.below(4) {
                mutate(&mut bytes, &other, &mut random);
            }
            if catch_unwind(AssertUnwindSafe(|| run(&bytes))).is_err() {
                panic!("{name}, seed {seed}: see above");
            }
        }
    }
}

/// Controls: the corpus is read as what it is, so that mutations reach behind the headers; and a panic is noticed.
#[test]
fn the_corpus_is_sound() {
    for (name, file) in [
        ("ply", "a.ply"),
        ("compressed_ply", "a.compressed.ply"),
        ("splat", "a.splat"),
        ("splatv", "a.splatv"),
        ("ksplat", "a.ksplat"),
        ("sog", "a.sog"),
        ("spz", "a.spz"),
    ] {
        for (i, bytes) in corpus(name).iter().enumerate() {
            assert!(common::read(file, bytes).is_ok_and(|s| !s.splats.is_empty()), "{name} {i}");
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    for text in [CAMERAS, NERF] {
        std::fs::write(&path, text).unwrap();
        assert_eq!(motes_scenes::cameras::load(&path).unwrap().len(), 1, "{text}");
    }
    std::fs::write(folder.path().join("scene.ply.motes.json"), SETTINGS).unwrap();
    let settings = motes_scenes::settings::Settings::load(&folder.path().join("scene.ply"));
    assert_eq!(settings.unwrap().unwrap().views.len(), 1);
    for bytes in corpus("levels") {
        let file = LevelFile::from_bytes(Path::new("a.mlod"), bytes.into()).unwrap();
        assert!((0..2).all(|level| file.read(0, level).is_ok()), "{:?}", file.groups());
    }
    for (text, count) in LABELS.iter().zip([4, 3, 3]) {
        assert_eq!(Labels::parse(Path::new("a.json"), text.as_bytes()).unwrap().ids.len(), count);
    }
    assert!(catch_unwind(|| panic!("on purpose")).is_err());
}
