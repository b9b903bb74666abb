//! What the tests that go through more than one crate share.

pub mod golden;
pub mod hard;
#[cfg(unix)]
pub mod monado;
#[cfg(unix)]
pub mod remote;
pub mod spirv;

use motes_renderer::gpu::{Gpu, GpuOptions};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file or folder of the sample scenes: below the folder that `MOTES_SCENES` names, else `../shared/scenes` beside
/// the project.
///
/// # Panics
/// Where it is absent: a test that needs a scene fails without it, it is never skipped.
#[allow(clippy::panic, reason = "only tests call it")]
pub fn sample(path: impl AsRef<Path>) -> PathBuf {
    let folder = match std::env::var_os("MOTES_SCENES") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes"),
    };
    let file = folder.join(path.as_ref());
    if !file.exists() {
        panic!("{} is missing: set MOTES_SCENES to the folder of the sample scenes", file.display());
    }
    file
}

/// A device for tests: validation is on, and its end is a test of its own.
///
/// When it goes, the validation layer must have said nothing and nothing made with the device may be left.
pub struct TestGpu {
    gpu: Arc<Gpu>,
}

impl TestGpu {
    /// The device that the environment names.
    ///
    /// # Panics
    /// Without Vulkan, a device or the validation layer: such a machine cannot test Motes, and must not seem to.
    #[allow(clippy::panic, reason = "only tests call it")]
    #[allow(clippy::new_without_default, reason = "it can fail")]
    pub fn new() -> Self {
        match Gpu::offscreen(&GpuOptions { validation: true }) {
            Ok(gpu) => Self { gpu },
            Err(e) => {
                panic!("{e}\nTests need Vulkan with the validation layer: run them by `cargo xtask test`")
            }
        }
    }
}

impl Deref for TestGpu {
    type Target = Arc<Gpu>;
    fn deref(&self) -> &Arc<Gpu> {
        &self.gpu
    }
}

impl Drop for TestGpu {
    #[allow(clippy::panic, reason = "only tests call it")]
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let messages = self.gpu.messages();
        assert!(messages.is_empty(), "the validation layer complains:\n{}", messages.join("\n"));
        let holders = Arc::strong_count(&self.gpu) - 1;
        assert_eq!(holders, 0, "{holders} buffers, images or renderers were never freed");
    }
}

/// Peak signal-to-noise ratio of two pictures' colours, dB; infinite where they are equal.
///
/// # Panics
/// Where the sizes differ.
pub fn psnr(a: &[[u8; 3]], b: &[[u8; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let square: f64 = a
        .iter()
        .flatten()
        .zip(b.iter().flatten())
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum();
    10.0 * (255.0f64.powi(2) * (3 * a.len()) as f64 / square).log10()
}
