//! Scenes with fewer splats.

use motes_scenes::Splats;

use super::Importance;
use super::merge::{self, Alike};
use super::recording::Recording;
use super::refit::{Effort, Goal, refit};
use crate::reference::{ReferenceError, ReferenceOptions};

/// By what splats are ranked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rank {
    /// How much the pictures would change without it ([`Importance::change`]).
    #[default]
    Change,
    /// The same for each layer that it is: what costs most for what it gives goes first, so that layers become few.
    ChangePerLayer,
    /// Visible blending weight, summed over all pixels ([`Importance::weight`]).
    Weight,
    /// Largest visible blending weight at a pixel ([`Importance::peak`]).
    Peak,
}

impl Rank {
    /// A value per splat; the lower, the less it is missed.
    pub fn values(self, importance: &Importance) -> Vec<f64> {
        match self {
            Self::Change => importance.change.clone(),
            Self::ChangePerLayer => {
                importance.change.iter().zip(&importance.covered).map(|(c, n)| c / n.max(1.0)).collect()
            }
            Self::Weight => importance.weight.clone(),
            Self::Peak => importance.peak.clone(),
        }
    }
}

/// Splats with the lowest value first; equal values in the scene's order.
pub fn lowest_first(values: &[f64]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..values.len() as u32).collect();
    order.sort_by(|&a, &b| values[a as usize].total_cmp(&values[b as usize]));
    order
}

/// How a scene is simplified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Simplify {
    /// Splats to keep.
    pub keep: usize,
    /// What goes first.
    pub rank: Rank,
    /// Which neighbours are merged first, for at most half of what has to go; none: no merging.
    pub merge: Option<Alike>,
    /// Rounds of ranking: splats that hide each other's absence must not all go at once, and what is fitted between the rounds
    /// takes over from what went.
    pub rounds: usize,
    /// How colours and opacities are fitted after the last round; one step of it after each of the others. No steps: they stay.
    pub effort: Effort,
}

impl Default for Simplify {
    fn default() -> Self {
        let effort = Effort { steps: 3, passes: 6 };
        Self { keep: 0, rank: Rank::Change, merge: Some(Alike::default()), rounds: 5, effort }
    }
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Done {
    /// Pairs that became one.
    pub merged: usize,
    /// Splats that were removed.
    pub pruned: usize,
}

/// Simplifies a scene so that it still looks like the goals, whose pictures are the whole scene's. The recording is of the
/// scene from the goals' views. A scene that has no more splats than are to be kept stays as it is.
///
/// # Errors
/// The reference's.
pub fn simplify(
    splats: &mut Splats,
    mut recording: Recording,
    goals: &[Goal],
    options: &ReferenceOptions,
    how: &Simplify,
    mut told: impl FnMut(&str),
) -> Result<Done, ReferenceError> {
    let mut done = Done::default();
    if splats.len() <= how.keep {
        return Ok(done);
    }
    if let Some(alike) = how.merge {
        told("merging neighbours");
        let pairs = merge::pairs(splats, alike, (splats.len() - how.keep) / 2);
        done.merged = pairs.len();
        merge::merge(splats, &pairs);
    }
    let views = || goals.iter().map(|g| &g.view);
    let fits = how.effort.steps > 0;
    let between = Effort { steps: 1, ..how.effort };
    if done.merged > 0 {
        told("looking");
        recording = Recording::of(splats, views(), options)?;
        if fits {
            told("fitting colours and opacities");
            refit(splats, &recording, goals, between)?;
        }
    }
    let rounds = how.rounds.max(1);
    let excess = splats.len().saturating_sub(how.keep);
    for round in 1..=rounds {
        // The same share of the way in each round.
        told("ranking splats");
        let values = how.rank.values(&recording.importance(splats));
        let before = splats.len();
        let (gone, pruned) = prune(splats, &values, how.keep + excess * (rounds - round) / rounds);
        done.pruned += pruned;
        if round < rounds {
            recording.retain(before, |i| !gone[i]);
        }
        if fits && round < rounds {
            told("fitting colours and opacities");
            refit(splats, &recording, goals, between)?;
        }
    }
    // What has grown reaches further, and what was hidden shows: looked at again.
    if fits {
        told("fitting colours and opacities");
        drop(recording);
        let recording = Recording::of(splats, views(), options)?;
        refit(splats, &recording, goals, how.effort)?;
    }
    Ok(done)
}

/// The splats with the highest opacities: the cut of the report's figure 17 (`002`), the naive baseline.
pub fn opacity_cut(splats: &Splats, keep: usize) -> Splats {
    let mut cut = splats.clone();
    let opacities: Vec<f64> = splats.opacities.iter().map(|&o| f64::from(o)).collect();
    prune(&mut cut, &opacities, keep);
    cut
}

/// Removes what has the lowest values; returns what is gone of the scene before, and how much that is.
fn prune(splats: &mut Splats, values: &[f64], target: usize) -> (Vec<bool>, usize) {
    let order = lowest_first(values);
    let excess = splats.len().saturating_sub(target);
    let mut gone = vec![false; splats.len()];
    for &i in &order[..excess] {
        gone[i as usize] = true;
    }
    splats.retain(|i| !gone[i]);
    (gone, excess)
}

#[cfg(test)]
mod tests {
    use super::super::refit::residual;
    use super::super::tests::ahead;
    use super::*;
    use crate::View;
    use glam::DVec3;
    use motes_scenes::synthetic::Recipe;

    /// Half of a scene's splats look more like the whole when they were chosen and fitted than when they were cut by opacity.
    #[test]
    fn simplified_scenes_look_like_the_whole_one() {
        let whole = Recipe { count: 600, seed: 3, ..Default::default() }.still();
        let options = ReferenceOptions { stop_below: 1e-4, ..Default::default() };
        let middle = DVec3::from_array(whole.origin);
        let views: Vec<View> = (0..4)
            .map(|k| {
                let turn = f64::from(k) * 1.57;
                let eye = middle + DVec3::new(turn.sin(), -0.3, turn.cos()) * 12.0;
                View::look_at(eye, middle, DVec3::NEG_Y, ahead().fov, [48, 48])
            })
            .collect();
        let goals: Vec<Goal> = views.iter().map(|v| Goal::of(&whole, v, &options).unwrap()).collect();
        let run = |how: Simplify| {
            let mut splats = whole.clone();
            let recording = Recording::of(&splats, &views, &options).unwrap();
            let done = simplify(&mut splats, recording, &goals, &options, &how, |_| ()).unwrap();
            assert_eq!(splats.len(), how.keep.min(600));
            assert_eq!(done.merged + done.pruned, 600 - splats.len());
            residual(&splats, &goals, &options).unwrap()
        };
        let plain = Simplify { keep: 300, merge: None, rounds: 1, effort: NO_FIT, ..Default::default() };
        let ours = run(Simplify { keep: 300, ..Default::default() });
        let chosen = run(plain);
        let cut = opacity_cut(&whole, 300);
        assert_eq!(cut.len(), 300);
        let cut = residual(&cut, &goals, &options).unwrap();
        assert!(ours < chosen && chosen < 0.7 * cut, "{ours} {chosen} {cut}");
        assert_eq!(
            run(Simplify { keep: 10_000, ..plain }),
            0.0_f64.max(run(Simplify { keep: 600, ..plain }))
        );
    }

    const NO_FIT: Effort = Effort { steps: 0, passes: 0 };

    #[test]
    fn ranks_are_stable() {
        assert_eq!(lowest_first(&[2.0, 1.0, 2.0, 0.0, 1.0]), [3, 1, 4, 0, 2]);
    }
}
