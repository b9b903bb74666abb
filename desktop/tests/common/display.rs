//! A display of a test's own: Xvfb, whose memory is a file.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use motes_desktop::measure::Picture;

/// An X server without a screen.
pub struct Display {
    server: Child,
    /// What clients call it, such as `:99`.
    pub name: String,
    /// Where its memory is.
    pub folder: PathBuf,
}

impl Display {
    /// Starts one of this size; its memory is kept in a folder.
    pub fn new(folder: &Path, size: [u32; 2]) -> Self {
        // Without `-noreset` the server begins anew when its last client leaves, and refuses whoever comes meanwhile:
        // a program that starts while `xdotool` has just looked for its window.
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-nolisten", "tcp", "-noreset", "-screen", "0"])
            .arg(format!("{}x{}x24", size[0], size[1]))
            .arg("-fbdir")
            .arg(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is not installed (package xvfb)");
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        Self { server, name: format!(":{}", number.trim()), folder: folder.to_owned() }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// What is on the screen of the server that keeps its memory in a folder: an X window dump with 32 bits a pixel, blue
/// first.
pub fn screen(folder: &Path) -> Picture {
    let bytes = std::fs::read(folder.join("Xvfb_screen0")).unwrap();
    let word = |i: usize| u32::from_be_bytes(bytes[4 * i..4 * i + 4].try_into().unwrap()) as usize;
    let (header, width, height, row, colours) = (word(0), word(4), word(5), word(12), word(19));
    let start = header + 12 * colours;
    let pixel = |y: usize, x: usize| {
        let at = start + y * row + 4 * x;
        [bytes[at + 2], bytes[at + 1], bytes[at]]
    };
    let rgb: Vec<u8> = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(y, x))).collect();
    Picture::from_rgb8([width as u32, height as u32], &rgb).unwrap()
}
