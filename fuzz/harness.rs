//! What every fuzz target does with its bytes; also run on stable Rust with a fixed corpus (`tests/tests/hard_fuzz.rs`).
//!
//! A reader gives an error or a scene that keeps the promises of `Splats`. A panic is a finding, and so is memory
//! beyond what the file can account for (libFuzzer's limit).
#![allow(dead_code, clippy::panic, reason = "each target uses one of these; a finding is a panic")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use motes_scenes::labels::Labels;
use motes_scenes::levels::LevelFile;
use motes_scenes::settings::Settings;
use motes_scenes::{LoadOptions, Splats, load_bytes};

/// Name of a target, and what it does with bytes.
pub type Target = (&'static str, fn(&[u8]));

/// Every target, by name.
pub const TARGETS: [Target; 11] = [
    ("ply", ply),
    ("compressed_ply", compressed_ply),
    ("splat", splat),
    ("splatv", splatv),
    ("ksplat", ksplat),
    ("sog", sog),
    ("spz", spz),
    ("levels", levels),
    ("labels", labels),
    ("cameras", cameras),
    ("settings", settings),
];

pub fn ply(bytes: &[u8]) {
    scene("fuzz.ply", bytes);
}
pub fn compressed_ply(bytes: &[u8]) {
    scene("fuzz.compressed.ply", bytes);
}
pub fn splat(bytes: &[u8]) {
    scene("fuzz.splat", bytes);
}
pub fn splatv(bytes: &[u8]) {
    scene("fuzz.splatv", bytes);
}
pub fn ksplat(bytes: &[u8]) {
    scene("fuzz.ksplat", bytes);
}
pub fn sog(bytes: &[u8]) {
    scene("fuzz.sog", bytes);
}
pub fn spz(bytes: &[u8]) {
    scene("fuzz.spz", bytes);
}

fn scene(name: &str, bytes: &[u8]) {
    match load_bytes(Path::new(name), Arc::from(bytes), &LoadOptions::default()) {
        Ok(scene) => {
            if let Some(broken) = broken_promise(&scene.splats) {
                panic!("{name}: {broken}");
            }
        }
        Err(error) => {
            assert!(error.to_string().contains("fuzz"), "{name}: a message without the file's name: {error}")
        }
    }
}

/// A file of levels, and every part of it.
pub fn levels(bytes: &[u8]) {
    let name = Path::new("fuzz.mlod");
    let named = |e: &motes_scenes::SceneError| {
        assert!(e.to_string().contains("fuzz"), "a message without the file's name: {e}");
    };
    match LevelFile::from_bytes(name, Arc::from(bytes)) {
        Ok(file) => {
            assert!(!file.levels().is_empty(), "a file without levels");
            for (g, group) in file.groups().iter().enumerate().take(8) {
                for (l, range) in group.ranges.iter().enumerate() {
                    match file.read(g, l) {
                        Ok(splats) => {
                            assert_eq!(splats.len() as u64, range.splats);
                            if let Some(broken) = broken_promise(&splats) {
                                panic!("group {g}, level {l}: {broken}");
                            }
                        }
                        Err(error) => named(&error),
                    }
                }
            }
        }
        Err(error) => named(&error),
    }
}

/// Labels in any of their forms.
pub fn labels(bytes: &[u8]) {
    match Labels::parse(Path::new("fuzz.labels.json"), bytes) {
        Ok(labels) => {
            // 0 is none of the classes.
            let unnamed = labels.ids.iter().find(|&&id| id > 0 && labels.class(id).is_none());
            assert!(unnamed.is_none(), "class {unnamed:?} has no name");
        }
        Err(error) => {
            assert!(error.to_string().contains("fuzz"), "a message without the file's name: {error}");
        }
    }
}

/// Cameras in JSON and in COLMAP's text, by what the bytes begin with.
pub fn cameras(bytes: &[u8]) {
    let name = if bytes.first() == Some(&b'#') { "images.txt" } else { "cameras.json" };
    let path = write(name, bytes);
    if let Ok(cameras) = motes_scenes::cameras::load(&path) {
        for camera in cameras {
            let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
            assert!(numbers.iter().chain(&camera.position()).all(|v| v.is_finite()), "{camera:?}");
            assert!(camera.width > 0 && camera.height > 0, "{camera:?}");
        }
    }
}

/// The settings beside a scene.
pub fn settings(bytes: &[u8]) {
    write("scene.ply.motes.json", bytes);
    if let Ok(Some(settings)) = Settings::load(&folder().join("scene.ply")) {
        let placed = settings.scene_to_world();
        assert!(placed.is_finite(), "{placed:?}");
    }
}

/// A folder of this process, in memory where the system has such a place.
fn folder() -> PathBuf {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    base.join(format!("motes-fuzz-{}", std::process::id()))
}

fn write(name: &str, bytes: &[u8]) -> PathBuf {
    let folder = folder();
    let path = folder.join(name);
    if let Err(e) = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&path, bytes)) {
        panic!("{}: {e}", path.display());
    }
    path
}

/// What a scene does not keep of what `Splats` promises.
fn broken_promise(splats: &Splats) -> Option<&'static str> {
    let n = splats.len();
    let coefficients = motes_scenes::sh_coefficients(splats.sh_degree);
    let lengths = [
        splats.rotations.len(),
        splats.log_scales.len(),
        splats.opacities.len(),
        splats.sh.len() / coefficients,
    ];
    if lengths != [n; 4] {
        return Some("arrays of different lengths");
    }
    let finite = |v: &[f32]| v.iter().all(|v| v.is_finite());
    if !(finite(splats.means.as_flattened())
        && finite(splats.log_scales.as_flattened())
        && finite(splats.sh.as_flattened()))
    {
        return Some("a number that is none");
    }
    let unit = |q: &[f32; 4]| (q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4;
    if !splats.rotations.iter().all(unit) {
        return Some("a rotation of another length than 1");
    }
    if !splats.opacities.iter().all(|o| (0.0..=1.0).contains(o)) {
        return Some("an opacity outside of 0 to 1");
    }
    None
}
