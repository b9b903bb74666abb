//! A moving scene in a scripted session at 72 Hz: each frame shows its own time, in an order that is made for it.
#![allow(clippy::unwrap_used, reason = "a test may")]

use ash::vk;
use motes_app::governor::{Budget, Governor};
use motes_app::headset::{Comfort, Eye, EyeFov, Input, Pose};
use motes_app::opened::Opened;
use motes_app::time::TimeControl;
use motes_renderer::{Offscreen, Packing, Precision, RenderConfig, SceneOnDevice, ShPrecision};
use motes_scenes::synthetic::{Animation, Recipe};
use motes_scenes::{LoadOptions, save};
use motes_tests::TestGpu;
use motes_xr::{
    Content, EyeImages, FrameTime, Script, ScriptFrame, ScriptStep, ScriptedHeadset, SessionState, Viewer,
};

const PERIOD: i64 = 1_000_000_000 / 72;
const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// The head stands still for six frames, then for six frames elsewhere, and so on.
fn script(frames: i64) -> Script {
    let eye = |frame: i64, x: f32| Eye {
        pose: Pose { position: [x + 0.05 * (frame / 6) as f32, 1.6, 0.0], ..Pose::default() },
        fov: EyeFov { left: -0.8, right: 0.8, up: 0.8, down: -0.8 },
    };
    let step = |frame: i64| {
        ScriptStep::Frame(Box::new(ScriptFrame {
            time: FrameTime {
                display_time: 1 + frame * PERIOD,
                period: PERIOD,
                should_render: true,
                focused: true,
            },
            input: Input::default(),
            eyes: Some([eye(frame, -0.032), eye(frame, 0.032)]),
            order: None,
        }))
    };
    let mut steps: Vec<_> = (0..frames).map(step).collect();
    steps.push(ScriptStep::Ended(SessionState::Exiting));
    Script { images: EyeImages { size: [64, 64], format: vk::Format::R8G8B8A8_UNORM }, steps }
}

#[test]
fn every_frame_shows_its_time_in_both_eyes() {
    let gpu = TestGpu::new();
    let animation = Animation { fleeting: 1.0, width: 0.05, ..Animation::default() };
    let splats = Recipe { count: 1500, seed: 8, ..Recipe::default() }.moving(&animation);
    let file = std::env::temp_dir().join(format!("motes-playback-{}.ply", std::process::id()));
    save(&file, &splats).unwrap();
    let opened = Opened::load(std::slice::from_ref(&file), &LoadOptions::default()).unwrap();
    std::fs::remove_file(&file).unwrap();
    let mut headset = ScriptedHeadset::new(&gpu, script(24)).unwrap();
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.show(Content::new(&gpu, &opened, PACKING).unwrap()).unwrap();
    viewer.read_back(&headset, true).unwrap();
    // Thirty scene frames a second, so that times and views do not go in step.
    viewer.playback = Some(TimeControl::new(1.0, 30));

    let scene = SceneOnDevice::new(&gpu, &opened.scene.splats, PACKING).unwrap();
    assert!(scene.positions.alive().is_some());
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut frame = 0;
    while viewer.step(&mut headset).unwrap().is_none() {
        let last = *viewer.last_frame().unwrap();
        let seen = viewer.pictures().unwrap();
        let time = (frame as f64 * PERIOD as f64 / 1e9) as f32;
        assert!((last.wanted.time - time).abs() < 1e-6, "frame {frame}: {} is not {time}", last.wanted.time);
        assert!((last.used.time - time).abs() < 1e-6, "frame {frame}: an order for {}", last.used.time);
        let at = |time| RenderConfig { time, ..RenderConfig::default() };
        let (expected, _) = offscreen.render(&scene, &last.views, &at(last.wanted.time)).unwrap();
        if frame % 6 > 0 {
            // The order was made for the very place.
            assert_eq!(last.used, last.wanted, "frame {frame}");
            for eye in 0..2 {
                assert!(seen[eye] == expected[eye], "frame {frame}, eye {eye}");
            }
        }
        // Controls: the frame before, and the other eye.
        let before = at(last.wanted.time - PERIOD as f32 / 1e9);
        let (early, _) = offscreen.render(&scene, &last.views, &before).unwrap();
        assert!(seen[0] != early[0] && seen[1] != early[1], "frame {frame} is not the one before");
        assert!(seen[0] != seen[1]);
        frame += 1;
    }
    assert_eq!(frame, 24);
}

/// The governor in the headset's frames: both eyes, the head in motion.
#[test]
fn the_headset_holds_its_budget() {
    let gpu = TestGpu::new();
    let splats = Recipe { count: 2500, log_scales: [-3.0, -1.6], ..Recipe::default() }.still();
    let file = std::env::temp_dir().join(format!("motes-budget-{}.ply", std::process::id()));
    save(&file, &splats).unwrap();
    let opened = Opened::load(std::slice::from_ref(&file), &LoadOptions::default()).unwrap();
    std::fs::remove_file(&file).unwrap();
    let run = |budget: Option<Budget>| {
        let mut headset = ScriptedHeadset::new(&gpu, script(150)).unwrap();
        let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
        viewer.show(Content::new(&gpu, &opened, PACKING).unwrap()).unwrap();
        viewer.governor = budget.map(Governor::new);
        let mut layers = 0.0;
        while viewer.step(&mut headset).unwrap().is_none() {
            let report = viewer.report();
            if report.shown_pixels > 0 {
                layers = f64::from(report.predicted_unhidden) / report.shown_pixels as f64;
            }
        }
        let level = viewer.governor.as_ref().map_or(0, Governor::level);
        (layers, level)
    };
    let (free, _) = run(None);
    let budget = 0.6 * free;
    let (held, level) = run(Some(Budget::Layers(budget)));
    println!("{free:.1} layers, {held:.1} with a budget of {budget:.1} (step {level})");
    assert!(free > budget, "the control is within the budget anyway");
    assert!(held <= budget && level > 0);
}
