//! One known splat per format, anisotropic and coloured: axes, order of quaternions, logarithms, order of harmonics.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail them")]

mod common;

use common::encode::{self, Encoding};
use common::{angle, difference, pack, read};
use motes_scenes::{Format, LoadOptions, Motion, SH_C0, Splats, load, sh_coefficients};

/// Largest errors that a format's quantisation allows.
struct Tolerance {
    mean: f32,
    /// Radians.
    rotation: f64,
    log_scale: f32,
    opacity: f32,
    color: f32,
    sh: f32,
}

const EXACT: Tolerance =
    Tolerance { mean: 0.0, rotation: 2e-7, log_scale: 0.0, opacity: 2e-7, color: 2e-7, sh: 0.0 };

/// Splats of which no two numbers are alike, the first being the known one.
fn known(sh_degree: u8, moving: bool) -> Splats {
    let n = 7;
    let mut splats = Splats::zeroed(n, sh_degree, moving);
    let coefficients = sh_coefficients(sh_degree);
    for i in 0..n {
        let t = i as f32;
        splats.means[i] = [0.5 + 0.1 * t, -1.25 + 0.07 * t, 2.0 - 0.11 * t];
        let q = [0.1, -0.3 + 0.1 * t, 0.5, 0.8];
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        splats.rotations[i] = q.map(|v| v / length);
        splats.log_scales[i] = [-0.7 - 0.1 * t, -3.0, -5.3];
        splats.opacities[i] = 153.0 / 255.0;
        for k in 0..coefficients {
            splats.sh[i * coefficients + k] = std::array::from_fn(|c| match k {
                0 => ([204.0, 102.0, 51.0][c] / 255.0 - 0.5) / SH_C0,
                _ => 0.03 * (k as f32 - 7.0) + 0.25 * (c as f32 - 1.0),
            });
        }
        if let Some(motion) = &mut splats.motion {
            motion.centers[i] = 0.25 + 0.1 * t;
            motion.widths[i] = 0.125 + 0.05 * t;
            motion.polynomials[i] = [[0.1, 0.2, 0.3], [-0.4, 0.5, 0.6], [0.7, -0.8, 0.9]];
            motion.omegas[i] = [0.05, -0.06, 0.07, 0.08 + 0.1 * t];
        }
    }
    splats
}

/// Why `found` is not `expected`, if it is not.
fn mismatch(found: &Splats, expected: &Splats, tolerance: &Tolerance) -> Option<String> {
    if (found.len(), found.sh_degree) != (expected.len(), expected.sh_degree) {
        return Some(format!("{} splats of degree {}", found.len(), found.sh_degree));
    }
    let too_far = |name: &str, a: &[f32], b: &[f32], limit: f32| {
        let d = difference(a, b);
        (!(d <= limit)).then(|| format!("{name} differ by {d}, more than {limit}"))
    };
    let bands = |s: &Splats, constant: bool| -> Vec<f32> {
        let n = sh_coefficients(s.sh_degree);
        s.sh.iter().enumerate().filter(|(i, _)| (i % n == 0) == constant).flat_map(|(_, v)| *v).collect()
    };
    too_far("means", found.means.as_flattened(), expected.means.as_flattened(), tolerance.mean)
        .or_else(|| {
            let worst = found
                .rotations
                .iter()
                .zip(&expected.rotations)
                .map(|(a, b)| angle(*a, *b))
                .fold(0.0, f64::max);
            (!(worst <= tolerance.rotation)).then(|| format!("rotations differ by {worst} rad"))
        })
        .or_else(|| {
            let (a, b) = (found.log_scales.as_flattened(), expected.log_scales.as_flattened());
            too_far("log-scales", a, b, tolerance.log_scale)
        })
        .or_else(|| too_far("opacities", &found.opacities, &expected.opacities, tolerance.opacity))
        .or_else(|| too_far("colours", &bands(found, true), &bands(expected, true), tolerance.color / SH_C0))
        .or_else(|| too_far("harmonics", &bands(found, false), &bands(expected, false), tolerance.sh))
}

fn check(name: &str, bytes: &[u8], format: Format, expected: &Splats, tolerance: &Tolerance) -> Splats {
    let scene = read(name, bytes).unwrap();
    assert_eq!(scene.sources[0].format, format, "{name}");
    assert_eq!(scene.report.dropped_total(), 0, "{name}");
    if let Some(problem) = mismatch(&scene.splats, expected, tolerance) {
        panic!("{name}: {problem}");
    }
    scene.splats
}

/// Largest difference per motion array: centres, widths (relative), polynomials, omegas.
fn motion_differences(a: &Motion, b: &Motion) -> [f32; 4] {
    let widths: Vec<f32> = a.widths.iter().zip(&b.widths).map(|(a, b)| a / b - 1.0).collect();
    [
        difference(&a.centers, &b.centers),
        difference(&widths, &vec![0.0; widths.len()]),
        difference(a.polynomials.as_flattened().as_flattened(), b.polynomials.as_flattened().as_flattened()),
        difference(a.omegas.as_flattened(), b.omegas.as_flattened()),
    ]
}

#[test]
fn ply_in_every_encoding_order_and_type() {
    for degree in 0..=3 {
        let expected = known(degree, false);
        for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
            let plain = encode::ply(&encode::columns(&expected), encoding, false);
            check("plain.ply", &plain, Format::Ply, &expected, &EXACT);
            for seed in 0..10 {
                let mut columns = encode::columns(&expected);
                encode::disorder(&mut columns, seed);
                let more = seed % 2 == 1;
                check("lists.ply", &encode::ply(&columns, encoding, more), Format::Ply, &expected, &EXACT);
                columns.retain(|c| c.kind != "list");
                check("order.ply", &encode::ply(&columns, encoding, more), Format::Ply, &expected, &EXACT);
            }
        }
    }
}

#[test]
fn ply_quaternions_of_any_length_are_normalised() {
    let expected = known(0, false);
    let mut columns = encode::columns(&expected);
    for c in columns.iter_mut().filter(|c| c.name.starts_with("rot_")) {
        c.values.iter_mut().for_each(|v| *v *= -3.7);
    }
    check("long.ply", &encode::ply(&columns, Encoding::Little, false), Format::Ply, &expected, &EXACT);
}

#[test]
fn spacetime_ply_has_raw_colours_and_divides_omega_with_the_rotation() {
    let mut expected = known(0, true);
    let mut columns = encode::columns(&expected);
    assert_eq!(columns.len(), 32);
    for c in columns.iter_mut().filter(|c| c.name.starts_with("rot_") || c.name.starts_with("omega_")) {
        c.values.iter_mut().for_each(|v| *v *= 2.5);
    }
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        let found = check(
            "moving.ply",
            &encode::ply(&columns, encoding, false),
            Format::SpacetimePly,
            &expected,
            &Tolerance { mean: 0.0, rotation: 3e-7, log_scale: 0.0, opacity: 2e-7, color: 2e-7, sh: 0.0 },
        );
        let d = motion_differences(found.motion.as_ref().unwrap(), expected.motion.as_ref().unwrap());
        assert!(d[0] == 0.0 && d[1] < 1e-6 && d[2] == 0.0 && d[3] < 1e-7, "{d:?}");
    }
    // Negative control: another omega is noticed.
    expected.motion.as_mut().unwrap().omegas[3][2] += 1e-3;
    let found = read("moving.ply", &encode::ply(&columns, Encoding::Little, false)).unwrap().splats;
    let d = motion_differences(found.motion.as_ref().unwrap(), expected.motion.as_ref().unwrap());
    assert!(d[3] > 9e-4, "{d:?}");
}

#[test]
fn full_model_spacetime_gaussians_are_refused_with_the_reason() {
    let mut columns = encode::columns(&known(0, true));
    for k in 0..3 {
        columns.push(encode::Column { kind: "float", name: format!("f_t_{k}"), values: vec![0.0; 7] });
    }
    let error = read("full.ply", &encode::ply(&columns, Encoding::Little, false)).unwrap_err().to_string();
    assert!(error.contains("neural network") && error.contains("full.ply"), "{error}");
}

#[test]
fn compressed_ply() {
    for degree in 0..=3 {
        let expected = known(degree, false);
        // Bounds of a chunk over 2047 and 1023 steps, 10-bit components, bytes, 256 steps of 1/32.
        let tolerance = Tolerance {
            mean: 0.7 / 1023.0,
            rotation: 4e-3,
            log_scale: 1.0 / 1023.0,
            opacity: 1e-6,
            color: 1e-6,
            sh: 1.01 / 64.0,
        };
        check("a.ply", &encode::compressed_ply(&expected), Format::CompressedPly, &expected, &tolerance);
    }
}

#[test]
fn splat() {
    let expected = known(0, false);
    // Four components of error 1/255 each.
    let tolerance =
        Tolerance { mean: 0.0, rotation: 1.7e-2, log_scale: 1e-6, opacity: 1e-6, color: 1e-6, sh: 0.0 };
    check("a.splat", &encode::splat(&expected), Format::Splat, &expected, &tolerance);
}

#[test]
fn splatv() {
    let expected = known(0, true);
    let tolerance =
        Tolerance { mean: 0.0, rotation: 2e-3, log_scale: 6e-4, opacity: 1e-6, color: 1e-6, sh: 0.0 };
    // Found by its magic number, whatever its name.
    let found = check("a.bin", &encode::splatv(&expected), Format::SplatV, &expected, &tolerance);
    let d = motion_differences(found.motion.as_ref().unwrap(), expected.motion.as_ref().unwrap());
    assert!(d[0] < 3e-4 && d[1] < 6e-4 && d[2] < 3e-4 && d[3] < 3e-4, "{d:?}");
}

#[test]
fn ksplat_in_sections_and_in_full_buckets() {
    let tolerance = Tolerance {
        mean: 5.0 / 2.0 / 32767.0,
        rotation: 2e-3,
        log_scale: 6e-4,
        opacity: 1e-6,
        color: 1e-6,
        sh: 1.01 / 255.0,
    };
    let all = known(1, false);
    for level in [1, 2] {
        // Each section ends where the next one begins, and a file that ends within one is refused.
        let parts = [all.selected(&[0, 1, 2, 3, 4]), all.selected(&[5, 6])];
        let file = encode::ksplat_of_sections(&parts.each_ref().map(|p| encode::ksplat(p, level)));
        check("a.ksplat", &file, Format::KSplat, &all, &tolerance);
        let error = read("a.ksplat", &file[..file.len() - 1]).unwrap_err().to_string();
        assert!(error.contains("ends"), "{error}");
        let full = all.selected(&[0, 1, 2, 3]);
        let file = encode::ksplat_in_full_buckets(&full, level);
        check("a.ksplat", &file, Format::KSplat, &full, &tolerance);
    }
}

#[test]
fn ksplat_at_every_level() {
    for (level, sh) in [(0, 0.0), (1, 3e-4), (2, 1.01 / 255.0)] {
        for degree in 0..=3 {
            let expected = known(degree, false);
            let half = level > 0;
            let tolerance = Tolerance {
                mean: if half { 5.0 / 2.0 / 32767.0 } else { 0.0 },
                rotation: if half { 2e-3 } else { 2e-7 },
                log_scale: if half { 6e-4 } else { 1e-6 },
                opacity: 1e-6,
                color: 1e-6,
                sh,
            };
            check("a.ksplat", &encode::ksplat(&expected, level), Format::KSplat, &expected, &tolerance);
        }
    }
}

#[test]
fn sog_of_both_versions_zipped_and_in_a_folder() {
    for version in [1, 2] {
        for degree in 0..=3 {
            let expected = known(degree, false);
            // Version 1: 256 steps per range. The ranges: log-scales 0.6 and 1, logits 12, harmonics 0.92.
            let coarse = |steps: f32| if version == 1 { steps * 0.51 / 255.0 } else { 0.0 };
            let tolerance = Tolerance {
                mean: 3e-5,
                // Half a step in three components, and what follows for the largest: at most √12 of it, twice.
                rotation: 2.0 * 3.47 / 255.0 * 0.7072,
                log_scale: coarse(1.0),
                opacity: coarse(12.0 / 4.0).max(1e-6),
                color: coarse(1.0).max(2e-7),
                sh: coarse(0.92),
            };
            let files = pack::sog(&expected, version);
            for (below, deflate) in [("", false), ("", true), ("scene/", false)] {
                let zip = pack::zip(&files, below, deflate);
                check("a.bin", &zip, Format::Sog, &expected, &tolerance);
            }
            let folder = tempfile::tempdir().unwrap();
            pack::unzip(&files, folder.path());
            for path in [folder.path().to_owned(), folder.path().join("meta.json")] {
                let scene = load(&path, &LoadOptions::default()).unwrap();
                assert_eq!(mismatch(&scene.splats, &expected, &tolerance), None, "version {version}");
                let bytes: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
                assert_eq!(scene.sources[0].bytes, bytes as u64);
            }
        }
    }
}

#[test]
fn spz_of_every_version() {
    for version in 1..=4 {
        for degree in 0..=3 {
            let expected = known(degree, false);
            let tolerance = Tolerance {
                // Half a step of 12 bits; of a half float between 1 and 2, and 2 and 4.
                mean: if version == 1 { 1.0 / 1024.0 } else { 0.51 / 4096.0 },
                rotation: if version < 3 { 2e-2 } else { 3.47 / 511.0 * 0.7072 },
                log_scale: 0.51 / 16.0,
                opacity: 1e-6,
                color: 0.51 / 255.0 / 0.15 * SH_C0,
                sh: 0.51 / 128.0,
            };
            check("a.bin", &pack::spz(&expected, version), Format::Spz, &expected, &tolerance);
        }
    }
}

#[test]
fn what_spz_writes_it_reads() {
    for degree in 0..=3 {
        let expected = known(degree, false);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spz");
        motes_scenes::save(&path, &expected).unwrap();
        let tolerance = Tolerance {
            mean: 0.51 / 65536.0,
            rotation: 3.47 / 511.0 * 0.7072,
            log_scale: 0.51 / 16.0,
            opacity: 1e-6,
            color: 0.51 / 255.0 / 0.15 * SH_C0,
            sh: if degree < 2 { 4.01 / 128.0 } else { 8.01 / 128.0 },
        };
        check("a.spz", &std::fs::read(&path).unwrap(), Format::Spz, &expected, &tolerance);
    }
    // The coordinates' precision follows the extent, and an origin far out is no obstacle.
    for (far, error) in [(100.0, 8e-6), (1_300.0, 1.3e-4), (3e6, 0.26)] {
        let mut splats = known(0, false);
        splats.origin = [far, 0.0, -far];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("far.spz");
        motes_scenes::save(&path, &splats).unwrap();
        let found = load(&path, &LoadOptions::default()).unwrap().splats;
        for i in 0..splats.len() {
            for (a, b) in found.mean_of(i).into_iter().zip(splats.mean_of(i)) {
                assert!((a - b).abs() <= error, "{far} m out: {a}, not {b}");
            }
        }
    }
    let mut splats = known(0, false);
    splats.origin = [1e7, 0.0, 0.0];
    let error = motes_scenes::save(&std::env::temp_dir().join("x.spz"), &splats).unwrap_err().to_string();
    assert!(error.contains("farther out") && error.contains("x.spz"), "{error}");
}

/// The comparison that every test here rests on sees a swapped axis, a missing logarithm, another order of harmonics.
#[test]
fn mistakes_are_noticed() {
    let expected = known(3, false);
    let loose =
        Tolerance { mean: 1e-2, rotation: 2e-2, log_scale: 1e-2, opacity: 1e-2, color: 1e-2, sh: 2e-2 };
    assert_eq!(mismatch(&expected, &expected, &loose), None);
    type Mistake = fn(&mut Splats);
    let mistakes: [(&str, Mistake); 7] = [
        ("means", |s| s.means[0].swap(0, 1)),
        ("rotations", |s| s.rotations[0].rotate_left(1)),
        ("rotations", |s| s.rotations[0][1] *= -1.0),
        ("log-scales", |s| s.log_scales[0].swap(1, 2)),
        ("opacities", |s| s.opacities[0] = 0.64),
        ("colours", |s| s.sh[0].swap(0, 2)),
        ("harmonics", |s| s.sh.swap(1, 2)),
    ];
    for (what, mistake) in mistakes {
        let mut wrong = expected.clone();
        mistake(&mut wrong);
        let found = mismatch(&wrong, &expected, &loose);
        assert!(found.as_ref().is_some_and(|m| m.starts_with(what)), "{what}: {found:?}");
    }
}
