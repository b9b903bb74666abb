//! Loading on a thread of its own: the headset never waits for a file.

use crate::{Content, XrError};
use motes_app::loader::Storage;
use motes_app::opened::Opened;
use motes_renderer::gpu::Gpu;
use motes_renderer::plan::Plan;
use motes_scenes::{CancelToken, LoadOptions, SceneError};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread::JoinHandle;

/// What loading ends with.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The device cannot hold it.
    #[error(transparent)]
    Device(#[from] XrError),
    /// The thread ended without a word.
    #[error("loading ended unexpectedly; the log says more")]
    Ended,
}

/// What was loaded: on the device, and in memory for when the device is lost.
pub struct Loaded {
    /// On the device.
    pub content: Content,
    /// In memory.
    pub opened: Arc<Opened>,
    /// The plan by which it is stored, where there is one.
    pub plan: Option<Plan>,
}

/// Reads scenes and brings them to the device, while frames go on.
pub struct Loader {
    result: Receiver<Result<Loaded, LoadError>>,
    /// Thousandths of the reading.
    progress: Arc<AtomicU32>,
    cancel: CancelToken,
    thread: Option<JoinHandle<()>>,
}

/// From where a scene comes.
#[derive(Clone, Debug)]
pub enum SceneSource {
    /// Files or folders, merged; the sample where there is none.
    Files(Vec<PathBuf>),
    /// One that was read before.
    Memory(Arc<Opened>),
}

impl Loader {
    /// Starts loading.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn start(gpu: &Arc<Gpu>, source: SceneSource, storage: Storage) -> Result<Self, XrError> {
        let (outbox, result) = channel();
        let progress = Arc::new(AtomicU32::new(0));
        let cancel = CancelToken::default();
        let (gpu, of_thread, stop) = (gpu.clone(), progress.clone(), cancel.clone());
        let thread = std::thread::Builder::new().name("load".into()).spawn(move || {
            let options = LoadOptions {
                progress: Some(Arc::new(move |p| {
                    let files = p.files.max(1) as f32;
                    let done = (p.file as f32 + p.fraction.clamp(0.0, 1.0)) / files;
                    of_thread.store((done * 1000.0) as u32, Ordering::Relaxed);
                })),
                cancel: stop,
                ..Default::default()
            };
            let load = || -> Result<Loaded, LoadError> {
                let opened = match source {
                    SceneSource::Files(paths) => Arc::new(Opened::load_to_play(&paths, &options)?),
                    SceneSource::Memory(opened) => opened,
                };
                let (packing, plan) = storage.of(&opened);
                Ok(Loaded { content: Content::new(&gpu, &opened, packing)?, opened, plan })
            };
            // Who no longer wants it does not listen.
            let _ = outbox.send(load());
        });
        Ok(Self { result, progress, cancel, thread: Some(thread.map_err(XrError::Thread)?) })
    }

    /// How much is read, `0 ..= 1`.
    pub fn progress(&self) -> f32 {
        self.progress.load(Ordering::Relaxed) as f32 / 1000.0
    }

    /// What was loaded, once it is; never waits.
    pub fn poll(&mut self) -> Option<Result<Loaded, LoadError>> {
        match self.result.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(LoadError::Ended)),
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
