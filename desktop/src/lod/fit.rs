//! Curves through observations, by least squares (Levenberg–Marquardt).

use motes_app::lod::{Branch, ClassQuality, Quality};
use rmpfit::{MPError, MPFitter, MPPar, MPResult};

use super::observe::Observation;

/// Classes that fewer views saw are left out, as in the thesis (§6.1).
pub const LEAST_VIEWS: usize = 10;
/// Branches with fewer distances than this have no shape of their own.
const LEAST_DISTANCES: usize = 4;
/// A logarithm that explains less than this of the spread within views falls back to a table of steps.
const LEAST_R2: f64 = 0.3;
/// Nor is a slope believed that is less than so many standard errors above 0: a few means line up by chance.
const LEAST_SLOPE: f64 = 3.0;
/// Observations count less the further they lie off (Huber): beyond so many residuals' deviations.
const HUBER: f64 = 2.5;

/// `y = a x + b`, with the root mean square residual and the coefficient of determination.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Line {
    /// Slope.
    pub a: f64,
    /// Value at 0.
    pub b: f64,
    /// Root mean square residual.
    pub residual: f64,
    /// Coefficient of determination.
    pub r2: f64,
    /// Standard error of the slope.
    pub error: f64,
}

/// The least-squares line; `None` where all `x` are one.
pub fn line(points: &[[f64; 2]]) -> Option<Line> {
    let n = points.len() as f64;
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
    let (mx, my) = (mean(0), mean(1));
    let sum = |f: &dyn Fn(&[f64; 2]) -> f64| points.iter().map(f).sum::<f64>();
    let (xx, xy) = (sum(&|p| (p[0] - mx).powi(2)), sum(&|p| (p[0] - mx) * (p[1] - my)));
    if !(xx > 0.0) {
        return None;
    }
    let (a, b) = (xy / xx, my - xy / xx * mx);
    let (residual, r2) = quality_of(points.iter().map(|p| (p[1], a * p[0] + b)));
    Some(Line { a, b, residual, r2, error: residual / xx.sqrt() })
}

/// Root mean square residual and coefficient of determination of (observed, predicted) pairs.
fn quality_of(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> (f64, f64) {
    let n = pairs.clone().count().max(1) as f64;
    let mean = pairs.clone().map(|p| p.0).sum::<f64>() / n;
    let off: f64 = pairs.clone().map(|(y, f)| (y - f).powi(2)).sum();
    let spread: f64 = pairs.map(|(y, _)| (y - mean).powi(2)).sum();
    ((off / n).sqrt(), if spread > 0.0 { 1.0 - off / spread } else { 1.0 })
}

/// Mean SSIM of a class at each step, over the views.
pub fn means(observations: &[Observation], class: u16) -> Vec<[f64; 2]> {
    let mut sums: Vec<(f64, f64, f64)> = Vec::new();
    for o in observations.iter().filter(|o| o.class == class) {
        match sums.iter_mut().find(|s| s.0 == o.step) {
            Some(s) => {
                s.1 += o.ssim;
                s.2 += 1.0;
            }
            None => sums.push((o.step, o.ssim, 1.0)),
        }
    }
    sums.sort_by(|a, b| a.0.total_cmp(&b.0));
    sums.into_iter().map(|(step, sum, n)| [step, sum / n]).collect()
}

/// The parameters that are fitted, in the order of the solver: slopes K, γ, μ, α of both branches, and b. β is tried at
/// every distance between observations, since residuals jump where it passes one.
struct Problem<'a> {
    /// `ln i`, distance, SSIM, weight.
    points: &'a [[f64; 4]],
    beta: f64,
    limits: Vec<MPPar>,
}

fn branch(p: &[f64]) -> Branch {
    Branch { k: p[0], gamma: p[1], mu: p[2], alpha: p[3] }
}

impl MPFitter for Problem<'_> {
    fn eval(&mut self, p: &[f64], deviates: &mut [f64]) -> MPResult<()> {
        let branches = [branch(&p[..4]), branch(&p[4..8])];
        for (deviate, [i, d, ssim, weight]) in deviates.iter_mut().zip(self.points) {
            let slope = branches[usize::from(*d >= self.beta)].slope(*d);
            *deviate = weight * (ssim - slope * i - p[8]);
            if !deviate.is_finite() {
                return Err(MPError::Eval);
            }
        }
        Ok(())
    }

    fn number_of_points(&self) -> usize {
        self.points.len()
    }

    fn parameters(&self) -> &[MPPar] {
        &self.limits
    }
}

fn limited(low: f64, high: f64) -> MPPar {
    MPPar { limited_low: true, limited_up: true, limit_low: low, limit_up: high, ..MPPar::new() }
}

/// Fits equation 6.4 to a class's observations, or what of it they carry: the curve, else a logarithm, else a table of
/// means. `None` where fewer than [`LEAST_VIEWS`] views saw the class.
pub fn fit(observations: &[Observation], class: u16, name: &str, least_views: usize) -> Option<ClassQuality> {
    let mine: Vec<&Observation> = observations.iter().filter(|o| o.class == class).collect();
    let mut views: Vec<usize> = mine.iter().map(|o| o.view).collect();
    views.sort_unstable();
    views.dedup();
    if views.len() < least_views.max(1) {
        return None;
    }
    let points: Vec<[f64; 2]> = mine.iter().map(|o| [o.step.max(1.0).ln(), o.ssim]).collect();
    let means = means(observations, class);
    let logarithm = line(&points);
    // Whether the logarithm holds is seen on the means: views differ for reasons of their own.
    let of_means = line(&means.iter().map(|p| [p[0].max(1.0).ln(), p[1]]).collect::<Vec<_>>());
    let quality = match (logarithm, of_means) {
        (Some(l), Some(m)) if m.r2 >= LEAST_R2 && l.a > LEAST_SLOPE * l.error => {
            let logarithm = Quality::Logarithm { a: l.a, b: l.b };
            match curve(&mine, l) {
                Some(curve) if curve_predicts_better(&mine, &views) => curve,
                _ => logarithm,
            }
        }
        _ => Quality::Steps { points: rising(means) },
    };
    let (residual, r2) = quality_of(mine.iter().map(|o| (o.ssim, quality.ssim(o.step, o.distance))));
    Some(ClassQuality { class, name: name.to_owned(), quality, residual, r2, views: views.len() })
}

/// Whether, of views that are left out of the fit one by one, the curve predicts the SSIM better than the logarithm alone:
/// nine coefficients can follow the noise of a dozen views.
fn curve_predicts_better(mine: &[&Observation], views: &[usize]) -> bool {
    let (mut by_curve, mut by_line) = (0.0, 0.0);
    for &left_out in views {
        let rest: Vec<&Observation> = mine.iter().copied().filter(|o| o.view != left_out).collect();
        let points: Vec<[f64; 2]> = rest.iter().map(|o| [o.step.max(1.0).ln(), o.ssim]).collect();
        let Some(l) = line(&points) else { return false };
        let Some(curve) = curve(&rest, l) else { return false };
        for o in mine.iter().filter(|o| o.view == left_out) {
            by_curve += (o.ssim - curve.ssim(o.step, o.distance)).abs();
            by_line += (o.ssim - l.a * o.step.max(1.0).ln() - l.b).abs();
        }
    }
    by_curve < by_line
}

/// The best curve over all places of β; `None` where there are too few distances for two branches.
fn curve(mine: &[&Observation], start: Line) -> Option<Quality> {
    let mut distances: Vec<f64> = mine.iter().map(|o| o.distance).collect();
    distances.sort_by(f64::total_cmp);
    distances.dedup();
    let (nearest, farthest) = (*distances.first()?, *distances.last()?);
    let span = farthest - nearest;
    if distances.len() < 2 * LEAST_DISTANCES || !(span > 0.0) {
        return None;
    }
    let mut points: Vec<[f64; 4]> =
        mine.iter().map(|o| [o.step.max(1.0).ln(), o.distance, o.ssim, 1.0]).collect();
    // Shapes that the distances can tell apart; slopes of one sign.
    let steepest = 2.0 / span;
    let limits = || {
        let shape = || {
            [
                limited(1e-6, 4.0 * start.a),
                limited(-steepest, steepest),
                limited(0.0, farthest + span),
                limited(0.25, 2.0),
            ]
        };
        let mut limits: Vec<MPPar> = shape().into_iter().chain(shape()).collect();
        limits.push(limited(-1.0, 1.0));
        limits
    };
    let mut best: Option<(f64, Vec<f64>, f64)> = None;
    for _round in 0..2 {
        best = None;
        for k in LEAST_DISTANCES..=distances.len() - LEAST_DISTANCES {
            let beta = 0.5 * (distances[k - 1] + distances[k]);
            for gamma in [-0.1 / span, 0.1 / span] {
                let mut p = vec![
                    start.a,
                    gamma,
                    nearest,
                    1.0,
                    start.a,
                    -gamma,
                    farthest,
                    1.0,
                    start.b.clamp(-1.0, 1.0),
                ];
                let mut problem = Problem { points: &points, beta, limits: limits() };
                if let Ok(status) = problem.mpfit(&mut p)
                    && best.as_ref().is_none_or(|b| status.best_norm < b.0)
                {
                    best = Some((status.best_norm, p, beta));
                }
            }
        }
        // Views that are off for reasons of their own must not bend the curve: once more with Huber's weights.
        let (norm, p, beta) = best.as_ref()?;
        let deviation = (norm / points.len() as f64).sqrt().max(1e-6);
        for point in &mut points {
            let slope = branch(if point[1] < *beta { &p[..4] } else { &p[4..8] }).slope(point[1]);
            let off = (point[2] - slope * point[0] - p[8]).abs() / deviation;
            point[3] = if off > HUBER { (HUBER / off).sqrt() } else { 1.0 };
        }
    }
    let (_, p, beta) = best?;
    Some(Quality::Curve { near: branch(&p[..4]), far: branch(&p[4..8]), beta, b: p[8] })
}

/// The nearest rising sequence, by pooling neighbours that fall (isotonic regression).
fn rising(points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for p in &points {
        pools.push((p[1], 1));
        while let [.., (a, n), (b, m)] = pools[..] {
            if a <= b {
                break;
            }
            pools.truncate(pools.len() - 2);
            pools.push(((a * n as f64 + b * m as f64) / (n + m) as f64, n + m));
        }
    }
    let values = pools.into_iter().flat_map(|(value, n)| std::iter::repeat_n(value, n));
    points.iter().zip(values).map(|(p, value)| [p[0], value]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_scenes::synthetic::Random;

    fn observed(truth: impl Fn(f64, f64) -> f64, noise: f32) -> Vec<Observation> {
        let mut random = Random::new(2);
        let mut all = Vec::new();
        for view in 0..14 {
            let distance = 1.0 + 0.26 * view as f64;
            for step in [100.0, 300.0, 1000.0, 3000.0] {
                let ssim = truth(step, distance) + f64::from(random.uniform(-noise, noise));
                all.push(Observation { class: 1, view, step, distance, ssim, pixels: 500 });
            }
        }
        all
    }

    #[test]
    fn a_curve_of_the_model_comes_back() {
        let near = Branch { k: 0.05, gamma: 0.3, mu: 1.0, alpha: 1.2 };
        let far = Branch { k: 0.06, gamma: 0.2, mu: 4.4, alpha: 1.0 };
        let truth = Quality::Curve { near, far, beta: 2.5, b: 0.3 };
        let observations = observed(|i, d| truth.ssim(i, d), 0.003);
        let found = fit(&observations, 1, "one", LEAST_VIEWS).unwrap();
        assert!(matches!(found.quality, Quality::Curve { .. }), "{found:?}");
        assert!(found.residual < 0.004 && found.r2 > 0.99, "{found:?}");
        // Between what was observed.
        for (i, d) in [(500.0, 1.4), (2000.0, 3.3), (150.0, 4.2)] {
            assert!((found.quality.ssim(i, d) - truth.ssim(i, d)).abs() < 0.01);
        }
        // Where views differ for reasons that have nothing to do with distance, the curve is not believed.
        let mut random = Random::new(9);
        let offsets: Vec<f64> = (0..14).map(|_| f64::from(random.uniform(-0.1, 0.1))).collect();
        let mut erratic = observed(|i, _| 0.3 + 0.06 * i.ln(), 0.003);
        erratic.iter_mut().for_each(|o| o.ssim += offsets[o.view]);
        let plain = fit(&erratic, 1, "erratic", LEAST_VIEWS).unwrap().quality;
        assert!(matches!(plain, Quality::Logarithm { .. }), "{plain:?}");
        // Control: without distances the same observations are explained worse.
        let plain = line(&observations.iter().map(|o| [o.step.ln(), o.ssim]).collect::<Vec<_>>()).unwrap();
        assert!(plain.residual > 2.0 * found.residual, "{plain:?}");
    }

    #[test]
    fn poor_observations_fall_back_and_rare_classes_are_left_out() {
        let level = observed(|_, _| 0.8, 0.05);
        assert!(matches!(fit(&level, 1, "flat", 10).unwrap().quality, Quality::Steps { .. }));
        let falling = observed(|i, _| 1.0 - 0.05 * i.ln(), 0.01);
        let Quality::Steps { points } = fit(&falling, 1, "falling", 10).unwrap().quality else { panic!() };
        assert!(points.windows(2).all(|w| w[0][1] <= w[1][1]), "{points:?}");
        let few: Vec<_> = observed(|i, _| 0.1 * i.ln(), 0.01).into_iter().filter(|o| o.view < 6).collect();
        assert_eq!(fit(&few, 1, "rare", LEAST_VIEWS), None);
        assert!(matches!(fit(&few, 1, "few", 3).unwrap().quality, Quality::Logarithm { .. }));
        assert_eq!(fit(&few, 2, "absent", 0), None);
    }

    #[test]
    fn lines_and_pools_are_what_they_say() {
        let l = line(&[[0.0, 1.0], [1.0, 3.0], [2.0, 5.0]]).unwrap();
        assert!((l.a - 2.0).abs() < 1e-12 && (l.b - 1.0).abs() < 1e-12 && l.r2 == 1.0);
        assert_eq!(line(&[[1.0, 1.0], [1.0, 2.0]]), None);
        let pooled = rising(vec![[1.0, 0.5], [2.0, 0.3], [3.0, 0.4], [4.0, 0.9]]);
        assert_eq!(pooled.iter().map(|p| (p[1] * 10.0).round()).collect::<Vec<_>>(), [4.0, 4.0, 4.0, 9.0]);
    }
}
