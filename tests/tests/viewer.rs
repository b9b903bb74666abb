//! The viewer without a window: scenes come and go while frames go on.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use motes_app::eye::{EyeMode, EyeMotion};
use motes_app::viewer::{Command, Viewer};
use motes_renderer::{Precision, RenderConfig, View};
use motes_tests::{TestGpu, sample};

/// Goes on until something is so; returns the frames that it took and the progress that was seen.
fn until(viewer: &mut Viewer, done: impl Fn(&Viewer) -> bool) -> (usize, Vec<f32>) {
    let start = Instant::now();
    let (mut frames, mut progress) = (0, Vec::new());
    while !done(viewer) {
        assert!(start.elapsed() < Duration::from_secs(120), "it never comes: {:?}", viewer.message);
        if let Some(loading) = viewer.loading() {
            progress.push(loading.fraction);
        }
        drop(viewer.advance(0.01, &EyeMotion::default()));
        frames += 1;
        std::thread::sleep(Duration::from_millis(1));
    }
    (frames, progress)
}

#[test]
fn scenes_load_while_frames_go_on() {
    let gpu = TestGpu::new();
    let mut viewer = Viewer::new(&gpu, RenderConfig::default());
    viewer.open(vec![sample("photos_snowmiku/snowmiku_sh3.ply")]);
    assert!(viewer.stage.is_none(), "opening does not wait");
    let (frames, progress) = until(&mut viewer, |v| v.stage.is_some());
    println!("{frames} frames while it loaded, progress {:?}", progress.last());
    assert!(frames > 2, "the viewer stood still");
    assert!(progress.windows(2).all(|p| p[0] <= p[1]), "progress went back");

    // The first camera of the data set, then the next, then round to the last.
    let stage = viewer.stage.as_ref().unwrap();
    let cameras = stage.opened.cameras.clone();
    assert_eq!((cameras.len(), stage.camera), (97, Some(0)));
    let stands = |viewer: &Viewer, i: usize| {
        let wanted = View::from_camera(&cameras[i]);
        (viewer.eye.position() - wanted.eye).length() < 1e-9
    };
    assert!(stands(&viewer, 0));
    viewer.obey(Command::NextCamera);
    assert!(stands(&viewer, 1));
    viewer.obey(Command::PreviousCamera);
    viewer.obey(Command::PreviousCamera);
    assert!(stands(&viewer, 96) && !stands(&viewer, 0));
    viewer.obey(Command::SwitchMode);
    assert_eq!(viewer.eye.mode, EyeMode::Fly);

    // Another packing: the scene is brought to the device anew, the eye stays.
    viewer.config.precision = Precision::F16;
    until(&mut viewer, |v| v.stage.as_ref().is_some_and(|s| s.scene.packing.precision == Precision::F16));
    assert!(stands(&viewer, 96));

    // A scene that is not there is said, and the one on show stays.
    viewer.open(vec![PathBuf::from("/nowhere/garden.ply")]);
    until(&mut viewer, |v| v.loading().is_none());
    assert!(viewer.message.as_ref().unwrap().contains("/nowhere/garden.ply"));
    assert!(viewer.stage.is_some());

    // Two in a row: the second is shown, the first is dropped.
    viewer.open(vec![sample("static/hq_garden_lod2")]);
    viewer.open(vec![sample("static/fruit_drops_minimal.ply")]);
    until(&mut viewer, |v| v.stage.as_ref().is_some_and(|s| s.scene.splats == 4721));

    let views = viewer.views([200, 100]);
    let config = viewer.frame_config();
    let (scene, order) = viewer.frame(&views, &config).unwrap();
    assert_eq!(order.indices.len(), scene.splats as usize, "the first order is waited for");
    viewer.obey(Command::SwitchStereo);
    let views = viewer.views([200, 100]);
    assert_eq!((views.len(), views[0].size), (2, [100, 100]));
}
