//! What a bench writes down while it runs: one line of JSON for everything that is finished, so that nothing is lost and
//! nothing is measured twice.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

pub use motes_app::measurement::{FrameRecord, Machine, RECORD as FILE, Refusal, SceneRecord};
use serde::{Deserialize, Serialize};

use super::BenchError;
use crate::measure::{Flip, Worst};

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
    use motes_renderer::{FrameReport, Traffic};

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
}
