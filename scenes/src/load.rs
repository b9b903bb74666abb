//! The way in: from paths to a [`Scene`].

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

use crate::report::{LoadReport, SourceInfo};
use crate::source::Source;
use crate::{Format, SceneError, Splats, formats, merge, recentre, sanitise};

/// A loaded scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Its splats.
    pub splats: Splats,
    /// What loading found, kept and dropped.
    pub report: LoadReport,
    /// The files it came from, in order.
    pub sources: Vec<SourceInfo>,
}

impl Scene {
    /// Labels every splat with the file it came from: the first file's are 1, the second's 2, …
    /// Files beyond `u16::MAX` share the last label.
    pub fn label_by_source(&mut self) {
        let mut labels = vec![0_u16; self.splats.len()];
        for (i, source) in self.sources.iter().enumerate() {
            let label = u16::try_from(i + 1).unwrap_or(u16::MAX);
            if let Some(range) = labels.get_mut(source.splats.clone()) {
                range.fill(label);
            }
        }
        self.splats.labels = Some(labels);
    }
}

/// How far loading is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// The file being read.
    pub path: PathBuf,
    /// Which of how many files, from 0.
    pub file: usize,
    /// How many files.
    pub files: usize,
    /// How much of that file is read, `0 ..= 1`.
    pub fraction: f32,
}

/// Stops loading from another thread. Clones share one switch.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Stops whatever is loaded with this token, within a few milliseconds, with [`SceneError::Cancelled`].
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it was stopped.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a scene may need at most; a header that asks for more is refused before anything is allocated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Number of splats.
    pub splats: u64,
    /// Bytes of the splats in memory.
    pub memory: u64,
}

impl Default for Limits {
    /// `u32::MAX` splats (the device counts them in u32), as many bytes as there are.
    fn default() -> Self {
        Self { splats: u64::from(u32::MAX), memory: u64::MAX }
    }
}

/// Called on loading threads, some hundred times a file at most.
pub type ProgressCallback = Arc<dyn Fn(&Progress) + Send + Sync>;

/// Called on the thread that loads, before it goes on, with a part of the scene ([`crate::early`]).
pub type EarlyCallback = Arc<dyn Fn(Scene) + Send + Sync>;

/// How to load.
#[derive(Clone, Default)]
pub struct LoadOptions {
    /// Told how far loading is.
    pub progress: Option<ProgressCallback>,
    /// Given parts of a large scene before the whole is read, to be shown meanwhile; what is loaded is the same with it
    /// and without. Scenes that are merged from several files come in one piece.
    pub early: Option<EarlyCallback>,
    /// Stops loading.
    pub cancel: CancelToken,
    /// What a scene may need at most.
    pub limits: Limits,
    /// The level of detail to read of a streamed scene: 0 is the finest, larger ones are clamped to the coarsest there is.
    pub level: u32,
}

/// What a reader may ask of the loader: limits, progress, cancellation, warnings. Shared by its threads.
pub(crate) struct LoadContext<'a> {
    options: &'a LoadOptions,
    file: usize,
    files: usize,
    /// Steps of progress already reported, out of [`PROGRESS_STEPS`].
    reported: AtomicU64,
    done: AtomicU64,
    bytes_on_disk: AtomicU64,
    antialiased: AtomicBool,
    warnings: Mutex<Vec<String>>,
}

const PROGRESS_STEPS: u64 = 200;

impl<'a> LoadContext<'a> {
    pub(crate) fn new(options: &'a LoadOptions, file: usize, files: usize) -> Self {
        Self {
            options,
            file,
            files,
            reported: AtomicU64::new(0),
            done: AtomicU64::new(0),
            bytes_on_disk: AtomicU64::new(0),
            antialiased: AtomicBool::new(false),
            warnings: Mutex::default(),
        }
    }

    /// The options.
    pub(crate) fn options(&self) -> &LoadOptions {
        self.options
    }

    /// Who is given parts of the scene.
    pub(crate) fn early(&self) -> Option<&EarlyCallback> {
        self.options.early.as_ref().filter(|_| self.files == 1)
    }

    /// Whether the file says that it was trained with a compensated low-pass filter.
    pub(crate) fn is_antialiased(&self) -> bool {
        self.antialiased.load(Ordering::Relaxed)
    }

    /// Call before allocating: whether `count` splats of this kind may be had. `count` must already be known
    /// to be backed by the file's bytes. Returns the count as an index.
    pub(crate) fn admit(
        &self,
        source: &Source,
        count: u64,
        sh_degree: u8,
        moving: bool,
    ) -> Result<usize, SceneError> {
        let limits = self.options.limits;
        let too_large = |what, limit| SceneError::TooLarge { path: source.path().to_owned(), what, limit };
        if count > limits.splats {
            return Err(too_large(format!("{count} splats"), format!("{} splats", limits.splats)));
        }
        let bytes = count.saturating_mul(Splats::bytes_per_splat(sh_degree, moving) as u64);
        if bytes > limits.memory {
            return Err(too_large(
                format!("{count} splats need {bytes} bytes of memory"),
                format!("{} bytes", limits.memory),
            ));
        }
        usize::try_from(bytes)
            .and_then(|_| usize::try_from(count))
            .map_err(|_| too_large(format!("{count} splats"), "this machine's address space".to_owned()))
    }

    /// `work` more units of `total` are done; fails once loading is cancelled. Call it every few milliseconds.
    pub(crate) fn advance(&self, source: &Source, work: u64, total: u64) -> Result<(), SceneError> {
        if self.options.cancel.is_cancelled() {
            return Err(SceneError::Cancelled { path: source.path().to_owned() });
        }
        let done = self.done.fetch_add(work, Ordering::Relaxed) + work;
        if let Some(callback) = &self.options.progress {
            let fraction = (done as f64 / total.max(1) as f64).min(1.0);
            let step = (fraction * PROGRESS_STEPS as f64) as u64;
            if self.reported.fetch_max(step, Ordering::Relaxed) < step {
                callback(&Progress {
                    path: source.path().to_owned(),
                    file: self.file,
                    files: self.files,
                    fraction: fraction as f32,
                });
            }
        }
        Ok(())
    }

    /// Counts bytes on disk beyond those of the source itself (files inside of a folder).
    pub(crate) fn add_bytes(&self, bytes: u64) {
        self.bytes_on_disk.fetch_add(bytes, Ordering::Relaxed);
    }

    /// The file says that it was trained with Mip-Splatting's compensated low-pass filter.
    pub(crate) fn set_antialiased(&self) {
        self.antialiased.store(true, Ordering::Relaxed);
    }

    /// Something that the user should know, one sentence.
    pub(crate) fn warn(&self, warning: impl Into<String>) {
        let warning = warning.into();
        log::warn!("{warning}");
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push(warning);
    }
}

/// Loads one scene: a file, a SOG folder, or a folder of scene files that belong together (merged in the order
/// of their names).
///
/// # Errors
/// [`SceneError`], naming the file, the place, and what to do.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene, SceneError> {
    load_many(&[path], options)
}

/// Loads several scenes and merges them in the given order: spherical harmonics are padded with zeros to the
/// highest degree; where any of them moves, the others' splats get no motion and are always there.
/// [`Scene::sources`] tells which splats came from where.
///
/// # Errors
/// [`SceneError`] for the first scene that cannot be loaded.
pub fn load_many<P: AsRef<Path>>(paths: &[P], options: &LoadOptions) -> Result<Scene, SceneError> {
    let mut parts = Vec::new();
    for path in paths {
        let source = Source::open(path.as_ref())?;
        if Format::of(&source)? == Format::Folder {
            parts.extend(crate::sequence::folder_parts(path.as_ref())?);
        } else {
            parts.push(path.as_ref().to_owned());
        }
    }
    let mut scene = Scene::default();
    for (i, path) in parts.iter().enumerate() {
        let context = LoadContext::new(options, i, parts.len());
        merge::append(&mut scene, load_source(&Source::open(path)?, context)?, path)?;
    }
    Ok(scene)
}

/// Loads a scene file that is already in memory (an embedded sample, an asset of an application).
/// `name` stands for its path: in messages, and for its extension.
///
/// # Errors
/// As [`load`].
pub fn load_bytes(name: &Path, bytes: Arc<[u8]>, options: &LoadOptions) -> Result<Scene, SceneError> {
    load_source(&Source::from_bytes(name, bytes), LoadContext::new(options, 0, 1))
}

fn load_source(source: &Source, context: LoadContext<'_>) -> Result<Scene, SceneError> {
    context.advance(source, 0, 1)?;
    let format = Format::of(source)?;
    let mut splats = formats::read(format, source, &context)?;
    let read = splats.len();
    let sanitised = sanitise(&mut splats);
    recentre::recentre(&mut splats);
    let path = source.path().display();
    if !sanitised.dropped.is_empty() {
        let reasons: Vec<String> = sanitised.dropped.iter().map(|(why, n)| format!("{n} ({why})")).collect();
        context.warn(format!("{path}: of {read} splats, some were dropped: {}", reasons.join(", ")));
    }
    if splats.is_empty() {
        context.warn(format!("{path}: no splats in it"));
    }
    let giants = giants(&splats);
    if giants > 0 {
        context.warn(format!(
            "{path}: {giants} splats are larger than the scene and may hide it or be slow to draw"
        ));
    }
    let info = SourceInfo {
        path: source.path().to_owned(),
        format,
        bytes: source.len() + context.bytes_on_disk.load(Ordering::Relaxed),
        splats: 0..splats.len(),
        sh_degree: splats.sh_degree,
        antialiased: context.is_antialiased(),
    };
    let warnings = context.warnings.into_inner().unwrap_or_else(PoisonError::into_inner);
    let report = LoadReport {
        read,
        kept: splats.len(),
        dropped: sanitised.dropped,
        raised_scales: sanitised.raised_scales,
        bounded_widths: sanitised.bounded_widths,
        warnings,
    };
    Ok(Scene { splats, report, sources: vec![info] })
}

/// Splats that fill the view from anywhere: with a standard deviation of more than twice the radius in which nine
/// tenths of the scene lie. (One of them can take a weak device down.)
fn giants(splats: &Splats) -> usize {
    let step = splats.len().div_ceil(recentre::SAMPLES).max(1);
    let sample: Vec<&[f32; 3]> = splats.means.iter().step_by(step).collect();
    if sample.len() < 10 {
        return 0;
    }
    let middle: [f32; 3] = std::array::from_fn(|k| {
        let mut values: Vec<f32> = sample.iter().map(|m| m[k]).collect();
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f32::total_cmp).1
    });
    let mut distances: Vec<f32> =
        sample.iter().map(|m| (0..3).map(|k| (m[k] - middle[k]).powi(2)).sum::<f32>().sqrt()).collect();
    let most = distances.len() * 9 / 10;
    let radius = *distances.select_nth_unstable_by(most, f32::total_cmp).1;
    if radius == 0.0 {
        return 0;
    }
    let limit = (2.0 * radius).ln();
    splats.log_scales.par_iter().filter(|s| s.iter().any(|v| *v > limit)).count()
}
