//! Loading beyond the formats: what is dropped, merging, far scenes, limits, progress, cancelling, folders, saving.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail them")]

mod common;

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use common::encode::{self, Column, Encoding};
use common::{angle, defect, difference, read, samples};
use motes_scenes::synthetic::{Animation, Recipe};
use motes_scenes::{
    CancelToken, DropReason, Format, Limits, LoadOptions, MIN_LOG_SCALE, MIN_WIDTH, SH_C0, SceneError,
    Splats, load, load_bytes, load_many, looks_like_sequence, sanitise, save, sequence_frames,
    sh_coefficients,
};

fn still(count: usize, sh_degree: u8) -> Splats {
    Recipe { count, sh_degree, seed: count as u64, ..Recipe::default() }.still()
}

fn moving(count: usize) -> Splats {
    Recipe { count, ..Recipe::default() }.moving(&Animation::default())
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

// What is dropped.

#[test]
fn every_reason_to_drop_a_splat() {
    type Spoil = fn(&mut Splats, usize);
    let cases: [(DropReason, Spoil); 15] = [
        (DropReason::Mean, |s, i| s.means[i][1] = f32::NAN),
        (DropReason::Mean, |s, i| s.means[i][2] = f32::NEG_INFINITY),
        (DropReason::Mean, |s, i| s.means[i][0] = -2e15),
        (DropReason::Rotation, |s, i| s.rotations[i][3] = f32::NAN),
        (DropReason::Rotation, |s, i| s.rotations[i][0] = f32::INFINITY),
        (DropReason::ZeroRotation, |s, i| s.rotations[i] = [9e-4, 0.0, 0.0, 0.0]),
        (DropReason::Scale, |s, i| s.log_scales[i][0] = f32::NAN),
        (DropReason::Scale, |s, i| s.log_scales[i][2] = 89.0),
        (DropReason::Opacity, |s, i| s.opacities[i] = f32::NAN),
        (DropReason::Color, |s, i| s.sh[4 * i][1] = f32::INFINITY),
        (DropReason::Color, |s, i| s.sh[4 * i + 3][2] = f32::NAN),
        (DropReason::Motion, |s, i| s.motion.as_mut().unwrap().polynomials[i][2][1] = f32::NAN),
        (DropReason::Motion, |s, i| s.motion.as_mut().unwrap().omegas[i][0] = f32::INFINITY),
        (DropReason::Time, |s, i| s.motion.as_mut().unwrap().centers[i] = f32::NAN),
        (DropReason::Time, |s, i| s.motion.as_mut().unwrap().widths[i] = -1.0),
    ];
    let clean = Recipe { count: 5000, sh_degree: 1, ..Recipe::default() }.moving(&Animation::default());
    for (reason, spoil) in cases {
        let mut splats = clean.clone();
        // At both ends, and across the pieces in which splats are looked at.
        for i in [0, 17, 4095, 4096, 4999] {
            spoil(&mut splats, i);
        }
        let result = sanitise(&mut splats);
        assert_eq!(result.dropped, [(reason, 5)].into(), "{reason}");
        assert_eq!(splats.len(), 4995);
        assert_eq!(defect(&splats), None);
        // The others are what they were, in order.
        assert_eq!(splats.means[0], clean.means[1]);
        assert_eq!(splats.means[4092], clean.means[4094]);
        assert_eq!(splats.sh_of(4994), clean.sh_of(4998));
        assert_eq!(
            splats.motion.as_ref().unwrap().centers[4994],
            clean.motion.as_ref().unwrap().centers[4998]
        );
    }
    // Negative control: nothing is dropped from a clean scene.
    let mut splats = clean.clone();
    assert!(sanitise(&mut splats).dropped.is_empty());
    assert_eq!(splats.means, clean.means);
}

#[test]
fn what_can_be_mended_is_mended_and_counted() {
    let mut splats = moving(3);
    splats.rotations[0] = [3e30, 0.0, 0.0, 4e30];
    splats.log_scales[1] = [f32::NEG_INFINITY, -1e9, -3.0];
    splats.opacities[1] = 1.5;
    let motion = splats.motion.as_mut().unwrap();
    motion.omegas[0] = [1e12, 0.0, 0.0, 0.0];
    motion.widths = vec![0.0, f32::INFINITY, 0.5];
    let result = sanitise(&mut splats);
    assert!(result.dropped.is_empty());
    assert_eq!((result.raised_scales, result.bounded_widths), (2, 2));
    assert!(difference(&splats.rotations[0], &[0.6, 0.0, 0.0, 0.8]) < 1e-7, "{:?}", splats.rotations[0]);
    assert_eq!(splats.log_scales[1], [MIN_LOG_SCALE, MIN_LOG_SCALE, -3.0]);
    assert_eq!(splats.opacities[1], 1.0);
    let motion = splats.motion.unwrap();
    assert!((motion.omegas[0][0] / 2e-19 - 1.0).abs() < 1e-6, "{:?}", motion.omegas[0]);
    assert_eq!(motion.widths, [MIN_WIDTH, f32::MAX, 0.5]);
}

#[test]
fn infinite_logits_mean_exactly_zero_and_one() {
    let mut columns = encode::columns(&still(4, 0));
    let opacity = columns.iter_mut().find(|c| c.name == "opacity").unwrap();
    opacity.values = vec![f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 0.0];
    for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
        let scene = read("a.ply", &encode::ply(&columns, encoding, false)).unwrap();
        assert_eq!(scene.splats.opacities, [1.0, 0.0, 0.5]);
        assert_eq!(scene.report.dropped, [(DropReason::Opacity, 1)].into());
        assert_eq!((scene.report.read, scene.report.kept), (4, 3));
    }
}

// PLY headers.

#[test]
fn messages_name_file_place_and_remedy() {
    let scene = still(3, 3);
    let spoil = |change: &dyn Fn(&mut Vec<Column>), encoding| {
        let mut columns = encode::columns(&scene);
        change(&mut columns);
        read("dir/a.ply", &encode::ply(&columns, encoding, false)).unwrap_err().to_string()
    };
    let remove = |name: &'static str| move |c: &mut Vec<Column>| c.retain(|c| c.name != name);
    let little = Encoding::Little;
    let text = encode::ply(&encode::columns(&scene), Encoding::Ascii, false);
    let text = String::from_utf8(text).unwrap();
    let messages = [
        (spoil(&remove("rot_2"), little), "missing properties: rot_2"),
        (spoil(&remove("scale_2"), little), "surfel"),
        (spoil(&remove("f_rest_7"), little), "there are 44"),
        (spoil(&|c| c.iter_mut().filter(|c| c.name == "y").for_each(|c| c.kind = "list"), little), "'y'"),
        (
            spoil(&|c| c.push(Column { kind: "float", name: "x".into(), values: vec![0.0; 3] }), little),
            "twice",
        ),
        (
            read("dir/a.ply", text.replace("end_header", "end_heade").as_bytes()).unwrap_err().to_string(),
            "header line",
        ),
        (
            read("dir/a.ply", text.trim_end().as_bytes().split_at(text.len() - 400).0)
                .unwrap_err()
                .to_string(),
            "line 70",
        ),
        (
            read("dir/a.ply", text.replacen("\n0.", "\nzero ", 1).as_bytes()).unwrap_err().to_string(),
            "'zero'",
        ),
        (read("dir/a.ply", b"").unwrap_err().to_string(), "the file is empty"),
        (read("dir/a.ply", b"glTF....").unwrap_err().to_string(), "glTF"),
        (
            read("dir/a.ply", &encode::plain_ply(&scene)[..2000]).unwrap_err().to_string(),
            "3 vertices of 248 bytes",
        ),
    ];
    for (message, expected) in messages {
        assert!(
            message.starts_with("dir/a.ply: ") && message.contains(expected),
            "'{expected}' in: {message}"
        );
    }
}

#[test]
fn harmonics_of_higher_degree_are_cut_with_a_warning() {
    let scene = still(5, 3);
    let mut columns: Vec<Column> =
        encode::columns(&scene).into_iter().filter(|c| !c.name.starts_with("f_rest_")).collect();
    // Degree 4: 24 coefficients per channel, of which the first 15 are those of degree 3.
    for c in 0..3 {
        for k in 0..24 {
            let values =
                (0..5).map(|i| if k < 15 { f64::from(scene.sh_of(i)[1 + k][c]) } else { 9.0 }).collect();
            columns.push(Column { kind: "float", name: format!("f_rest_{}", 24 * c + k), values });
        }
    }
    let found = read("a.ply", &encode::ply(&columns, Encoding::Little, false)).unwrap();
    assert_eq!(found.splats.sh, scene.sh);
    assert!(found.report.warnings[0].contains("degree 4"), "{:?}", found.report.warnings);
}

#[test]
fn bytes_behind_the_splats_are_reported() {
    let mut bytes = encode::plain_ply(&still(3, 0));
    bytes.extend([0; 13]);
    let scene = read("a.ply", &bytes).unwrap();
    assert!(scene.report.warnings[0].contains("13 bytes"), "{:?}", scene.report.warnings);
}

#[test]
fn scenes_without_splats_load_and_say_so() {
    for (name, bytes) in [
        ("a.ply", encode::plain_ply(&still(0, 1))),
        ("b.ply", encode::ply(&encode::columns(&still(0, 0)), Encoding::Ascii, false)),
        ("a.splat", Vec::new()),
        ("c.ply", encode::plain_ply(&moving(0))),
    ] {
        let scene = read(name, &bytes).unwrap();
        assert!(scene.splats.is_empty(), "{name}");
        assert!(scene.report.warnings[0].contains("no splats"), "{name}: {:?}", scene.report.warnings);
    }
}

#[test]
fn splats_larger_than_the_scene_are_reported() {
    let mut splats = still(500, 0);
    let warnings = |splats: &Splats| read("a.ply", &encode::plain_ply(splats)).unwrap().report.warnings;
    assert_eq!(warnings(&splats), [""; 0]);
    splats.log_scales[3][1] = 1.5;
    splats.log_scales[77] = [12.0; 3];
    assert!(warnings(&splats)[0].contains("2 splats are larger"), "{:?}", warnings(&splats));
}

#[test]
fn ascii_numbers_as_every_runtime_prints_them() {
    let mut text =
        String::from_utf8(encode::ply(&encode::columns(&still(7, 0)), Encoding::Ascii, false)).unwrap();
    let start = text.find("end_header\n").unwrap() + 11;
    let rows: Vec<String> = text[start..].lines().map(str::to_owned).collect();
    text.truncate(start);
    for (row, x) in rows.iter().zip(["nan", "-nan(ind)", "1.#QNAN", "-1.#INF", "INF", "+1.5E+00", "-.5"]) {
        // Windows line ends, blank lines, tabs and leading blanks, too.
        let (_, others) = row.split_once(' ').unwrap();
        text += &format!("  {x}\t{others}\r\n\r\n");
    }
    let scene = read("a.ply", text.trim_end().as_bytes()).unwrap();
    assert_eq!(scene.report.dropped, [(DropReason::Mean, 5)].into());
    assert_eq!([scene.splats.means[0][0], scene.splats.means[1][0]], [1.5, -0.5]);
}

#[test]
fn rows_beyond_four_gigabytes() {
    let folder = tempfile::tempdir().unwrap();
    let splats = still(9, 1);
    let plain = encode::plain_ply(&splats);
    let split = plain.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    // Five gigabytes of another element, which take no room on the disk.
    let header = String::from_utf8(plain[..split].to_vec()).unwrap();
    let header =
        header.replace("element vertex", "element junk 640000000\nproperty double a\nelement vertex");
    let path = folder.path().join("large.ply");
    let mut file = std::fs::File::create(&path).unwrap();
    file.write_all(header.as_bytes()).unwrap();
    file.seek(SeekFrom::Current(640_000_000 * 8)).unwrap();
    file.write_all(&plain[split..]).unwrap();
    drop(file);
    let found = load(&path, &LoadOptions::default()).unwrap();
    assert!(found.sources[0].bytes > 5_000_000_000);
    assert_eq!((found.splats.means, found.splats.sh), (splats.means, splats.sh));
}

#[test]
fn a_file_that_shrinks_while_it_is_read_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "a.ply", &encode::plain_ply(&still(50_000, 3)));
    let shrink = path.clone();
    let progress = Arc::new(move |_: &motes_scenes::Progress| {
        std::fs::OpenOptions::new().write(true).open(&shrink).unwrap().set_len(5000).unwrap();
    });
    let error = load(&path, &LoadOptions { progress: Some(progress), ..LoadOptions::default() }).unwrap_err();
    assert!(matches!(error, SceneError::Malformed { .. }), "{error}");
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(load(&path, &LoadOptions::default()), Err(SceneError::Io { .. })));
}

// Far from the origin.

#[test]
fn far_scenes_are_recentred_without_loss() {
    let scene = still(3000, 0);
    // UTM coordinates: an f32 resolves 3 and 50 cm there.
    let offset = [412_345.25, 5_812_345.5, 120.75];
    let mut columns = encode::columns(&scene);
    for (column, offset) in columns.iter_mut().zip(offset) {
        column.kind = "double";
        column.values.iter_mut().for_each(|v| *v += offset);
    }
    for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
        let found = read("far.ply", &encode::ply(&columns, encoding, false)).unwrap().splats;
        assert!((0..3).all(|k| (found.origin[k] - offset[k]).abs() < 1.0), "{:?}", found.origin);
        for i in 0..scene.len() {
            let mean = found.mean_of(i);
            for k in 0..3 {
                let error = mean[k] - (f64::from(scene.means[i][k]) + offset[k]);
                assert!(error.abs() < 2e-7, "{encoding:?}: {error}");
            }
        }
    }
    // Singles have lost it before, but are recentred, too.
    columns.iter_mut().for_each(|c| c.kind = "float");
    let found = read("far.ply", &encode::ply(&columns, Encoding::Little, false)).unwrap().splats;
    assert!((found.origin[1] - offset[1]).abs() < 1.0);
    assert!(found.means.as_flattened().iter().all(|v| v.abs() < 3.0));
    let worst = (0..scene.len())
        .map(|i| (found.mean_of(i)[1] - f64::from(scene.means[i][1]) - offset[1]).abs())
        .fold(0.0, f64::max);
    assert!(worst > 0.1 && worst <= 0.25, "{worst}");
    // A scene near its origin is left alone, and so is one with a few splats far out.
    let mut near = scene.clone();
    near.means[..100].fill([1e9; 3]);
    let found = read("near.ply", &encode::plain_ply(&near)).unwrap().splats;
    assert_eq!((found.origin, found.means), ([0.0; 3], near.means));
}

// Merging.

#[test]
fn merging_pads_harmonics_and_leaves_still_splats_alone() {
    let folder = tempfile::tempdir().unwrap();
    let parts = [still(50, 1), moving(40), still(30, 3)];
    let paths = [
        write(folder.path(), "a.ply", &encode::plain_ply(&parts[0])),
        write(folder.path(), "b.ply", &encode::plain_ply(&parts[1])),
        write(folder.path(), "c.ply", &encode::plain_ply(&parts[2])),
    ];
    let mut scene = load_many(&paths, &LoadOptions::default()).unwrap();
    assert_eq!(defect(&scene.splats), None);
    assert_eq!((scene.splats.len(), scene.splats.sh_degree), (120, 3));
    let ranges: Vec<_> = scene.sources.iter().map(|s| s.splats.clone()).collect();
    assert_eq!(ranges, [0..50, 50..90, 90..120]);
    assert_eq!(scene.sources.iter().map(|s| s.sh_degree).collect::<Vec<_>>(), [1, 0, 3]);
    assert_eq!(scene.sources[1].format, Format::SpacetimePly);
    assert_eq!(scene.sources[2].path, paths[2]);
    assert_eq!(scene.sources[2].bytes, std::fs::metadata(&paths[2]).unwrap().len());
    assert_eq!(scene.report.read, 120);

    let alone: Vec<Splats> = paths.iter().map(|p| load(p, &LoadOptions::default()).unwrap().splats).collect();
    for (part, range) in alone.iter().zip(&ranges) {
        assert_eq!(scene.splats.means[range.clone()], part.means);
        assert_eq!(scene.splats.rotations[range.clone()], part.rotations);
        assert_eq!(scene.splats.log_scales[range.clone()], part.log_scales);
        assert_eq!(scene.splats.opacities[range.clone()], part.opacities);
        for (i, j) in range.clone().enumerate() {
            let (own, merged) = (part.sh_of(i), scene.splats.sh_of(j));
            assert_eq!(merged[..own.len()], *own);
            assert!(merged[own.len()..].iter().all(|v| *v == [0.0; 3]));
        }
    }
    let motion = scene.splats.motion.as_ref().unwrap();
    for still in [0..50, 90..120] {
        assert!(motion.widths[still.clone()].iter().all(|w| *w == f32::MAX));
        assert!(motion.polynomials[still.clone()].as_flattened().as_flattened().iter().all(|v| *v == 0.0));
        assert!(motion.omegas[still].as_flattened().iter().all(|v| *v == 0.0));
    }
    let own = alone[1].motion.as_ref().unwrap();
    assert_eq!(motion.polynomials[50..90], own.polynomials);
    assert_eq!(motion.centers[50..90], own.centers);
    assert!(own.polynomials.as_flattened().as_flattened().iter().any(|v| *v != 0.0));

    scene.label_by_source();
    let labels = scene.splats.labels.unwrap();
    assert!((0..120).all(|i| labels[i]
        == if i < 50 {
            1
        } else if i < 90 {
            2
        } else {
            3
        }));
}

#[test]
fn merging_far_scenes_keeps_the_first_origin() {
    let folder = tempfile::tempdir().unwrap();
    let far = |name: &str, offset: f64| {
        let mut columns = encode::columns(&still(200, 0));
        columns[0].kind = "double";
        columns[0].values.iter_mut().for_each(|v| *v += offset);
        write(folder.path(), name, &encode::ply(&columns, Encoding::Little, false))
    };
    let paths = [far("a.ply", 1e6), far("b.ply", 1e6 + 500.0), far("c.ply", 3e6)];
    let scene = load_many(&paths, &LoadOptions::default()).unwrap();
    let first = still(200, 0).means[7][0];
    for (i, offset) in [(7, 1e6), (207, 1e6 + 500.0)] {
        assert!((scene.splats.mean_of(i)[0] - offset - f64::from(first)).abs() < 1e-4);
    }
    assert!((scene.splats.mean_of(407)[0] - 3e6 - f64::from(first)).abs() < 0.25);
    let warnings = &scene.report.warnings;
    assert!(
        warnings.len() == 1 && warnings[0].contains("c.ply") && warnings[0].contains("2000 km"),
        "{warnings:?}"
    );
}

#[test]
fn a_folder_of_scenes_is_merged_in_the_order_of_its_names() {
    let folder = tempfile::tempdir().unwrap();
    for (name, n) in [("part10.ply", 3), ("part2.ply", 2), ("PART1.SPLAT", 1)] {
        let bytes = if n == 1 { encode::splat(&still(n, 0)) } else { encode::plain_ply(&still(n, 0)) };
        write(folder.path(), name, &bytes);
    }
    write(folder.path(), "readme.txt", b"no scene");
    let scene = load(folder.path(), &LoadOptions::default()).unwrap();
    assert_eq!(scene.sources.iter().map(|s| s.splats.len()).collect::<Vec<_>>(), [1, 2, 3]);
    let nothing = tempfile::tempdir().unwrap();
    let error = load(nothing.path(), &LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no scene file"), "{error}");
}

// Sequences.

#[test]
fn frames_are_listed_in_the_order_of_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["frame_10.ply", "frame_9.ply", "frame_2.compressed.ply", "frame_0100.ply", "notes.txt"] {
        write(folder.path(), name, b"");
    }
    let names = |folder: &Path| -> Vec<String> {
        let frames = sequence_frames(folder).unwrap();
        frames.iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect()
    };
    assert_eq!(
        names(folder.path()),
        ["frame_2.compressed.ply", "frame_9.ply", "frame_10.ply", "frame_0100.ply"]
    );
    assert!(looks_like_sequence(folder.path()));
    write(folder.path(), "environment.sog", b"");
    assert!(!looks_like_sequence(folder.path()));

    let samples = samples();
    assert_eq!(names(&samples.join("4d/flipbook_monkey")).len(), 12);
    assert!(looks_like_sequence(&samples.join("4d/flipbook_monkey")));
    for parts in
        ["static/lacadiere_lod3", "static/hq_garden_lod2", "static/flowers_lod0", "static/statues", "4d"]
    {
        assert!(!looks_like_sequence(&samples.join(parts)), "{parts}");
    }
    let error = sequence_frames(&samples.join("static/playbot")).unwrap_err().to_string();
    assert!(error.contains("one scene"), "{error}");
}

// Options.

#[test]
fn progress_rises_to_the_end_for_every_file() {
    let folder = tempfile::tempdir().unwrap();
    let text = encode::ply(&encode::columns(&still(5000, 3)), Encoding::Ascii, false);
    let mut columns = encode::columns(&still(9000, 0));
    encode::disorder(&mut columns, 3);
    let paths = [
        write(folder.path(), "a.ply", &encode::plain_ply(&still(20_000, 3))),
        write(folder.path(), "b.ply", &text),
        write(folder.path(), "c.ply", &encode::ply(&columns, Encoding::Little, true)),
        write(folder.path(), "d.ply", &encode::compressed_ply(&still(50_000, 1))),
    ];
    let seen = Arc::new(Mutex::new(Vec::new()));
    let progress = {
        let seen = Arc::clone(&seen);
        Arc::new(move |p: &motes_scenes::Progress| seen.lock().unwrap().push(p.clone()))
    };
    load_many(&paths, &LoadOptions { progress: Some(progress), ..LoadOptions::default() }).unwrap();
    let seen = seen.lock().unwrap();
    for (i, path) in paths.iter().enumerate() {
        let fractions: Vec<f32> = seen.iter().filter(|p| p.file == i).map(|p| p.fraction).collect();
        assert!(seen.iter().filter(|p| p.file == i).all(|p| p.path == *path && p.files == 4));
        let last = fractions.iter().copied().fold(0.0, f32::max);
        assert!(
            fractions.len() >= 2 && fractions.len() <= 210 && last > 0.85,
            "{}: {fractions:?}",
            path.display()
        );
    }
}

#[test]
fn loading_can_be_cancelled() {
    let bytes: Arc<[u8]> = encode::plain_ply(&still(50_000, 3)).into();
    let cancel = CancelToken::default();
    let calls = Arc::new(Mutex::new(0));
    let options = LoadOptions {
        cancel: cancel.clone(),
        progress: Some({
            let calls = Arc::clone(&calls);
            Arc::new(move |p: &motes_scenes::Progress| {
                *calls.lock().unwrap() += 1;
                if p.fraction > 0.2 {
                    cancel.cancel();
                }
            })
        }),
        ..LoadOptions::default()
    };
    let result = load_bytes(Path::new("a.ply"), Arc::clone(&bytes), &options);
    assert!(matches!(result, Err(SceneError::Cancelled { .. })), "{result:?}");
    // Soon after the fifth of the file at which it was asked for.
    assert!(*calls.lock().unwrap() < 48);
    assert!(load_bytes(Path::new("a.ply"), bytes, &LoadOptions::default()).is_ok());
}

#[test]
fn limits_refuse_before_allocating() {
    let bytes: Arc<[u8]> = encode::plain_ply(&still(1000, 3)).into();
    let load = |limits| {
        load_bytes(Path::new("a.ply"), Arc::clone(&bytes), &LoadOptions { limits, ..LoadOptions::default() })
    };
    let exact = Limits { splats: 1000, memory: 236_000 };
    assert!(load(exact).is_ok());
    for limits in [Limits { splats: 999, ..exact }, Limits { memory: 235_999, ..exact }] {
        let error = load(limits).unwrap_err();
        assert!(matches!(error, SceneError::TooLarge { .. }), "{error}");
    }
}

// Saving.

/// Largest differences of what every format keeps: means, rotations (rad), log-scales, opacities, colours.
fn differences(a: &Splats, b: &Splats) -> [f64; 5] {
    assert_eq!(a.len(), b.len());
    let dc = |s: &Splats| -> Vec<f32> { (0..s.len()).flat_map(|i| s.sh_of(i)[0]).collect() };
    [
        f64::from(difference(a.means.as_flattened(), b.means.as_flattened())),
        a.rotations.iter().zip(&b.rotations).map(|(a, b)| angle(*a, *b)).fold(0.0, f64::max),
        f64::from(difference(a.log_scales.as_flattened(), b.log_scales.as_flattened())),
        f64::from(difference(&a.opacities, &b.opacities)),
        f64::from(difference(&dc(a), &dc(b)) * SH_C0),
    ]
}

#[test]
fn a_saved_ply_is_the_trainers_layout_and_loads_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    for degree in 0..=3 {
        let mut splats = still(700, degree);
        splats.opacities[..5].copy_from_slice(&[0.0, 1.0, 1.0 - f32::EPSILON / 2.0, 1e-30, 0.5]);
        let path = folder.path().join(format!("{degree}.ply"));
        save(&path, &splats).unwrap();
        // Byte for byte what the test's own encoder makes of it, but for the header's comment and opacities (which
        // stay finite).
        let saved = std::fs::read(&path).unwrap();
        let row = 4 * (17 + 3 * (sh_coefficients(degree) - 1));
        let own = encode::plain_ply(&splats);
        assert_eq!(saved[saved.len() - row * 695..], own[own.len() - row * 695..]);
        let found = load(&path, &LoadOptions::default()).unwrap();
        assert_eq!(found.report.dropped_total(), 0);
        assert_eq!(found.splats.sh, splats.sh);
        let d = differences(&found.splats, &splats);
        assert!(d[0] == 0.0 && d[1] < 3e-7 && d[2] == 0.0 && d[3] < 2e-7 && d[4] == 0.0, "{d:?}");
        assert_eq!(found.splats.opacities[..3], splats.opacities[..3]);
    }
    // 248 bytes a splat at degree 3.
    assert!((std::fs::metadata(folder.path().join("3.ply")).unwrap().len() - 700 * 248) < 2000);
    // Negative control.
    let mut other = still(700, 0);
    other.log_scales[99][2] += 1e-3;
    let found = load(&folder.path().join("0.ply"), &LoadOptions::default()).unwrap().splats;
    assert!(differences(&found, &other)[2] > 9e-4);
}

#[test]
fn a_saved_moving_scene_moves_as_it_did() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("moving.ply");
    let splats = moving(500);
    save(&path, &splats).unwrap();
    let found = load(&path, &LoadOptions::default()).unwrap();
    assert_eq!(found.sources[0].format, Format::SpacetimePly);
    let d = differences(&found.splats, &splats);
    assert!(d[0] == 0.0 && d[1] < 3e-7 && d[2] == 0.0 && d[3] < 2e-7 && d[4] < 2e-7, "{d:?}");
    let (a, b) = (found.splats.motion.unwrap(), splats.motion.unwrap());
    assert_eq!((a.centers, &a.polynomials), (b.centers, &b.polynomials));
    assert!(difference(a.omegas.as_flattened(), b.omegas.as_flattened()) < 3e-7);
    let (mut endless, mut fleeting) = (0, 0);
    for (a, b) in a.widths.iter().zip(&b.widths) {
        if *b == f32::MAX {
            assert_eq!(*a, f32::MAX);
            endless += 1;
        } else {
            assert!((a / b - 1.0).abs() < 1e-6);
            fleeting += 1;
        }
    }
    assert!(endless > 100 && fleeting > 100);
}

#[test]
fn a_far_scene_is_saved_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("far.ply");
    let mut splats = still(100, 0);
    splats.origin = [4e5, 5.8e6, 100.0];
    save(&path, &splats).unwrap();
    let found = load(&path, &LoadOptions::default()).unwrap().splats;
    for i in 0..100 {
        let (a, b) = (found.mean_of(i), splats.mean_of(i));
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 2e-7), "{a:?} {b:?}");
    }
}

#[test]
fn a_saved_splat_file_is_within_its_steps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    let splats = still(400, 2);
    save(&path, &splats).unwrap();
    assert_eq!(std::fs::metadata(&path).unwrap().len(), 400 * 32);
    let found = load(&path, &LoadOptions::default()).unwrap().splats;
    let d = differences(&found, &splats);
    let byte = 0.5 / 255.0 + 1e-6;
    assert!(d[0] == 0.0 && d[1] < 1.7e-2 && d[2] < 1e-6 && d[3] < byte && d[4] < byte, "{d:?}");
    // Bytes survive another turn.
    save(&path, &found).unwrap();
    let again = load(&path, &LoadOptions::default()).unwrap().splats;
    assert_eq!((again.opacities, again.sh), (found.opacities, found.sh));
    assert!(again.rotations.iter().zip(&found.rotations).all(|(a, b)| angle(*a, *b) < 1.7e-2));
}

#[test]
fn saving_leaves_no_half_file_and_knows_its_extensions() {
    let folder = tempfile::tempdir().unwrap();
    let error = save(&folder.path().join("a.obj"), &still(1, 0)).unwrap_err().to_string();
    assert!(error.contains(".obj") && error.contains(".ply"), "{error}");
    let error = save(&folder.path().join("nowhere/a.ply"), &still(1, 0)).unwrap_err().to_string();
    assert!(error.contains("nowhere"), "{error}");
    save(&folder.path().join("A.PLY"), &still(1, 0)).unwrap();
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["A.PLY"]);
}
