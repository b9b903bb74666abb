//! Pipelines on disk: kept, found again, and replaced where they are damaged.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_renderer::pipeline_cache::{Kept, file_for};
use motes_renderer::{Fov, Offscreen, Packing, Precision, RenderConfig, SceneOnDevice, ShPrecision, View};
use motes_scenes::synthetic::Recipe;
use motes_tests::TestGpu;
use std::fs;
use std::path::PathBuf;

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn pipelines_are_kept_and_damaged_files_are_announced_and_replaced() {
    let folder = Folder(std::env::temp_dir().join(format!("motes-pipelines-{}", std::process::id())));
    let gpu = TestGpu::new();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };
    let scene = SceneOnDevice::new(&gpu, &Recipe::default().still(), packing).unwrap();
    let size = [64, 48];
    let fov = Fov::vertical(0.9, size);
    let view = View::look_at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::NEG_Y, fov, size);
    let frame = || {
        let mut offscreen = Offscreen::new(&gpu).unwrap();
        let kept = offscreen.renderer().keep_pipelines(&folder.0).unwrap();
        (kept, offscreen.render(&scene, &[view], &RenderConfig::default()).unwrap().0)
    };
    let file = file_for(&gpu, &folder.0);
    let (kept, picture) = frame();
    assert_eq!(kept, Kept::Nothing);
    let whole = fs::read(&file).unwrap();
    let (kept, again) = frame();
    let Kept::Pipelines(bytes) = kept else { panic!("{kept:?}") };
    // lavapipe keeps no more than the head that the standard demands.
    assert!(bytes >= 32 && again == picture, "{bytes} bytes");

    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 0x10;
    for (what, damaged) in [
        ("cut", whole[..whole.len() / 2].to_vec()),
        ("flipped", flipped),
        ("empty", Vec::new()),
        ("text", b"hello".to_vec()),
    ] {
        fs::write(&file, damaged).unwrap();
        let (kept, again) = frame();
        assert!(matches!(kept, Kept::Damaged(_)), "{what}: {kept:?}");
        assert_eq!(again, picture, "{what}");
        let (kept, _) = frame();
        assert!(matches!(kept, Kept::Pipelines(_)), "{what} is not replaced: {kept:?}");
    }
    // A program that may be ended at any time writes them before it goes.
    fs::remove_file(&file).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    offscreen.renderer().keep_pipelines(&folder.0).unwrap();
    offscreen.renderer().save_pipelines();
    assert!(!file.exists(), "there is nothing to write yet");
    offscreen.render(&scene, &[view], &RenderConfig::default()).unwrap();
    offscreen.renderer().save_pipelines();
    assert!(fs::read(&file).unwrap().len() >= 32);
    drop(offscreen);
    // A folder that cannot be made is no reason to stop.
    let nowhere = folder.0.join("file");
    fs::write(&nowhere, b"in the way").unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    assert!(!matches!(offscreen.renderer().keep_pipelines(&nowhere).unwrap(), Kept::Pipelines(_)));
    offscreen.render(&scene, &[view], &RenderConfig::default()).unwrap();
    drop(offscreen);
    assert_eq!(fs::read(&nowhere).unwrap(), b"in the way");
}
