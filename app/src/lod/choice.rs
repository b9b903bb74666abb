//! Which level each region is drawn at, from frame to frame.
//!
//! A region takes the coarsest level whose predicted SSIM is at least the target's share of what the finest level is
//! predicted to have at that distance (thesis `000`, §6.3: the curve of its class, at the distance of its nearest box). It
//! becomes finer as soon as it must, and coarser only where the coarser level exceeds the target by a margin, so that it
//! does not swing. Levels change by a cross-fade over some frames. What no view can see is not drawn at all. Where not all
//! levels are in memory, those that are wanted are wished for, and what is there is drawn until they are.

use glam::DVec3;
use motes_renderer::View;

use super::{Bounds, Quality};

/// How levels are chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning {
    /// SSIM to keep, as a share of the finest level's.
    pub target: f64,
    /// A coarser level must exceed the target by this much.
    pub margin: f64,
    /// Length of a cross-fade, seconds; 0: levels change at once.
    pub fade: f64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self { target: 0.97, margin: 0.004, fade: 1.0 }
    }
}

/// How far beyond a view's sides regions are drawn, radians: an order that is made for one frame serves the next two, in
/// which a head turns by less.
const MARGIN: f64 = 0.25;
/// Under load the target falls at once; without, it rises again by so much in a second.
const RECOVERY: f64 = 0.01;

/// Splats that change their level together.
#[derive(Clone, Debug)]
pub struct Region {
    /// SSIM of its class; none where it is not known: the finest level then.
    pub quality: Option<Quality>,
    /// Boxes around the means of its opaque splats.
    pub near: Vec<Bounds>,
    /// Box around all that its splats may cover.
    pub reach: Bounds,
    /// Splats at each level, the finest first.
    pub splats: Vec<u32>,
}

/// What can be drawn, where not everything is in memory.
pub struct Store<'a> {
    /// Pages that there is room for.
    pub room: u64,
    /// Pages that so many splats take.
    pub takes: &'a dyn Fn(u32) -> u64,
    /// Whether a region is there at a level.
    pub holds: &'a dyn Fn(usize, usize) -> bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Shown {
    /// The level that the curve calls for.
    wanted: usize,
    /// The level that there is room for: `wanted`, or a coarser one.
    goal: usize,
    /// The level that is drawn; none before the first is there.
    level: Option<usize>,
    /// The level before, and how far its cross-fade is, `0 .. 1`.
    fading: Option<(usize, f64)>,
    seen: bool,
    distance: f64,
}

/// The levels of all regions.
#[derive(Clone, Debug)]
pub struct LevelChoice {
    /// May be changed at any time.
    pub tuning: Tuning,
    steps: Vec<f64>,
    regions: Vec<Region>,
    shown: Vec<Shown>,
    /// Regions in view, the nearest first.
    near: Vec<usize>,
    /// A region came into view or left it.
    near_changed: bool,
    ease: f64,
    /// Something was chosen once.
    begun: bool,
}

impl LevelChoice {
    /// Of regions with levels of these steps ([`motes_scenes::levels::Level::step`]), the finest first.
    pub fn new(steps: Vec<f64>, regions: Vec<Region>, tuning: Tuning) -> Self {
        let shown = Shown { wanted: 0, goal: 0, level: None, fading: None, seen: false, distance: 0.0 };
        let shown = vec![shown; regions.len()];
        Self { tuning, steps, regions, shown, near: Vec::new(), near_changed: false, ease: 0.0, begun: false }
    }

    /// Chooses for views at once, without regard for what was shown before: for single pictures.
    pub fn settle(&mut self, views: &[View]) {
        self.begun = true;
        let eye = motes_renderer::midpoint(views);
        for (region, shown) in self.regions.iter().zip(&mut self.shown) {
            let (seen, distance) = (region.may_be_seen(views), region.distance(eye));
            let level = wanted(region, &self.steps, self.tuning.target - self.ease, distance);
            *shown = Shown { wanted: level, goal: level, level: Some(level), fading: None, seen, distance };
        }
    }

    /// Goes on by `seconds`, for the views of the next frame. `ease` is by how much the target is lowered under load.
    /// Whether anything that is drawn has changed. The first time, nothing fades.
    pub fn advance(&mut self, views: &[View], seconds: f64, ease: f64) -> bool {
        if !self.begun {
            self.settle(views);
            return true;
        }
        self.advance_within(
            views,
            seconds,
            ease,
            &Store { room: u64::MAX, takes: &|_| 0, holds: &|_, _| true },
        )
    }

    /// As [`LevelChoice::advance`], of what is in memory. Where there is no room for all that is wanted, far regions become
    /// coarser first. What [`LevelChoice::wishes`] lists is to be brought.
    pub fn advance_within(&mut self, views: &[View], seconds: f64, ease: f64, store: &Store<'_>) -> bool {
        self.begun = true;
        self.ease = ease.max(self.ease - RECOVERY * seconds);
        self.want(views);
        self.make_room(store);
        let fade = self.tuning.fade;
        let mut changed = false;
        for (i, shown) in self.shown.iter_mut().enumerate() {
            let before = (shown.level, shown.fading);
            if let Some((_, done)) = &mut shown.fading {
                *done += seconds / fade;
                // Written so that no NaN of a fade without length goes on for ever.
                if !(*done < 1.0) || !shown.seen {
                    shown.fading = None;
                }
            }
            // What is drawn has to be there; unseen, it may have gone.
            shown.level = shown.level.filter(|&level| (store.holds)(i, level));
            if shown.fading.is_none() && shown.level != Some(shown.goal) {
                let coarsest = self.steps.len().saturating_sub(1);
                // Before the goal is there, whatever is: the next coarser, else the next finer.
                let there = |level: &usize| (store.holds)(i, *level);
                let best = match shown.level {
                    _ if there(&shown.goal) => Some(shown.goal),
                    Some(level) => Some(level),
                    None => (shown.goal..=coarsest).find(there).or_else(|| (0..shown.goal).rev().find(there)),
                };
                if let (Some(old), Some(new)) = (shown.level, best)
                    && old != new
                    && shown.seen
                    && fade > 0.0
                {
                    shown.fading = Some((old, 0.0));
                }
                shown.level = best;
            }
            changed |= before != (shown.level, shown.fading);
        }
        changed || self.near_changed
    }

    /// What every region would be drawn at, and which are in view.
    fn want(&mut self, views: &[View]) {
        let eye = motes_renderer::midpoint(views);
        let Tuning { target, margin, .. } = self.tuning;
        let target = target - self.ease;
        self.near_changed = false;
        for (region, shown) in self.regions.iter().zip(&mut self.shown) {
            let seen = region.may_be_seen(views);
            self.near_changed |= seen != shown.seen;
            shown.seen = seen;
            shown.distance = region.distance(eye);
            let finer = wanted(region, &self.steps, target, shown.distance);
            let coarser = wanted(region, &self.steps, target + margin, shown.distance);
            shown.wanted = if finer < shown.wanted { finer } else { coarser.max(shown.wanted) };
            shown.goal = shown.wanted;
        }
    }

    /// Lets regions in view have what they want as long as there is room, the nearest first, and the coarsest level after
    /// that.
    fn make_room(&mut self, store: &Store<'_>) {
        self.near.clear();
        if store.room == u64::MAX {
            return;
        }
        self.near.extend((0..self.shown.len()).filter(|&i| self.shown[i].seen));
        let shown = &mut self.shown;
        self.near.sort_unstable_by(|&a, &b| shown[a].distance.total_cmp(&shown[b].distance).then(a.cmp(&b)));
        let coarsest = self.steps.len().saturating_sub(1);
        let takes =
            |i: usize, level: usize| (store.takes)(self.regions[i].splats.get(level).copied().unwrap_or(0));
        let mut taken: u64 = self.near.iter().map(|&i| takes(i, coarsest)).sum();
        for &i in &self.near {
            let free = store.room.saturating_sub(taken);
            let least = takes(i, coarsest);
            let fits = |level: &usize| takes(i, *level).saturating_sub(least) <= free;
            let goal = (shown[i].wanted..=coarsest).find(fits).unwrap_or(coarsest);
            taken += takes(i, goal).saturating_sub(least);
            shown[i].goal = goal;
        }
    }

    /// What is to be brought into memory, the most urgent first: something of every region in view, then the levels that
    /// there is room for.
    pub fn wishes(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let coarsest = self.steps.len().saturating_sub(1);
        let nothing_yet = self.near.iter().filter(|&&i| self.shown[i].level.is_none());
        let something = nothing_yet.map(move |&i| (i, coarsest));
        something.chain(self.near.iter().map(|&i| (i, self.shown[i].goal)))
    }

    /// Number of levels.
    pub fn count(&self) -> usize {
        self.steps.len()
    }

    /// Regions in view of which nothing is there, and those that are not at the level that they should have.
    pub fn missing(&self) -> (usize, usize) {
        let seen = self.shown.iter().filter(|s| s.seen);
        let nothing = seen.clone().filter(|s| s.level.is_none()).count();
        (nothing, seen.filter(|s| s.level != Some(s.goal)).count())
    }

    /// Whether no cross-fade is under way.
    pub fn at_rest(&self) -> bool {
        self.ease == 0.0 && self.shown.iter().all(|s| s.fading.is_none())
    }

    /// What is drawn: region, level and share. The shares of a region that is seen add up to 1.
    pub fn shares(&self) -> impl Iterator<Item = (usize, usize, f32)> + '_ {
        self.shown.iter().enumerate().filter(|(_, s)| s.seen).flat_map(|(region, s)| {
            let (before, share) = match s.fading {
                None => (None, 1.0),
                // Smooth at both ends: opaque splats show most of themselves with little of their share.
                Some((before, t)) => (Some(before), t * t * (3.0 - 2.0 * t)),
            };
            let coming = s.level.map(|level| (region, level, share as f32));
            coming.into_iter().chain(before.map(|level| (region, level, (1.0 - share) as f32)))
        })
    }

    /// The level that each region is drawn at; none of what is not seen, or not there.
    pub fn levels(&self) -> impl Iterator<Item = Option<usize>> + '_ {
        self.shown.iter().map(|s| s.level.filter(|_| s.seen))
    }
}

impl Region {
    fn distance(&self, eye: DVec3) -> f64 {
        self.near.iter().map(|b| b.distance(eye)).fold(f64::INFINITY, f64::min)
    }

    fn may_be_seen(&self, views: &[View]) -> bool {
        views.iter().any(|view| self.reach.may_be_seen(view, MARGIN))
    }
}

/// The coarsest level that keeps a share of the finest one's predicted SSIM, and is not empty where that has splats.
fn wanted(region: &Region, steps: &[f64], share: f64, distance: f64) -> usize {
    let Some(quality) = &region.quality else { return 0 };
    // A region without opaque splats has no distance; from far away is as good as any.
    let distance = if distance.is_finite() { distance } else { f64::MAX.sqrt() };
    let finest = steps.first().map_or(1.0, |&s| quality.ssim(s, distance));
    let mut level = quality.choose(steps, share * finest, distance).unwrap_or(0);
    let splats = |level: usize| region.splats.get(level).copied().unwrap_or(0);
    while level > 0 && splats(level) == 0 && splats(0) > 0 {
        level -= 1;
    }
    level
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use crate::lod::Branch;
    use motes_renderer::Fov;

    /// Of a class that looks the better at each level the farther it is.
    fn region(at: DVec3, splats: [u32; 3]) -> Region {
        let branch = Branch { k: 0.1, gamma: 0.05, mu: 20.0, alpha: 1.0 };
        let quality = Quality::Curve { near: branch, far: branch, beta: 1e9, b: 0.3 };
        let mut bounds = Bounds::EMPTY;
        bounds.include(at, 0.5);
        Region { quality: Some(quality), near: vec![bounds], reach: bounds, splats: splats.into() }
    }

    fn from(z: f64) -> Vec<View> {
        let fov = Fov::vertical(1.0, [64, 48]);
        vec![View::look_at(DVec3::Z * z, DVec3::ZERO, DVec3::NEG_Y, fov, [64, 48])]
    }

    fn choice(tuning: Tuning) -> LevelChoice {
        // The finest level's slope is steepest where d = μ; there the coarse ones lose most.
        LevelChoice::new(vec![1000.0, 500.0, 250.0], vec![region(DVec3::ZERO, [100, 50, 25])], tuning)
    }

    fn level(choice: &LevelChoice) -> usize {
        choice.levels().next().unwrap().unwrap()
    }

    #[test]
    fn coarser_where_the_curve_allows_and_never_below_the_target() {
        let mut choice = choice(Tuning { target: 0.9, ..Default::default() });
        let mut seen = std::collections::BTreeSet::new();
        for z in (1..40).map(|i| f64::from(i) * 0.5) {
            choice.settle(&from(-z));
            let quality = choice.regions[0].quality.as_ref().unwrap();
            let distance = choice.regions[0].distance(DVec3::Z * -z);
            let share = |l: usize| quality.ssim(choice.steps[l], distance) / quality.ssim(1000.0, distance);
            assert!(share(level(&choice)) >= 0.9, "{z}");
            assert!(level(&choice) == 2 || share(level(&choice) + 1) < 0.9, "{z}: not the coarsest");
            seen.insert(level(&choice));
        }
        assert!(seen.len() > 1, "{seen:?}");
    }

    /// A viewer who sways across a border of levels: with a margin one change, without it one each time.
    #[test]
    fn levels_do_not_swing() {
        let changes = |margin: f64| {
            let mut choice = choice(Tuning { target: 0.9, margin, fade: 0.0 });
            choice.settle(&from(-2.0));
            let mut count = 0;
            // Where the level changes, found by walking.
            let border = (200..2000).map(|i| f64::from(i) * 0.01).find(|&z| {
                let before = level(&choice);
                choice.settle(&from(-z));
                before != level(&choice)
            });
            let border = border.unwrap();
            for i in 0..50 {
                let before = level(&choice);
                choice.advance(&from(-border + if i % 2 == 0 { 0.02 } else { -0.02 }), 0.014, 0.0);
                count += usize::from(level(&choice) != before);
            }
            count
        };
        assert!(changes(0.004) <= 1, "{}", changes(0.004));
        assert!(changes(0.0) > 40, "{}", changes(0.0));
    }

    #[test]
    fn levels_fade_into_each_other() {
        let mut choice = choice(Tuning { target: 0.9999, fade: 0.5, ..Default::default() });
        choice.settle(&from(-6.0));
        assert!(level(&choice) == 0 && choice.at_rest());
        choice.tuning.target = 0.5;
        let (mut frames, mut last) = (0, 0.0);
        assert!(choice.advance(&from(-6.0), 1.0 / 72.0, 0.0));
        while !choice.at_rest() {
            let shares: Vec<_> = choice.shares().collect();
            assert_eq!((shares.len(), shares[0].1, shares[1].1), (2, 2, 0));
            assert!((shares[0].2 + shares[1].2 - 1.0).abs() < 1e-6);
            // A step is at most 1.5 times the mean step.
            assert!(shares[0].2 >= last && shares[0].2 - last <= 1.5 / 36.0 + 1e-6);
            last = shares[0].2;
            choice.advance(&from(-6.0), 1.0 / 72.0, 0.0);
            frames += 1;
        }
        assert!((35..=37).contains(&frames), "{frames}");
        assert_eq!(choice.shares().collect::<Vec<_>>(), [(0, 2, 1.0)]);
        assert!(!choice.advance(&from(-6.0), 1.0 / 72.0, 0.0), "then nothing changes any more");
        // A fade without length is none.
        choice.tuning = Tuning { target: 0.9999, fade: 0.0, ..Default::default() };
        choice.advance(&from(-6.0), 1.0 / 72.0, 0.0);
        assert_eq!(choice.shares().collect::<Vec<_>>(), [(0, 0, 1.0)]);
    }

    #[test]
    fn what_is_not_seen_is_not_drawn_and_comes_back_at_its_level() {
        let mut choice = choice(Tuning::default());
        let away = View::look_at(DVec3::Z * -6.0, DVec3::Z * -9.0, DVec3::NEG_Y, from(-6.0)[0].fov, [64, 48]);
        choice.settle(&[away]);
        assert_eq!((choice.shares().count(), choice.levels().next().unwrap()), (0, None));
        choice.tuning.target = 0.5;
        choice.advance(&[away], 0.01, 0.0);
        choice.advance(&from(-6.0), 0.01, 0.0);
        assert_eq!(choice.shares().collect::<Vec<_>>(), [(0, 2, 1.0)], "unseen, it changed without a fade");
    }

    #[test]
    fn load_lowers_the_target_at_once_and_rest_raises_it_slowly() {
        let mut choice = choice(Tuning { target: 0.9999, margin: 0.0, fade: 0.0 });
        choice.settle(&from(-6.0));
        choice.advance(&from(-6.0), 0.01, 0.4);
        assert_eq!(level(&choice), 2);
        choice.advance(&from(-6.0), 0.01, 0.0);
        assert!(level(&choice) == 2 && !choice.at_rest(), "it does not swing back");
        let mut seconds = 0.0;
        while level(&choice) > 0 {
            choice.advance(&from(-6.0), 0.1, 0.0);
            seconds += 0.1;
        }
        assert!(seconds > 5.0, "{seconds}");
    }

    /// Three regions in a row before the viewer; memory for some of it.
    #[test]
    fn memory_goes_to_the_nearest_and_nothing_is_missing_once_it_is_there() {
        let regions = [0.0, 8.0, 16.0].map(|z| region(DVec3::Z * z, [100, 50, 25]));
        let steps = vec![1000.0, 500.0, 250.0];
        let tuning = Tuning { target: 0.9999, ..Default::default() };
        let mut choice = LevelChoice::new(steps, regions.to_vec(), tuning);
        let held = std::cell::RefCell::new(std::collections::BTreeSet::new());
        let holds = |region: usize, level: usize| held.borrow().contains(&(region, level));
        let store = Store { room: 180, takes: &|splats| splats.into(), holds: &holds };
        choice.advance_within(&from(-6.0), 0.01, 0.0, &store);
        assert!(choice.shares().count() == 0 && choice.missing() == (3, 3));
        // Something of each, then 100 + 50 + 25 of the 180 splats.
        let wishes: Vec<_> = choice.wishes().collect();
        assert_eq!(wishes, [(0, 2), (1, 2), (2, 2), (0, 0), (1, 1), (2, 2)]);
        for wish in wishes {
            held.borrow_mut().insert(wish);
            for _ in 0..60 {
                choice.advance_within(&from(-6.0), 0.01, 0.0, &store);
            }
            // What came once stays until something better is there.
            let drawn = choice.levels().flatten().count();
            assert!(drawn >= held.borrow().iter().filter(|(_, level)| *level == 2).count());
        }
        assert!(choice.missing() == (0, 0) && choice.at_rest());
        assert_eq!(choice.levels().collect::<Vec<_>>(), [Some(0), Some(1), Some(2)]);
        // Behind the viewer now, the three are wished for no more.
        let away = View::look_at(DVec3::Z * -6.0, DVec3::Z * -9.0, DVec3::NEG_Y, from(-6.0)[0].fov, [64, 48]);
        choice.advance_within(&[away], 0.01, 0.0, &store);
        assert!(choice.wishes().count() == 0 && choice.missing() == (0, 0));
    }

    #[test]
    fn a_level_without_splats_does_not_tear_a_hole() {
        let mut choice = choice(Tuning { target: 0.1, ..Default::default() });
        choice.regions[0].splats = vec![100, 50, 0];
        choice.settle(&from(-6.0));
        assert_eq!(level(&choice), 1);
        choice.regions[0].quality = None;
        choice.settle(&from(-6.0));
        assert_eq!(level(&choice), 0, "what nothing is known of is drawn at its finest");
    }
}
