#![allow(clippy::unwrap_used, reason = "a test may")]

use super::*;
use std::collections::VecDeque;

/// A scene whose cost each step lowers by a factor of its own. Frames are two under way, as the renderer's.
struct Load {
    /// Cost as asked for.
    cost: f64,
    /// Cost on each level over that on the one before.
    factors: Vec<f64>,
    /// Levels of the frames under way.
    under_way: VecDeque<usize>,
    noise: f64,
    random: Random,
}

/// PCG (O'Neill 2014): numbers that are the same in every run.
#[derive(Clone)]
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let word = (((self.0 >> 18) ^ self.0) >> 27) as u32;
        f64::from(word.rotate_right((self.0 >> 59) as u32)) / 4_294_967_296.0
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

impl Load {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        // Some steps save nothing, some two thirds.
        let factors = (0..LADDER.len()).map(|_| f64::min(1.0, random.between(0.35, 1.2))).collect();
        Self { cost: 10.0, factors, under_way: VecDeque::from([0, 0]), noise: 0.0, random }
    }

    fn at(&self, level: usize) -> f64 {
        self.cost * self.factors[..level].iter().product::<f64>()
    }

    /// Draws a frame by the governor's level, and tells it of the one before the last.
    fn frame(&mut self, governor: &mut Governor) -> Option<Change> {
        self.under_way.push_back(governor.level());
        let level = self.under_way.pop_front().unwrap();
        let noise = self.random.between(1.0 - self.noise, 1.0 + self.noise);
        governor.observe_cost(self.at(level) * noise, &RenderConfig::default())
    }

    fn frames(&mut self, governor: &mut Governor, count: usize) -> Vec<Change> {
        (0..count).filter_map(|_| self.frame(governor)).collect()
    }
}

const LIMIT: f64 = 18.0;

fn governor() -> Governor {
    Governor::new(Budget::Layers(LIMIT))
}

/// Up and down with nothing in between: without margin, patience or memory.
const WITHOUT_HYSTERESIS: Tuning =
    Tuning { settle: 3, haste: 1, patience: 1, margin: 0.0, guess: 1.0, memory: 0.0 };

#[test]
fn the_first_level_changes_nothing_and_every_further_one_something() {
    // Early stop at its own transmittance is what the default does anyway.
    let config = RenderConfig::default();
    assert_eq!(at_level(&config, 0), config);
    assert_eq!(at_level(&config, 1), config);
    for level in 2..=LADDER.len() {
        let drawn = |level| (at_level(&config, level), foveation_at(level));
        assert_ne!(drawn(level), drawn(level - 1), "{level}");
    }
    // Nothing is asked to be drawn more exactly than it was.
    let coarse = RenderConfig {
        stop_below: 0.2,
        min_contribution: 10.0,
        max_radius: 0.01,
        resolution_scale: 0.5,
        ..RenderConfig::default()
    };
    assert_eq!(at_level(&coarse, LADDER.len()), coarse);
}

/// In the order that was decided: early stop, contribution, radius, resolution; within each, never back.
#[test]
fn the_ladder_is_in_order() {
    let kind = |s: &Step| match s {
        Step::EarlyStop(_) => 0,
        Step::Contribution(_) => 1,
        Step::Radius(_) => 2,
        Step::Foveation(_) => 3,
        Step::Resolution(_) => 4,
    };
    for pair in LADDER.windows(2) {
        assert!(kind(&pair[0]) <= kind(&pair[1]), "{pair:?}");
        let rises = match (pair[0], pair[1]) {
            (Step::EarlyStop(a), Step::EarlyStop(b)) | (Step::Contribution(a), Step::Contribution(b)) => {
                a < b && b / a <= 2.1
            }
            (Step::Radius(a), Step::Radius(b)) => b < a && b / a >= 0.6,
            (Step::Foveation(a), Step::Foveation(b)) => a < b,
            (Step::Resolution(a), Step::Resolution(b)) => b < a && a - b <= 0.061,
            _ => true,
        };
        assert!(rises, "{pair:?} is no small step");
    }
}

#[test]
fn choices_that_forbid_a_step_go_without_it() {
    let last = |config: &RenderConfig| at_level(config, LADDER.len());
    let back = RenderConfig { composite: Composite::BackToFront, ..RenderConfig::default() };
    assert_eq!(at_level(&back, 1).composite, Composite::EarlyStop);
    let ten_bits = RenderConfig { target: TargetFormat::Rgb10A2, ..back };
    assert_eq!(last(&ten_bits).composite, Composite::BackToFront);
    assert!(last(&ten_bits).resolution_scale < 1.0);
    let stochastic = RenderConfig {
        sorter: Sorter::Stochastic,
        composite: Composite::FrontToBack,
        ..RenderConfig::default()
    };
    let drawn = last(&stochastic);
    assert_eq!((drawn.composite, drawn.resolution_scale), (Composite::FrontToBack, 1.0));
    assert!(drawn.min_contribution > 0.0);
}

/// Whatever the steps save, and whatever the scene cost before: under a constant load it comes to rest, within the budget
/// where that is possible, and not further up than it must be.
#[test]
fn under_a_constant_load_it_comes_to_rest() {
    for seed in 0..300 {
        let mut load = Load::new(seed);
        let mut governor = governor();
        // Something else before: any state to begin with.
        for _ in 0..3 {
            load.cost = load.random.between(0.5, 400.0);
            let frames = load.random.between(1.0, 200.0) as usize;
            load.frames(&mut governor, frames);
        }
        load.cost = load.random.between(0.5, 200.0);
        let changes = load.frames(&mut governor, 2500);
        // It turns round at most twice a level that it tries: up, and once down too far and back.
        let turns = changes.windows(2).filter(|c| (c[0].to > c[0].from) != (c[1].to > c[1].from)).count();
        assert!(turns <= 2 * LADDER.len(), "seed {seed}: {turns} turns");
        let level = governor.level();
        assert_eq!(load.frames(&mut governor, 2000), [], "seed {seed}: it still moves");
        assert!(governor.is_at_rest());
        let last = load.at(LADDER.len()) > LIMIT;
        assert!(load.at(level) <= LIMIT || last && level == LADDER.len(), "seed {seed}: over at {level}");
        // The level below that differs would not leave the margin, as far as it knows.
        if level > 1 {
            // The default stops there anyway: below the second level there is nothing but the first of all.
            let below = if level == 2 { 0 } else { level - 1 };
            let most = load.at(below).max(load.at(level) * Tuning::default().guess);
            assert!(most > LIMIT * (1.0 - 2.0 * Tuning::default().margin), "seed {seed}: idle at {level}");
        }
    }
}

/// Control: without hysteresis the same loads make it swing for ever.
#[test]
fn without_hysteresis_it_swings() {
    let mut swinging = 0;
    for seed in 0..100 {
        let mut load = Load::new(seed);
        let mut governor = Governor::tuned(Budget::Layers(LIMIT), WITHOUT_HYSTERESIS);
        load.cost = load.random.between(19.0, 60.0);
        load.frames(&mut governor, 2500);
        swinging += usize::from(load.frames(&mut governor, 2000).len() > 100);
    }
    assert!(swinging > 80, "{swinging} of 100 swing");
}

/// Random sequences of everything: jumps, ramps, noise. It moves seldom, and never more than a step that means something.
#[test]
fn under_any_load_it_moves_seldom_and_by_single_steps() {
    for seed in 0..200 {
        let mut load = Load::new(1000 + seed);
        let mut governor = governor();
        let (mut changes, mut over, mut frames) = (Vec::new(), 0, 0);
        for _ in 0..40 {
            let to = load.random.between(0.0, 150.0);
            let length = load.random.between(1.0, 300.0) as usize;
            let from = if load.random.next() < 0.5 { to } else { load.cost };
            load.noise = if load.random.next() < 0.5 { 0.0 } else { 0.03 };
            for i in 0..length {
                load.cost = from + (to - from) * i as f64 / length as f64;
                changes.extend(load.frame(&mut governor));
                frames += 1;
                over += usize::from(load.at(governor.level()) > LIMIT && load.at(LADDER.len()) <= LIMIT);
            }
        }
        for change in &changes {
            let (low, high) = (change.from.min(change.to), change.from.max(change.to));
            // Level 1 is level 0 where early stop is on already.
            assert!(high - low == 1 || (low, high) == (0, 2), "seed {seed}: {change:?}");
        }
        // Each change is followed by frames that say nothing, and each way down by patience.
        assert!(changes.len() * 5 <= frames, "seed {seed}: {} changes in {frames} frames", changes.len());
        assert!(over * 4 <= frames, "seed {seed}: over the budget in {over} of {frames} frames");
    }
}

/// Noise of a few percent around a load that just fits makes no difference.
#[test]
fn noise_does_not_move_it() {
    for seed in 0..50 {
        let mut load = Load::new(seed);
        let mut governor = governor();
        load.noise = 0.02;
        load.cost = load.random.between(19.0, 80.0);
        load.frames(&mut governor, 2500);
        let changes = load.frames(&mut governor, 2000);
        assert!(changes.len() <= 2, "seed {seed}: {changes:?}");
    }
}

#[test]
fn what_no_step_can_hold_is_said_once_and_a_new_budget_begins_from_there() {
    let mut governor = governor();
    let config = RenderConfig::default();
    let report = |layers: f32| FrameReport {
        shown_pixels: 100,
        predicted_unhidden: 100.0 * layers,
        ..FrameReport::default()
    };
    for _ in 0..1000 {
        governor.observe(&report(500.0), &config);
    }
    assert!(governor.is_beyond() && governor.level() == LADDER.len() && governor.is_at_rest());
    assert_eq!(governor.cost(), 500.0);
    governor.set_budget(Budget::Layers(900.0));
    assert!(!governor.is_beyond() && governor.level() == LADDER.len());
    for _ in 0..3000 {
        governor.observe(&report(3.0), &config);
    }
    assert_eq!(governor.level(), 0);
    // A frame that drew nothing says nothing.
    assert_eq!(governor.observe(&FrameReport::default(), &config), None);
    assert_eq!(governor.cost(), 3.0);
}

#[test]
fn budgets_are_layers_or_milliseconds() {
    assert_eq!("18".parse(), Ok(Budget::QUEST_3));
    assert_eq!("9 ms".parse(), Ok(Budget::Milliseconds(9.0)));
    for text in ["18", "9ms", "2.5"] {
        assert_eq!(text.parse::<Budget>().unwrap().to_string(), text);
    }
    for bad in ["", "0", "-3", "ms", "1e9", "NaN", "many"] {
        assert!(bad.parse::<Budget>().unwrap_err().contains("9ms"), "{bad}");
    }
    let json = serde_json::to_string(&Budget::Milliseconds(9.0)).unwrap();
    assert_eq!((json.as_str(), serde_json::from_str(&json).unwrap()), ("\"9ms\"", Budget::Milliseconds(9.0)));

    // 18 layers on two eyes of a Quest 3, and no splats, are 9 ms.
    let config = RenderConfig::default();
    let report = FrameReport { shown_pixels: 10, predicted_unhidden: 180.0, ..FrameReport::default() };
    assert_eq!(Budget::QUEST_3.cost(&report, &config), Some(18.0));
    let ms = Budget::Milliseconds(9.0).cost(&report, &config).unwrap();
    assert!((ms - 9.07).abs() < 0.05, "{ms}");
    // Where the device counts nothing there is nothing to go by.
    let instanced = RenderConfig { expansion: Expansion::Instanced, ..config };
    assert_eq!(Budget::QUEST_3.cost(&report, &instanced), None);
    let counted = FrameReport { vertices: 8, fragments: 120, ..report };
    assert_eq!(Budget::QUEST_3.cost(&counted, &instanced), Some(12.0));
}

/// A device that draws what is predicted, and saves by foveation what the predictions know nothing of.
struct Foveated {
    /// Layers as asked for.
    layers: f64,
    /// What each level of foveation leaves.
    leaves: [f64; 4],
    timers: bool,
    /// The governor's answers of the frames under way.
    under_way: VecDeque<(RenderConfig, Foveation)>,
}

impl Foveated {
    fn new(layers: f64, leaves: [f64; 4]) -> Self {
        Self { layers, leaves, timers: true, under_way: VecDeque::new() }
    }

    fn frame(&mut self, governor: &mut Governor) -> Option<Change> {
        let asked = RenderConfig::default();
        self.under_way.push_back((governor.apply(&asked), governor.foveation()));
        if self.under_way.len() < 3 {
            return None;
        }
        let (config, foveation) = self.under_way.pop_front().unwrap();
        // Neither stop nor contribution nor radius saves anything here: only what is left to the headset, and pixels.
        let layers = self.layers * f64::from(config.resolution_scale).powi(2);
        let report = FrameReport {
            shown_pixels: 1000,
            predicted_unhidden: (1000.0 * layers) as f32,
            draw_ns: if self.timers { 7.0 * 1000.0 * layers * self.leaves[foveation as usize] } else { 0.0 },
            ..FrameReport::default()
        };
        governor.observe(&report, &asked)
    }

    fn frames(&mut self, governor: &mut Governor, count: usize) -> Vec<Change> {
        (0..count).filter_map(|_| self.frame(governor)).collect()
    }
}

#[test]
fn foveation_is_taken_before_the_resolution_and_given_back() {
    let mut device = Foveated::new(22.0, [1.0, 0.9, 0.75, 0.6]);
    let mut governor = governor();
    governor.offer_foveation(true);
    device.frames(&mut governor, 2000);
    // 22 layers: low leaves 19.8, medium 16.5 of the budget's 18.
    assert_eq!(governor.foveation(), Foveation::Medium);
    assert!((governor.cost() - 16.5).abs() < 0.1 && governor.is_at_rest(), "{}", governor.cost());
    assert_eq!(governor.apply(&RenderConfig::default()).resolution_scale, 1.0);
    assert_eq!(governor.in_words(), "foveation medium");
    assert_eq!(device.frames(&mut governor, 1000), [], "it swings");
    // Less to draw: the rims become as fine as the middle again.
    device.layers = 5.0;
    device.frames(&mut governor, 2000);
    assert_eq!((governor.foveation(), governor.level()), (Foveation::None, 0));
}

#[test]
fn foveation_that_saves_nothing_or_is_not_offered_leaves_it_to_the_resolution() {
    for (offered, timers, leaves) in
        [(false, true, [1.0, 0.9, 0.75, 0.6]), (true, false, [1.0, 0.9, 0.75, 0.6]), (true, true, [1.0; 4])]
    {
        let mut device = Foveated { timers, ..Foveated::new(22.0, leaves) };
        let mut governor = governor();
        governor.offer_foveation(offered);
        let changes = device.frames(&mut governor, 2000);
        let drawn = governor.apply(&RenderConfig::default());
        assert!(drawn.resolution_scale < 1.0 && governor.is_at_rest(), "{drawn:?}");
        let foveated = offered && timers;
        assert_eq!(governor.in_words().ends_with(" %, foveation high"), foveated, "{}", governor.in_words());
        assert_eq!(governor.foveation() == Foveation::High, foveated);
        let tried = changes.iter().any(|c| matches!(LADDER[c.to.max(1) - 1], Step::Foveation(_)));
        assert_eq!(tried, foveated, "{changes:?}");
    }
}
