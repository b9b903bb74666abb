//! What goes wrong with a headset's session: the behaviour and the message of each.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use clap::Parser;
use motes_app::headset::Comfort;
use motes_app::loader::{SceneSource, Storage};
use motes_app::opened::Opened;
use motes_desktop::commands::xr::{Outcome, XrArgs, run};
use motes_renderer::{Packing, Precision, RenderConfig, ShPrecision};
use motes_scenes::LoadOptions;
use motes_tests::monado::{Inside, Monado, Source, inside, log_to_stderr};
use motes_tests::sample;
use motes_xr::{
    Content, Headset, Runtime, RuntimeHeadset, RuntimeOptions, SessionOptions, SessionState, ShowOptions,
    Viewer, show,
};
use std::time::Duration;

const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// Coarse images: the driver draws on the processor.
fn coarse() -> SessionOptions {
    SessionOptions { resolution_scale: 0.3, ..Default::default() }
}

fn headset() -> (RuntimeHeadset, Viewer) {
    let runtime =
        Runtime::new(&(), RuntimeOptions { validation: true, readable: false, ..Default::default() })
            .unwrap();
    let headset = RuntimeHeadset::new(runtime, &coarse()).unwrap();
    let path = sample("static/fruit_drops_minimal.ply");
    let opened = Opened::load(&[path], &LoadOptions::default()).unwrap();
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.show(Content::new(headset.gpu(), &opened, PACKING).unwrap()).unwrap();
    (headset, viewer)
}

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    xr: XrArgs,
}

fn args(line: &str) -> XrArgs {
    Line::parse_from(std::iter::once("motes").chain(line.split_whitespace())).xr
}

#[test]
fn without_a_runtime_the_command_says_so_and_asks_for_a_window() {
    let name = "without_a_runtime_the_command_says_so_and_asks_for_a_window";
    if inside() {
        let Outcome::Window(reason) = run(&args("")).unwrap() else { panic!("there is no headset") };
        println!("{reason}");
        let error = run(&args("--no-window")).unwrap_err().to_string();
        assert_eq!(error, reason, "where no window may stand in, it is an error");
        return;
    }
    // The manifest that the environment names is not there.
    let said = Inside::start(name, &[("XR_RUNTIME_JSON", "/nowhere/runtime.json".into())]).finish();
    assert!(
        said.contains("no OpenXR runtime is installed or active. Start your headset's software"),
        "{said}"
    );
    // The runtime is there, and its service is not.
    let folder = std::env::temp_dir().join(format!("motes-empty-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let said = Inside::start(name, &[("XDG_RUNTIME_DIR", folder.clone().into())]).finish();
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(said.contains("installed but does not run") && said.contains("monado-service"), "{said}");
}

#[test]
fn a_killed_service_ends_the_session_with_an_error() {
    let name = "a_killed_service_ends_the_session_with_an_error";
    if inside() {
        log_to_stderr();
        let (mut headset, mut viewer) = headset();
        let error = loop {
            match viewer.step(&mut headset) {
                Ok(ended) => assert_eq!(ended, None),
                Err(error) => break error,
            }
            if viewer.frames() == 3 {
                println!("under way");
            }
        };
        println!("{error}");
        assert!(error.is_lost(), "{error:?}");
        drop(viewer);
        assert!(headset.gpu().messages().is_empty(), "{:#?}", headset.gpu().messages());
        return;
    }
    let mut monado = Monado::start(Source::Simulated);
    let mut session = Inside::start(name, &monado.environment());
    session.wait_for("under way");
    monado.kill();
    let said = session.finish();
    assert!(said.contains("the OpenXR runtime was lost in mid-session"), "{said}");
}

#[test]
fn a_runtime_that_comes_back_is_used_again() {
    let name = "a_runtime_that_comes_back_is_used_again";
    if inside() {
        log_to_stderr();
        let options = ShowOptions {
            source: SceneSource::Files(vec![sample("static/fruit_drops_minimal.ply")]),
            storage: Storage::As(PACKING),
            config: RenderConfig::default(),
            comfort: Comfort::default(),
            budget: None,
            detail_target: 0.97,
            pipelines: None,
            session: coarse(),
            runtime: RuntimeOptions::default(),
            record: None,
            frames: 60,
            patience: Duration::from_secs(40),
            folder: None,
            report: None,
            measurements: None,
            thumbnails: None,
        };
        let visit = show(&(), &options, &mut || false).unwrap();
        println!("{visit:?}");
        assert_eq!((visit.recoveries, visit.frames >= 60), (1, true), "{visit:?}");
        return;
    }
    let mut monado = Monado::start(Source::Simulated);
    let mut session = Inside::start(name, &monado.environment());
    session.wait_for("visible -> focused");
    monado.kill();
    session.wait_for("Waiting for it for 40 s");
    monado.restart();
    session.wait_for("the runtime is back");
    let said = session.finish();
    // Shown in both sessions; or in the second alone, where the first one was killed before the scene was there.
    assert!((1..=2).contains(&said.matches("4721 splats").count()), "{said}");
}

#[test]
fn focus_lost_to_a_second_client_comes_back() {
    let name = "focus_lost_to_a_second_client_comes_back";
    if inside() {
        log_to_stderr();
        let (mut headset, mut viewer) = headset();
        let second = std::env::var_os("MOTES_TEST_SECOND").is_some();
        let mut states = Vec::new();
        let mut hidden = 0;
        loop {
            let before = viewer.frames();
            assert_eq!(viewer.step(&mut headset).unwrap(), None);
            let state = headset.state();
            if states.last() != Some(&state) {
                println!("now {state}");
                states.push(state);
            }
            if matches!(state, SessionState::Synchronized | SessionState::Ready) && viewer.frames() == before
            {
                hidden += 1;
            }
            let focused = states.iter().filter(|s| **s == SessionState::Focused).count();
            if focused == if second { 1 } else { 2 } && viewer.frames() >= 10 {
                break;
            }
        }
        println!("{states:?}, {hidden} frames of which nothing is seen");
        assert!(hidden > 0, "frames with should_render = false are ended and not drawn");
        headset.request_exit().unwrap();
        while viewer.step(&mut headset).unwrap().is_none() {}
        drop(viewer);
        let said = headset.runtime().messages();
        assert!(said.is_empty(), "OpenXR's core validation complains: {said:#?}");
        assert!(headset.gpu().messages().is_empty(), "{:#?}", headset.gpu().messages());
        return;
    }
    let mut monado = Monado::start(Source::Simulated);
    let mut first = Inside::start(name, &monado.environment());
    first.wait_for("now focused");
    let mut environment = monado.environment();
    environment.push(("MOTES_TEST_SECOND", "1".into()));
    let second = Inside::start(name, &environment);
    first.wait_for("now synchronized");
    second.finish();
    first.wait_for("now focused");
    first.finish();
    assert!(monado.stop().success());
}
