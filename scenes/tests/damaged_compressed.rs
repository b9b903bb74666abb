//! Damaged SOG and SPZ files: an error or a valid scene, in bounded memory; and files made to fill memory.

#![allow(clippy::panic, clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::path::Path;
use std::sync::Mutex;

use common::allocation::{Counting, peak};
use common::{defect, pack, read, samples};
use motes_scenes::synthetic::{Random, Recipe};
use motes_scenes::{LoadOptions, Scene, SceneError, Splats, load};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Memory is measured for the whole program: one test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// What became of many damaged files.
#[derive(Debug, Default)]
struct Outcome {
    errors: usize,
    scenes: usize,
    /// Most memory beyond 4 × the file, bytes.
    excess: i64,
}

/// Loads a damaged file of `length` bytes, and fails the test where that is worse than an error.
fn survive(outcome: &mut Outcome, what: &str, length: u64, load: impl FnOnce() -> Result<Scene, SceneError>) {
    let (result, most) = peak(load);
    match &result {
        Ok(scene) => {
            outcome.scenes += 1;
            if let Some(defect) = defect(&scene.splats) {
                panic!("{what}: {defect}");
            }
        }
        Err(error) => {
            outcome.errors += 1;
            let text = error.to_string();
            assert!(text.len() > 20, "{what}: “{text}” says too little");
        }
    }
    outcome.excess = outcome.excess.max(most as i64 - 4 * length as i64);
    assert!(outcome.excess <= 64 << 20, "{what}: {most} bytes of memory for a file of {length}");
}

/// Cuts at every hundredth of the length, and `seeds` times overwrites 1 to 16 random bytes.
fn damage(name: &str, bytes: &[u8], seeds: u64) -> Outcome {
    let mut outcome = Outcome::default();
    for percent in 0..100 {
        let cut = &bytes[..bytes.len() * percent / 100];
        survive(&mut outcome, &format!("{name} cut at {percent} %"), cut.len() as u64, || read(name, cut));
    }
    for seed in 0..seeds {
        let damaged = overwritten(bytes, seed);
        let what = format!("{name} overwritten, seed {seed}");
        survive(&mut outcome, &what, bytes.len() as u64, || read(name, &damaged));
    }
    println!("{name}: {outcome:?}");
    outcome
}

fn overwritten(bytes: &[u8], seed: u64) -> Vec<u8> {
    let mut random = Random::new(seed);
    let mut damaged = bytes.to_vec();
    for _ in 0..=random.below(16) {
        let at = random.below(bytes.len() as u64) as usize;
        damaged[at] = random.bits() as u8;
    }
    damaged
}

/// A scene with few distinct values, which a SOG palette of ours can hold.
fn small(sh_degree: u8) -> Splats {
    let mut splats = Recipe { count: 1000, sh_degree, ..Default::default() }.still();
    let coarse = |v: &mut f32| *v = (*v * 8.0).round() / 8.0;
    splats.log_scales.as_flattened_mut().iter_mut().for_each(coarse);
    splats.sh.as_flattened_mut().iter_mut().for_each(coarse);
    splats
}

#[test]
fn spz_of_every_version() {
    let _alone = ALONE.lock();
    let splats = small(2);
    for version in 1..=4 {
        let outcome = damage("small.spz", &pack::spz(&splats, version), 1000);
        // Checksums and sizes catch nearly everything in a gzip stream; zstd streams have none here.
        assert!(outcome.errors > 100, "version {version}: {outcome:?}");
    }
    // Without the checksum in the way: what is damaged is damaged before it is packed.
    let attributes = pack::spz_attributes(&splats, 3, 2, 12);
    let plain = [pack::spz_header(3, 1000, 2, 12, 0, 0), attributes.concat()].concat();
    let mut outcome = Outcome::default();
    for seed in 0..1000 {
        // Half of the damage in the header.
        let mut damaged = overwritten(&plain, seed);
        if seed % 2 == 0 {
            damaged[..16].copy_from_slice(&overwritten(&plain[..16], seed));
        }
        let packed = pack::gzip(&damaged);
        survive(&mut outcome, &format!("seed {seed}"), packed.len() as u64, || read("plain.spz", &packed));
    }
    println!("damaged before packing: {outcome:?}");
    assert!(outcome.scenes > 400 && outcome.errors > 100, "{outcome:?}");
}

#[test]
fn sample_files() {
    let _alone = ALONE.lock();
    for (name, seeds) in [
        ("static/skull.sog", 20),
        ("static/skull_sh3_v3.spz", 40),
        ("static/biker.spz", 100),
        ("4d/flipbook_monkey/monkey_0001.sog", 1000),
        ("photos_snowmiku/snapshots/iteration_00100.spz", 200),
    ] {
        let bytes = std::fs::read(samples().join(name)).unwrap();
        let outcome = damage(name, &bytes, seeds);
        assert!(outcome.errors >= 100, "{name}: {outcome:?}");
    }
}

#[test]
fn sog_of_both_versions_zipped() {
    let _alone = ALONE.lock();
    for version in [1, 2] {
        let files = pack::sog(&small(1), version);
        let outcome = damage("small.sog", &pack::zip(&files, "", version == 1), 1000);
        assert!(outcome.errors > 1000, "{outcome:?}");
        // Zip's checksums catch what is damaged afterwards; this is damaged before.
        let mut outcome = Outcome::default();
        for seed in 0..1000 {
            let mut files = files.clone();
            let file = seed as usize % files.len();
            files[file].1 = overwritten(&files[file].1, seed);
            let zip = pack::zip(&files, "", false);
            let what = format!("seed {seed}, {}", files[file].0);
            survive(&mut outcome, &what, zip.len() as u64, || read("small.sog", &zip));
        }
        println!("version {version}, damaged before zipping: {outcome:?}");
        assert!(outcome.scenes > 100 && outcome.errors > 100, "{outcome:?}");
    }
}

/// Every file of a streamed scene's smallest level, cut and overwritten where it lies; images of libwebp's making.
#[test]
fn files_of_folders() {
    let _alone = ALONE.lock();
    let folder = tempfile::tempdir().unwrap();
    let from = samples().join("static/playbot");
    let mut names = vec!["lod-meta.json".to_owned()];
    for entry in std::fs::read_dir(from.join("6_0")).unwrap() {
        names.push(format!("6_0/{}", entry.unwrap().file_name().to_string_lossy()));
    }
    names.sort();
    std::fs::create_dir(folder.path().join("6_0")).unwrap();
    let mut length = 0;
    for name in &names {
        length += std::fs::copy(from.join(name), folder.path().join(name)).unwrap();
    }
    let options = LoadOptions { level: 6, ..Default::default() };
    let open = || load(folder.path(), &options);
    assert_eq!(open().unwrap().splats.len(), 1_873);
    let mut outcome = Outcome::default();
    for name in &names {
        let path = folder.path().join(name);
        // The samples are read-only.
        let bytes = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        survive(&mut outcome, &format!("without {name}"), length, open);
        for percent in 0..100 {
            std::fs::write(&path, &bytes[..bytes.len() * percent / 100]).unwrap();
            survive(&mut outcome, &format!("{name} cut at {percent} %"), length, open);
        }
        for seed in 0..1000 / names.len() as u64 + 1 {
            std::fs::write(&path, overwritten(&bytes, seed)).unwrap();
            survive(&mut outcome, &format!("{name} overwritten, seed {seed}"), length, open);
        }
        std::fs::write(&path, &bytes).unwrap();
    }
    println!("{outcome:?}");
    assert!(outcome.scenes > 100 && outcome.errors > 900, "{outcome:?}");
    assert_eq!(open().unwrap().splats.len(), 1_873);
}

/// Memory for a small file that claims to be large: the error, and that it came without the memory.
fn refused(what: &str, bytes: &[u8], words: &[&str]) {
    let (result, most) = peak(|| read(what, bytes));
    let error = result.unwrap_err().to_string();
    for word in words {
        assert!(error.contains(word), "{what}: {error}");
    }
    assert!(most <= 4 * bytes.len() + (64 << 20), "{what}: {most} bytes for a file of {}", bytes.len());
}

#[test]
fn bombs_are_refused_before_they_go_off() {
    let _alone = ALONE.lock();
    let expansion = &["more than 64 times as much"][..];
    for count in [10_000_000, u32::MAX] {
        let header = pack::spz_header(3, count, 3, 12, 0, 0);
        // Zeros compress a thousandfold.
        refused("gzip.spz", &pack::gzip(&[header, vec![0; 1 << 20]].concat()), expansion);
        let header = pack::spz_header(4, count, 0, 12, 0, 5);
        refused("zstd.spz", &pack::spz_4(&header, &[], &vec![vec![0; 1 << 16]; 5]), expansion);
    }
    // Within the factor, but the contents are not there.
    let header = pack::spz_header(3, 190_000, 3, 12, 0, 0);
    refused("short.spz", &pack::gzip(&[header, vec![0; 1 << 20]].concat()), &["ends after 1048576 of"]);

    // A zstd frame whose window is 1 GiB: its second byte says so.
    let mut file = pack::spz(&small(0), 4);
    let streams = 32 + 5 * 16;
    assert_eq!(file[streams..streams + 4], [0x28, 0xb5, 0x2f, 0xfd]);
    file[streams + 4] &= !0x20;
    file[streams + 5] = 20 << 3;
    refused("window.spz", &file, &["stream 0 of 5"]);

    // 16383² equal pixels take some hundred bytes, as many splats 18 GB.
    let side = 16_383_u32;
    let image = {
        let row = vec![7; side as usize * 4];
        let mut small = pack::webp(side, 1, &row);
        // Width and height are 14 bits each behind the signature of the bit stream.
        let at = small.windows(4).position(|w| w == b"VP8L").unwrap() + 9;
        let bits = (side - 1) | (side - 1) << 14 | 1 << 28;
        small[at..at + 4].copy_from_slice(&bits.to_le_bytes());
        small
    };
    let count = u64::from(side) * u64::from(side);
    let mut files = pack::sog(&small(0), 2);
    let meta = files.pop().unwrap().1;
    let meta = String::from_utf8(meta).unwrap().replace("\"count\":1000", &format!("\"count\":{count}"));
    files.iter_mut().for_each(|(_, bytes)| bytes.clone_from(&image));
    files.push(("meta.json".to_owned(), meta.into_bytes()));
    refused("pixels.sog", &pack::zip(&files, "", false), expansion);
    // The same images with the true count are no scene of a thousand splats.
    files.last_mut().unwrap().1 = pack::sog(&small(0), 2).pop().unwrap().1;
    refused("pixels.sog", &pack::zip(&files, "", false), &["16383 × 16383 pixels for 1000 splats"]);

    // Zeros in a zip.
    let mut files = pack::sog(&small(0), 2);
    files[0].1 = vec![0; 100 << 20];
    let zip = pack::zip(&files, "", true);
    drop(files);
    refused("zeros.sog", &zip, &["means_l.webp", "more than four times as much"]);
}

/// What the measurement would not miss.
#[test]
fn memory_is_measured() {
    let _alone = ALONE.lock();
    let (_, most) = peak(|| std::hint::black_box(vec![1_u8; 100 << 20]).len());
    assert!(most >= 100 << 20, "{most}");
    let file = samples().join("static/skull_sh3_v3.spz");
    let (scene, most) = peak(|| load(Path::new(&file), &LoadOptions::default()).unwrap());
    let bytes = scene.splats.len() * Splats::bytes_per_splat(3, false);
    assert!(most >= bytes && most < 2 * bytes, "{most} for {bytes} of splats");
}
