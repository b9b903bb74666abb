//! What a headset shows, frame by frame, in a scripted session: the head stands still.
#![allow(clippy::unwrap_used, reason = "a test may")]

use ash::vk;
use motes_app::headset::menu::HOTTEST_LAYERS;
use motes_app::headset::{Comfort, Eye, EyeFov, HandInput, Input, Pose};
use motes_app::opened::Opened;
use motes_renderer::gpu::Gpu;
use motes_renderer::{Offscreen, Packing, Precision, RenderConfig, SceneOnDevice, ShPrecision};
use motes_scenes::synthetic::Recipe;
use motes_scenes::{LoadOptions, save};
use motes_tests::TestGpu;
use motes_xr::{
    Content, EyeImages, FrameTime, Headset, Script, ScriptFrame, ScriptStep, ScriptedHeadset, Viewer,
};
use std::sync::Arc;

const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// As many frames as are asked for.
fn script(frames: i64) -> Script {
    let period = 1_000_000_000 / 72;
    let eye = |x| Eye {
        pose: Pose { position: [x, 1.6, 0.3], ..Pose::default() },
        fov: EyeFov { left: -0.8, right: 0.8, up: 0.8, down: -0.8 },
    };
    let step = |i| {
        let display_time = 1 + i * period;
        ScriptStep::Frame(Box::new(ScriptFrame {
            time: FrameTime { display_time, period, should_render: true, focused: true },
            input: Input::default(),
            eyes: Some([eye(-0.032), eye(0.032)]),
            order: None,
            hidden: None,
        }))
    };
    let images = EyeImages { size: [64, 64], format: vk::Format::R8G8B8A8_UNORM };
    Script { images, steps: (0..frames).map(step).collect() }
}

fn headset(gpu: &Arc<Gpu>, frames: i64) -> ScriptedHeadset {
    ScriptedHeadset::new(gpu, script(frames)).unwrap()
}

/// A generated scene, by way of a file.
fn opened() -> Opened {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    save(&path, &Recipe { count: 1500, ..Recipe::default() }.still()).unwrap();
    Opened::load(std::slice::from_ref(&path), &LoadOptions::default()).unwrap()
}

#[test]
fn the_user_stays_while_more_of_a_scene_comes() {
    let gpu = TestGpu::new();
    let whole = opened();
    let mut part = whole.clone();
    part.scene.splats = whole.scene.splats.selected(&(0..300).collect::<Vec<_>>());
    let mut headset = headset(&gpu, 6);
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.read_back(&headset, true).unwrap();
    viewer.show(Content::new(&gpu, &part, PACKING).unwrap()).unwrap();
    for _ in 0..3 {
        assert_eq!(viewer.step(&mut headset).unwrap(), None);
    }
    let (placement, seen) = (*viewer.placement().unwrap(), viewer.pictures().unwrap());
    viewer.refine(Content::new(&gpu, &whole, PACKING).unwrap()).unwrap();
    for _ in 0..3 {
        assert_eq!(viewer.step(&mut headset).unwrap(), None);
    }
    assert_eq!(*viewer.placement().unwrap(), placement);
    let (more, last) = (viewer.pictures().unwrap(), *viewer.last_frame().unwrap());
    let scene = SceneOnDevice::new(&gpu, &whole.scene.splats, PACKING).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let (expected, _) = offscreen.render(&scene, &last.views, &RenderConfig::default()).unwrap();
    assert!(more[..] == expected[..] && more[0] != seen[0]);
    viewer.show(Content::new(&gpu, &whole, PACKING).unwrap()).unwrap();
    assert!(viewer.placement().is_none(), "another scene begins at its own first view");
}

#[test]
fn where_the_scene_is_empty_the_surroundings_are_seen() {
    let gpu = TestGpu::new();
    let mut headset = headset(&gpu, 2);
    // A colour of its own that must not shine through.
    let config = RenderConfig { background: [0.2, 0.9, 0.4], ..RenderConfig::default() };
    let mut viewer = Viewer::new(&headset, config, Comfort::default()).unwrap();
    viewer.read_back(&headset, true).unwrap();
    viewer.show(Content::new(&gpu, &opened(), PACKING).unwrap()).unwrap();
    assert_eq!(headset.surroundings(), Some(false));
    let mut see = |headset: &mut ScriptedHeadset| {
        assert_eq!(viewer.step(headset).unwrap(), None);
        let [left, _] = viewer.pictures().unwrap();
        left.pixels
    };
    let before = see(&mut headset);
    assert!(before.iter().all(|p| p[3] == 255), "opaque while nothing is shown behind");
    let empty = [51, 230, 102, 255];
    headset.show_surroundings(true).unwrap();
    let after = see(&mut headset);
    let (mut clear, mut solid) = (0, 0);
    for (before, after) in before.iter().zip(&after) {
        if *before == empty {
            // The faintest of layers round to nothing before, and to a step after.
            assert!(after.iter().all(|v| *v <= 2), "empty: {after:?}");
            clear += usize::from(*after == [0; 4]);
        }
        // Premultiplied: what the background's colour added is gone, by as much as is transparent. (Three roundings to
        // 8 bits, and those of the half-float sums.)
        let through = f64::from(255 - after[3]) / 255.0;
        for k in 0..3 {
            let added = f64::from(before[k]) - f64::from(after[k]);
            assert!((added - through * f64::from(empty[k])).abs() <= 2.0, "{before:?} {after:?}");
        }
        solid += usize::from(after[3] == 255);
    }
    println!("{clear} pixels empty, {solid} solid");
    assert!(clear > 100 && solid > 20);
}

#[test]
fn layers_are_seen_in_the_headset() {
    let gpu = TestGpu::new();
    let (mut headset, opened) = (headset(&gpu, 3), opened());
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.read_back(&headset, true).unwrap();
    viewer.show(Content::new(&gpu, &opened, PACKING).unwrap()).unwrap();
    let scene = SceneOnDevice::new(&gpu, &opened.scene.splats, PACKING).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut seen = Vec::new();
    for heat in [false, true, false] {
        viewer.heat = heat;
        assert_eq!(viewer.step(&mut headset).unwrap(), None);
        let last = *viewer.last_frame().unwrap();
        offscreen.renderer().show_layers(heat.then_some(HOTTEST_LAYERS)).unwrap();
        let (expected, _) = offscreen.render(&scene, &last.views, &RenderConfig::default()).unwrap();
        let pictures = viewer.pictures().unwrap();
        assert!(pictures[..] == expected[..], "heat: {heat}");
        seen.push(pictures);
    }
    assert!(seen[0] == seen[2] && seen[0] != seen[1]);
}

#[test]
fn where_the_eyes_were_is_known_without_a_device() {
    let gpu = TestGpu::new();
    let opened = opened();
    let mut script = script(40);
    // Walks, turns and jumps, looking at the panel in between.
    for (i, step) in script.steps.iter_mut().enumerate() {
        let ScriptStep::Frame(frame) = step else { continue };
        let aim = Pose { position: [0.2, 1.2, 0.0], ..Pose::default() };
        frame.input.hands[1] = HandInput { aim: Some(aim), ..HandInput::default() };
        frame.input.walk = if (3..15).contains(&i) { [0.3, 1.0] } else { [0.0; 2] };
        frame.input.turn = if (17..20).contains(&i) { 1.0 } else { 0.0 };
        frame.input.teleport = (25..28).contains(&i);
        frame.input.panel = i == 12 || i == 30;
    }
    let content = Content::new(&gpu, &opened, PACKING).unwrap();
    let views = script.views(&content.scene_to_world, &content.first_view, &Comfort::default());
    let mut headset = ScriptedHeadset::new(&gpu, script).unwrap();
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.show(content).unwrap();
    for (i, expected) in views.iter().enumerate() {
        assert_eq!(viewer.step(&mut headset).unwrap(), None);
        assert_eq!(viewer.last_frame().unwrap().views, *expected, "frame {i}");
    }
    assert_eq!((views.len(), viewer.frames()), (40, 40));
    assert!(
        (views[39][0].eye - views[0][0].eye).length() > 1.0 && views[39][0].rotation != views[0][0].rotation
    );
}
