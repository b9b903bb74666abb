//! A scene at all its levels: the splats of all regions and levels in one list, and what is drawn of it.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use motes_renderer::parts::{Part, Parts, shared_opacity};
use motes_scenes::levels::{Group, LevelFile};
use motes_scenes::{CancelToken, Scene, SceneError, Splats};

use super::{Bounds, LevelChoice, Model, Region, Tuning};

/// Splats less opaque than this do not count for distances.
const OPAQUE: f32 = 0.1;
/// Splats in a box for distances: a class that reaches round the viewer is near where its splats are.
const IN_A_BOX: usize = 512;

/// A scene at all its levels, in memory.
#[derive(Clone, Debug)]
pub struct Levels {
    /// All splats, region by region, the finest level first.
    pub splats: Arc<Splats>,
    steps: Vec<f64>,
    regions: Vec<Region>,
    /// By region and level.
    ranges: Vec<Vec<Range<u32>>>,
    /// Why there is nothing to choose levels by, for people.
    pub unfitted: Option<String>,
}

impl Levels {
    /// Reads all of a file of levels (`.mlod`).
    ///
    /// # Errors
    /// [`SceneError`] where the file is none, or a part of it is damaged; also where it is cancelled.
    pub fn load(path: &Path, cancel: &CancelToken) -> Result<Self, SceneError> {
        let file = LevelFile::open(path)?;
        let (model, unfitted) = match Model::of_file(&file) {
            Ok(model) => (model, None),
            Err(why) => (Model::default(), Some(why)),
        };
        let (mut parts, mut ranges, mut regions) = (Vec::new(), Vec::new(), Vec::new());
        let mut end = 0u32;
        for (group, about) in file.groups().iter().enumerate() {
            let mut region = region_of(about, &model);
            let mut of_levels = Vec::new();
            for level in 0..file.levels().len() {
                if cancel.is_cancelled() {
                    return Err(SceneError::Cancelled { path: path.to_owned() });
                }
                let splats = file.read(group, level)?;
                if level == 0 && splats.opacities.iter().any(|&o| o >= OPAQUE) {
                    region.near = boxes(&splats);
                }
                let first = end;
                end = u32::try_from(splats.len()).ok().and_then(|n| end.checked_add(n)).ok_or_else(|| {
                    let (path, limit) = (path.to_owned(), format!("{} splats", u32::MAX));
                    SceneError::TooLarge { path, what: "all its levels together".into(), limit }
                })?;
                of_levels.push(first..end);
                parts.push(splats);
            }
            ranges.push(of_levels);
            regions.push(region);
        }
        let steps = file.levels().iter().map(|l| l.step).collect();
        Ok(Self { splats: Arc::new(Scene::joined(parts)), steps, regions, ranges, unfitted })
    }

    /// Begins to choose levels.
    pub fn choice(&self, tuning: Tuning) -> LevelChoice {
        LevelChoice::new(self.steps.clone(), self.regions.clone(), tuning)
    }

    /// Splats of the finest level.
    pub fn finest(&self) -> u64 {
        self.regions.iter().filter_map(|r| r.splats.first()).map(|&n| u64::from(n)).sum()
    }

    /// Regions at levels, each with a share, as [`LevelChoice::shares`] lists them.
    pub fn parts(&self, shares: impl Iterator<Item = (usize, usize, f32)>) -> Parts {
        let range = |region: usize, level: usize| self.ranges.get(region).and_then(|r| r.get(level));
        Parts::new(shares.filter_map(|(region, level, share)| Some(part(range(region, level)?, share))))
    }

    /// The splats of some parts as a scene of its own, opacities by their shares: what the device draws of them.
    pub fn drawn(&self, parts: &Parts) -> Splats {
        let indices: Vec<u32> = parts.indices().collect();
        let mut splats = self.splats.selected(&indices);
        let shares = parts.list().iter().flat_map(|p| std::iter::repeat_n(p.share, p.splats as usize));
        for (opacity, share) in splats.opacities.iter_mut().zip(shares) {
            *opacity = shared_opacity(*opacity, share);
        }
        splats
    }

    /// How fine each splat is that [`Levels::drawn`] gives of some parts: 1 at the finest level, 0 at the coarsest.
    pub fn fineness(&self, parts: &Parts) -> Vec<f64> {
        // Rising, as the splats lie.
        let of_levels = |r: &Vec<Range<u32>>| r.clone().into_iter().enumerate();
        let ranges = self.ranges.iter().flat_map(of_levels).filter(|(_, range)| !range.is_empty());
        let by_first: Vec<(u32, usize)> = ranges.map(|(level, range)| (range.start, level)).collect();
        let coarsest = self.steps.len().saturating_sub(1).max(1) as f64;
        let fineness = |i: u32| {
            let at = by_first.partition_point(|(first, _)| *first <= i);
            1.0 - at.checked_sub(1).map_or(0.0, |at| by_first[at].1 as f64) / coarsest
        };
        parts.indices().map(fineness).collect()
    }
}

/// What is known of a region before any of it is read: its class's curve, and the boxes around its splats. A file that does not
/// say how far they reach is drawn all around.
pub(super) fn region_of(group: &Group, model: &Model) -> Region {
    let everywhere = Bounds([DVec3::splat(-1e30), DVec3::splat(1e30)]);
    Region {
        quality: model.of_class(group.class).cloned(),
        near: vec![Bounds(group.bounds.map(DVec3::from))],
        reach: group.reach.map_or(everywhere, |corners| Bounds(corners.map(DVec3::from))),
        splats: group.ranges.iter().map(|r| u32::try_from(r.splats).unwrap_or(u32::MAX)).collect(),
    }
}

fn part(range: &Range<u32>, share: f32) -> Part {
    Part { first: range.start, splats: range.end - range.start, share }
}

/// Boxes around opaque splats, halved along their longest side until each holds few.
fn boxes(splats: &Splats) -> Vec<Bounds> {
    let opaque = (0..splats.len()).filter(|&i| splats.opacities[i] >= OPAQUE);
    let mut means: Vec<DVec3> = opaque.map(|i| splats.mean_of(i).into()).collect();
    let mut boxes = Vec::new();
    halve(&mut means, &mut boxes);
    boxes
}

fn halve(means: &mut [DVec3], boxes: &mut Vec<Bounds>) {
    if means.is_empty() {
        return;
    }
    let mut bounds = Bounds::EMPTY;
    means.iter().for_each(|m| bounds.include(*m, 0.0));
    if means.len() <= IN_A_BOX {
        boxes.push(bounds);
        return;
    }
    let side = bounds.0[1] - bounds.0[0];
    let axis = (0..3).fold(0, |longest, k| if side[k] > side[longest] { k } else { longest });
    let half = means.len() / 2;
    means.select_nth_unstable_by(half, |a, b| a[axis].total_cmp(&b[axis]));
    let (low, high) = means.split_at_mut(half);
    halve(low, boxes);
    halve(high, boxes);
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use motes_scenes::synthetic::Recipe;

    #[test]
    fn boxes_are_small_and_hold_every_opaque_splat() {
        let mut splats = Recipe { count: 3000, ..Default::default() }.still();
        for (i, opacity) in splats.opacities.iter_mut().enumerate() {
            *opacity = if i % 3 == 0 { 0.05 } else { 0.5 };
        }
        let boxes = boxes(&splats);
        assert_eq!(boxes.len(), 4);
        for i in (0..3000).filter(|i| i % 3 != 0) {
            let at = splats.mean_of(i).into();
            assert!(boxes.iter().any(|b| b.distance(at) == 0.0));
        }
    }
}
