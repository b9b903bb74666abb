//! Damaged files give an error or a valid scene: never a panic, a hang, or an allocation beyond four times the file
//! and 64 MiB.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail them")]

mod common;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;

use common::allocation::{Counting, peak};
use common::encode::{self, Encoding};
use common::{defect, samples};
use motes_scenes::synthetic::{Animation, Random, Recipe};
use motes_scenes::{LoadOptions, Scene, SceneError, Splats, load_bytes};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Memory is counted for the whole process: one test at a time.
static TURN: Mutex<()> = Mutex::new(());

/// Files loaded so far, for [`watch`].
static LOADED: AtomicU64 = AtomicU64::new(0);

fn take_turn() -> MutexGuard<'static, ()> {
    watch();
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Ends the process when a minute passes without a file having been loaded: something hangs.
fn watch() {
    static START: Once = Once::new();
    START.call_once(|| {
        std::thread::spawn(|| {
            loop {
                let before = LOADED.load(Ordering::Relaxed);
                std::thread::sleep(Duration::from_secs(60));
                if LOADED.load(Ordering::Relaxed) == before {
                    eprintln!("a file has been loading for a minute: it hangs");
                    std::process::exit(101);
                }
            }
        });
    });
}

fn allowed(file: usize) -> usize {
    4 * file + (64 << 20)
}

/// What is wrong with how a file was dealt with.
fn offence(
    result: std::thread::Result<Result<Scene, SceneError>>,
    memory: usize,
    name: &str,
    len: usize,
) -> Option<String> {
    if memory > allowed(len) {
        return Some(format!("{memory} bytes were allocated for a file of {len}"));
    }
    match result {
        Err(_) => Some("panic".to_owned()),
        Ok(Ok(scene)) => defect(&scene.splats),
        Ok(Err(error)) => {
            let text = error.to_string();
            (!text.contains(name) || text.len() > 1000).then(|| format!("unhelpful message: {text}"))
        }
    }
}

/// Loads a file; whether it could be read.
fn try_load(name: &str, bytes: &[u8], what: &str) -> bool {
    let bytes: Arc<[u8]> = Arc::from(bytes);
    let len = bytes.len();
    let (result, memory) = peak(|| {
        catch_unwind(AssertUnwindSafe(|| load_bytes(Path::new(name), bytes, &LoadOptions::default())))
    });
    LOADED.fetch_add(1, Ordering::Relaxed);
    let read = matches!(result, Ok(Ok(_)));
    if let Some(offence) = offence(result, memory, name, len) {
        panic!("{name}, {what}: {offence}");
    }
    read
}

/// Small files of every format and flavour.
fn small_files() -> Vec<(&'static str, Vec<u8>)> {
    let still = |sh_degree, count| Recipe { count, sh_degree, ..Recipe::default() }.still();
    let moving: Splats = Recipe { count: 60, ..Recipe::default() }.moving(&Animation::default());
    let disordered = |encoding, more| {
        let mut columns = encode::columns(&still(1, 40));
        encode::disorder(&mut columns, 5);
        encode::ply(&columns, encoding, more)
    };
    vec![
        ("little.ply", encode::plain_ply(&still(3, 40))),
        ("big.ply", encode::ply(&encode::columns(&still(0, 60)), Encoding::Big, false)),
        ("ascii.ply", encode::ply(&encode::columns(&still(0, 30)), Encoding::Ascii, false)),
        ("lists.ply", disordered(Encoding::Little, true)),
        ("lists-big.ply", disordered(Encoding::Big, false)),
        ("lists-ascii.ply", disordered(Encoding::Ascii, true)),
        ("moving.ply", encode::plain_ply(&moving)),
        ("chunks.compressed.ply", encode::compressed_ply(&still(0, 300))),
        ("harmonics.compressed.ply", encode::compressed_ply(&still(3, 280))),
        ("a.splat", encode::splat(&still(0, 101))),
        ("a.splatv", encode::splatv(&moving)),
        ("level0.ksplat", encode::ksplat(&still(1, 30), 0)),
        ("level1.ksplat", encode::ksplat(&still(2, 30), 1)),
        ("level2.ksplat", encode::ksplat(&still(3, 30), 2)),
    ]
}

#[test]
fn files_cut_anywhere() {
    let _turn = take_turn();
    for (name, bytes) in small_files() {
        assert!(try_load(name, &bytes, "whole"));
        let mut refused = 0;
        for percent in 0..100 {
            let cut = bytes.len() * percent / 100;
            refused += usize::from(!try_load(name, &bytes[..cut], &format!("cut to {cut} bytes")));
        }
        // A .splat that ends between two splats is a shorter .splat.
        assert!(refused > 60, "{name}: {refused} of 100 cuts were refused");
        // And around the headers, byte by byte.
        for cut in 0..bytes.len().min(600) {
            try_load(name, &bytes[..cut], &format!("cut to {cut} bytes"));
        }
    }
}

/// Overwrites some bytes, one of four ways.
fn damage(bytes: &mut [u8], random: &mut Random) {
    let n = 1 + random.below(8);
    let kind = random.below(4);
    for _ in 0..n {
        match kind {
            // Anything, anywhere.
            0 => {
                let at = random.below(bytes.len() as u64) as usize;
                bytes[at] = random.bits() as u8;
            }
            // Anything, in the header.
            1 => {
                let at = random.below(bytes.len().min(700) as u64) as usize;
                bytes[at] = random.bits() as u8;
            }
            // Numbers that are troublesome as a count or as a float, where binary headers have theirs.
            2 => {
                let troublesome =
                    [0, 1, u32::MAX, i32::MAX as u32, 1 << 31, 0x7f80_0000, 0x7fc0_0000, 1 << 24];
                let value = troublesome[random.below(troublesome.len() as u64) as usize];
                let at = (random.below((bytes.len().min(5200) / 4) as u64) * 4) as usize;
                if let Some(place) = bytes.get_mut(at..at + 4) {
                    place.copy_from_slice(&value.to_le_bytes());
                }
            }
            // Other digits, where text has some.
            _ => {
                let start = random.below(bytes.len().min(1500) as u64) as usize;
                if let Some(digit) = bytes[start..].iter_mut().find(|b| b.is_ascii_digit()) {
                    *digit = b'0' + random.below(10) as u8;
                }
            }
        }
    }
}

#[test]
fn files_with_bytes_overwritten() {
    let _turn = take_turn();
    for (name, bytes) in small_files() {
        let mut read = 0;
        for seed in 0..1000 {
            let mut damaged = bytes.clone();
            damage(&mut damaged, &mut Random::new(seed));
            read += u32::from(try_load(name, &damaged, &format!("seed {seed}")));
        }
        let expected =
            if name.ends_with("splat") && !name.ends_with("ksplat") { 1000..=1000 } else { 20..=995 };
        assert!(expected.contains(&read), "{name}: {read} of 1000 could be read");
    }
}

#[test]
fn headers_that_promise_too_much() {
    let _turn = take_turn();
    let scene = Recipe { count: 3, ..Recipe::default() }.still();
    for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
        for more in [false, true] {
            let file = encode::ply(&encode::columns(&scene), encoding, more);
            let end = file.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            let header = String::from_utf8(file[..end].to_vec()).unwrap();
            for count in ["4", "1000000", "4294967295", "18446744073709551615", "99999999999999999999"] {
                for element in ["vertex 3", "face 2"].iter().filter(|e| header.contains(*e)) {
                    let name = element.split(' ').next().unwrap();
                    let promise = header.replace(element, &format!("{name} {count}"));
                    let bytes = [promise.as_bytes(), &file[end..]].concat();
                    assert!(!try_load("promise.ply", &bytes, count), "{element} as {count}, {encoding:?}");
                }
            }
        }
    }
    // A header without end.
    let mut endless = b"ply\nformat ascii 1.0\ncomment ".to_vec();
    endless.resize(10 << 20, b'x');
    assert!(!try_load("endless.ply", &endless, "comment"));
    // A line without end.
    let mut line = encode::ply(&encode::columns(&scene), Encoding::Ascii, false);
    assert_eq!(line.pop(), Some(b'\n'));
    line.resize(10 << 20, b'1');
    assert!(!try_load("line.ply", &line, "line"));
    // Nothing but lists, of no items.
    let columns = vec![encode::Column { kind: "list", name: "a".into(), values: vec![0.0; 1000] }];
    assert!(!try_load("lists.ply", &encode::ply(&columns, Encoding::Little, false), "lists"));
}

/// Real files, where four times the file is what counts.
#[test]
fn sample_files_cut_anywhere() {
    let _turn = take_turn();
    for name in [
        "static/fruit_drops_minimal.ply",
        "static/skull_sh3.compressed.ply",
        "static/guitar.compressed.ply",
        "static/lucy_100k.splat",
        "static/plant_l1.ksplat",
        "4d/spinach_4.splatv",
        "4d/yellow_clip3.splatv",
        "4d/spinach_stg_lite.ply",
        "photos_snowmiku/snowmiku_sh3.ply",
    ] {
        let bytes = std::fs::read(samples().join(name)).unwrap();
        assert!(try_load(name, &bytes, "whole"));
        for percent in 0..100 {
            try_load(name, &bytes[..bytes.len() * percent / 100], &format!("cut at {percent} %"));
        }
    }
}

/// A trained scene, read straight into its arrays: less memory than the file has bytes, and a buffer per thread.
#[test]
fn a_ply_needs_no_second_copy() {
    let _turn = take_turn();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    motes_scenes::save(&path, &Recipe { count: 200_000, sh_degree: 3, ..Recipe::default() }.still()).unwrap();
    let file = std::fs::metadata(&path).unwrap().len() as usize;
    assert_eq!(file / 200_000, 248);
    let (scene, memory) = peak(|| motes_scenes::load(&path, &LoadOptions::default()).unwrap());
    LOADED.fetch_add(1, Ordering::Relaxed);
    assert_eq!(scene.splats.len(), 200_000);
    assert!(memory > file * 9 / 10 && memory < file * 3 / 2, "{memory} bytes for a file of {file}");
}

#[test]
fn offences_are_noticed() {
    let _turn = take_turn();
    // Memory, on another thread too.
    let (_, memory) = peak(|| std::thread::spawn(|| drop(vec![1_u8; 80 << 20])).join());
    assert!(memory > allowed(1000), "{memory}");
    let fine = || Ok(Ok(Scene::default()));
    assert_eq!(offence(fine(), 1000, "a.ply", 1000), None);
    assert!(offence(fine(), memory, "a.ply", 1000).is_some());
    let mut scene = Scene { splats: Recipe::default().still(), ..Scene::default() };
    scene.splats.log_scales[7][1] = f32::NAN;
    assert!(offence(Ok(Ok(scene)), 0, "a.ply", 1000).is_some_and(|o| o.contains("log_scales")));
    assert!(offence(catch_unwind(|| panic!("on purpose")), 0, "a.ply", 1000).is_some());
    let anonymous = SceneError::Cancelled { path: "b.ply".into() };
    assert!(offence(Ok(Err(anonymous)), 0, "a.ply", 1000).is_some());
}
