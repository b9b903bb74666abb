//! How to draw as cheaply as an error allows: presets that come from measured fronts, not from taste.
//!
//! `data/quality.json` is written by `motes bench --presets`: for every configuration that no other beats, its largest
//! mean FLIP error over the measured scenes, and its predicted headset frame over the default's. It states when, where
//! and on what it was measured.

use std::fmt;
use std::str::FromStr;

use motes_renderer::{Choice, RenderConfig};
use serde::{Deserialize, Serialize};

const TABLE: &str = include_str!("../data/quality.json");

/// Where a table comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The command.
    pub command: String,
    /// When it was measured.
    pub date: String,
    /// The commit that measured.
    pub commit: Option<String>,
    /// The device and its driver.
    pub device: String,
    /// The scenes.
    pub scenes: Vec<String>,
    /// Width and height of the pictures, pixels.
    pub size: [u32; 2],
    /// For FLIP.
    pub pixels_per_degree: f32,
}

/// A configuration that no other beats.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// What it changes in the default, as `name=value` with spaces between; `default` for nothing.
    pub configuration: String,
    /// Largest mean FLIP error over the scenes.
    pub flip: f64,
    /// Predicted headset frame over the default's, mean over the scenes.
    pub cost: f64,
}

/// Measured fronts of several scenes as one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// Where it comes from.
    pub provenance: Provenance,
    /// From the least error to the least cost.
    pub points: Vec<Point>,
}

/// How close a picture must come to the exact one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quality {
    /// The closest of what was measured.
    Exact,
    /// FLIP of at most 0.01.
    Balanced,
    /// FLIP of at most 0.05.
    Fast,
    /// A mean FLIP error of at most this.
    Within(f64),
}

impl Quality {
    /// The mean FLIP error that is allowed; `None`: as little as there is.
    pub fn limit(self) -> Option<f64> {
        match self {
            Self::Exact => None,
            Self::Balanced => Some(0.01),
            Self::Fast => Some(0.05),
            Self::Within(limit) => Some(limit),
        }
    }
}

impl FromStr for Quality {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "exact" => Ok(Self::Exact),
            "balanced" => Ok(Self::Balanced),
            "fast" => Ok(Self::Fast),
            number => match number.parse() {
                Ok(limit) if limit > 0.0 && limit <= 1.0 => Ok(Self::Within(limit)),
                _ => Err(format!(
                    "'{text}' is no quality: write exact, balanced, fast, or a mean FLIP error above 0 and up to 1"
                )),
            },
        }
    }
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact => f.pad("exact"),
            Self::Balanced => f.pad("balanced"),
            Self::Fast => f.pad("fast"),
            Self::Within(limit) => write!(f, "{limit}"),
        }
    }
}

/// Why there is no configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QualityError {
    /// The table is damaged: a fault of this build.
    #[error("the table of qualities cannot be read: {0}")]
    Table(String),
    /// Nothing that was measured is that close.
    #[error(
        "nothing that was measured comes within a FLIP error of {wanted} on every scene; the least is {least:.4}"
    )]
    Unreachable {
        /// What was asked for.
        wanted: f64,
        /// What there is.
        least: f64,
    },
}

impl Table {
    /// The one of this build.
    ///
    /// # Errors
    /// A fault of this build.
    pub fn built_in() -> Result<Self, QualityError> {
        serde_json::from_str(TABLE).map_err(|e| QualityError::Table(e.to_string()))
    }

    /// The cheapest point that is close enough on every measured scene.
    ///
    /// # Errors
    /// [`QualityError::Unreachable`].
    pub fn cheapest(&self, quality: Quality) -> Result<&Point, QualityError> {
        let least = self.points.iter().map(|p| p.flip).fold(f64::INFINITY, f64::min);
        let wanted = quality.limit().unwrap_or(least);
        let close = self.points.iter().filter(|p| p.flip <= wanted);
        close.min_by(|a, b| a.cost.total_cmp(&b.cost)).ok_or(QualityError::Unreachable { wanted, least })
    }

    /// That point's configuration.
    ///
    /// # Errors
    /// As [`Table::cheapest`], or a configuration that this build does not know.
    pub fn config(&self, quality: Quality) -> Result<RenderConfig, QualityError> {
        config_of(&self.cheapest(quality)?.configuration)
    }
}

fn config_of(text: &str) -> Result<RenderConfig, QualityError> {
    let mut config = RenderConfig::default();
    for word in text.split_whitespace().filter(|w| *w != "default") {
        let problem = || QualityError::Table(format!("'{word}' is no change of a configuration"));
        let (name, value) = word.split_once('=').ok_or_else(problem)?;
        let choice = Choice::named(name).ok_or_else(problem)?;
        choice.set(&mut config, value).map_err(|e| QualityError::Table(format!("{name}: {e}")))?;
    }
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let point =
            |configuration: &str, flip, cost| Point { configuration: configuration.into(), flip, cost };
        Table {
            points: vec![
                point("radius=full projection=exact", 0.001, 1.5),
                point("default", 0.008, 1.0),
                point("shape=diamond stop-below=0.05", 0.03, 0.5),
            ],
            ..Table::built_in().unwrap()
        }
    }

    #[test]
    fn the_cheapest_that_is_close_enough() {
        let table = table();
        let name = |q| table.cheapest(q).unwrap().configuration.as_str();
        assert_eq!(name(Quality::Exact), "radius=full projection=exact");
        assert_eq!(name(Quality::Balanced), "default");
        assert_eq!(name(Quality::Fast), "shape=diamond stop-below=0.05");
        assert_eq!(name(Quality::Within(0.0299)), "default");
        let config = table.config(Quality::Fast).unwrap();
        assert_eq!((config.shape, config.stop_below), (motes_renderer::QuadShape::Diamond, 0.05));
        let error = table.cheapest(Quality::Within(1e-4)).unwrap_err();
        assert_eq!(error, QualityError::Unreachable { wanted: 1e-4, least: 0.001 });
        assert!(
            config_of("form=round").is_err() && config_of("shape=round").is_err() && config_of("x").is_err()
        );
    }

    /// Every point of the built-in table is a configuration that this build knows, and none beats another.
    #[test]
    fn the_built_in_table_is_a_front() {
        let table = Table::built_in().unwrap();
        assert!(table.points.len() >= 3 && !table.provenance.scenes.is_empty(), "{table:?}");
        for pair in table.points.windows(2) {
            assert!(pair[0].flip < pair[1].flip && pair[0].cost > pair[1].cost, "{pair:?}");
        }
        for point in &table.points {
            config_of(&point.configuration).unwrap();
        }
        assert_eq!(table.cheapest(Quality::Exact).unwrap(), &table.points[0]);
        assert!(table.cheapest(Quality::Fast).is_ok());
    }

    #[test]
    fn qualities_are_words_or_numbers() {
        for word in ["exact", "balanced", "fast", "0.025"] {
            assert_eq!(word.parse::<Quality>().unwrap().to_string(), word);
        }
        for bad in ["", "best", "0", "-0.1", "2", "NaN"] {
            assert!(bad.parse::<Quality>().is_err(), "{bad}");
        }
        assert!(Quality::Balanced.limit() < Quality::Fast.limit());
    }
}
