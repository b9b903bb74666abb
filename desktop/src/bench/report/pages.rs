//! The pages of the named experiments: published figures, ours, and why they differ.

use motes_renderer::projection_error::{self, PAPER_HALF};
use motes_renderer::{Fov, PRESETS};
use serde::Serialize;

use super::super::experiments::{EXPERIMENTS, Experiment, Quantity, Row};
use super::super::outcome::Outcome;
use super::super::sweep::{self, Changes};
use super::super::{BenchError, measure};
use super::Contents;
use crate::measure::{Picture, flip_map};

/// A named experiment in the report.
#[derive(Serialize)]
pub struct ExperimentPage {
    name: &'static str,
    title: &'static str,
    question: &'static str,
    source: &'static str,
    why: &'static str,
    /// Scenes that it was measured on.
    scenes: Vec<String>,
    rows: Vec<RowPage>,
    /// Configurations that belong to it.
    configurations: Vec<String>,
    /// Error by angle, where it was measured: scene, configuration, means over rings of ten degrees.
    rings: Vec<(String, String, Vec<f64>)>,
}

#[derive(Serialize)]
struct RowPage {
    what: &'static str,
    published: &'static str,
    ours: Vec<Figure>,
}

/// A figure of ours, for a scene.
#[derive(Serialize)]
struct Figure {
    scene: String,
    value: Option<f64>,
    text: String,
}

/// ε(θ, φ) of 003 over the paper's domain, and expectations over fields of view.
#[derive(Serialize)]
pub struct Surface {
    /// Half the side of the domain, radians.
    limit: f64,
    /// Values by rows of θ.
    values: Vec<Vec<f64>>,
    /// ε of the optimal projection.
    optimal: f64,
    /// Half-width of the region for the expectations, radians.
    half: f64,
    /// (field of view in words, expectation of the classic projection, of the optimal one).
    expectations: Vec<(&'static str, f64, f64)>,
}

impl Surface {
    /// Half-width of a splat's region for the expectations: three standard deviations of a splat of 1°, and wide fields
    /// of view stay in front of the plane.
    const HALF: f64 = 3.0 * std::f64::consts::PI / 180.0;

    pub fn new() -> Self {
        const STEPS: i32 = 16;
        let limit = 0.95 * PAPER_HALF;
        let at = |i: i32| limit * f64::from(i) / f64::from(STEPS);
        let row = |i| (-STEPS..=STEPS).map(|j| projection_error::epsilon(at(i), at(j), PAPER_HALF)).collect();
        let square = |degrees: f64| {
            let t = (degrees / 2.0).to_radians().tan();
            Fov { left: -t, right: t, up: -t, down: t }
        };
        let headset = Fov { left: -1.43, right: 1.43, up: -1.11, down: 1.11 };
        let optimal = projection_error::epsilon_optimal(Self::HALF);
        let expectations = [
            ("45° square, a photograph", square(45.0)),
            ("60° square", square(60.0)),
            ("90° square", square(90.0)),
            ("110° × 96°, a headset's eye", headset),
        ]
        .map(|(name, fov)| (name, projection_error::expectation(&fov, Self::HALF), optimal));
        Self {
            limit,
            values: (-STEPS..=STEPS).map(row).collect(),
            optimal: projection_error::epsilon_optimal(PAPER_HALF),
            half: Self::HALF,
            expectations: expectations.to_vec(),
        }
    }
}

/// The pages of all experiments of which anything was measured.
pub fn experiments(contents: &Contents<'_>) -> Result<Vec<ExperimentPage>, BenchError> {
    EXPERIMENTS.iter().map(|e| page(contents, e)).collect()
}

fn page(contents: &Contents<'_>, experiment: &Experiment) -> Result<ExperimentPage, BenchError> {
    let configurations: Vec<String> = experiment.sweep.expand()?.into_iter().map(|p| p.name).collect();
    let belongs = |o: &&Outcome| configurations.contains(&o.configuration);
    // A scene that is there for this experiment alone speaks first; one for another does not speak here.
    let mut scenes: Vec<&str> = Vec::new();
    for own in [true, false] {
        for scene in &contents.record.scenes {
            let fits =
                if own { scene.only.as_deref() == Some(experiment.name) } else { scene.only.is_none() };
            if fits && contents.outcomes.iter().any(|o| o.scene == scene.scene) {
                scenes.push(&scene.scene);
            }
        }
    }
    let rings = contents
        .outcomes
        .iter()
        .filter(belongs)
        .filter(|o| {
            experiment.name == "projection" && o.rings.len() > 4 && scenes.contains(&o.scene.as_str())
        })
        .map(|o| (o.scene.clone(), o.configuration.clone(), o.rings.clone()))
        .collect();
    let mut rows = Vec::new();
    for row in experiment.rows {
        let mut ours = Vec::new();
        for scene in &scenes {
            ours.push(figure(contents, experiment, row, scene)?);
        }
        rows.push(RowPage { what: row.what, published: row.published, ours });
    }
    Ok(ExperimentPage {
        name: experiment.name,
        title: experiment.title,
        question: experiment.question,
        source: experiment.source,
        why: experiment.why,
        scenes: scenes.into_iter().map(str::to_owned).collect(),
        rows,
        configurations,
        rings,
    })
}

fn name_of(experiment: &Experiment, changes: Changes) -> Result<String, BenchError> {
    let preset = PRESETS.iter().find(|p| p.name == experiment.sweep.base);
    let mut config = preset.map(|p| (p.config)()).unwrap_or_default();
    for (name, value) in changes {
        sweep::change(&mut config, name, value)?;
    }
    Ok(sweep::describe(&config))
}

fn figure(
    contents: &Contents<'_>,
    experiment: &Experiment,
    row: &Row,
    scene: &str,
) -> Result<Figure, BenchError> {
    let find = |name: &str| contents.outcomes.iter().find(|o| o.scene == scene && o.configuration == name);
    let missing = |name: &str| {
        let refused = contents.record.refusals.iter().find(|r| r.scene == scene && r.configuration == name);
        let text = refused.map_or_else(|| "not measured".to_owned(), |r| format!("cannot run: {}", r.reason));
        Figure { scene: scene.to_owned(), value: None, text }
    };
    let of = name_of(experiment, row.of)?;
    let Some(a) = find(&of) else { return Ok(missing(&of)) };
    let value = match row.over {
        None => read(row.quantity, a),
        Some(over) => {
            let over = name_of(experiment, over)?;
            let Some(b) = find(&over) else { return Ok(missing(&over)) };
            if row.quantity == Quantity::Flip {
                let load = |name: &str| Picture::load(&measure::picture_path(contents.folder, scene, name));
                let map = flip_map(&load(&over)?, &load(&of)?, contents.pixels_per_degree)?;
                Some(map.iter().map(|&e| f64::from(e)).sum::<f64>() / map.len() as f64)
            } else if row.quantity == Quantity::DeviceRate {
                // Of ratios within one round, where there are some: drift cancels.
                match (a.ratio, b.ratio) {
                    (Some(a), Some(b)) => Some(b.median / a.median),
                    _ => None,
                }
            } else {
                read(row.quantity, a).zip(read(row.quantity, b)).map(|(a, b)| a / b)
            }
        }
    };
    let value = value.filter(|v| v.is_finite());
    let text = value.map_or_else(|| "no figure".to_owned(), |v| short(v, row.quantity == Quantity::Flip));
    Ok(Figure { scene: scene.to_owned(), value, text })
}

fn read(quantity: Quantity, o: &Outcome) -> Option<f64> {
    match quantity {
        Quantity::Layers => Some(o.layers),
        Quantity::Vertices => Some(o.vertices),
        Quantity::DeviceTime => Some(o.device_ms.median),
        Quantity::DeviceRate => Some(1e3 / o.device_ms.median),
        Quantity::PredictedRate => Some(o.predicted.fps()),
        Quantity::SceneBytes => Some(o.scene_bytes as f64),
        Quantity::Visible => Some(o.visible),
        Quantity::Flip => Some(o.flip),
        Quantity::Ssim => o.ssim,
        Quantity::Worst => Some(o.worst),
        Quantity::SortTime => o.sort_ms.map(|s| s.median),
    }
}

/// Three significant digits; FLIP errors to the sixth place, as its own tool prints them.
fn short(value: f64, flip: bool) -> String {
    if flip {
        return format!("{value:.6}");
    }
    let digits = 2 - value.abs().max(1e-9).log10().floor() as i32;
    format!("{value:.*}", digits.clamp(0, 6) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_short() {
        assert_eq!(short(0.5, false), "0.500");
        assert_eq!(short(12.345, false), "12.3");
        assert_eq!(short(12345.6, false), "12346");
        assert_eq!(short(0.0654501, true), "0.065450");
    }

    #[test]
    fn the_surface_is_the_papers() {
        let surface = Surface::new();
        let middle = surface.values.len() / 2;
        assert_eq!(surface.values[middle][middle], surface.optimal);
        assert!(surface.values[0][0] > 50.0 * surface.optimal && surface.values.len() == 33);
        let by_view: Vec<f64> = surface.expectations.iter().map(|e| e.1).collect();
        assert!(by_view.is_sorted() && by_view[0] > surface.expectations[0].2, "{by_view:?}");
    }
}
