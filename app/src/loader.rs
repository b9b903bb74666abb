//! Loads a scene on a thread of its own, so that whoever shows it never stands still: reading, packing, uploading.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use motes_renderer::gpu::{Gpu, GpuError};
use motes_renderer::plan::{Overrides, Plan};
use motes_renderer::{Packing, SceneOnDevice};
use motes_scenes::statement::Statement;
use motes_scenes::{CancelToken, EarlyCallback, LoadOptions, Scene, SceneError};

use crate::framing::Framing;
use crate::lod::{Detail, Resident, Tuning};
use crate::opened::{Opened, name_of};
use crate::thumbnail::Thumbnail;

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

/// From where a scene comes.
#[derive(Clone, Debug)]
pub enum SceneSource {
    /// Files or folders, merged; the sample where there is none.
    Files(Vec<PathBuf>),
    /// One that was read before.
    Memory(Arc<Opened>),
    /// A file of levels, read on the way into so many bytes.
    Within(PathBuf, u64),
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

/// What is to be loaded, and how.
#[derive(Clone, Debug)]
pub struct LoadRequest {
    /// From where.
    pub source: SceneSource,
    /// How it is stored on the device.
    pub storage: Storage,
    /// Where small pictures of scenes are kept; none is taken without.
    pub thumbnails: Option<PathBuf>,
}

/// A scene that is ready to be drawn.
pub struct Loaded {
    /// The scene in memory.
    pub opened: Arc<Opened>,
    /// The scene on the device.
    pub scene: Arc<SceneOnDevice>,
    /// Its levels of detail, where it has any.
    pub detail: Option<Detail>,
    /// Its dense part.
    pub framing: Framing,
    /// The plan by which it is stored, where there is one; none of a part.
    pub plan: Option<Plan>,
    /// All of it, and the last that comes; else a part of it ([`motes_scenes::early`]).
    pub whole: bool,
}

impl Loaded {
    fn new(gpu: &Arc<Gpu>, opened: Arc<Opened>, storage: Storage, whole: bool) -> Result<Self, GpuError> {
        let (packing, plan) = storage.of(&opened);
        let scene = Arc::new(SceneOnDevice::new(gpu, opened.stored(), packing)?);
        let levels = opened.levels.clone();
        let detail = levels.map(|levels| Detail::whole(levels, scene.clone(), Tuning::default()));
        let framing = Framing::of(&opened.scene.splats, &opened.settings);
        Ok(Self { opened, scene, detail, framing, plan: plan.filter(|_| whole), whole })
    }
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
    results: Receiver<Result<Loaded, LoadError>>,
    thread: Option<JoinHandle<()>>,
}

/// What the loading thread works with.
struct Worker {
    gpu: Arc<Gpu>,
    storage: Storage,
    thumbnails: Option<PathBuf>,
    progress: Arc<Mutex<Loading>>,
    cancel: CancelToken,
    results: Sender<Result<Loaded, LoadError>>,
}

impl Worker {
    fn tell(&self, what: String, fraction: f32) {
        tell(&self.progress, what, fraction);
    }

    /// Reads scenes, and hands parts of them over on the way.
    fn read(&self, paths: &[PathBuf]) -> Result<Opened, SceneError> {
        let shown = self.progress.clone();
        let options = LoadOptions {
            cancel: self.cancel.clone(),
            progress: Some(Arc::new(move |p| {
                let several =
                    if p.files > 1 { format!(" ({} of {})", p.file + 1, p.files) } else { String::new() };
                let fraction = (p.file as f32 + p.fraction) / p.files.max(1) as f32;
                tell(&shown, format!("reading {}{several}", name_of(&p.path)), fraction);
            })),
            early: paths.first().map(|path| self.early(path)),
            ..Default::default()
        };
        Opened::load_to_play(paths, &options)
    }

    /// Brings parts of a scene to the device.
    fn early(&self, path: &Path) -> EarlyCallback {
        let (gpu, storage, results) = (self.gpu.clone(), self.storage, self.results.clone());
        let path = path.to_owned();
        Arc::new(move |part: Scene| {
            let opened = Opened::part(&path, part).map(Arc::new).map_err(LoadError::from);
            match opened.and_then(|opened| Ok(Loaded::new(&gpu, opened, storage, false)?)) {
                // Nobody waits any more where it is not taken; it is dropped then.
                Ok(loaded) => drop(results.send(Ok(loaded))),
                Err(error) => log::warn!("a part of the scene cannot be shown: {error}"),
            }
        })
    }

    /// Opens a file of levels. The coarsest stands for the scene: for what it looks like as a whole.
    fn within(&self, path: PathBuf, bytes: u64) -> Result<Loaded, LoadError> {
        let options = LoadOptions { cancel: self.cancel.clone(), level: u32::MAX, ..Default::default() };
        let opened = Arc::new(Opened::load(std::slice::from_ref(&path), &options)?);
        let (packing, plan) = self.storage.of(&opened);
        let (resident, choice) = Resident::open(&self.gpu, &path, packing, bytes, Tuning::default())?;
        let framing = Framing::of(&opened.scene.splats, &opened.settings);
        let scene = resident.scene().clone();
        let detail = Some(Detail::within(resident, choice));
        Ok(Loaded { opened, scene, detail, framing, plan, whole: true })
    }

    fn load(&self, source: SceneSource) -> Result<Loaded, LoadError> {
        let opened = match source {
            SceneSource::Files(paths) => Arc::new(self.read(&paths)?),
            SceneSource::Memory(opened) => opened,
            SceneSource::Within(path, bytes) => return self.within(path, bytes),
        };
        self.tell(format!("uploading {}", opened.name), 1.0);
        let loaded = Loaded::new(&self.gpu, opened, self.storage, true)?;
        self.keep_thumbnail(&loaded);
        Ok(loaded)
    }

    /// Takes a small picture of a scene of which there is none yet.
    fn keep_thumbnail(&self, loaded: &Loaded) {
        let Loaded { opened, scene, framing, .. } = loaded;
        let (Some(folder), Some(path)) = (&self.thumbnails, &opened.path) else { return };
        let file = Thumbnail::file(folder, path);
        if file.exists() || self.cancel.is_cancelled() {
            return;
        }
        let kept = match Thumbnail::take(&self.gpu, opened, scene, framing) {
            Ok(picture) => picture.save(&file).map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        if let Err(problem) = kept {
            log::warn!("{}: no small picture of {}: {problem}", file.display(), opened.name);
        }
    }
}

fn tell(progress: &Mutex<Loading>, what: String, fraction: f32) {
    let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
    // Threads that read at once may tell out of turn.
    *progress = Loading { what, fraction: progress.fraction.max(fraction) };
}

impl Loader {
    /// Begins to bring a scene to the device.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn start(gpu: &Arc<Gpu>, request: LoadRequest) -> Result<Self, LoadError> {
        let LoadRequest { source, storage, thumbnails } = request;
        let progress = Arc::new(Mutex::new(Loading { what: "opening".into(), fraction: 0.0 }));
        let cancel = CancelToken::default();
        let (sender, results) = channel();
        let worker = Worker {
            gpu: gpu.clone(),
            storage,
            thumbnails,
            progress: progress.clone(),
            cancel: cancel.clone(),
            results: sender,
        };
        let thread = std::thread::Builder::new()
            .name("load".into())
            .spawn(move || drop(worker.results.send(worker.load(source))))
            .map_err(|e| LoadError::Thread(e.to_string()))?;
        Ok(Self { progress, cancel, results, thread: Some(thread) })
    }

    /// Asks it to stop, without waiting.
    pub fn cancel(&self) {
        self.cancel.cancel();
    }

    /// How far it is.
    pub fn progress(&self) -> Loading {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What has come since: parts of a large scene, each with more of it than the one before, then the whole scene or
    /// an error, which is the last. Never waits.
    pub fn poll(&mut self) -> Option<Result<Loaded, LoadError>> {
        match self.results.try_recv() {
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
