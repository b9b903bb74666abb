//! The overdraw governor: holds a budget of layers per pixel, or of a headset's predicted milliseconds, by drawing less
//! exactly where a frame would take more.
//!
//! What a frame takes is known from what the device itself adds up before it draws ([`FrameReport::predicted_unhidden`]:
//! areas of all polygons, less what early stop is predicted to hide), so that it is the same on every machine and every
//! run. The governor answers with a ladder of small steps, in this order: early stop at a higher transmittance, a
//! threshold on a splat's contribution, a cap on radii, foveation where a headset offers it, the resolution. Each changes
//! pictures more than the one before.
//! A scene with levels of detail ([`crate::lod`]) lowers its target with every step.
//!
//! It does not swing. A frame over the budget moves it up; it comes down only where the step below is expected to fit
//! with a margin, which it knows from what that step saved when it was taken, and only after frames in a row said so.
//! Where that was seen only once it may come down in vain, once: then it knows.
//! Under a constant load it therefore comes to rest, whatever the steps save; the tests hold it to that.

use std::fmt;
use std::str::FromStr;

use motes_renderer::{
    Composite, Expansion, FrameReport, Lens, RenderConfig, STOP_BELOW, Sorter, TargetFormat,
};
use serde::{Deserialize, Serialize};

use crate::prediction::{FrameLoad, StageRates};

mod foveation;

pub use foveation::Foveation;

use foveation::Effect;

/// What a frame may take.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Budget {
    /// Layers of splats per pixel of the shown image, mean over all views.
    Layers(f64),
    /// Predicted frame of a Quest 3 ([`StageRates::quest_3`]), ms.
    Milliseconds(f64),
}

impl Budget {
    /// A Quest 3 at 72 Hz that spends 9 ms of a frame on fragments: some 18 layers on both eyes.
    pub const QUEST_3: Self = Self::Layers(18.0);

    /// The figure: layers, or ms.
    pub fn limit(self) -> f64 {
        match self {
            Self::Layers(limit) | Self::Milliseconds(limit) => limit,
        }
    }

    /// What a frame took, in the budget's unit. `None` where it is not known: nothing was drawn, or the expansion
    /// predicts nothing and the device counts nothing.
    pub fn cost(self, report: &FrameReport, config: &RenderConfig) -> Option<f64> {
        if report.shown_pixels == 0 {
            return None;
        }
        let fragments = match config.expansion {
            Expansion::Precomputed => f64::from(report.predicted_unhidden),
            Expansion::Instanced | Expansion::Geometry if report.vertices == 0 => return None,
            _ => report.fragments as f64,
        };
        let layers = fragments / report.shown_pixels as f64;
        Some(match self {
            Self::Layers(_) => layers,
            Self::Milliseconds(_) => {
                let corners = config.shape.corners();
                let load = FrameLoad::new(report.visible, config.expansion, corners, layers);
                StageRates::quest_3().predict(&load).ms()
            }
        })
        .filter(|cost| cost.is_finite())
    }
}

impl FromStr for Budget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, kind): (_, fn(f64) -> Self) = match text.trim().strip_suffix("ms") {
            Some(number) => (number, Self::Milliseconds),
            None => (text, Self::Layers),
        };
        match number.trim().parse::<f64>() {
            Ok(limit) if (0.1..=1000.0).contains(&limit) => Ok(kind(limit)),
            _ => Err(format!(
                "'{text}' is no budget: write layers per pixel like 18, or milliseconds of a Quest 3 like 9ms, from 0.1 \
                 to 1000"
            )),
        }
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Layers(limit) => write!(f, "{limit}"),
            Self::Milliseconds(limit) => write!(f, "{limit}ms"),
        }
    }
}

impl TryFrom<String> for Budget {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Budget> for String {
    fn from(budget: Budget) -> Self {
        budget.to_string()
    }
}

/// One step of the ladder: what it sets at least (or at most), whatever was asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Early stop is on, and finishes pixels below this transmittance.
    EarlyStop(f32),
    /// Splats of lower contribution (pixels) are left out.
    Contribution(f32),
    /// Radii are capped at this fraction of the larger image side.
    Radius(f32),
    /// How coarse a headset draws the rims of its images. Taken where it offers that and the device's timers tell what it
    /// saves.
    Foveation(Foveation),
    /// The rendered image's side over the shown one's.
    Resolution(f32),
}

/// The ladder, from what is seen least to what is seen most. All steps up to the one in force hold.
pub const LADDER: &[Step] = &[
    Step::EarlyStop(STOP_BELOW),
    Step::EarlyStop(0.006),
    Step::EarlyStop(0.012),
    Step::EarlyStop(0.025),
    Step::EarlyStop(0.05),
    Step::Contribution(0.25),
    Step::Contribution(0.5),
    Step::Contribution(1.0),
    Step::Contribution(2.0),
    Step::Contribution(4.0),
    Step::Radius(0.5),
    Step::Radius(0.35),
    Step::Radius(0.25),
    Step::Radius(0.18),
    Step::Radius(0.12),
    Step::Radius(0.09),
    Step::Radius(0.06),
    Step::Foveation(Foveation::Low),
    Step::Foveation(Foveation::Medium),
    Step::Foveation(Foveation::High),
    Step::Resolution(0.95),
    Step::Resolution(0.9),
    Step::Resolution(0.85),
    Step::Resolution(0.8),
    Step::Resolution(0.75),
    Step::Resolution(0.71),
    Step::Resolution(0.65),
    Step::Resolution(0.6),
    Step::Resolution(0.55),
    Step::Resolution(0.5),
];

impl Step {
    /// Applies it where it asks for less than is drawn anyway, and where the other choices allow it.
    fn apply(self, config: &mut RenderConfig) {
        let stochastic = config.sorter == Sorter::Stochastic;
        match self {
            // Nothing is blended, or what was blended is not known precisely enough to stop by it.
            Self::EarlyStop(_) if stochastic || config.target == TargetFormat::Rgb10A2 => {}
            Self::EarlyStop(below) => {
                config.composite = Composite::EarlyStop;
                config.stop_below = config.stop_below.max(below);
            }
            Self::Contribution(least) => config.min_contribution = config.min_contribution.max(least),
            Self::Radius(most) => config.max_radius = config.max_radius.min(most),
            // The headset's matter.
            Self::Foveation(_) => {}
            Self::Resolution(_) if stochastic || config.lens != Lens::Perspective => {}
            Self::Resolution(most) => config.resolution_scale = config.resolution_scale.min(most),
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EarlyStop(below) => write!(f, "early stop at 1/{:.0}", 1.0 / below),
            Self::Contribution(least) => write!(f, "no splats below {least} px"),
            Self::Radius(most) => write!(f, "radii up to {:.0} % of the image", 100.0 * most),
            Self::Foveation(level) => write!(f, "foveation {level}"),
            Self::Resolution(most) => write!(f, "resolution {:.0} %", 100.0 * most),
        }
    }
}

/// How readily the governor moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning {
    /// Frames after a change that say nothing about it: they were under way before it.
    pub settle: u32,
    /// Frames in a row over the budget before a step up.
    pub haste: u32,
    /// Frames in a row that must promise room before a step down.
    pub patience: u32,
    /// The step below must be expected to leave this share of the budget free.
    pub margin: f64,
    /// What the step below takes, over what is taken now, where it is not known.
    pub guess: f64,
    /// What a step saved is known if it came out twice within this share, until the cost on it has changed by as much.
    /// 0: it is never known.
    pub memory: f64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self { settle: 3, haste: 2, patience: 30, margin: 0.06, guess: 1.5, memory: 0.15 }
    }
}

/// What a step saved when it was taken.
#[derive(Clone, Copy, Debug)]
struct Saving {
    /// Cost below over cost on it.
    ratio: f64,
    /// Cost on it then.
    at: f64,
    /// It came out so twice: the scene did not happen to change at the same moment.
    sure: bool,
}

/// A change of the step in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// The level before; 0 is nothing but what was asked for.
    pub from: usize,
    /// The level from now on.
    pub to: usize,
    /// What frames took before, in the budget's unit.
    pub cost: f64,
}

/// Holds a budget.
#[derive(Clone, Debug)]
pub struct Governor {
    budget: Budget,
    tuning: Tuning,
    level: usize,
    /// Cost of the newest frame, in the budget's unit.
    cost: f64,
    /// Frames since the last change.
    since: u32,
    over: u32,
    under: u32,
    /// Cost before the last change, and the level then, until that change has settled.
    before: Option<(f64, usize)>,
    /// By level; the first stands for nothing.
    savings: [Option<Saving>; LADDER.len() + 1],
    /// The last step does not suffice, and that was said.
    beyond: bool,
    /// What foveation saves; none where it cannot be had.
    foveation: Option<Effect>,
}

impl Governor {
    /// One that holds a budget.
    pub fn new(budget: Budget) -> Self {
        Self::tuned(budget, Tuning::default())
    }

    /// One that moves as it is told.
    pub fn tuned(budget: Budget, tuning: Tuning) -> Self {
        Self {
            budget,
            tuning,
            level: 0,
            cost: 0.0,
            since: 0,
            over: 0,
            under: 0,
            before: None,
            savings: [None; LADDER.len() + 1],
            beyond: false,
            foveation: None,
        }
    }

    /// The budget.
    pub fn budget(&self) -> Budget {
        self.budget
    }

    /// Another budget. The step in force stays, and moves from there.
    pub fn set_budget(&mut self, budget: Budget) {
        if self.budget != budget {
            let foveation = self.foveation.take();
            *self = Self { level: self.level, foveation, ..Self::tuned(budget, self.tuning) };
        }
    }

    /// The level in force: 0 is what was asked for, `LADDER.len()` the last step.
    pub fn level(&self) -> usize {
        self.level
    }

    /// The step in force; `None` where everything is as it was asked for.
    pub fn step(&self) -> Option<Step> {
        self.level.checked_sub(1).and_then(|i| LADDER.get(i).copied())
    }

    /// Says whether the headset lets its foveation be set.
    pub fn offer_foveation(&mut self, offered: bool) {
        if offered != self.foveation.is_some() {
            self.foveation = offered.then(Effect::default);
        }
    }

    /// The foveation by the step in force.
    pub fn foveation(&self) -> Foveation {
        if self.foveation.as_ref().is_some_and(Effect::known) {
            foveation_at(self.level)
        } else {
            Foveation::None
        }
    }

    /// What the newest frame took, in the budget's unit.
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Whether not even the last step holds the budget.
    pub fn is_beyond(&self) -> bool {
        self.beyond
    }

    /// Whether nothing would change if frames went on as the last ones.
    pub fn is_at_rest(&self) -> bool {
        self.since > self.tuning.settle && self.over == 0 && self.under == 0
    }

    /// The step in force in words, with the foveation that a step before it has set.
    pub fn in_words(&self) -> String {
        let step = self.step().map_or("as asked for".to_owned(), |step| step.to_string());
        match (self.step(), self.foveation()) {
            (Some(Step::Foveation(_)), _) | (_, Foveation::None) => step,
            (_, foveation) => format!("{step}, foveation {foveation}"),
        }
    }

    /// The configuration by the step in force.
    pub fn apply(&self, config: &RenderConfig) -> RenderConfig {
        at_level(config, self.level)
    }

    /// Takes what a frame took that was drawn by [`Governor::apply`] of this configuration. Says what it changes, in the
    /// log too.
    pub fn observe(&mut self, report: &FrameReport, config: &RenderConfig) -> Option<Change> {
        let settled = self.since >= self.tuning.settle;
        let level = self.foveation();
        let share = self.foveation.as_mut().map_or(1.0, |effect| effect.observe(report, level, settled));
        let cost = self.budget.cost(report, config)? * share;
        let change = self.observe_cost(cost, config);
        if let Some(change) = change {
            let step = self.step().map_or("drawn as asked for".to_owned(), |s| s.to_string());
            let (budget, of) = (self.budget.limit(), LADDER.len());
            let unit = self.unit();
            log::info!("overdraw: {cost:.1} {unit}, budget {budget}: {step} (step {} of {of})", change.to);
        }
        let beyond = self.level == self.next_level(config) && cost > self.budget.limit();
        if beyond && !self.beyond && self.since > self.tuning.settle {
            log::warn!("overdraw: {cost:.1} {} is over the budget at the last step", self.unit());
            self.beyond = true;
        } else if !beyond {
            self.beyond = false;
        }
        change
    }

    /// The budget's unit, in words.
    pub fn unit(&self) -> &'static str {
        match self.budget {
            Budget::Layers(_) => "layers a pixel",
            Budget::Milliseconds(_) => "ms predicted",
        }
    }

    /// As [`Governor::observe`], for a cost in the budget's unit, and without a word.
    pub fn observe_cost(&mut self, cost: f64, config: &RenderConfig) -> Option<Change> {
        self.cost = cost;
        self.since = self.since.saturating_add(1);
        if self.since <= self.tuning.settle {
            return None;
        }
        self.learn(cost);
        let limit = self.budget.limit();
        let room = cost * self.ratio_below(cost) <= limit * (1.0 - self.tuning.margin);
        self.over = if cost > limit { self.over + 1 } else { 0 };
        self.under = if room && self.level > 0 { self.under + 1 } else { 0 };
        let next = self.next_level(config);
        if self.over > 0 && next == self.level {
            // There is nowhere to go.
            self.over = 0;
        }
        if self.over >= self.tuning.haste {
            return Some(self.go(next, cost));
        }
        // Far below the budget there is no need to wait as long.
        let patience =
            if cost < 0.5 * limit { self.tuning.patience.div_ceil(3) } else { self.tuning.patience };
        (self.under >= patience).then(|| self.go(self.level_below(config), cost))
    }

    fn go(&mut self, to: usize, cost: f64) -> Change {
        let from = std::mem::replace(&mut self.level, to);
        self.before = Some((cost, from));
        (self.since, self.over, self.under) = (0, 0, 0);
        Change { from, to, cost }
    }

    /// What the last change saved or cost, now that it shows.
    fn learn(&mut self, cost: f64) {
        let Some((before, from)) = self.before.take() else { return };
        if self.tuning.memory <= 0.0 || !(cost > 0.0 && before > 0.0) {
            return;
        }
        let (step, ratio, at) =
            if self.level > from { (self.level, before / cost, cost) } else { (from, cost / before, before) };
        let ratio = ratio.max(1.0);
        let sure = self.savings[step].is_some_and(|s| (ratio / s.ratio - 1.0).abs() <= self.tuning.memory);
        self.savings[step] = Some(Saving { ratio, at, sure });
    }

    /// What the step below is expected to take, over what is taken now.
    fn ratio_below(&self, cost: f64) -> f64 {
        match self.savings[self.level] {
            Some(s) if s.sure && (cost / s.at - 1.0).abs() <= self.tuning.memory => s.ratio,
            // Seen once, or of another load: a high ratio may mean no more than that something else came into view.
            Some(s) => s.ratio.min(self.tuning.guess),
            None => self.tuning.guess,
        }
    }

    /// By how much the target of levels of detail is lowered, SSIM: 0.01 for each step of the ladder, at most 0.1.
    pub fn detail_ease(&self) -> f64 {
        0.01 * self.level.min(10) as f64
    }

    /// The next level that changes anything; the same where there is none.
    fn next_level(&self, config: &RenderConfig) -> usize {
        (self.level + 1..=LADDER.len()).find(|&l| !self.same(config, l, self.level)).unwrap_or(self.level)
    }

    /// The highest level below that changes anything: 0 where all below are the same.
    fn level_below(&self, config: &RenderConfig) -> usize {
        let differs = |l: &usize| !self.same(config, *l, self.level);
        let Some(mut level) = (0..self.level).rev().find(differs) else { return 0 };
        // Of levels that mean the same, the first has the savings.
        while level > 0 && self.same(config, level - 1, level) {
            level -= 1;
        }
        level
    }

    /// Whether two levels mean the same.
    fn same(&self, config: &RenderConfig, a: usize, b: usize) -> bool {
        let foveated = self.foveation.as_ref().is_some_and(Effect::known);
        at_level(config, a) == at_level(config, b) && !(foveated && foveation_at(a) != foveation_at(b))
    }
}

fn at_level(config: &RenderConfig, level: usize) -> RenderConfig {
    let mut config = config.clone();
    for step in LADDER.iter().take(level) {
        step.apply(&mut config);
    }
    config
}

fn foveation_at(level: usize) -> Foveation {
    let steps = LADDER.iter().take(level).rev();
    let levels = steps.filter_map(|step| if let Step::Foveation(level) = step { Some(*level) } else { None });
    levels.into_iter().next().unwrap_or_default()
}

#[cfg(test)]
mod tests;
