//! A large scene on the device, part by part.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::time::{Duration, Instant};

use glam::DVec3;
use motes_app::eye::EyeMotion;
use motes_app::loader::{LoadRequest, Loaded, Loader, SceneSource, Storage};
use motes_app::thumbnail::Thumbnail;
use motes_app::viewer::Viewer;
use motes_renderer::{
    Fov, Offscreen, Packing, Picture, Precision, RenderConfig, SceneOnDevice, ShPrecision, View,
};
use motes_scenes::early::FIRST;
use motes_scenes::synthetic::Random;
use motes_scenes::{LoadOptions, Splats, load, save};
use motes_tests::{TestGpu, psnr};

const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// A wavy, coloured ground of small, flat splats, as dense as trained scenes are, in no order.
fn ground(count: usize) -> Splats {
    let mut random = Random::new(7);
    let mut splats = Splats::zeroed(count, 0, false);
    for i in 0..count {
        let [x, z] = [random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0)];
        let wave = (6.0 * x).sin() * (5.0 * z).cos();
        splats.means[i] = [x, 0.1 * wave, z];
        splats.rotations[i] = [0.0, 0.0, 0.0, 1.0];
        let size = (4.0 / count as f32).sqrt();
        splats.log_scales[i] = [size.ln(), (0.2 * size).ln(), size.ln()];
        splats.opacities[i] = 0.5;
        splats.sh[i] = [wave, (9.0 * x).sin(), (7.0 * z).cos()];
    }
    splats
}

fn look() -> View {
    let size = [160, 120];
    View::look_at(DVec3::new(0.0, 0.9, -1.6), DVec3::ZERO, DVec3::Y, Fov::vertical(0.9, size), size)
}

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

#[test]
fn parts_come_before_the_whole_and_look_like_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ground.ply");
    save(&path, &ground(4 * FIRST + 1)).unwrap();
    let gpu = TestGpu::new();
    let request = LoadRequest {
        source: SceneSource::Files(vec![path.clone()]),
        storage: Storage::As(PACKING),
        thumbnails: None,
    };
    let mut loader = Loader::start(&gpu, request).unwrap();
    let mut loaded: Vec<Loaded> = Vec::new();
    let begun = Instant::now();
    while !loaded.last().is_some_and(|l| l.whole) {
        assert!(begun.elapsed() < Duration::from_secs(120), "it never comes");
        match loader.poll() {
            Some(result) => {
                loaded.push(result.unwrap());
                println!("{} splats after {:?}", loaded[loaded.len() - 1].scene.splats, begun.elapsed());
            }
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    let [part, whole] = &loaded[..] else { panic!("{} scenes", loaded.len()) };
    assert_eq!((part.scene.splats, whole.scene.splats), (FIRST as u32, 4 * FIRST as u32 + 1));

    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut render = |scene: &SceneOnDevice| {
        let config = RenderConfig::default();
        offscreen.render(scene, &[look()], &config).unwrap().0.remove(0)
    };
    let [early, last] = [render(&part.scene), render(&whole.scene)];
    // The last is what loading in one piece shows, bit for bit.
    let at_once = load(&path, &LoadOptions::default()).unwrap();
    assert!(last == render(&SceneOnDevice::new(&gpu, &at_once.splats, PACKING).unwrap()));
    // The early one looks like it; better than as many splats of their own size, which leave gaps.
    let mut narrow = part.opened.scene.splats.clone();
    let wider = ((4 * FIRST + 1) as f32 / FIRST as f32).sqrt().ln();
    narrow.log_scales.iter_mut().flatten().for_each(|scale| *scale -= wider);
    let narrow = render(&SceneOnDevice::new(&gpu, &narrow, PACKING).unwrap());
    let [early, narrow] = [early, narrow].map(|picture| psnr(&colours(&picture), &colours(&last)));
    println!("a quarter of the splats: {early:.1} dB; of their own size {narrow:.1} dB");
    assert!(early > 24.0 && early > narrow + 6.0, "{early} {narrow}");
}

#[test]
fn a_small_picture_of_a_scene_is_kept_from_its_first_opening_on() {
    let folder = tempfile::tempdir().unwrap();
    let [path, thumbnails] = ["ground.ply", "thumbnails"].map(|name| folder.path().join(name));
    save(&path, &ground(5000)).unwrap();
    let gpu = TestGpu::new();
    let file = Thumbnail::file(&thumbnails, &path);
    let load = || {
        let source = SceneSource::Files(vec![path.clone()]);
        let storage = Storage::As(PACKING);
        let request = LoadRequest { source, storage, thumbnails: Some(thumbnails.clone()) };
        let mut loader = Loader::start(&gpu, request).unwrap();
        loop {
            match loader.poll() {
                Some(loaded) => return loaded.unwrap(),
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
    };
    assert!(!file.exists());
    let loaded = load();
    let kept = Thumbnail::load(&file).unwrap();
    let taken = Thumbnail::take(&gpu, &loaded.opened, &loaded.scene, &loaded.framing).unwrap();
    assert!(kept == taken, "the file holds what was taken");
    let bright = kept.rgb().iter().filter(|v| **v > 100).count();
    assert!(bright > kept.rgb().len() / 20, "the ground is seen: {bright}");
    // What is kept already is not taken anew.
    let written = std::fs::metadata(&file).unwrap().modified().unwrap();
    drop(load());
    assert_eq!(std::fs::metadata(&file).unwrap().modified().unwrap(), written);
}

#[test]
fn the_eye_stays_while_more_of_a_scene_comes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ground.ply");
    save(&path, &ground(4 * FIRST)).unwrap();
    let gpu = TestGpu::new();
    let mut viewer = Viewer::new(&gpu, RenderConfig::default());
    let begun = Instant::now();
    let advance = |viewer: &mut Viewer| {
        assert!(begun.elapsed() < Duration::from_secs(120), "it never comes");
        drop(viewer.advance(0.01, &EyeMotion::default()));
        std::thread::sleep(Duration::from_millis(1));
    };
    viewer.open(vec![path]);
    while viewer.stage.is_none() {
        advance(&mut viewer);
    }
    assert!(viewer.stage.as_ref().unwrap().partial && viewer.loading().is_some());
    assert_eq!(viewer.stage.as_ref().unwrap().scene.splats, FIRST as u32);
    viewer.eye.move_by(&EyeMotion { turn: 0.4, lift: 0.1, ..EyeMotion::default() });
    viewer.stage.as_mut().unwrap().settings.scale = 2.5;
    let place = viewer.eye.position();
    while viewer.stage.as_ref().unwrap().partial {
        advance(&mut viewer);
    }
    let stage = viewer.stage.as_ref().unwrap();
    assert_eq!((stage.scene.splats, stage.settings.scale), (4 * FIRST as u32, 2.5));
    assert_eq!(viewer.eye.position(), place);
    assert!(viewer.loading().is_none());
}
