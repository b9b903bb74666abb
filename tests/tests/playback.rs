//! A moving scene in a scripted session at 72 Hz: each frame shows its own time, in an order that is made for it, between
//! the scene's frames and at whole ones.
#![allow(clippy::unwrap_used, reason = "a test may")]

use ash::vk;
use glam::DVec3;
use motes_app::governor::{Budget, Governor};
use motes_app::headset::{Comfort, Eye, EyeFov, Input, Pose};
use motes_app::measurement::SWEEP;
use motes_app::opened::Opened;
use motes_app::sequence::SequenceOnDevice;
use motes_app::time::{TimeCommand, TimeControl};
use motes_desktop::bench::record::Record;
use motes_renderer::{
    Fov, Offscreen, Packing, Picture, Precision, RenderConfig, SceneOnDevice, ShPrecision, Sorter, View,
};
use motes_scenes::synthetic::{Animation, Recipe};
use motes_scenes::{LoadOptions, load_many, save, sequence_frames};
use motes_tests::TestGpu;
use motes_xr::{
    Content, EyeImages, FrameTime, Script, ScriptFrame, ScriptStep, ScriptedHeadset, SessionState, Viewer,
};

const PERIOD: i64 = 1_000_000_000 / 72;
const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// The head stands still for so many frames, then as many elsewhere, and so on.
fn script(frames: i64, still: i64) -> Script {
    let eye = |frame: i64, x: f32| Eye {
        pose: Pose { position: [x + 0.05 * (frame / still) as f32, 1.6, 0.0], ..Pose::default() },
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
            hidden: None,
        }))
    };
    let mut steps: Vec<_> = (0..frames).map(step).collect();
    steps.push(ScriptStep::Ended(SessionState::Exiting));
    Script { images: EyeImages { size: [64, 64], format: vk::Format::R8G8B8A8_UNORM }, steps }
}

/// What a session at 72 Hz showed of a scene of 30 frames a second.
struct Seen {
    /// Scene times, frame by frame.
    times: Vec<f32>,
    /// How many frames an order was older than the frame that it was used for, at most.
    oldest: usize,
}

fn play(whole_frames: bool) -> Seen {
    let gpu = TestGpu::new();
    let animation = Animation { fleeting: 1.0, width: 0.05, ..Animation::default() };
    let splats = Recipe { count: 1500, seed: 8, ..Recipe::default() }.moving(&animation);
    let name = format!("motes-playback-{}-{whole_frames}.ply", std::process::id());
    let file = std::env::temp_dir().join(name);
    save(&file, &splats).unwrap();
    let opened = Opened::load(std::slice::from_ref(&file), &LoadOptions::default()).unwrap();
    std::fs::remove_file(&file).unwrap();
    let mut headset = ScriptedHeadset::new(&gpu, script(24, 6)).unwrap();
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.show(Content::new(&gpu, &opened, PACKING).unwrap()).unwrap();
    assert!(viewer.playback.is_some(), "a moving scene plays by itself");
    viewer.read_back(&headset, true).unwrap();
    // Thirty scene frames a second, so that times and views do not go in step.
    let mut control = TimeControl::new(1.0, 30);
    control.obey(TimeCommand::WholeFrames(whole_frames));
    viewer.playback = Some(control);

    let scene = SceneOnDevice::new(&gpu, &opened.scene.splats, PACKING).unwrap();
    assert!(scene.positions.alive().is_some());
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut seen = Seen { times: Vec::new(), oldest: 0 };
    let mut wanted = Vec::new();
    let mut before = None;
    while viewer.step(&mut headset).unwrap().is_none() {
        let frame = seen.times.len();
        let last = *viewer.last_frame().unwrap();
        let pictures = viewer.pictures().unwrap();
        let exact = frame as f64 * PERIOD as f64 / 1e9;
        let time = if whole_frames { (exact * 30.0 + 1e-9).floor() / 30.0 } else { exact } as f32;
        assert!((last.wanted.time - time).abs() < 1e-6, "frame {frame}: {} is not {time}", last.wanted.time);
        assert!((last.used.time - time).abs() < 1e-6, "frame {frame}: an order for {}", last.used.time);
        // The order was made for this frame, or for where the eyes were in the one before.
        wanted.push(last.wanted.center);
        let age = wanted.iter().rev().position(|&center| center == last.used.center);
        seen.oldest = seen.oldest.max(age.unwrap());
        let at = |time| RenderConfig { time, ..RenderConfig::default() };
        // Where the head stood still the order was made for the very place; where it has just moved, for the place before.
        assert!(frame.is_multiple_of(6) || last.used == last.wanted, "frame {frame}");
        let sorted_from = if last.used.center == last.wanted.center { last.views } else { before.unwrap() };
        before = Some(last.views);
        offscreen.sort(&scene, &sorted_from, &at(last.used.time));
        let (expected, _) = offscreen.picture(&scene, &last.views, &at(last.wanted.time)).unwrap();
        for eye in 0..2 {
            assert!(pictures[eye] == expected[eye], "frame {frame}, eye {eye}");
        }
        // Controls: another time, and the other eye.
        let early = at(last.wanted.time - PERIOD as f32 / 1e9);
        let (early, _) = offscreen.render(&scene, &last.views, &early).unwrap();
        assert!(pictures[0] != early[0] && pictures[1] != early[1], "frame {frame} is not the one before");
        assert!(pictures[0] != pictures[1]);
        seen.times.push(last.wanted.time);
    }
    assert_eq!(seen.times.len(), 24);
    println!("whole frames {whole_frames}: the oldest order was {} frames old", seen.oldest);
    seen
}

#[test]
fn every_frame_shows_its_time_in_both_eyes() {
    let seen = play(false);
    assert!(seen.oldest <= 1, "{}", seen.oldest);
    assert!(seen.times.windows(2).all(|w| w[1] > w[0]));
}

#[test]
fn whole_frames_at_30_hz_are_shown_at_72() {
    let seen = play(true);
    assert!(seen.oldest <= 1, "{}", seen.oldest);
    let mut distinct = seen.times.clone();
    distinct.dedup();
    // A third of a second: ten frames, each seen two or three times.
    assert_eq!(distinct.len(), 10);
}

/// The panel's measurement, to its end: a record as `motes bench` keeps it, a table, and the rates that follow.
#[test]
fn a_measurement_in_the_headset_is_a_benchs_record() {
    let gpu = TestGpu::new();
    let opened =
        Opened::load(&[motes_tests::sample("static/fruit_drops_minimal.ply")], &LoadOptions::default());
    let mut headset = ScriptedHeadset::new(&gpu, script(500, 500)).unwrap();
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.show(Content::new(&gpu, &opened.unwrap(), PACKING).unwrap()).unwrap();
    viewer.measure();
    assert!(!viewer.measuring(), "there is no folder yet");
    let folder = tempfile::tempdir().unwrap();
    viewer.measurements = Some(folder.path().to_owned());
    viewer.measure();
    let mut frames = 0;
    while viewer.measuring() {
        assert!(viewer.step(&mut headset).unwrap().is_none(), "the script is too short");
        frames += 1;
    }
    let written = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let record = Record::read(&written).unwrap();
    assert_eq!((record.machines.len(), record.scenes.len(), record.refusals.len()), (1, 1, 0));
    assert_eq!(record.frames.len() % SWEEP.len(), 0);
    assert!(frames > record.frames.len() && record.frames.len() >= 12 * 20, "{frames}");
    // Each configuration was really drawn: other choices, other counts.
    let fragments = |name: &str| {
        let mut of: Vec<_> =
            record.frames.iter().filter(|f| f.configuration == name).map(|f| f.report.fragments).collect();
        of.sort_unstable();
        of[of.len() / 2]
    };
    assert!(fragments("shape=diamond") < fragments("default"));
    assert!(fragments("shape=square") > fragments("default"));
    assert!(fragments("composite=front-to-back") >= fragments("default"));
    let table = std::fs::read_to_string(written.join("results.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + SWEEP.len());
    assert!(record.frames.iter().all(|f| f.report.device_ns() > 0.0 && f.report.views == 2));
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
        let mut headset = ScriptedHeadset::new(&gpu, script(150, 6)).unwrap();
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

/// Frames are read and brought to the device ahead, within a budget that holds four of twelve; each is its own file's.
#[test]
fn a_sequence_is_shown_frame_by_frame_within_its_budget() {
    let gpu = TestGpu::new();
    let frames = sequence_frames(&motes_tests::sample("4d/flipbook_monkey")).unwrap();
    let options = LoadOptions::default();
    let one = SceneOnDevice::new(&gpu, &load_many(&frames[..1], &options).unwrap().splats, PACKING).unwrap();
    let budget = 9 * (one.bytes() + 12 * u64::from(one.splats)) / 2;
    let mut sequence = SequenceOnDevice::new(&gpu, &frames, PACKING, budget).unwrap();
    let control = sequence.time_control();
    assert_eq!((control.frames(), (control.duration() * 30.0).round()), (12, 12.0));
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let view = View::look_at(
        DVec3::new(0.3, 0.2, -3.0),
        DVec3::ZERO,
        DVec3::NEG_Y,
        Fov { left: -0.8, right: 0.8, up: -0.6, down: 0.6 },
        [64, 48],
    );
    let config = RenderConfig { sorter: Sorter::Gpu, ..RenderConfig::default() };
    let mut before: Option<Vec<Picture>> = None;
    for (frame, path) in frames.iter().enumerate().step_by(4) {
        let shown = sequence.wait_for(frame).unwrap();
        let (pictures, _) = offscreen.render(&shown, &[view], &config).unwrap();
        let alone = load_many(std::slice::from_ref(path), &options).unwrap().splats;
        let alone = SceneOnDevice::new(&gpu, &alone, PACKING).unwrap();
        let (expected, _) = offscreen.render(&alone, &[view], &config).unwrap();
        assert!(pictures == expected, "frame {frame}");
        // Control: the frame before is another.
        assert!(before.as_ref() != Some(&pictures), "frame {frame} is the one before");
        before = Some(pictures);
    }
    assert!(sequence.peak() <= budget, "{} of {budget} bytes", sequence.peak());
    println!("{} of {budget} bytes at most", sequence.peak());
    gpu.wait_idle().unwrap();
}
