//! A whole visit to the headset: from finding the runtime until the user leaves, through losses of the runtime.

use crate::shelf::Shelf;
use crate::{
    Content, Headset, Platform, Recorder, Runtime, RuntimeHeadset, RuntimeOptions, SessionOptions,
    SessionState, Viewer, XrError,
};
use motes_app::governor::{Budget, Governor};
use motes_app::headset::Comfort;
use motes_app::loader::{LoadError, LoadRequest, Loaded, Loader, SceneSource, Storage};
use motes_renderer::RenderConfig;
use motes_renderer::gpu::DeviceReport;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What is shown, and how.
#[derive(Clone, Debug)]
pub struct ShowOptions {
    /// The scene.
    pub source: SceneSource,
    /// How it is stored on the device. By plan, what the scene calls for goes before `config`.
    pub storage: Storage,
    /// How it is drawn; `near` and `near_fade` in metres.
    pub config: RenderConfig,
    /// Comfort options.
    pub comfort: Comfort,
    /// What a frame may take; nothing is held without.
    pub budget: Option<Budget>,
    /// SSIM that levels of detail keep, as a share of the finest level's; the panel changes it.
    pub detail_target: f64,
    /// The folder where pipelines are kept from one visit to the next; nowhere without.
    pub pipelines: Option<PathBuf>,
    /// Bindings, resolution, handedness.
    pub session: SessionOptions,
    /// Validation, and whether images can be copied.
    pub runtime: RuntimeOptions,
    /// Where the session is recorded; nowhere where there is none.
    pub record: Option<PathBuf>,
    /// The session ends after as many frames; 0: when the user ends it.
    pub frames: u64,
    /// How long a lost runtime is waited for.
    pub patience: Duration,
    /// A folder whose scenes the panel offers; new ones are seen. None: only the source is shown.
    pub folder: Option<PathBuf>,
    /// Where small pictures of scenes are kept, for the panel's list; none are taken without.
    pub thumbnails: Option<PathBuf>,
    /// Where measurements are written that the panel's button makes; nowhere where there is none.
    pub measurements: Option<PathBuf>,
    /// Where the device's report is written at the start, for `motes device`; nowhere where there is none.
    pub report: Option<PathBuf>,
}

/// How often a lost runtime is looked for.
const RETRY: Duration = Duration::from_millis(500);

/// How a visit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Visit {
    /// Frames drawn.
    pub frames: u64,
    /// How often the runtime was lost and found again.
    pub recoveries: u32,
}

/// Why a visit did not take place, or broke off.
#[derive(Debug, thiserror::Error)]
pub enum ShowError {
    /// The headset.
    #[error(transparent)]
    Headset(#[from] XrError),
    /// The scene.
    #[error(transparent)]
    Load(#[from] LoadError),
}

impl ShowError {
    /// Whether there is no headset to be had at all.
    pub fn is_absent(&self) -> bool {
        matches!(self, Self::Headset(error) if error.is_absent())
    }
}

/// Called once a step, some hundred times a second at most: follows the system's events, and says whether the visit is
/// to end.
pub type Pump<'a> = &'a mut dyn FnMut() -> bool;

/// Shows a scene until the user ends it, or `leave` says so.
///
/// A runtime that is lost in mid-session is waited for; the scene is not read again.
///
/// # Errors
/// There is no headset, it was lost for good, or the scene cannot be shown.
pub fn show(platform: &Platform, options: &ShowOptions, leave: Pump<'_>) -> Result<Visit, ShowError> {
    let mut options = options.clone();
    let mut visit = Visit { frames: 0, recoveries: 0 };
    let mut runtime = Runtime::new(platform, options.runtime)?;
    loop {
        let lost = match session(runtime, &mut options, &mut visit, leave) {
            Ok(SessionState::LossPending) => "the runtime announced that it goes".to_owned(),
            Ok(_) => return Ok(visit),
            Err(ShowError::Headset(error)) if error.is_lost() => error.to_string(),
            Err(error) => return Err(error),
        };
        log::warn!("{lost}. Waiting for it for {} s", options.patience.as_secs());
        let Some(found) = find_again(platform, &options, leave)? else { return Ok(visit) };
        runtime = found;
        visit.recoveries += 1;
        log::info!("the runtime is back");
    }
}

/// Waits for a runtime that was lost; none where the visit is to end.
fn find_again(
    platform: &Platform,
    options: &ShowOptions,
    leave: Pump<'_>,
) -> Result<Option<Runtime>, XrError> {
    let begun = Instant::now();
    loop {
        if leave() {
            return Ok(None);
        }
        match Runtime::new(platform, options.runtime) {
            Err(error) if (error.is_absent() || error.is_lost()) && begun.elapsed() < options.patience => {
                std::thread::sleep(RETRY);
            }
            other => return other.map(Some),
        }
    }
}

/// One session, from its beginning to its end.
fn session(
    runtime: Runtime,
    options: &mut ShowOptions,
    visit: &mut Visit,
    leave: Pump<'_>,
) -> Result<SessionState, ShowError> {
    let mut lines = vec![runtime.description().to_owned()];
    lines.extend(runtime.optional().fallbacks().into_iter().map(str::to_owned));
    let headset = RuntimeHeadset::new(runtime, &options.session)?;
    if let Some(file) = options.report.take() {
        write_report(DeviceReport { headset: lines, ..DeviceReport::of(headset.gpu()) }, &file);
    }
    match options.record.clone() {
        // Only the first session: the second would begin the file anew.
        Some(path) if visit.recoveries == 0 => {
            run(&mut Recorder::new(headset, &path)?, options, visit, leave)
        }
        _ => run(&mut { headset }, options, visit, leave),
    }
}

/// Writes the device's report. That it cannot be written is no reason to show nothing.
fn write_report(report: DeviceReport, file: &Path) {
    let text = serde_json::to_vec_pretty(&report).map_err(std::io::Error::other);
    match text.and_then(|text| std::fs::write(file, text)) {
        Ok(()) => log::info!("what this device offers: {}", file.display()),
        Err(error) => log::error!("{}: {error}", file.display()),
    }
}

fn run(
    headset: &mut dyn Headset,
    options: &mut ShowOptions,
    visit: &mut Visit,
    leave: Pump<'_>,
) -> Result<SessionState, ShowError> {
    let request = |options: &ShowOptions, source| LoadRequest {
        source,
        storage: options.storage,
        thumbnails: options.thumbnails.clone(),
    };
    let mut loading = Some(Loader::start(headset.gpu(), request(options, options.source.clone()))?);
    let mut viewer = Viewer::new(headset, options.config.clone(), options.comfort)?;
    if let Some(folder) = &options.pipelines {
        viewer.keep_pipelines(folder)?;
    }
    viewer.governor = options.budget.map(Governor::new);
    viewer.detail_target = options.detail_target;
    viewer.measurements.clone_from(&options.measurements);
    let shelf = options.folder.as_deref().map(|folder| Shelf::watch(folder, options.thumbnails.as_deref()));
    let mut shelf = shelf.transpose().map_err(XrError::Thread)?;
    let before = visit.frames;
    let mut asked = false;
    // Only a part of what is being loaded is shown.
    let mut partial = false;
    loop {
        match loading.as_mut().and_then(Loader::poll) {
            None => {}
            Some(Ok(loaded)) => {
                if loaded.whole {
                    loading = None;
                    options.source = SceneSource::Memory(loaded.opened.clone());
                }
                take(&mut viewer, headset, loaded, &mut partial)?;
            }
            Some(Err(error)) => {
                loading = None;
                // Another scene can be chosen: the user is told, and what was shown stays.
                if shelf.is_none() {
                    return Err(error.into());
                }
                log::error!("{error}");
                viewer.tell(error.to_string());
            }
        }
        viewer.set_loading(loading.as_ref().map(|loader| loader.progress().fraction));
        if let Some(shelf) = &mut shelf {
            if let Some(scenes) = shelf.news() {
                viewer.offer(&scenes);
            }
            if let Some(scene) = viewer.chosen().and_then(|i| shelf.scene(i)) {
                log::info!("opening {}", scene.display());
                let source = SceneSource::Files(vec![scene.to_owned()]);
                loading = Some(Loader::start(headset.gpu(), request(options, source))?);
                partial = false;
            }
        }
        let ended = viewer.step(headset)?;
        visit.frames = before + viewer.frames();
        if let Some(state) = ended {
            return Ok(state);
        }
        let enough = options.frames != 0 && visit.frames >= options.frames;
        if (leave() || enough) && !asked {
            asked = true;
            if !headset.request_exit()? {
                // A session that does not run has no end to wait for.
                return Ok(SessionState::Exiting);
            }
        }
    }
}

/// Shows what was loaded: from its first view on, or in place of the part of it that is shown.
fn take(
    viewer: &mut Viewer,
    headset: &dyn Headset,
    loaded: Loaded,
    partial: &mut bool,
) -> Result<(), XrError> {
    let Loaded { opened, scene, detail, framing, plan, whole } = loaded;
    for warning in &opened.scene.report.warnings {
        log::warn!("{warning}");
    }
    let part = if whole { "" } else { ", a part of it" };
    log::info!("{}: {} splats{part}", opened.name, opened.scene.splats.len());
    if let Some(plan) = &plan {
        viewer.config = plan.apply(&viewer.config);
    }
    let content = Content::of(headset.gpu(), &opened, (scene, detail), &framing)?;
    let more = std::mem::replace(partial, !whole);
    if more { viewer.refine(content) } else { viewer.show(content) }
}
