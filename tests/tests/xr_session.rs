//! A session on Monado, from its beginning to its end, with both validation layers on.
#![allow(clippy::unwrap_used, reason = "a test may")]

use motes_app::headset::Comfort;
use motes_app::loader::Storage;
use motes_app::opened::Opened;
use motes_desktop::measure as saved;
use motes_desktop::replay::{ReplayOptions, replay};
use motes_desktop::studio::{picture_of, side_by_side};
use motes_renderer::gpu::Gpu;
use motes_renderer::{Packing, Picture, Precision, RenderConfig, ShPrecision};
use motes_scenes::LoadOptions;
use motes_tests::monado::{Source, with_monado};
use motes_tests::{TestGpu, sample};
use motes_xr::{
    Content, Headset, Recorder, Runtime, RuntimeHeadset, RuntimeOptions, Script, ScriptStep, ScriptedHeadset,
    SessionOptions, SessionState, Viewer,
};
use std::sync::Arc;

const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 1 };

/// A small real scene.
fn opened() -> Opened {
    Opened::load(&[sample("static/fruit_drops_minimal.ply")], &LoadOptions::default()).unwrap()
}

fn content(gpu: &Arc<Gpu>) -> Content {
    Content::new(gpu, &opened(), PACKING).unwrap()
}

/// A session with both validation layers, of half the runtime's resolution: the driver draws on the processor.
fn headset() -> RuntimeHeadset {
    let runtime =
        Runtime::new(&(), RuntimeOptions { validation: true, readable: true, ..Default::default() }).unwrap();
    let options = SessionOptions { resolution_scale: 0.5, ..Default::default() };
    RuntimeHeadset::new(runtime, &options).unwrap()
}

/// Neither layer may have said anything.
fn clean(headset: &RuntimeHeadset) {
    let said = headset.runtime().messages();
    assert!(said.is_empty(), "OpenXR's core validation complains: {said:#?}");
    let said = headset.gpu().messages();
    assert!(said.is_empty(), "Vulkan's validation complains: {said:#?}");
}

#[test]
fn three_hundred_frames_begin_and_end_cleanly() {
    with_monado("three_hundred_frames_begin_and_end_cleanly", Source::Simulated, || {
        let mut headset = headset();
        let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
        viewer.show(content(headset.gpu())).unwrap();
        let mut states = Vec::new();
        let ended = loop {
            if let Some(ended) = viewer.step(&mut headset).unwrap() {
                break ended;
            }
            if states.last() != Some(&headset.state()) {
                states.push(headset.state());
            }
            if viewer.frames() == 300 {
                headset.request_exit().unwrap();
            }
        };
        assert_eq!(ended, SessionState::Exiting);
        assert!(states.contains(&SessionState::Focused), "{states:?}");
        let report = viewer.report();
        assert!(report.visible > 1000 && report.views == 2, "the scene was seen: {report:?}");
        drop(viewer);
        clean(&headset);
    });
}

/// What a session's eyes saw, frame by frame.
fn watch(headset: &mut dyn Headset, content: Content, frames: u64) -> Vec<[Picture; 2]> {
    let mut viewer = Viewer::new(headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.read_back(headset, true).unwrap();
    viewer.show(content).unwrap();
    let mut seen = Vec::new();
    while viewer.step(headset).unwrap().is_none() {
        seen.extend(viewer.pictures());
        if viewer.frames() == frames {
            headset.request_exit().unwrap();
        }
    }
    seen
}

#[test]
fn a_recorded_session_replays_bit_for_bit() {
    with_monado("a_recorded_session_replays_bit_for_bit", Source::Simulated, || {
        let file = std::env::temp_dir().join(format!("motes-session-{}.jsonl", std::process::id()));
        let seen = {
            let headset = headset();
            let content = content(headset.gpu());
            let mut headset = Recorder::new(headset, &file).unwrap();
            let seen = watch(&mut headset, content, 20);
            clean(headset.inner());
            seen
        };
        let script = Script::read(&file).unwrap();
        std::fs::remove_file(&file).unwrap();
        let gpu = TestGpu::new();
        let again = {
            let content = content(&gpu);
            watch(&mut ScriptedHeadset::new(&gpu, script.clone()).unwrap(), content, u64::MAX)
        };
        assert!(seen.len() >= 20 && again == seen, "{} frames, {} replayed", seen.len(), again.len());
        // By the command, as files.
        let folder = tempfile::tempdir().unwrap();
        let options = ReplayOptions {
            storage: Storage::As(PACKING),
            config: RenderConfig::default(),
            comfort: Comfort::default(),
            budget: None,
        };
        let frames = replay(&gpu, &opened(), script.clone(), &options, folder.path()).unwrap();
        assert_eq!(frames as usize, seen.len());
        for (i, eyes) in seen.iter().enumerate() {
            let file = saved::Picture::load(&folder.path().join(format!("{i:05}.png"))).unwrap();
            let eyes = [picture_of(&eyes[0]).unwrap(), picture_of(&eyes[1]).unwrap()];
            assert!(file == side_by_side(&eyes).unwrap(), "frame {i}");
        }
        assert_ne!(seen[5][0], seen[5][1], "the eyes see different pictures");
        assert_ne!(seen[5], seen[15], "the simulated head moves");
        // Control: one bit of one pose is another picture, if only by a bit; a tenth of a degree surely is.
        let mut wrong = script;
        for step in &mut wrong.steps {
            if let ScriptStep::Frame(frame) = step
                && let Some(eyes) = &mut frame.eyes
            {
                eyes[0].pose.position[0] += 0.001;
            }
        }
        let moved = {
            let content = content(&gpu);
            watch(&mut ScriptedHeadset::new(&gpu, wrong).unwrap(), content, u64::MAX)
        };
        assert!(moved.iter().zip(&seen).all(|(a, b)| a[0] != b[0]));
    });
}
