//! The measuring: pictures and their errors first, then rounds in which every configuration is drawn once, so that a
//! machine that grows slower or warmer does so for all of them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use motes_renderer::gpu::{Gpu, GpuError};
use motes_renderer::{Offscreen, Packing, RenderConfig, SceneOnDevice, Sorter, Traffic, View};

use super::record::{
    ErrorRecord, FrameRecord, Journal, Line, Machine, RING_DEGREES, Refusal, SceneRecord, TruthRecord,
};
use super::subject::Subject;
use super::sweep::Point;
use super::truth::LAYERS_SHOWN;
use super::{BenchError, truth};
use crate::measure::{ColourMap, Picture, Settings, coloured, compare};
use crate::shots::Shot;

/// How fast the head moves sideways where an order is older than the frame, metres per second: leaning over.
pub const HEAD_SPEED: f64 = 0.5;
/// Frames per second that the age of an order is counted in.
pub const FRAME_RATE: f64 = 72.0;

/// Bytes of scenes that are kept on the device at once, so that forms of storage take turns without being packed anew.
const KEPT_BYTES: u64 = 2 << 30;

/// What to measure.
pub struct Plan<'a> {
    /// Scenes and views.
    pub subjects: &'a [Subject],
    /// Configurations.
    pub points: &'a [Point],
    /// Configurations of each named experiment, for subjects that are there for one only.
    pub of_experiment: &'a dyn Fn(&str) -> Vec<Point>,
    /// Rounds.
    pub rounds: u32,
    /// For FLIP.
    pub settings: Settings,
    /// The bench's folder.
    pub folder: &'a Path,
    /// Whether to show how far it is.
    pub progress: bool,
}

/// Measures what is not yet in the folder.
///
/// # Errors
/// A device that is lost, a folder that cannot be written. Configurations that cannot run are written down as such.
pub fn run(plan: &Plan<'_>, gpu: &Arc<Gpu>, journal: &mut Journal) -> Result<(), BenchError> {
    journal.write(Line::Machine(Machine::here(&gpu.capabilities)))?;
    let steps = plan.subjects.iter().map(|s| (s.views.len() * (1 + points(plan, s).len())) as u64);
    let frames =
        plan.subjects.iter().map(|s| (s.views.len() * points(plan, s).len()) as u64 * u64::from(plan.rounds));
    let bar = if plan.progress {
        ProgressBar::new(steps.sum::<u64>() + frames.sum::<u64>())
    } else {
        ProgressBar::hidden()
    };
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} % · {eta} left · {wide_msg}") {
        bar.set_style(style);
    }
    for subject in plan.subjects {
        let points = points(plan, subject);
        let mut bench = SubjectBench {
            plan,
            subject,
            journal,
            bar: &bar,
            offscreen: Offscreen::new(gpu)?,
            gpu,
            kept: Vec::new(),
            sorted: None,
        };
        bench.pictures(&points)?;
        for round in 1..=plan.rounds {
            bench.round(&points, round)?;
        }
    }
    bar.finish_and_clear();
    Ok(())
}

fn points(plan: &Plan<'_>, subject: &Subject) -> Vec<Point> {
    match subject.only {
        Some(experiment) => (plan.of_experiment)(experiment),
        None => plan.points.to_vec(),
    }
}

/// A configuration at the moment that a picture shows.
fn at(config: &RenderConfig, shot: &Shot) -> RenderConfig {
    RenderConfig { time: shot.time.unwrap_or(0.0), ..config.clone() }
}

struct SubjectBench<'a> {
    plan: &'a Plan<'a>,
    subject: &'a Subject,
    journal: &'a mut Journal,
    bar: &'a ProgressBar,
    offscreen: Offscreen,
    gpu: &'a Arc<Gpu>,
    kept: Vec<(Packing, Arc<SceneOnDevice>)>,
    /// What the order in hand was made for.
    sorted: Option<(View, String)>,
}

impl SubjectBench<'_> {
    /// Truths, and every configuration's picture against them. This warms up pipelines, too.
    fn pictures(&mut self, points: &[Point]) -> Result<(), BenchError> {
        let (subject, plan) = (self.subject, self.plan);
        self.journal.write(Line::Scene(SceneRecord {
            scene: subject.name.clone(),
            splats: subject.splats.len() as u32,
            sh_degree: subject.splats.sh_degree,
            moving: subject.splats.motion.is_some(),
            only: subject.only.map(str::to_owned),
        }))?;
        for (i, view) in subject.views.iter().enumerate() {
            self.bar
                .set_message(format!("{}, {}: what pictures are measured against", subject.name, view.name));
            let truth = self.truth(view)?;
            self.bar.inc(1);
            for point in points {
                self.bar.set_message(format!("{}, {}: {}", subject.name, view.name, point.name));
                let done = self.journal.record.has_error(&subject.name, &view.name, &point.name)
                    || self.journal.record.is_refused(&subject.name, &point.name);
                if !done {
                    match self.picture(view, point) {
                        Ok((picture, scene)) => {
                            let layers = self.layers(view, point, &scene, i == 0)?;
                            self.compare(view, point, &truth, &picture, layers, scene.bytes())?;
                            if i == 0 {
                                let path = picture_path(plan.folder, &subject.name, &point.name);
                                picture.save(&path)?;
                            }
                        }
                        Err(error) => self.refuse(point, error)?,
                    }
                }
                self.bar.inc(1);
            }
        }
        Ok(())
    }

    fn truth(&mut self, view: &Shot) -> Result<Picture, BenchError> {
        let (name, folder) = (&self.subject.name, self.plan.folder);
        let file = truth::path(folder, name, &view.name);
        let known = self.journal.record.truths.iter().find(|t| t.scene == *name && t.view == view.name);
        if let Some(TruthRecord { size, .. }) = known {
            if *size != view.view.size {
                return Err(BenchError::Setting(format!(
                    "{} holds pictures of {} × {} pixels of {name}, not {} × {}; choose another folder",
                    folder.display(),
                    size[0],
                    size[1],
                    view.view.size[0],
                    view.view.size[1]
                )));
            }
            return Ok(Picture::load(&file)?);
        }
        std::fs::create_dir_all(folder.join("pictures")).map_err(BenchError::io(folder.join("pictures")))?;
        let (picture, record) = truth::make(folder, self.subject, view, &mut self.offscreen)?;
        self.journal.write(Line::Truth(record))?;
        Ok(picture)
    }

    /// The scene in the form that a configuration asks for.
    fn scene(&mut self, config: &RenderConfig) -> Result<Arc<SceneOnDevice>, GpuError> {
        let packing = Packing::of_config(config);
        let packing = Packing { sh_degree: packing.sh_degree.min(self.subject.splats.sh_degree), ..packing };
        if let Some((_, scene)) = self.kept.iter().find(|(p, _)| *p == packing) {
            return Ok(scene.clone());
        }
        let kept = self.kept.iter().map(|(_, s)| s.bytes()).sum::<u64>();
        if kept > KEPT_BYTES {
            self.kept.clear();
        }
        let scene = Arc::new(SceneOnDevice::new(self.gpu, &self.subject.splats, packing)?);
        self.kept.push((packing, scene.clone()));
        Ok(scene)
    }

    /// Sorts as a configuration asks, from where the head was when its order was made. Returns the time, ms.
    fn sort(&mut self, scene: &SceneOnDevice, view: &View, config: &RenderConfig) -> Option<f64> {
        let age = f64::from(config.sort_interval.saturating_sub(1)) / FRAME_RATE;
        let behind = view.rotation.row(0) * (age * HEAD_SPEED);
        let then = View { eye: view.eye - behind, ..*view };
        let what = format!("{} {} {}", config.order, config.key_bits, config.time);
        if config.sorter != Sorter::Cpu || self.sorted.as_ref().is_some_and(|(v, w)| *v == then && *w == what)
        {
            return None;
        }
        let start = Instant::now();
        // Now, whatever the interval: the age of the order is made here.
        let now = RenderConfig { sort_interval: 1, ..config.clone() };
        self.offscreen.sort(scene, std::slice::from_ref(&then), &now);
        self.sorted = Some((then, what));
        Some(start.elapsed().as_secs_f64() * 1e3)
    }

    fn picture(&mut self, view: &Shot, point: &Point) -> Result<(Picture, Arc<SceneOnDevice>), BenchError> {
        let config = at(&point.config, view);
        let scene = self.scene(&config)?;
        self.sort(&scene, &view.view, &config);
        let (pictures, _) = self.offscreen.picture(&scene, std::slice::from_ref(&view.view), &config)?;
        let picture = pictures.first().ok_or_else(|| BenchError::Setting("no picture was drawn".into()))?;
        Ok((to_picture(picture)?, scene))
    }

    /// Layers per pixel of the shown image, shaded and blended; their map as a picture, where it is wanted.
    fn layers(
        &mut self,
        view: &Shot,
        point: &Point,
        scene: &SceneOnDevice,
        save: bool,
    ) -> Result<Option<[f64; 2]>, BenchError> {
        let config = at(&point.config, view);
        let maps = match self.offscreen.layers(scene, std::slice::from_ref(&view.view), &config) {
            Ok((maps, _)) => maps,
            Err(GpuError::Unsupported { .. } | GpuError::Config(_)) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        // Counting sorts anew.
        self.sorted = None;
        let Some(map) = maps.first() else { return Ok(None) };
        if save {
            let values = map.shaded.iter().map(|&l| f64::from(l));
            let picture = coloured(map.size, values, [0.0, LAYERS_SHOWN], ColourMap::Viridis)?;
            picture.save(&layers_path(self.plan.folder, &self.subject.name, &point.name))?;
        }
        let pixels = |size: [u32; 2]| f64::from(size[0]) * f64::from(size[1]);
        let share = pixels(map.size) / pixels(view.view.size);
        Ok(Some([map.mean_shaded() * share, map.mean_blended() * share]))
    }

    #[allow(clippy::too_many_arguments, reason = "what was measured of one picture")]
    fn compare(
        &mut self,
        view: &Shot,
        point: &Point,
        truth: &Picture,
        picture: &Picture,
        layers: Option<[f64; 2]>,
        scene_bytes: u64,
    ) -> Result<(), BenchError> {
        let comparison = compare(truth, picture, &self.plan.settings)?;
        let error = ErrorRecord {
            scene: self.subject.name.clone(),
            view: view.name.clone(),
            configuration: point.name.clone(),
            psnr: comparison.whole.psnr.is_finite().then_some(comparison.whole.psnr),
            ssim: comparison.whole.ssim,
            flip: comparison.flip,
            worst: comparison.worst,
            rings: rings(&view.view, &comparison.maps.flip),
            layers,
            hash: hash(&picture.to_rgb8()),
            scene_bytes,
            memory: self.gpu.allocated_bytes(),
        };
        self.journal.write(Line::Error(error))
    }

    /// Writes down why a configuration cannot run; a device that is gone ends the bench.
    fn refuse(&mut self, point: &Point, error: BenchError) -> Result<(), BenchError> {
        match error {
            BenchError::Gpu(e) if !e.is_lost() => self.journal.write(Line::Refused(Refusal {
                scene: self.subject.name.clone(),
                configuration: point.name.clone(),
                reason: e.to_string(),
            })),
            other => Err(other),
        }
    }

    /// Draws every configuration once.
    fn round(&mut self, points: &[Point], round: u32) -> Result<(), BenchError> {
        let subject = self.subject;
        for view in &subject.views {
            for point in points {
                self.bar
                    .set_message(format!("{}, {}: round {round}, {}", subject.name, view.name, point.name));
                let record = &self.journal.record;
                let done = record.has_frame(&subject.name, &view.name, &point.name, round)
                    || record.is_refused(&subject.name, &point.name);
                if !done {
                    let config = at(&point.config, view);
                    if let Err(error) = self.frame(view, point, &config, round) {
                        self.refuse(point, error)?;
                    }
                }
                self.bar.inc(1);
            }
        }
        Ok(())
    }

    fn frame(
        &mut self,
        view: &Shot,
        point: &Point,
        config: &RenderConfig,
        round: u32,
    ) -> Result<(), BenchError> {
        let scene = self.scene(config)?;
        let sort_ms = self.sort(&scene, &view.view, config);
        let start = Instant::now();
        let report = self.offscreen.draw(&scene, std::slice::from_ref(&view.view), config)?;
        let wall_ms = start.elapsed().as_secs_f64() * 1e3;
        self.journal.write(Line::Frame(FrameRecord {
            scene: self.subject.name.clone(),
            view: view.name.clone(),
            configuration: point.name.clone(),
            round,
            traffic: Traffic::of(&scene, config, &report),
            report,
            wall_ms,
            sort_ms,
        }))
    }
}

/// The file of a configuration's picture (from a scene's first view).
pub fn picture_path(folder: &Path, scene: &str, configuration: &str) -> PathBuf {
    folder.join("pictures").join(format!("{}.png", truth::file_name(&[scene, configuration])))
}

/// The file of a configuration's layers (from a scene's first view).
pub fn layers_path(folder: &Path, scene: &str, configuration: &str) -> PathBuf {
    folder.join("pictures").join(format!("{}.layers.png", truth::file_name(&[scene, configuration])))
}

/// A drawn picture as one to compare.
///
/// # Errors
/// Never for pictures that were drawn: the pixels fill their size.
pub fn to_picture(picture: &motes_renderer::Picture) -> Result<Picture, BenchError> {
    let bytes: Vec<u8> = picture.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    Ok(Picture::from_rgb8(picture.size, &bytes)?)
}

/// FNV-1a.
pub fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3))
}

/// Means of a map over rings of angle from the middle of the view; −1 for a ring without pixels.
fn rings(view: &View, map: &[f32]) -> Vec<f64> {
    let [w, h] = view.size;
    let mut sums = vec![(0.0, 0u32); (90.0 / RING_DEGREES) as usize];
    let f = view.fov;
    for (i, error) in map.iter().enumerate() {
        let (x, y) = ((i as u32 % w) as f64 + 0.5, (i as u32 / w) as f64 + 0.5);
        let x = f.left + (f.right - f.left) * x / f64::from(w);
        let y = f.up + (f.down - f.up) * y / f64::from(h);
        let ring = (x.hypot(y).atan().to_degrees() / RING_DEGREES) as usize;
        if let Some((sum, count)) = sums.get_mut(ring) {
            *sum += f64::from(*error);
            *count += 1;
        }
    }
    while sums.last().is_some_and(|s| s.1 == 0) {
        sums.pop();
    }
    sums.iter().map(|&(sum, n)| if n == 0 { -1.0 } else { sum / f64::from(n) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use motes_renderer::Fov;

    #[test]
    fn rings_are_angles() {
        let fov = Fov { left: -1.0, right: 1.0, up: -1.0, down: 1.0 };
        let view = View::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov, [200, 200]);
        // An error in the middle only, and one everywhere.
        let middle: Vec<f32> = (0..40_000)
            .map(|i| if (i % 200 - 100i32).abs() < 5 && (i / 200 - 100).abs() < 5 { 1.0 } else { 0.0 })
            .collect();
        let found = rings(&view, &middle);
        assert!(found[0] > 0.05 && found[1..].iter().all(|v| *v == 0.0), "{found:?}");
        let everywhere = rings(&view, &vec![0.5; 40_000]);
        // The corners are 54.7° off.
        assert_eq!(everywhere, vec![0.5; 6]);
    }

    #[test]
    fn hashes_tell_pictures_apart() {
        assert_eq!(hash(b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_ne!(hash(b"ab"), hash(b"ba"));
    }
}
