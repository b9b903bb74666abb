//! Quality as a function of a level's step and of the distance: the thesis's equation 6.4 (`000`, §6.3).

use motes_scenes::levels::LevelFile;
use serde::{Deserialize, Serialize};

/// The two branches' part of the model: `K exp(−γ |d − μ|^α)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Branch {
    /// Scale, SSIM per unit of `ln i`.
    pub k: f64,
    /// How fast it falls (below 0: rises) with the distance.
    pub gamma: f64,
    /// Distance that it falls away from.
    pub mu: f64,
    /// Shape of the fall, above 0.
    pub alpha: f64,
}

impl Branch {
    /// SSIM per unit of `ln i` at a distance.
    pub fn slope(&self, distance: f64) -> f64 {
        self.k * (-self.gamma * (distance - self.mu).abs().powf(self.alpha)).exp()
    }
}

/// SSIM of a class, from the level's step and the class's minimum distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", tag = "form")]
pub enum Quality {
    /// Equation 6.4: `SSIM(i, d) = K_n exp(−γ_n |d − μ_n|^α_n) ln(i) + b`, `n = 1` for `d < β`, else 2.
    Curve {
        /// `n = 1`.
        near: Branch,
        /// `n = 2`.
        far: Branch,
        /// Where they meet.
        beta: f64,
        /// SSIM at `i = 1`.
        b: f64,
    },
    /// Equation 6.1, where distances say too little: `a ln(i) + b`.
    Logarithm {
        /// SSIM per unit of `ln i`.
        a: f64,
        /// SSIM at `i = 1`.
        b: f64,
    },
    /// Where no curve fits: mean SSIM at each step, made to rise; between steps, linear in `ln i`.
    Steps {
        /// Step and SSIM, both rising.
        points: Vec<[f64; 2]>,
    },
}

impl Quality {
    /// Predicted SSIM of a level at a distance (scene units), at most 1.
    pub fn ssim(&self, step: f64, distance: f64) -> f64 {
        let i = step.max(1.0).ln();
        let value = match self {
            Self::Curve { near, far, beta, b } => {
                let branch = if distance < *beta { near } else { far };
                branch.slope(distance) * i + b
            }
            Self::Logarithm { a, b } => a * i + b,
            Self::Steps { points } => between(points, i),
        };
        value.min(1.0)
    }

    /// The coarsest of the steps (of any order) that reaches a target at a distance, as an index; the best predicted where
    /// none does. `None` where there are no steps.
    pub fn choose(&self, steps: &[f64], target: f64, distance: f64) -> Option<usize> {
        let predicted = |i: usize| self.ssim(steps[i], distance);
        let reach = (0..steps.len()).filter(|&i| predicted(i) >= target);
        reach.min_by(|&a, &b| steps[a].total_cmp(&steps[b])).or_else(|| {
            (0..steps.len())
                .max_by(|&a, &b| predicted(a).total_cmp(&predicted(b)).then(steps[a].total_cmp(&steps[b])))
        })
    }
}

fn between(points: &[[f64; 2]], i: f64) -> f64 {
    let at = |k: usize| (points[k][0].max(1.0).ln(), points[k][1]);
    let Some(last) = points.len().checked_sub(1) else { return 1.0 };
    let next = points.iter().position(|p| p[0].max(1.0).ln() >= i);
    match next {
        None => at(last).1,
        Some(0) => at(0).1,
        Some(k) => {
            let ((x0, y0), (x1, y1)) = (at(k - 1), at(k));
            y0 + (y1 - y0) * (i - x0) / (x1 - x0)
        }
    }
}

/// What is known of a class's quality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassQuality {
    /// The class.
    pub class: u16,
    /// Its name, by which models are carried over to other scenes.
    pub name: String,
    /// The model.
    pub quality: Quality,
    /// Root mean square residual, SSIM.
    pub residual: f64,
    /// Coefficient of determination over all observations.
    pub r2: f64,
    /// Views that the class was seen in.
    pub views: usize,
}

/// The models of a scene, as a file of levels keeps them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// One a class; classes that were seen too rarely are left out.
    pub classes: Vec<ClassQuality>,
    /// What SSIM is against: `photographs`, or `finest` (level 0's pictures).
    pub against: String,
}

impl Model {
    /// What a file of levels keeps.
    ///
    /// # Errors
    /// It keeps none, or one of another version: a sentence for people.
    pub fn of_file(file: &LevelFile) -> Result<Self, String> {
        let what = |why: String| format!("{}: {why}; run motes lod fit", file.path().display());
        let value = file.extra().get("model").ok_or_else(|| what("the levels have no fit".into()))?;
        serde_json::from_value(value.clone()).map_err(|e| what(format!("its fit cannot be read ({e})")))
    }

    /// The model of a class.
    pub fn of_class(&self, class: u16) -> Option<&Quality> {
        self.classes.iter().find(|c| c.class == class).map(|c| &c.quality)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    fn bicycle() -> Quality {
        // Figure 6.9 of the thesis lists these for the class “bicycle”; K folds C in, as equation 6.4 does.
        let near = Branch { k: 0.0342, gamma: 1.4269, mu: 3.1625, alpha: 2.4362 };
        let far = Branch { k: 0.0342, gamma: -0.7355, mu: 1.8787, alpha: 0.0606 };
        Quality::Curve { near, far, beta: 2.0, b: 0.4645 }
    }

    #[test]
    fn the_curve_is_the_theses() {
        let q = bicycle();
        let by_hand =
            0.0342 * (0.7355f64 * (5.0f64 - 1.8787).abs().powf(0.0606)).exp() * 30_000f64.ln() + 0.4645;
        assert!((q.ssim(30_000.0, 5.0) - by_hand.min(1.0)).abs() < 1e-12);
        assert!(q.ssim(1000.0, 5.0) < q.ssim(30_000.0, 5.0));
        // At the reference distance of a branch its slope is K.
        let Quality::Curve { near, .. } = q else { unreachable!() };
        assert_eq!(near.slope(3.1625), 0.0342);
    }

    #[test]
    fn the_coarsest_level_that_suffices_is_chosen() {
        let q = Quality::Logarithm { a: 0.1, b: 0.0 };
        let steps = [3500.0, 1000.0, 500.0, 100.0]; // 0.816, 0.691, 0.621, 0.461
        let chosen = [0.0, 0.6, 0.65, 0.7, 0.9].map(|target| q.choose(&steps, target, 1.0).unwrap());
        assert_eq!(chosen, [3, 2, 1, 0, 0]);
        assert_eq!(q.choose(&[], 0.5, 1.0), None);
        // Where quality falls with the step, the best is not the last.
        assert_eq!(Quality::Logarithm { a: -0.1, b: 1.0 }.choose(&steps, 0.9, 1.0), Some(3));
    }

    #[test]
    fn tables_are_read_between_their_points() {
        let q = Quality::Steps { points: vec![[10.0, 0.2], [1000.0, 0.6]] };
        assert_eq!([q.ssim(1.0, 0.0), q.ssim(10.0, 0.0), q.ssim(1e6, 0.0)], [0.2, 0.2, 0.6]);
        assert!((q.ssim(100.0, 0.0) - 0.4).abs() < 1e-12);
        assert_eq!(Quality::Steps { points: vec![] }.ssim(5.0, 0.0), 1.0);
        let text = serde_json::to_string(&bicycle()).unwrap();
        assert_eq!(serde_json::from_str::<Quality>(&text).unwrap(), bicycle());
    }
}
