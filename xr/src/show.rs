//! A whole visit to the headset: from finding the runtime until the user leaves, through losses of the runtime.

use crate::loader::{LoadError, Loader, SceneSource};
use crate::{
    Headset, Platform, Recorder, Runtime, RuntimeHeadset, RuntimeOptions, SessionOptions, SessionState,
    Viewer, XrError,
};
use motes_app::governor::{Budget, Governor};
use motes_app::headset::Comfort;
use motes_renderer::{Packing, RenderConfig};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// What is shown, and how.
#[derive(Clone, Debug)]
pub struct ShowOptions {
    /// The scene.
    pub source: SceneSource,
    /// How it is stored on the device.
    pub packing: Packing,
    /// How it is drawn; `near` and `near_fade` in metres.
    pub config: RenderConfig,
    /// Comfort options.
    pub comfort: Comfort,
    /// What a frame may take; nothing is held without.
    pub budget: Option<Budget>,
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
    let headset = RuntimeHeadset::new(runtime, &options.session)?;
    match options.record.clone() {
        // Only the first session: the second would begin the file anew.
        Some(path) if visit.recoveries == 0 => {
            run(&mut Recorder::new(headset, &path)?, options, visit, leave)
        }
        _ => run(&mut { headset }, options, visit, leave),
    }
}

fn run(
    headset: &mut dyn Headset,
    options: &mut ShowOptions,
    visit: &mut Visit,
    leave: Pump<'_>,
) -> Result<SessionState, ShowError> {
    let mut loading = Some(Loader::start(headset.gpu(), options.source.clone(), options.packing)?);
    let mut viewer = Viewer::new(headset, options.config.clone(), options.comfort)?;
    if let Some(folder) = &options.pipelines {
        viewer.keep_pipelines(folder)?;
    }
    viewer.governor = options.budget.map(Governor::new);
    let before = visit.frames;
    let mut asked = false;
    loop {
        if let Some(loader) = &mut loading
            && let Some(loaded) = loader.poll()
        {
            let loaded = loaded?;
            for warning in &loaded.opened.scene.report.warnings {
                log::warn!("{warning}");
            }
            log::info!("{}: {} splats", loaded.opened.name, loaded.opened.scene.splats.len());
            options.source = SceneSource::Memory(loaded.opened);
            viewer.show(loaded.content)?;
            loading = None;
        }
        viewer.set_loading(loading.as_ref().map(Loader::progress));
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
