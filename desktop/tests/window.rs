//! The window on a display of its own: keys in, pictures out.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test may")]
#![cfg(target_os = "linux")]

mod common;
#[path = "common/display.rs"]
mod display;

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use display::{Display, screen};
use motes_desktop::measure::Picture;

const SIZE: [u32; 2] = [480, 320];
/// There is no headset.
const NO_RUNTIME: &str = "/nowhere/runtime.json";
const PATIENCE: Duration = Duration::from_secs(120);

fn xdotool(display: &Display, arguments: &[&str]) -> String {
    let output = Command::new("xdotool").args(arguments).env("DISPLAY", &display.name).output();
    String::from_utf8(output.expect("xdotool is not installed").stdout).unwrap()
}

/// The program with its window.
struct Program<'a> {
    display: &'a Display,
    process: Child,
    lines: Receiver<String>,
}

impl<'a> Program<'a> {
    fn start(display: &'a Display, arguments: &[&str]) -> Self {
        let mut process = common::motes()
            .args(arguments)
            .env("DISPLAY", &display.name)
            .env_remove("WAYLAND_DISPLAY")
            .env("XR_RUNTIME_JSON", NO_RUNTIME)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let stdout = BufReader::new(process.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        let mut program = Self { display, process, lines };
        // The title says when the scene is there.
        let window = program.until("the scene is on show", |d| {
            let found = xdotool(d, &["search", "--name", "plant.spz"]);
            found.lines().next_back().map(str::to_owned)
        });
        xdotool(display, &["windowfocus", "--sync", &window]);
        program
    }

    fn until<T>(&mut self, what: &str, check: impl Fn(&Display) -> Option<T>) -> T {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            if let Some(found) = check(self.display) {
                return found;
            }
            if let Some(status) = self.process.try_wait().unwrap() {
                let mut said = String::new();
                self.process.stderr.take().unwrap().read_to_string(&mut said).unwrap();
                panic!("motes ended ({status}) before {what}:\n{said}");
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("no sign of this: {what}");
    }

    fn press(&self, key: &str) {
        xdotool(self.display, &["key", key]);
    }

    /// A picture by the key for it.
    fn picture(&self) -> Picture {
        self.press("p");
        let line = self.lines.recv_timeout(PATIENCE).expect("no picture was saved");
        Picture::load(Path::new(&line)).unwrap()
    }

    /// Says what was said on the error output.
    fn quit(mut self) -> String {
        self.press("Escape");
        let start = Instant::now();
        let status = loop {
            match self.process.try_wait().unwrap() {
                Some(status) => break status,
                None if start.elapsed() > PATIENCE => panic!("it does not quit"),
                None => std::thread::sleep(Duration::from_millis(50)),
            }
        };
        let mut said = String::new();
        self.process.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert!(status.success(), "{status}: {said}");
        said
    }
}

impl Drop for Program<'_> {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Largest difference of two pictures, steps of 255, in columns `from .. to`.
fn difference(a: &Picture, b: &Picture, from: u32, to: u32) -> f32 {
    assert_eq!(a.size(), b.size());
    let columns = |i: &usize| (from..to).contains(&(*i as u32 % a.size()[0]));
    let each = a.pixels().iter().zip(b.pixels()).enumerate().filter(|(i, _)| columns(i));
    each.flat_map(|(_, (a, b))| (0..3).map(|c| (a[c] - b[c]).abs())).fold(0.0, f32::max) * 255.0
}

/// Mean brightness of columns `from .. to`.
fn brightness(picture: &Picture, from: u32, to: u32) -> f32 {
    let columns = |i: usize| (from..to).contains(&(i as u32 % picture.size()[0]));
    let inside: Vec<_> = picture.pixels().iter().enumerate().filter(|(i, _)| columns(*i)).collect();
    inside.iter().map(|(_, p)| p.iter().sum::<f32>() / 3.0).sum::<f32>() / inside.len() as f32
}

#[test]
fn keys_move_the_eye_and_save_pictures() {
    let folder = common::folder("window");
    let display = Display::new(&folder, SIZE);
    let size = format!("{}x{}", SIZE[0], SIZE[1]);
    let pictures = folder.join("pictures");
    let arguments = ["--size", &size, "--no-panel", "--validation", "--pictures", pictures.to_str().unwrap()];
    let mut program = Program::start(&display, &arguments);

    let first = program.picture();
    assert_eq!(first.size(), SIZE);
    assert!(brightness(&first, 0, SIZE[0]) > 0.02, "the picture is blank");
    // Without a panel the window shows the very picture that is saved.
    program.until("the picture on the screen", |d| {
        (difference(&screen(&d.folder), &first, 0, SIZE[0]) <= 1.0).then_some(())
    });

    xdotool(&display, &["keydown", "Right"]);
    program.until("a turn", |d| (difference(&screen(&d.folder), &first, 0, SIZE[0]) > 60.0).then_some(()));
    xdotool(&display, &["keyup", "Right"]);
    let turned = program.picture();
    assert!(difference(&turned, &first, 0, SIZE[0]) > 60.0, "the eye has not moved");

    program.press("v");
    let stereo = program.picture();
    let half = SIZE[0] / 2;
    for from in [0, half] {
        assert!(brightness(&stereo, from, from + half) > 0.02, "an eye sees nothing");
    }
    program.press("v");
    assert_eq!(difference(&program.picture(), &turned, 0, SIZE[0]), 0.0, "one eye again");

    program.press("Tab");
    program.until("the panel", |d| {
        (difference(&screen(&d.folder), &turned, SIZE[0] - 60, SIZE[0]) > 60.0).then_some(())
    });
    assert_eq!(difference(&program.picture(), &turned, 0, SIZE[0]), 0.0, "the panel is not in a picture");
    program.press("Home");
    assert_eq!(difference(&program.picture(), &first, 0, SIZE[0]), 0.0, "back to the first view");
    assert_eq!(program.quit(), "");
}

#[test]
fn without_a_headset_a_window_opens() {
    let folder = common::folder("no-headset");
    let display = Display::new(&folder, SIZE);
    let mut program = Program::start(&display, &["xr", "--validation"]);
    program.until("the plant", |d| {
        let seen = screen(&d.folder);
        (brightness(&seen, 0, SIZE[0]) > 0.02).then_some(())
    });
    let said = program.quit();
    assert!(said.contains("no OpenXR runtime is installed or active"), "{said}");
    assert!(said.contains("A window opens instead"), "{said}");
}

#[test]
fn without_a_display_pictures_are_named() {
    let mut command = common::motes();
    for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
        command.env_remove(name);
    }
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success());
    assert!(said.contains("no display") && said.contains("motes render"), "{said}");
    // Neither a headset: both are said.
    let output = command.arg("xr").env("XR_RUNTIME_JSON", NO_RUNTIME).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success());
    assert!(said.contains("no OpenXR runtime") && said.contains("no display"), "{said}");
}
