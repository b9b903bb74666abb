//! What can go wrong with a headset's session.

use motes_renderer::gpu::GpuError;
use openxr::sys;

/// An error of the OpenXR runtime, of the device it uses, or of a recorded session.
#[derive(Debug, thiserror::Error)]
pub enum XrError {
    /// There is no OpenXR loader.
    #[error(
        "there is no OpenXR loader ({0}). Install your headset's software, or, on Debian and Ubuntu, \
         libopenxr-loader1"
    )]
    NoLoader(String),
    /// There is a loader, and no runtime is installed or active.
    #[error(
        "no OpenXR runtime is installed or active. Start your headset's software (SteamVR, Monado, Meta Link, …) \
         and make it the active OpenXR runtime"
    )]
    NoRuntime,
    /// The runtime is installed, and does not answer.
    #[error(
        "the OpenXR runtime is installed but does not run ({call}: {result}). Start its service (for Monado: \
         monado-service) and try again"
    )]
    NotRunning {
        /// The call.
        call: &'static str,
        /// The runtime's word.
        result: sys::Result,
    },
    /// The runtime has no headset.
    #[error(
        "the runtime ({runtime}) has no headset at hand: {result}. Connect it, and wake it by putting it on"
    )]
    NoHeadset {
        /// The runtime's name.
        runtime: String,
        /// The runtime's word.
        result: sys::Result,
    },
    /// Something that Motes cannot do without.
    #[error("the runtime ({runtime}) does not offer {wanted}, which Motes needs. {remedy}")]
    Missing {
        /// The runtime's name.
        runtime: String,
        /// What is missing.
        wanted: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The runtime ended, or lost the session, while it was in use.
    #[error(
        "the OpenXR runtime was lost in mid-session ({call}: {result}). Motes can go on once it runs again"
    )]
    Lost {
        /// The call.
        call: &'static str,
        /// The runtime's word.
        result: sys::Result,
    },
    /// Another call failed.
    #[error("{call}: {result}")]
    Call {
        /// The call.
        call: &'static str,
        /// The runtime's word.
        result: sys::Result,
    },
    /// The device's own.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The panel's.
    #[error(transparent)]
    Panel(#[from] motes_app::painter::PainterError),
    /// A recorded session that cannot be read or written.
    #[error("{file}: {place}: {problem}. {remedy}")]
    Script {
        /// The file.
        file: String,
        /// Where in it.
        place: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The system refuses a thread.
    #[error("a worker thread cannot be started: {0}. Close other programs")]
    Thread(std::io::Error),
}

impl XrError {
    /// Whether a session may be had again once the runtime is back.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Lost { .. })
    }

    /// Whether there is no headset to be had at all, so that another way of showing is to be taken.
    pub fn is_absent(&self) -> bool {
        matches!(self, Self::NoLoader(_) | Self::NoRuntime | Self::NotRunning { .. } | Self::NoHeadset { .. })
    }
}

/// Names the call that failed, and tells a lost runtime from a refusal.
pub(crate) trait During<T> {
    fn during(self, call: &'static str) -> Result<T, XrError>;
}

impl<T> During<T> for Result<T, sys::Result> {
    fn during(self, call: &'static str) -> Result<T, XrError> {
        self.map_err(|result| match result {
            sys::Result::ERROR_INSTANCE_LOST
            | sys::Result::ERROR_SESSION_LOST
            | sys::Result::ERROR_RUNTIME_FAILURE => XrError::Lost { call, result },
            _ => XrError::Call { call, result },
        })
    }
}
