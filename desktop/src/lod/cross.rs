//! Tests of what the curves promise (`000`, §5.5): for a target SSIM and a view that was not fitted to, each class takes the
//! coarsest level that is predicted to reach the target at its distance; the combined scene is drawn and measured.

use motes_app::lod::Model;
use motes_renderer::reference::ReferenceOptions;
use motes_scenes::levels::LevelFile;

use super::observe::{Target, combined, ssim};
use crate::error::CommandError;
use crate::measure::Matching;

/// One class in one view.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Promise {
    /// The class.
    pub class: u16,
    /// Its distance, scene units.
    pub distance: f64,
    /// The level that was chosen.
    pub level: usize,
    /// SSIM that was predicted.
    pub predicted: f64,
    /// SSIM that was measured.
    pub measured: f64,
    /// Pixels of its mask.
    pub pixels: usize,
}

/// One view at one target.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Trial {
    /// The view's name.
    pub view: String,
    /// The SSIM that was asked for.
    pub target: f64,
    /// Splats of the combined scene, as a share of the finest level's.
    pub splats: f64,
    /// SSIM over the whole picture.
    pub whole: f64,
    /// The classes.
    pub classes: Vec<Promise>,
}

/// Sums of trials at one target.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Summary {
    /// The SSIM that was asked for.
    pub target: f64,
    /// Mean share of the finest level's splats.
    pub splats: f64,
    /// Mean SSIM over whole pictures.
    pub whole: f64,
    /// Mean absolute difference of predicted and measured SSIM, over classes and views.
    pub absolute: f64,
    /// Mean of predicted less measured.
    pub bias: f64,
    /// The same difference of the means over views, averaged over classes.
    pub of_means: f64,
    /// Mean absolute difference for whole views: over their classes' pixels together.
    pub of_views: f64,
    /// Share of the classes and views that reached the target within 0.02, or were drawn at the finest level.
    pub kept: f64,
}

/// Level per group of a file for a target, from the distances of classes. Classes without a model are drawn at level 0.
pub fn choose(file: &LevelFile, model: &Model, distances: &[f64], target: f64) -> Vec<usize> {
    let steps: Vec<f64> = file.levels().iter().map(|l| l.step).collect();
    let level = |class: u16| {
        let distance = distances.get(usize::from(class)).copied().unwrap_or(f64::INFINITY);
        let quality = model.of_class(class)?;
        // Out of view: the coarsest.
        if distance.is_finite() {
            quality.choose(&steps, target, distance)
        } else {
            steps.len().checked_sub(1)
        }
    };
    file.groups().iter().map(|g| level(g.class).unwrap_or(0)).collect()
}

/// Tries a target in one view.
///
/// # Errors
/// A range is damaged, or the reference's.
pub fn trial(
    file: &LevelFile,
    model: &Model,
    target: &Target,
    wanted: f64,
    matching: Option<Matching>,
    options: &ReferenceOptions,
) -> Result<Trial, CommandError> {
    let levels = choose(file, model, &target.distances, wanted);
    let splats = combined(file, |group| Some(levels[group]))?;
    let (of_class, whole) = ssim(&splats, target, matching, options)?;
    let mut classes = Vec::new();
    for (class, found) in of_class.into_iter().enumerate() {
        let class = class as u16;
        let distance = target.distances.get(usize::from(class)).copied().unwrap_or(f64::INFINITY);
        let level = file.groups().iter().position(|g| g.class == class).map(|g| levels[g]);
        if let (Some((measured, pixels)), Some(quality), Some(level), true) =
            (found, model.of_class(class), level, distance.is_finite())
        {
            let predicted = quality.ssim(file.levels()[level].step, distance);
            classes.push(Promise { class, distance, level, predicted, measured, pixels });
        }
    }
    let finest = file.levels()[0].splats.max(1) as f64;
    let share = splats.len() as f64 / finest;
    Ok(Trial { view: target.name.clone(), target: wanted, splats: share, whole, classes })
}

/// Sums up the trials of one target.
pub fn summary(trials: &[Trial]) -> Summary {
    let n = trials.len().max(1) as f64;
    let all: Vec<&Promise> = trials.iter().flat_map(|t| &t.classes).collect();
    let m = all.len().max(1) as f64;
    let mut ids: Vec<u16> = all.iter().map(|p| p.class).collect();
    ids.sort_unstable();
    ids.dedup();
    let of_means = ids.iter().map(|id| {
        let mine = all.iter().filter(|p| p.class == *id);
        let count = mine.clone().count() as f64;
        (mine.map(|p| p.predicted - p.measured).sum::<f64>() / count).abs()
    });
    let of_views = trials.iter().map(|t| {
        let pixels = t.classes.iter().map(|p| p.pixels as f64).sum::<f64>().max(1.0);
        let off = |p: &Promise| (p.predicted - p.measured) * p.pixels as f64;
        (t.classes.iter().map(off).sum::<f64>() / pixels).abs()
    });
    let target = trials.first().map_or(0.0, |t| t.target);
    let kept = all.iter().filter(|p| p.measured >= target - 0.02 || p.level == 0).count();
    Summary {
        target,
        splats: trials.iter().map(|t| t.splats).sum::<f64>() / n,
        whole: trials.iter().map(|t| t.whole).sum::<f64>() / n,
        absolute: all.iter().map(|p| (p.predicted - p.measured).abs()).sum::<f64>() / m,
        bias: all.iter().map(|p| p.predicted - p.measured).sum::<f64>() / m,
        of_means: of_means.sum::<f64>() / ids.len().max(1) as f64,
        of_views: of_views.sum::<f64>() / n,
        kept: kept as f64 / m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summaries_are_means_over_classes_and_views() {
        let promise = |class, predicted, measured, level| Promise {
            class,
            distance: 1.0,
            level,
            predicted,
            measured,
            pixels: 10 * usize::from(class),
        };
        let trial = |classes| Trial { view: "v".into(), target: 0.8, splats: 0.5, whole: 0.9, classes };
        let s = summary(&[
            trial(vec![promise(1, 0.8, 0.9, 1), promise(2, 0.8, 0.7, 1)]),
            trial(vec![promise(1, 0.8, 0.7, 1), promise(2, 0.8, 0.7, 0)]),
        ]);
        assert!((s.absolute - 0.1).abs() < 1e-12 && (s.bias - 0.05).abs() < 1e-12);
        assert!((s.of_means - 0.05).abs() < 1e-12 && s.kept == 0.5 && s.splats == 0.5);
        // Of the first view (−0.1 · 10 + 0.1 · 20) / 30, of the second 0.1.
        assert!((s.of_views - (0.1 / 3.0 + 0.1) / 2.0).abs() < 1e-12, "{}", s.of_views);
    }
}
