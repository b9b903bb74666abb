//! Foveation: a headset draws the rims of its images more coarsely than their middle, where the lenses blur them anyway.
//!
//! What that saves cannot be predicted: which pixels go is the runtime's secret. So it is measured, by the device's timers:
//! the time of drawing over the predicted fragments, with foveation and without.

use std::fmt;

use motes_renderer::FrameReport;

/// How coarse the rims are (`XrFoveationLevelFB`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Foveation {
    /// As fine as the middle.
    #[default]
    None,
    /// A little coarser.
    Low,
    /// Coarser.
    Medium,
    /// Coarsest.
    High,
}

impl Foveation {
    /// Every level, from none up.
    pub const ALL: [Self; 4] = [Self::None, Self::Low, Self::Medium, Self::High];
}

impl fmt::Display for Foveation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::None => "none",
            Self::Low => "low",
            Self::Medium => "medium",
            Self::High => "high",
        })
    }
}

/// Share of a new measurement in the mean of all.
const NEW: f64 = 0.1;
/// No level is believed to leave less of a frame than this.
const LEAST: f64 = 0.2;

/// What each level leaves of a frame's cost.
#[derive(Clone, Debug, Default)]
pub(super) struct Effect {
    /// Time of drawing a predicted fragment without foveation, ns; none before it was measured.
    plain: Option<f64>,
    /// What each level leaves, over none; none where it was not measured.
    shares: [Option<f64>; Foveation::ALL.len()],
}

impl Effect {
    /// Whether anything can be measured: the device has timers, and frames without foveation were seen.
    pub fn known(&self) -> bool {
        self.plain.is_some()
    }

    /// Takes a frame that was drawn at a level, and says what that level leaves of the predicted cost. `settled`: the frame
    /// was not under way when the level changed.
    pub fn observe(&mut self, report: &FrameReport, level: Foveation, settled: bool) -> f64 {
        let rate = report.draw_ns / f64::from(report.predicted_unhidden);
        if settled && rate > 0.0 && rate.is_finite() {
            let mean = |old: Option<f64>, new: f64| Some(old.map_or(new, |old| old + NEW * (new - old)));
            match (level, self.plain) {
                (Foveation::None, plain) => self.plain = mean(plain, rate),
                (_, Some(plain)) => {
                    let share = &mut self.shares[level as usize];
                    *share = mean(*share, (rate / plain).clamp(LEAST, 1.0));
                }
                (_, None) => {}
            }
        }
        self.shares[level as usize].unwrap_or(1.0)
    }
}
