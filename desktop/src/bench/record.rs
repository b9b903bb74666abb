//! What a bench writes down while it runs: one line of JSON for everything that is finished, so that nothing is lost and
//! nothing is measured twice.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use motes_renderer::gpu::Capabilities;
use motes_renderer::{FrameReport, Traffic};
use serde::{Deserialize, Serialize};

use super::BenchError;
use crate::measure::{Flip, Worst};

/// The file's name in a bench's folder.
pub const FILE: &str = "measurements.jsonl";

/// One line.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Line {
    /// Where a run took place; a run that goes on elsewhere adds another.
    Machine(Machine),
    /// A scene.
    Scene(SceneRecord),
    /// What pictures of a view are measured against.
    Truth(TruthRecord),
    /// A picture against its truth.
    Error(ErrorRecord),
    /// One frame.
    Frame(FrameRecord),
    /// A configuration that cannot run.
    Refused(Refusal),
}

/// Where a run took place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// The Vulkan device.
    pub device: String,
    /// Its driver.
    pub driver: String,
    /// Vulkan's version.
    pub api: String,
    /// Whether the device is the processor.
    pub software: bool,
    /// The processor.
    pub processor: String,
    /// Threads that the system offers.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
    /// This program's version, and whether it was built with optimisation.
    pub version: String,
    /// The commit of the folder that the program lies in, where it is a git checkout.
    pub commit: Option<String>,
    /// Date and time (UTC) when the run began.
    pub date: String,
}

impl Machine {
    /// This one.
    pub fn here(capabilities: &Capabilities) -> Self {
        let build = if cfg!(debug_assertions) { "debug build" } else { "release build" };
        Self {
            device: capabilities.device.clone(),
            driver: capabilities.driver.clone(),
            api: capabilities.api.clone(),
            software: capabilities.software,
            processor: processor(),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            version: format!("{} ({build})", env!("CARGO_PKG_VERSION")),
            commit: commit(),
            date: date(std::time::SystemTime::now()),
        }
    }
}

fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| "unknown processor".to_owned(), |(_, name)| name.trim().to_owned())
}

fn commit() -> Option<String> {
    let program = std::env::current_exe().ok()?;
    let output = std::process::Command::new("git")
        .arg("-C")
        .arg(program.parent()?)
        .args(["describe", "--always", "--dirty", "--abbrev=12"])
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
}

/// `2026-11-25 14:03 UTC`.
fn date(time: std::time::SystemTime) -> String {
    let seconds = time.duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, minutes) = (seconds / 86_400, seconds % 86_400 / 60);
    // Days of the Gregorian calendar, counted in 400-year cycles from the first of March of the year 0.
    let shifted = days + 719_468;
    let (cycle, day) = (shifted / 146_097, shifted % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let (month, carry) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    let year = 400 * cycle + year + carry;
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02} UTC", minutes / 60, minutes % 60)
}

/// A scene, as far as a report needs it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// Its name in the bench.
    pub scene: String,
    /// Splats.
    pub splats: u32,
    /// Degree of its spherical harmonics.
    pub sh_degree: u8,
    /// Whether it moves.
    pub moving: bool,
    /// The named experiment that it is only there for.
    pub only: Option<String>,
}

/// What pictures of a view are measured against.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthRecord {
    /// Scene.
    pub scene: String,
    /// View.
    pub view: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// What it is, in words.
    pub what: String,
    /// Seconds that it took.
    pub seconds: f64,
    /// Layers blended per pixel, where the reference counted them: mean and largest.
    pub layers: Option<[f64; 2]>,
    /// Layers behind which less than 1/255 of the light is left: mean per pixel.
    pub hidden: Option<f64>,
    /// For a stand-in: PSNR (dB) against the reference at a size where that was affordable.
    pub stand_in_psnr: Option<f64>,
}

/// A picture against its truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorRecord {
    /// Scene.
    pub scene: String,
    /// View.
    pub view: String,
    /// Configuration.
    pub configuration: String,
    /// PSNR, dB; absent where nothing differs.
    pub psnr: Option<f64>,
    /// SSIM.
    pub ssim: Option<f64>,
    /// FLIP.
    pub flip: Flip,
    /// The pixel that differs most.
    pub worst: Worst,
    /// Mean FLIP error by angle from the middle of the view, in rings of [`RING_DEGREES`]; −1 where a ring is empty.
    pub rings: Vec<f64>,
    /// Fragments of splats per pixel of the shown image, exactly: shaded, and of those the ones that were blended.
    /// Absent where the device cannot count them.
    pub layers: Option<[f64; 2]>,
    /// A hash of the picture: equal pictures have equal ones.
    pub hash: u64,
    /// Bytes of the scene on the device.
    pub scene_bytes: u64,
    /// Bytes of everything that is allocated on the device.
    pub memory: u64,
}

/// Width of the rings of [`ErrorRecord::rings`].
pub const RING_DEGREES: f64 = 10.0;

/// One frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Scene.
    pub scene: String,
    /// View.
    pub view: String,
    /// Configuration.
    pub configuration: String,
    /// Round: every configuration is drawn once before the next begins.
    pub round: u32,
    /// What the device counted and took.
    pub report: FrameReport,
    /// Bytes that follow from the counts.
    pub traffic: Traffic,
    /// From recording the commands to the device's end, ms.
    pub wall_ms: f64,
    /// Sorting on the processor, ms; absent where the order was kept, or the processor did not sort.
    pub sort_ms: Option<f64>,
}

/// A configuration that cannot run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// Scene.
    pub scene: String,
    /// Configuration.
    pub configuration: String,
    /// Why.
    pub reason: String,
}

/// Everything that a bench's folder holds.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Where it was measured, in order of time.
    pub machines: Vec<Machine>,
    /// Scenes, in the order in which they were measured.
    pub scenes: Vec<SceneRecord>,
    /// Truths by scene and view.
    pub truths: Vec<TruthRecord>,
    /// Errors by scene, view and configuration.
    pub errors: Vec<ErrorRecord>,
    /// Frames.
    pub frames: Vec<FrameRecord>,
    /// Refusals.
    pub refusals: Vec<Refusal>,
    /// Configurations in the order in which they were first seen.
    pub configurations: Vec<String>,
    done: BTreeSet<String>,
}

impl Record {
    fn add(&mut self, line: Line) {
        self.done.insert(key(&line));
        let configuration = match &line {
            Line::Error(e) => Some(e.configuration.clone()),
            Line::Refused(r) => Some(r.configuration.clone()),
            _ => None,
        };
        if let Some(name) = configuration
            && !self.configurations.contains(&name)
        {
            self.configurations.push(name);
        }
        match line {
            Line::Machine(m) => self.machines.push(m),
            Line::Scene(s) => self.scenes.push(s),
            Line::Truth(t) => self.truths.push(t),
            Line::Error(e) => self.errors.push(e),
            Line::Frame(f) => self.frames.push(f),
            Line::Refused(r) => self.refusals.push(r),
        }
    }

    /// Whether a line for the same thing is there.
    pub fn has(&self, line: &Line) -> bool {
        self.done.contains(&key(line))
    }

    /// Whether a picture was compared.
    pub fn has_error(&self, scene: &str, view: &str, configuration: &str) -> bool {
        self.done.contains(&format!("error|{scene}|{view}|{configuration}"))
    }

    /// Whether a frame was measured.
    pub fn has_frame(&self, scene: &str, view: &str, configuration: &str, round: u32) -> bool {
        self.done.contains(&format!("frame|{scene}|{view}|{configuration}|{round}"))
    }

    /// Whether a configuration was refused.
    pub fn is_refused(&self, scene: &str, configuration: &str) -> bool {
        self.done.contains(&format!("refused|{scene}|{configuration}"))
    }

    /// Reads a bench's folder.
    ///
    /// # Errors
    /// No measurements in it, or a line that is none.
    pub fn read(folder: &Path) -> Result<Self, BenchError> {
        let path = folder.join(FILE);
        let text = std::fs::read_to_string(&path).map_err(BenchError::io(&path))?;
        Self::parse(&path, &text).map(|r| r.0)
    }

    /// The record, and the length of the text's whole lines: a run that was cut off may have left half of one.
    fn parse(path: &Path, text: &str) -> Result<(Self, usize), BenchError> {
        let mut record = Self::default();
        let mut whole = 0;
        for (i, line) in text.split_inclusive('\n').enumerate() {
            if !line.ends_with('\n') {
                break;
            }
            let parsed = serde_json::from_str(line).map_err(|e| BenchError::File {
                path: path.to_owned(),
                problem: format!(
                    "line {} is no measurement of this version ({e}). Choose another folder, or delete it to \
                     measure anew",
                    i + 1
                ),
            })?;
            record.add(parsed);
            whole += line.len();
        }
        Ok((record, whole))
    }

    /// Splats of every scene by name.
    pub fn splats(&self) -> BTreeMap<&str, u32> {
        self.scenes.iter().map(|s| (s.scene.as_str(), s.splats)).collect()
    }
}

fn key(line: &Line) -> String {
    match line {
        Line::Machine(m) => format!("machine|{}|{}", m.device, m.date),
        Line::Scene(s) => format!("scene|{}", s.scene),
        Line::Truth(t) => format!("truth|{}|{}", t.scene, t.view),
        Line::Error(e) => format!("error|{}|{}|{}", e.scene, e.view, e.configuration),
        Line::Frame(f) => format!("frame|{}|{}|{}|{}", f.scene, f.view, f.configuration, f.round),
        Line::Refused(r) => format!("refused|{}|{}", r.scene, r.configuration),
    }
}

/// A record that grows.
pub struct Journal {
    /// What is there.
    pub record: Record,
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens a folder's record, or begins one. Half a line at its end, from a run that was cut off, is removed.
    ///
    /// # Errors
    /// The folder cannot be made or written, or its record is none.
    pub fn open(folder: &Path) -> Result<Self, BenchError> {
        std::fs::create_dir_all(folder).map_err(BenchError::io(folder))?;
        let path = folder.join(FILE);
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .open(&path)
            .map_err(BenchError::io(&path))?;
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(BenchError::io(&path))?;
        let (record, whole) = Record::parse(&path, &text)?;
        if whole < text.len() {
            file.set_len(whole as u64).map_err(BenchError::io(&path))?;
            file.seek(SeekFrom::End(0)).map_err(BenchError::io(&path))?;
        }
        Ok(Self { record, path, file })
    }

    /// Writes a line down, unless one for the same thing is there.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write(&mut self, line: Line) -> Result<(), BenchError> {
        if self.record.has(&line) {
            return Ok(());
        }
        let io = |e: std::io::Error| BenchError::Io { path: self.path.clone(), source: e };
        let mut text = serde_json::to_string(&line).map_err(|e| io(e.into()))?;
        text.push('\n');
        self.file.write_all(text.as_bytes()).map_err(io)?;
        self.record.add(line);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("motes-bench-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        path
    }

    fn refusal(configuration: &str) -> Line {
        Line::Refused(Refusal {
            scene: "s".into(),
            configuration: configuration.into(),
            reason: "because".into(),
        })
    }

    fn frame(round: u32) -> Line {
        Line::Frame(FrameRecord {
            scene: "s".into(),
            view: "v".into(),
            configuration: "default".into(),
            round,
            report: FrameReport::default(),
            traffic: Traffic::default(),
            wall_ms: 1.5,
            sort_ms: None,
        })
    }

    #[test]
    fn a_run_that_was_cut_off_goes_on() {
        let folder = folder("resume");
        let mut journal = Journal::open(&folder).unwrap();
        journal.write(refusal("shape=diamond")).unwrap();
        journal.write(frame(1)).unwrap();
        journal.write(frame(1)).unwrap();
        drop(journal);
        let path = folder.join(FILE);
        let whole = std::fs::read_to_string(&path).unwrap();
        assert_eq!(whole.lines().count(), 2);
        std::fs::write(&path, format!("{whole}{{\"kind\":\"fra")).unwrap();
        let mut journal = Journal::open(&folder).unwrap();
        assert!(journal.record.has_frame("s", "v", "default", 1));
        assert!(!journal.record.has_frame("s", "v", "default", 2));
        assert!(
            journal.record.is_refused("s", "shape=diamond") && !journal.record.is_refused("s", "default")
        );
        journal.write(frame(2)).unwrap();
        let record = Record::read(&folder).unwrap();
        assert_eq!((record.frames.len(), record.refusals.len()), (2, 1));
        assert_eq!(record.configurations, ["shape=diamond"]);
    }

    #[test]
    fn other_files_are_refused_by_line() {
        let folder = folder("foreign");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(FILE), "{\"kind\":\"wave\"}\n").unwrap();
        let error = Journal::open(&folder).err().unwrap().to_string();
        assert!(error.contains("line 1") && error.contains(FILE), "{error}");
        assert!(Record::read(&folder.join("nowhere")).is_err());
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        let at = |seconds| date(std::time::UNIX_EPOCH + std::time::Duration::from_secs(seconds));
        assert_eq!(at(0), "1970-01-01 00:00 UTC");
        assert_eq!(at(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(at(1_798_761_599), "2026-12-31 23:59 UTC");
    }
}
