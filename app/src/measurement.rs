//! What a viewer measures on its own device: a fixed sweep of configurations on the scene that is shown. It is written
//! down in the form of `motes bench`, and the rates that `motes bench --rates` predicts frames by follow from it.
//!
//! Errors are not measured here: there is no reference in a headset. They do not depend on the device either, so a
//! bench on any machine has them.

use std::path::{Path, PathBuf};

use motes_renderer::gpu::Capabilities;
use motes_renderer::{CHOICES, Choice, FrameReport, RenderConfig, Traffic};
use serde::{Deserialize, Serialize};

use crate::prediction::{FrameLoad, StageRates};

/// The record's name in a bench's folder: a line of JSON for everything that is finished.
pub const RECORD: &str = "measurements.jsonl";
/// The table's name.
const TABLE: &str = "results.csv";
/// The name of the rates that follow.
const RATES: &str = "rates.json";

/// The configurations: what they change in the default. Nothing that would need the scene in another packing.
pub const SWEEP: [&str; 13] = [
    "default",
    "expansion=instanced",
    "projection=affine",
    "projection=exact",
    "shape=adaptive",
    "shape=square",
    "shape=diamond",
    "radius=full",
    "sort=gpu",
    "composite=front-to-back",
    "stop-below=0.02",
    "min-contribution=2",
    "target-format=rgba8",
];
/// Frames of each configuration that are not counted: pipelines are made, and reports are two frames old.
const WARM: u32 = 4;
/// Frames of each configuration that are.
const COUNTED: u32 = 20;

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
    if cfg!(target_os = "android") {
        return None;
    }
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

/// A line of the record, of the kinds that a viewer writes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Line {
    /// Where a run took place.
    Machine(Machine),
    /// A scene.
    Scene(SceneRecord),
    /// One frame.
    Frame(FrameRecord),
    /// A configuration that cannot run.
    Refused(Refusal),
}

/// What a configuration changes in the default: `shape=diamond stop-below=0.02`, or `default`.
pub fn describe(config: &RenderConfig) -> String {
    let default = RenderConfig::default();
    let differs = |c: &&Choice| c.get(config) != c.get(&default);
    let changes: Vec<_> =
        CHOICES.iter().filter(differs).map(|c| format!("{}={}", c.name, c.get(config))).collect();
    if changes.is_empty() { "default".to_owned() } else { changes.join(" ") }
}

/// The inverse of [`describe`].
///
/// # Errors
/// What choice or value does not exist.
pub fn parse(text: &str) -> Result<RenderConfig, String> {
    let mut config = RenderConfig::default();
    for word in text.split_whitespace().filter(|w| *w != "default") {
        let (name, value) =
            word.split_once('=').ok_or_else(|| format!("'{word}' is no change; write name=value"))?;
        change(&mut config, name, value)?;
    }
    Ok(config)
}

/// Changes one choice of a configuration.
///
/// # Errors
/// What choice or value does not exist.
pub fn change(config: &mut RenderConfig, name: &str, value: &str) -> Result<(), String> {
    let choice = Choice::named(name).ok_or_else(|| {
        let names: Vec<_> = CHOICES.iter().map(|c| c.name).collect();
        format!("there is no choice '{name}'; there are: {}", names.join(", "))
    })?;
    choice.set(config, value).map_err(|e| format!("{name}: {e}"))
}

/// A sweep under way, frame by frame.
#[derive(Clone, Debug)]
pub struct Measurement {
    points: Vec<(String, RenderConfig)>,
    point: usize,
    frame: u32,
    scene: SceneRecord,
    lines: Vec<Line>,
}

impl Measurement {
    /// Begins. Lengths and time are those of `shown`, the configuration that is on show.
    ///
    /// # Errors
    /// A mistake in [`SWEEP`].
    pub fn new(machine: Machine, scene: SceneRecord, shown: &RenderConfig) -> Result<Self, String> {
        let point = |name: &&str| -> Result<(String, RenderConfig), String> {
            let RenderConfig { near, near_fade, time, .. } = *shown;
            Ok(((*name).to_owned(), RenderConfig { near, near_fade, time, ..parse(name)? }))
        };
        let points = SWEEP.iter().map(point).collect::<Result<_, _>>()?;
        let lines = vec![Line::Machine(machine), Line::Scene(scene.clone())];
        Ok(Self { points, point: 0, frame: 0, scene, lines })
    }

    /// The configuration that is to be drawn now; none once it is finished.
    pub fn config(&self) -> Option<&RenderConfig> {
        self.points.get(self.point).map(|(_, config)| config)
    }

    /// How much is done, `0 ..= 1`.
    pub fn progress(&self) -> f32 {
        let whole = self.points.len() as u32 * (WARM + COUNTED);
        (self.point as u32 * (WARM + COUNTED) + self.frame) as f32 / whole as f32
    }

    /// A frame was drawn: what the newest finished one took, what follows from its counts, and the processor's time.
    pub fn drawn(&mut self, report: &FrameReport, traffic: Traffic, wall_ms: f64) {
        let Some((name, _)) = self.points.get(self.point) else { return };
        if self.frame >= WARM {
            self.lines.push(Line::Frame(FrameRecord {
                scene: self.scene.scene.clone(),
                view: "headset".into(),
                configuration: name.clone(),
                round: self.frame - WARM + 1,
                report: report.clone(),
                traffic,
                wall_ms,
                sort_ms: None,
            }));
        }
        self.frame += 1;
        if self.frame == WARM + COUNTED {
            (self.point, self.frame) = (self.point + 1, 0);
        }
    }

    /// The configuration cannot run on this device.
    pub fn refused(&mut self, reason: String) {
        if let Some((name, _)) = self.points.get(self.point) {
            let (scene, configuration) = (self.scene.scene.clone(), name.clone());
            self.lines.push(Line::Refused(Refusal { scene, configuration, reason }));
            (self.point, self.frame) = (self.point + 1, 0);
        }
    }

    /// The lines so far.
    pub fn lines(&self) -> &[Line] {
        &self.lines
    }

    /// Writes record, table and rates into a folder of their own below `folder`; says which.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn save(&self, folder: &Path) -> std::io::Result<PathBuf> {
        let date = self.lines.iter().find_map(|line| match line {
            Line::Machine(m) => Some(m.date.replace([' ', ':'], "-")),
            _ => None,
        });
        let folder = folder.join(date.unwrap_or_default());
        std::fs::create_dir_all(&folder)?;
        let mut record = String::new();
        for line in &self.lines {
            record += &serde_json::to_string(line)?;
            record.push('\n');
        }
        std::fs::write(folder.join(RECORD), record)?;
        std::fs::write(folder.join(TABLE), table(&self.lines))?;
        if let Ok(rates) = rates(&self.lines) {
            std::fs::write(folder.join(RATES), serde_json::to_string_pretty(&rates)?)?;
        }
        Ok(folder)
    }
}

/// The frames of each configuration, in the order of the record.
fn by_configuration(lines: &[Line]) -> Vec<(&str, Vec<&FrameRecord>)> {
    let mut found: Vec<(&str, Vec<&FrameRecord>)> = Vec::new();
    for line in lines {
        let Line::Frame(frame) = line else { continue };
        match found.iter_mut().find(|(name, _)| *name == frame.configuration) {
            Some((_, frames)) => frames.push(frame),
            None => found.push((&frame.configuration, vec![frame])),
        }
    }
    found
}

fn median(frames: &[&FrameRecord], value: impl Fn(&FrameRecord) -> f64) -> f64 {
    let mut values: Vec<f64> = frames.iter().map(|f| value(f)).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Fragments per pixel of the shown image, full-screen passes among them.
fn layers(frame: &FrameRecord) -> f64 {
    let r = &frame.report;
    let counted = if r.fragments > 0 { r.fragments as f64 } else { f64::from(r.predicted_fragments) };
    (counted + r.full_screen_fragments as f64) / r.shown_pixels.max(1) as f64
}

type Column = (&'static str, fn(&FrameRecord) -> f64);

/// The columns of `motes bench` that a viewer can fill, by the same names.
const COLUMNS: [Column; 13] = [
    ("layers_per_pixel", layers),
    ("fragments", |f| f.report.fragments as f64),
    ("primitives", |f| f.report.primitives as f64),
    ("vertices", |f| f.report.vertices as f64),
    ("splats_drawn", |f| f.report.visible.into()),
    ("draw_calls", |f| f.report.draws.into()),
    ("dispatches", |f| f.report.dispatches.into()),
    ("render_passes", |f| f.report.passes.into()),
    ("device_ms_median", |f| f.report.device_ns() / 1e6),
    ("upload_ms", |f| f.report.upload_ns / 1e6),
    ("prepare_ms", |f| f.report.prepare_ns / 1e6),
    ("draw_ms", |f| f.report.draw_ns / 1e6),
    ("wall_ms_median", |f| f.wall_ms),
];

/// Medians by configuration, as CSV.
pub fn table(lines: &[Line]) -> String {
    let mut text = String::from("scene,configuration,refused");
    for (name, _) in COLUMNS {
        text = text + "," + name;
    }
    text.push_str(",rounds\n");
    let quoted = |cell: &str| format!("\"{}\"", cell.replace('"', "\"\""));
    for (name, frames) in by_configuration(lines) {
        let scene = frames.first().map_or("", |f| f.scene.as_str());
        text += &format!("{},{},", quoted(scene), quoted(name));
        for (_, value) in COLUMNS {
            text += &format!(",{}", median(&frames, value));
        }
        text += &format!(",{}\n", frames.len());
    }
    for line in lines {
        if let Line::Refused(r) = line {
            let cells = ",".repeat(COLUMNS.len() + 1);
            text +=
                &format!("{},{},{}{cells}\n", quoted(&r.scene), quoted(&r.configuration), quoted(&r.reason));
        }
    }
    text
}

/// The rates that explain the measured frames best: least squares of `time = splats / a + fragments / b` over the medians
/// of the configurations. The stated uncertainty is the largest deviation.
///
/// # Errors
/// Why none can be told: no device times, or times that do not grow with both.
pub fn rates(lines: &[Line]) -> Result<StageRates, String> {
    let scene = lines.iter().find_map(|l| if let Line::Scene(s) = l { Some(s) } else { None });
    let machine = lines.iter().find_map(|l| if let Line::Machine(m) = l { Some(m) } else { None });
    let (Some(scene), Some(machine)) = (scene, machine) else {
        return Err("the record says neither machine nor scene".into());
    };
    let mut points = Vec::new();
    let mut eye = [0, 0];
    for (name, frames) in by_configuration(lines) {
        let config = parse(name)?;
        let corners = config.shape.corners();
        let load = FrameLoad::new(scene.splats, config.expansion, corners, 0.0);
        let fragments = median(&frames, |f| layers(f) * f.report.shown_pixels as f64);
        let seconds = median(&frames, |f| f.report.device_ns() / 1e9);
        if seconds > 0.0 {
            points.push([load.splats, fragments, seconds]);
        }
        if let Some(frame) = frames.first() {
            let of_an_eye = frame.report.shown_pixels as f64 / f64::from(frame.report.views.max(1));
            eye = [of_an_eye.sqrt().round() as u32; 2];
        }
    }
    if points.len() < 3 {
        return Err("too few configurations with device times".into());
    }
    // Relative errors: a point counts by what part of its time is not explained.
    let sum = |f: &dyn Fn(&[f64; 3]) -> f64| points.iter().map(|p| f(p) / (p[2] * p[2])).sum::<f64>();
    let (ss, sf, ff) = (sum(&|p| p[0] * p[0]), sum(&|p| p[0] * p[1]), sum(&|p| p[1] * p[1]));
    let (st, ft) = (sum(&|p| p[0] * p[2]), sum(&|p| p[1] * p[2]));
    let determinant = ss * ff - sf * sf;
    let (a, b) = ((st * ff - ft * sf) / determinant, (ft * ss - st * sf) / determinant);
    if !(a > 0.0 && b > 0.0 && a.is_finite() && b.is_finite()) {
        return Err("the measured times do not grow with both splats and fragments".into());
    }
    let off = |p: &[f64; 3]| {
        let predicted = p[0] * a + p[1] * b;
        (predicted / p[2]).max(p[2] / predicted) - 1.0
    };
    Ok(StageRates {
        device: machine.device.clone(),
        splats_per_second: 1.0 / a,
        fragments_per_second: 1.0 / b,
        eye,
        uncertainty: points.iter().map(off).fold(0.0, f64::max),
        source: format!("measured on {} with {}, {} splats", machine.date, scene.scene, scene.splats),
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    fn machine() -> Machine {
        Machine {
            device: "Adreno".into(),
            driver: "1".into(),
            api: "1.3".into(),
            software: false,
            processor: "p".into(),
            threads: 6,
            system: "android aarch64".into(),
            version: "0".into(),
            commit: None,
            date: "2026-11-25 10:00 UTC".into(),
        }
    }

    fn scene() -> SceneRecord {
        SceneRecord {
            scene: "plant, \"potted\"".into(),
            splats: 1000,
            sh_degree: 0,
            moving: false,
            only: None,
        }
    }

    /// A whole sweep on a device of known rates; `sort=gpu` is refused.
    fn measured(splats: f64, fragments: f64) -> Measurement {
        let shown = RenderConfig { near: 0.3, ..RenderConfig::default() };
        let mut m = Measurement::new(machine(), scene(), &shown).unwrap();
        let (mut frames, mut last) = (0, -1.0);
        while let Some(config) = m.config() {
            assert_eq!(config.near, 0.3);
            assert!(m.progress() >= last, "it goes on");
            last = m.progress();
            if m.points[m.point].0 == "sort=gpu" {
                m.refused("not here".into());
                continue;
            }
            let corners = config.shape.corners();
            let load = FrameLoad::new(1000, config.expansion, corners, 0.0).splats;
            let count = 10_000 + 3000 * m.point as u64;
            let seconds = load / splats + count as f64 / fragments;
            let report = FrameReport {
                views: 2,
                pixels: 800,
                shown_pixels: 800,
                fragments: count,
                // The first frames are slow: a pipeline was made.
                draw_ns: 1e9 * seconds * if m.frame < WARM { 50.0 } else { 1.0 },
                ..Default::default()
            };
            m.drawn(&report, Traffic::default(), 5.0);
            frames += 1;
            assert!(frames < 10_000);
        }
        assert_eq!(m.progress(), 1.0);
        m
    }

    #[test]
    fn rates_come_back_from_what_was_measured() {
        let m = measured(50e6, 4e9);
        let rates = rates(m.lines()).unwrap();
        assert!((rates.splats_per_second / 50e6 - 1.0).abs() < 1e-6, "{rates:?}");
        assert!((rates.fragments_per_second / 4e9 - 1.0).abs() < 1e-6 && rates.uncertainty < 1e-6);
        assert_eq!((rates.eye, rates.problem()), ([20, 20], None));
        // Control: another device is another.
        assert!(
            (super::rates(measured(50e6, 8e9).lines()).unwrap().fragments_per_second / 8e9 - 1.0).abs()
                < 1e-6
        );
        // Without device times there is nothing to tell.
        let mut lines = m.lines().to_vec();
        for line in &mut lines {
            if let Line::Frame(f) = line {
                f.report.draw_ns = 0.0;
            }
        }
        assert!(super::rates(&lines).unwrap_err().contains("device times"));
    }

    #[test]
    fn record_table_and_rates_are_written() {
        let folder = std::env::temp_dir().join(format!("motes-measured-{}", std::process::id()));
        let written = measured(50e6, 4e9).save(&folder).unwrap();
        let record = std::fs::read_to_string(written.join(RECORD)).unwrap();
        // One configuration is refused.
        assert_eq!(record.lines().count(), 2 + (SWEEP.len() - 1) * COUNTED as usize + 1);
        let lines: Vec<Line> = record.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert_eq!(rates(&lines).unwrap().eye, [20, 20]);
        let table = std::fs::read_to_string(written.join(TABLE)).unwrap();
        assert_eq!(table.lines().count(), 1 + SWEEP.len());
        assert!(table.contains("\"sort=gpu\",\"not here\""), "{table}");
        let rates: StageRates =
            serde_json::from_str(&std::fs::read_to_string(written.join(RATES)).unwrap()).unwrap();
        assert_eq!(rates.problem(), None);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_sweep_names_choices_that_exist() {
        for name in SWEEP {
            assert_eq!(describe(&parse(name).unwrap()), name);
        }
        assert!(parse("shape=circle").is_err() && parse("form=octagon").is_err());
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        let at = |seconds| date(std::time::UNIX_EPOCH + std::time::Duration::from_secs(seconds));
        assert_eq!(at(0), "1970-01-01 00:00 UTC");
        assert_eq!(at(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(at(1_798_761_599), "2026-12-31 23:59 UTC");
    }
}
