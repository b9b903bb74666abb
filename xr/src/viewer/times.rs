//! What a frame costs the processor.

use std::time::{Duration, Instant};

/// Where the processor's time went in the last drawn frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameTimes {
    /// Reading input and acting on it.
    pub act: Duration,
    /// Waiting for the device to be done with the frame before the last.
    pub wait: Duration,
    /// Drawing the panel, where it is shown.
    pub panel: Duration,
    /// Locating the eyes and computing their views.
    pub locate: Duration,
    /// Taking the order of splats; the first one is waited for.
    pub order: Duration,
    /// Acquiring the image, and waiting for the compositor to let go of it.
    pub image: Duration,
    /// Recording and submitting the drawing.
    pub draw: Duration,
    /// Ending the frame.
    pub end: Duration,
}

impl FrameTimes {
    /// The frame loop's own: everything but waiting and drawing.
    pub fn own(&self) -> Duration {
        self.act + self.locate + self.order + self.end
    }
}

/// Time since the last look.
pub(super) struct Clock(Instant);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    pub fn lap(&mut self) -> Duration {
        let now = Instant::now();
        now.duration_since(std::mem::replace(&mut self.0, now))
    }
}
