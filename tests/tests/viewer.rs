//! The viewer without a window: scenes come and go while frames go on.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use glam::DVec3;
use motes_app::eye::{EyeMode, EyeMotion};
use motes_app::governor::{Budget, Governor, LADDER};
use motes_app::viewer::{Command, Viewer};
use motes_renderer::plan::Overrides;
use motes_renderer::{Fov, Offscreen, PRESETS, Packing, Precision, RenderConfig, SceneOnDevice, View};
use motes_scenes::synthetic::Recipe;
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

/// Frames on a device, each drawn by what the governor made of the ones before.
#[test]
fn the_governor_holds_its_budget_and_gives_back_what_it_took() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let recipe = Recipe { count: 3000, log_scales: [-3.0, -1.5], ..Default::default() };
    let config = RenderConfig { sh_degree: 0, ..Default::default() };
    let scene = SceneOnDevice::new(&gpu, &recipe.still(), Packing::of_config(&config)).unwrap();
    let size = [64, 48];
    let fov = Fov::vertical(0.9, size);
    let view = View::look_at(DVec3::new(0.0, 0.0, -2.5), DVec3::ZERO, DVec3::NEG_Y, fov, size);
    for preset in PRESETS {
        // Whatever was asked for, no step makes choices that the device refuses.
        let mut governor = Governor::new(Budget::Layers(0.1));
        let mut asked = (preset.config)();
        asked.expansion = config.expansion;
        for _ in 0..400 {
            governor.observe_cost(100.0, &asked);
            governor.apply(&asked).check(1, &gpu.capabilities).unwrap();
        }
        assert_eq!(governor.level(), LADDER.len(), "{}", preset.name);
    }

    let mut draw = |config: &RenderConfig| offscreen.render(&scene, &[view], config).unwrap();
    let (as_asked, report) = draw(&config);
    let whole = Budget::Layers(1.0).cost(&report, &config).unwrap();
    let budget = 0.4 * whole;
    let mut governor = Governor::new(Budget::Layers(budget));
    let (mut changes, mut level_costs) = (0, vec![whole]);
    for _ in 0..400 {
        let (_, report) = draw(&governor.apply(&config));
        let cost = Budget::Layers(1.0).cost(&report, &config).unwrap();
        if governor.observe(&report, &config).is_some() {
            level_costs.push(cost);
            changes += 1;
        }
    }
    println!(
        "{whole:.1} layers, budget {budget:.1}: {:.1} at {:?}; {level_costs:.1?}",
        governor.cost(),
        governor.step()
    );
    // Control: without steps the frame is over the budget.
    assert!(whole > budget && governor.cost() <= budget && governor.is_at_rest());
    assert!(governor.level() > 0 && changes <= LADDER.len(), "{changes} changes");
    // Each step up was taken since the one before did not suffice, and none made it worse. (What early stop leaves is
    // predicted from bins of the order, whose borders move when splats go: by some thousandths.)
    assert!(level_costs.windows(2).all(|c| c[1] <= c[0] * 1.005), "{level_costs:?}");

    governor.set_budget(Budget::Layers(3.0 * whole));
    for _ in 0..1200 {
        let (_, report) = draw(&governor.apply(&config));
        governor.observe(&report, &config);
        if governor.level() == 0 {
            break;
        }
    }
    assert_eq!(draw(&governor.apply(&config)).0, as_asked, "what was taken came back");
}

/// A plain scene is loaded by its plan, and one with harmonics that comes after it gets them back.
#[test]
fn scenes_are_loaded_by_their_plans() {
    let gpu = TestGpu::new();
    let mut viewer = Viewer::new(&gpu, RenderConfig::default());
    viewer.by_plan = Some(Overrides::default());
    viewer.open(vec![sample("static/hq_garden_lod2")]);
    until(&mut viewer, |v| v.stage.is_some());
    let stage = viewer.stage.as_ref().unwrap();
    let stored = (stage.scene.packing.precision, stage.scene.packing.sh_degree);
    assert_eq!(stored, (Precision::F16, 0));
    assert_eq!(stage.scene.bytes(), 32 * u64::from(stage.scene.splats));
    assert_eq!((viewer.config.precision, viewer.config.sh_degree), stored);
    assert!(viewer.loading().is_none(), "nothing is packed anew");
    viewer.open(vec![sample("static/skull_sh3.compressed.ply")]);
    until(&mut viewer, |v| v.stage.as_ref().is_some_and(|s| s.opened.name.contains("skull")));
    let stage = viewer.stage.as_ref().unwrap();
    assert_eq!((stage.scene.packing.sh_degree, viewer.config.sh_degree), (3, 3));
    assert_eq!(stage.scene.bytes(), 80 * u64::from(stage.scene.splats));
}
