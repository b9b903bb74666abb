//! Loads a scene on a thread of its own, so that whoever shows it never stands still: reading, packing, uploading.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use motes_renderer::gpu::{Gpu, GpuError};
use motes_renderer::plan::{Overrides, Plan};
use motes_renderer::{Packing, SceneOnDevice};
use motes_scenes::statement::Statement;
use motes_scenes::{CancelToken, LoadOptions, SceneError};

use crate::opened::{Opened, name_of};

/// Why a scene is not there.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// It cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It cannot be brought to the device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The system gives no thread, or the thread ended without a word.
    #[error("loading: {0}")]
    Thread(String),
}

/// How a scene is to be stored on the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Storage {
    /// So.
    As(Packing),
    /// As the scene calls for, but for what is asked for.
    Planned(Overrides),
}

impl Storage {
    /// The packing of a scene, and the plan that it follows from.
    pub fn of(self, opened: &Opened) -> (Packing, Option<Plan>) {
        match self {
            Self::As(packing) => (packing, None),
            Self::Planned(overrides) => {
                let plan = Plan::of(&Statement::of(&opened.scene), &overrides);
                log::info!("{} by plan:\n{plan}", opened.name);
                (plan.packing, Some(plan))
            }
        }
    }
}

/// A scene that is ready to be drawn.
pub struct Loaded {
    /// The scene in memory.
    pub opened: Arc<Opened>,
    /// The scene on the device.
    pub scene: SceneOnDevice,
    /// The plan by which it is stored, where there is one.
    pub plan: Option<Plan>,
}

/// How far loading is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loading {
    /// What is being done, one line.
    pub what: String,
    /// How much of it is done, `0 ..= 1`.
    pub fraction: f32,
}

/// A scene on its way. Dropping it cancels, and waits for the few milliseconds that it takes.
pub struct Loader {
    progress: Arc<Mutex<Loading>>,
    cancel: CancelToken,
    result: Receiver<Result<Loaded, LoadError>>,
    thread: Option<JoinHandle<()>>,
}

fn tell(progress: &Mutex<Loading>, what: String, fraction: f32) {
    let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
    // Threads that read at once may tell out of turn.
    *progress = Loading { what, fraction: progress.fraction.max(fraction) };
}

impl Loader {
    /// Begins to read scenes (the sample where none is named) and to bring them to the device.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn open(gpu: &Arc<Gpu>, paths: Vec<PathBuf>, storage: Storage) -> Result<Self, LoadError> {
        Self::start(gpu, storage, move |progress, cancel| {
            let shown = progress.clone();
            let options = LoadOptions {
                cancel,
                progress: Some(Arc::new(move |p| {
                    let several =
                        if p.files > 1 { format!(" ({} of {})", p.file + 1, p.files) } else { String::new() };
                    let fraction = (p.file as f32 + p.fraction) / p.files.max(1) as f32;
                    tell(&shown, format!("reading {}{several}", name_of(&p.path)), fraction);
                })),
                ..Default::default()
            };
            Ok(Arc::new(Opened::load_to_play(&paths, &options)?))
        })
    }

    /// Begins to bring a scene to the device in another packing.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn pack(gpu: &Arc<Gpu>, opened: Arc<Opened>, packing: Packing) -> Result<Self, LoadError> {
        Self::start(gpu, Storage::As(packing), move |_, _| Ok(opened))
    }

    fn start(
        gpu: &Arc<Gpu>,
        storage: Storage,
        open: impl FnOnce(&Arc<Mutex<Loading>>, CancelToken) -> Result<Arc<Opened>, SceneError> + Send + 'static,
    ) -> Result<Self, LoadError> {
        let progress = Arc::new(Mutex::new(Loading { what: "opening".into(), fraction: 0.0 }));
        let cancel = CancelToken::default();
        let (sender, result) = channel();
        let (gpu, shown, token) = (gpu.clone(), progress.clone(), cancel.clone());
        let thread = std::thread::Builder::new()
            .name("load".into())
            .spawn(move || {
                let load = || {
                    let opened = open(&shown, token)?;
                    tell(&shown, format!("uploading {}", opened.name), 1.0);
                    let (packing, plan) = storage.of(&opened);
                    let scene = SceneOnDevice::new(&gpu, &opened.scene.splats, packing)?;
                    Ok(Loaded { opened, scene, plan })
                };
                // Nobody waits any more where it is not taken; it is dropped then.
                let _ = sender.send(load());
            })
            .map_err(|e| LoadError::Thread(e.to_string()))?;
        Ok(Self { progress, cancel, result, thread: Some(thread) })
    }

    /// Asks it to stop, without waiting.
    pub fn cancel(&self) {
        self.cancel.cancel();
    }

    /// How far it is.
    pub fn progress(&self) -> Loading {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The result, once it is there. Never waits.
    pub fn poll(&mut self) -> Option<Result<Loaded, LoadError>> {
        match self.result.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                Some(Err(LoadError::Thread("the thread ended early; please report the scene".into())))
            }
        }
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        self.cancel.cancel();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the loading thread had panicked");
        }
    }
}
