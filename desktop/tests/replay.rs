//! A session drawn again by the command.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test may")]

mod common;
#[cfg(target_os = "linux")]
#[path = "common/display.rs"]
mod display;

use glam::DVec3;
use motes_app::headset::{Eye, EyeFov, Input, Pose};
use motes_desktop::measure::Picture;
use motes_renderer::order::OrderRequest;
use motes_renderer::{KeyBits, OrderKey, TimeCull};
use motes_xr::{EyeImages, FrameTime, Script, ScriptFrame, ScriptStep, SessionState};

/// Five frames, the last three of which show a scene.
fn script() -> Script {
    let step = |i: i64| {
        let eye = |x: f32| Eye {
            pose: Pose { position: [x, 0.6, 0.02 * i as f32], ..Pose::default() },
            fov: EyeFov { left: -0.7, right: 0.7, up: 0.6, down: -0.6 },
        };
        let order = OrderRequest {
            key: OrderKey::Radial,
            bits: KeyBits::B32,
            center: DVec3::new(0.0, 0.0, -2.0),
            forward: DVec3::Z,
            second: None,
            time: 0.0,
            time_cull: TimeCull::Index,
            parts: 0,
        };
        ScriptStep::Frame(Box::new(ScriptFrame {
            time: FrameTime {
                display_time: 1 + i * 20_000_000,
                period: 20_000_000,
                should_render: true,
                focused: true,
            },
            input: Input::default(),
            eyes: (i > 0).then(|| [eye(-0.032), eye(0.032)]),
            order: (i > 1).then(|| order.into()),
            hidden: None,
        }))
    };
    let mut steps: Vec<_> = (0..5).map(step).collect();
    steps.push(ScriptStep::Ended(SessionState::Exiting));
    Script { images: EyeImages { size: [64, 48], format: ash::vk::Format::R8G8B8A8_SRGB }, steps }
}

#[test]
fn a_session_becomes_pictures() {
    let folder = common::folder("replay");
    let session = folder.join("session.jsonl");
    script().write(&session).unwrap();
    let run = |output: &std::path::Path| {
        let mut command = common::motes();
        command.args(["xr", "--validation", "--replay"]).arg(&session).arg("-o").arg(output);
        let output = command.output().unwrap();
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let (pictures, film) = (folder.join("pictures"), folder.join("film.png"));
    let (succeeded, said) = run(&pictures);
    assert!(succeeded && said.contains("3 frames"), "{said}");
    let load = |i: u32| Picture::load(&pictures.join(format!("{i:05}.png"))).unwrap();
    let [first, second, third] = [0, 1, 2].map(load);
    assert_eq!(first.size(), [128, 48]);
    assert!(first.pixels().iter().flatten().sum::<f32>() > 50.0, "the plant is seen");
    assert!(first != second && second != third, "the head moves");
    let half = |p: &Picture, eye: usize| -> Vec<[f32; 3]> {
        p.pixels().chunks_exact(64).skip(eye).step_by(2).flatten().copied().collect()
    };
    assert!(half(&first, 0) != half(&first, 1), "each eye has its own view");
    let (succeeded, said) = run(&film);
    assert!(succeeded, "{said}");
    assert!(Picture::load(&film).unwrap() == first, "an animated picture begins with the first");

    // Nothing was drawn; no session at all.
    let mut nothing = script();
    nothing.steps.truncate(2);
    nothing.write(&session).unwrap();
    let (succeeded, said) = run(&pictures);
    assert!(!succeeded && said.contains("no frame of the session shows a scene"), "{said}");
    std::fs::write(&session, "a session").unwrap();
    let (succeeded, said) = run(&pictures);
    assert!(!succeeded && said.contains("session.jsonl") && said.contains("line 1"), "{said}");
    let output = common::motes().args(["xr", "-o", "x"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("--replay"), "{said}");
}

/// Long enough to be seen.
#[test]
#[cfg(target_os = "linux")]
fn a_session_is_shown_in_a_window() {
    use std::process::Stdio;
    use std::time::{Duration, Instant};
    let folder = common::folder("preview");
    let session = folder.join("session.jsonl");
    let mut long = script();
    let last = long.steps[4].clone();
    long.steps.splice(4..5, std::iter::repeat_n(last, 8));
    long.write(&session).unwrap();
    let display = display::Display::new(&folder, [200, 100]);
    let mut process = common::motes()
        .args(["xr", "--validation", "--replay"])
        .arg(&session)
        .env("DISPLAY", &display.name)
        .env_remove("WAYLAND_DISPLAY")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    // Both eyes show the plant, which is not grey.
    let colourful = |columns: std::ops::Range<usize>| {
        let screen = display::screen(&display.folder);
        let rows = screen.pixels().chunks_exact(200);
        let pixels = rows.flat_map(|row| &row[columns.clone()]);
        pixels.filter(|p| (p[0] - p[2]).abs() > 0.1).count()
    };
    let mut seen = false;
    let status = loop {
        seen |= colourful(0..64) > 50 && colourful(64..128) > 50;
        if let Some(status) = process.try_wait().unwrap() {
            break status;
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    let mut said = String::new();
    std::io::Read::read_to_string(&mut process.stderr.take().unwrap(), &mut said).unwrap();
    assert!(status.success() && seen, "{status}, seen: {seen}\n{said}");
}
