//! Which configurations are measured: sweeps as data.
//!
//! A sweep has a base (a preset) and what it changes in it, one choice at a time or several together, in the words of the
//! command line. A configuration is known by [`describe`]: what it changes in the default. So one that occurs in
//! several sweeps is measured once, and one that was measured before is recognised.

use motes_app::measurement;
pub use motes_app::measurement::describe;
use motes_renderer::{CHOICES, PRESETS, RenderConfig};

use super::BenchError;
use super::experiments::EXPERIMENTS;

/// Choices and their values, as on the command line.
pub type Changes = &'static [(&'static str, &'static str)];

/// A set of configurations.
pub struct Sweep {
    /// The preset that everything starts from.
    pub base: &'static str,
    /// Each value of each choice, alone.
    pub axes: &'static [(&'static str, &'static [&'static str])],
    /// Several changes together.
    pub points: &'static [Changes],
}

/// One choice at a time from the default, and the presets: what a first look needs.
pub const QUICK: Sweep = Sweep {
    base: "default",
    axes: &[
        ("expansion", &["instanced", "geometry"]),
        ("projection", &["affine", "exact"]),
        ("low-pass", &["3d"]),
        ("shape", &["square", "diamond"]),
        ("radius", &["full"]),
        ("order", &["depth"]),
        ("sort", &["gpu", "stochastic"]),
        ("sort-interval", &["30"]),
        ("composite", &["front-to-back"]),
        ("stop-below", &["0.02", "0.1"]),
        ("precision", &["f16", "f16-naive"]),
        ("target-format", &["rgba32f", "rgba8"]),
        ("min-opacity", &["0.05"]),
        ("min-contribution", &["0.5", "2"]),
        ("resolution-scale", &["0.7071", "0.5"]),
    ],
    points: &[
        EXACT,
        &[("stop-below", "0.02"), ("min-contribution", "0.2")],
        &[("shape", "diamond"), ("stop-below", "0.05")],
        &[("shape", "diamond"), ("stop-below", "0.05"), ("resolution-scale", "0.7071")],
    ],
};

/// The most exact configuration of the device: what stands in for the reference where that takes too long.
pub const EXACT: Changes = &[
    ("projection", "exact"),
    ("radius", "full"),
    ("composite", "front-to-back"),
    ("target-format", "rgba32f"),
    ("min-opacity", "0"),
];

/// What a full sweep has beyond the quick one and the named experiments: finer steps, and together what is cheap alone.
const FULL: Sweep = Sweep {
    base: "default",
    axes: &[
        ("low-pass", &["2d-compensated", "3d-compensated", "none"]),
        ("shape", &["axis-aligned"]),
        ("radius", &["sqrt8"]),
        ("min-opacity", &["0.02", "0.1"]),
        ("min-contribution", &["0.2", "1"]),
        ("max-radius", &["0.25"]),
    ],
    points: &[
        &[("projection", "exact"), ("target-format", "rgba32f")],
        &[("projection", "exact"), ("target-format", "rgba32f"), ("radius", "full")],
        &[("stop-below", "0.01"), ("min-contribution", "0.1")],
        &[("stop-below", "0.02"), ("min-contribution", "0.5")],
        &[("stop-below", "0.05"), ("min-contribution", "0.5")],
        &[("stop-below", "0.1"), ("min-contribution", "1")],
        &[("stop-below", "0.05"), ("min-opacity", "0.05"), ("min-contribution", "1")],
        &[("stop-below", "0.1"), ("min-opacity", "0.1"), ("min-contribution", "2")],
        &[("shape", "diamond"), ("stop-below", "0.02")],
        &[("shape", "diamond"), ("stop-below", "0.1"), ("min-opacity", "0.05"), ("min-contribution", "1")],
        &[("stop-below", "0.02"), ("resolution-scale", "0.7071")],
        &[("stop-below", "0.05"), ("resolution-scale", "0.7071"), ("min-contribution", "0.5")],
        &[("stop-below", "0.05"), ("resolution-scale", "0.5")],
        &[("shape", "diamond"), ("stop-below", "0.1"), ("resolution-scale", "0.5"), ("min-opacity", "0.05")],
        &[("precision", "f16"), ("sh-precision", "f16")],
        &[("precision", "f16"), ("sh-precision", "u8"), ("target-format", "rgba8")],
        &[("precision", "f16"), ("sh-precision", "u8"), ("stop-below", "0.02"), ("min-contribution", "0.2")],
    ],
};

/// A configuration and its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// As [`describe`] says.
    pub name: String,
    /// The configuration.
    pub config: RenderConfig,
}

/// The inverse of [`describe`].
///
/// # Errors
/// A choice or a value that does not exist.
pub fn parse(text: &str) -> Result<RenderConfig, BenchError> {
    measurement::parse(text).map_err(BenchError::Setting)
}

/// Changes one choice of a configuration.
///
/// # Errors
/// A choice or a value that does not exist.
pub fn change(config: &mut RenderConfig, name: &str, value: &str) -> Result<(), BenchError> {
    measurement::change(config, name, value).map_err(BenchError::Setting)
}

impl Sweep {
    /// Its configurations, the base first, without repetitions.
    ///
    /// # Errors
    /// A choice or a value that does not exist: a mistake in the data of the sweep.
    pub fn expand(&self) -> Result<Vec<Point>, BenchError> {
        let preset = PRESETS
            .iter()
            .find(|p| p.name == self.base)
            .ok_or_else(|| BenchError::Setting(format!("there is no preset '{}'", self.base)))?;
        let base = (preset.config)();
        let mut points = Vec::new();
        push(&mut points, base.clone());
        for (name, values) in self.axes {
            for value in *values {
                let mut config = base.clone();
                change(&mut config, name, value)?;
                push(&mut points, config);
            }
        }
        for changes in self.points {
            let mut config = base.clone();
            for (name, value) in *changes {
                change(&mut config, name, value)?;
            }
            push(&mut points, config);
        }
        Ok(points)
    }
}

fn push(points: &mut Vec<Point>, config: RenderConfig) {
    let name = describe(&config);
    if !points.iter().any(|p| p.name == name) {
        points.push(Point { name, config });
    }
}

/// Names that `--sweep` takes, each with a line about it.
pub fn names() -> Vec<(&'static str, &'static str)> {
    let mut names = vec![
        ("quick", "one choice at a time from the default, and the presets"),
        ("full", "the quick sweep, finer steps, combinations, and every named experiment"),
    ];
    names.extend(EXPERIMENTS.iter().map(|e| (e.name, e.title)));
    names
}

/// The configurations of the named sweeps, the default first, without repetitions.
///
/// # Errors
/// A sweep that does not exist.
pub fn configurations(sweeps: &[String]) -> Result<Vec<Point>, BenchError> {
    let mut points = Vec::new();
    push(&mut points, RenderConfig::default());
    let mut add = |sweep: &Sweep| -> Result<(), BenchError> {
        for point in sweep.expand()? {
            push(&mut points, point.config);
        }
        Ok(())
    };
    for name in sweeps {
        match name.as_str() {
            "quick" => {
                add(&QUICK)?;
                add(&PRESET_SWEEPS[0])?;
                add(&PRESET_SWEEPS[1])?;
            }
            "full" => {
                add(&QUICK)?;
                add(&FULL)?;
                for sweep in &PRESET_SWEEPS {
                    add(sweep)?;
                }
                for experiment in EXPERIMENTS {
                    add(&experiment.sweep)?;
                }
            }
            name => match EXPERIMENTS.iter().find(|e| e.name == name) {
                Some(experiment) => add(&experiment.sweep)?,
                None => {
                    let known: Vec<_> = names().iter().map(|n| n.0).collect();
                    return Err(BenchError::Setting(format!(
                        "there is no sweep '{name}'; there are: {}",
                        known.join(", ")
                    )));
                }
            },
        }
    }
    Ok(points)
}

const PRESET_SWEEPS: [Sweep; 2] = [
    Sweep { base: "inria", axes: &[], points: &[] },
    Sweep { base: "quest-report", axes: &[("shape", &["diamond"])], points: &[] },
];

/// Choices that a configuration changes in the default, by name.
pub fn changed(config: &RenderConfig) -> Vec<&'static str> {
    let default = RenderConfig::default();
    CHOICES.iter().filter(|c| c.get(config) != c.get(&default)).map(|c| c.name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sweep_names_choices_that_exist() {
        for (name, _) in names() {
            let points = configurations(&[name.to_owned()]).unwrap();
            assert!(points.len() >= 3, "{name}");
            assert_eq!(points[0].name, "default");
            for point in &points {
                assert_eq!(parse(&point.name).unwrap(), point.config, "{}", point.name);
            }
            let mut unique: Vec<_> = points.iter().map(|p| &p.name).collect();
            unique.sort();
            unique.dedup();
            assert_eq!(unique.len(), points.len());
        }
        let count = |name: &str| configurations(&[name.to_owned()]).unwrap().len();
        assert!(count("full") > count("quick") + 30 && count("quick") < 40);
        // Together they are no more than apart.
        let both = configurations(&["quick".to_owned(), "full".to_owned()]).unwrap();
        assert_eq!(both.len(), count("full"));
    }

    #[test]
    fn mistakes_are_named() {
        let error = configurations(&["quik".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("quik") && error.contains("quick"), "{error}");
        assert!(parse("shape=circle").unwrap_err().to_string().contains("octagon"));
        assert!(parse("form=octagon").unwrap_err().to_string().contains("shape"));
        assert!(parse("octagon").is_err());
        let bad = Sweep { base: "default", axes: &[("shape", &["circle"])], points: &[] };
        assert!(bad.expand().is_err());
    }

    #[test]
    fn a_configuration_is_known_by_its_changes() {
        assert_eq!(describe(&RenderConfig::default()), "default");
        let mut config = RenderConfig::default();
        change(&mut config, "shape", "diamond").unwrap();
        change(&mut config, "stop-below", "1/50").unwrap();
        assert_eq!(describe(&config), "shape=diamond stop-below=0.02");
        assert_eq!(changed(&config), ["shape", "stop-below"]);
    }
}
