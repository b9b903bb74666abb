//! Only what a scene calls for: which buffers it gets on the device and which variant of the pipelines draws it, decided
//! from its statement, each decision with its reason and its figure.
//!
//! A plan is made anew whenever a scene changes: a still scene that motion is merged into, or that gains a band of
//! spherical harmonics, gets the buffer and the shader for it because its statement says so. What a plan leaves out
//! changes pictures by no more than [`Plan::BOUND_DB`] allows.

use crate::config::{Axis, Precision, Projection, RenderConfig, ShPrecision};
use crate::packing::{LOG_SCALE_RANGE, Packing};
use motes_scenes::statement::{Histogram, Statement};
use motes_shaders::layout::{GEOMETRY_WORDS_F32, MOTION_WORDS_F32, sh_words};
use std::fmt;

/// A band is left out where fewer than this share of the splats show 1/255 of it, …
const BAND_VISIBLE: f64 = 1e-3;
/// … and its root mean square over the scene is less than this.
const BAND_RMS: f64 = 0.25 / 255.0;
/// Splats that subtend less than this (standard deviation over distance) look alike in every projection: at 55° from the
/// axis, half of a headset's 110°, linearising moves their rim by `tan 55°` times it, 3 % of their size.
const NARROW: f64 = 0.02;
/// Share of wider splats from which the projection matters.
const WIDE_SHARE: f64 = 1e-3;

/// What is decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Topic {
    /// Whether there is a motion buffer and the code that moves splats.
    Motion,
    /// Up to which degree spherical harmonics are stored and evaluated.
    Harmonics,
    /// How harmonics are stored.
    HarmonicsStorage,
    /// How geometry is stored.
    Precision,
    /// How splats are projected.
    Projection,
}

/// One decision.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Decision {
    /// About what.
    pub topic: Topic,
    /// Whether the effect is there at all: the buffer, the compact form, the correction.
    pub on: bool,
    /// What was chosen, as on the command line.
    pub choice: String,
    /// Why, with the figure that decided.
    pub reason: String,
    /// Bytes a splat on the device that follow from it.
    pub bytes_per_splat: u64,
    /// Whether somebody asked for it, rather than the scene.
    pub overridden: bool,
}

/// What somebody asks for regardless of the scene. A scene never gets what it lacks: an override cannot add motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Overrides {
    /// Highest degree of spherical harmonics that is stored.
    pub sh_degree: Option<u8>,
    /// How harmonics are stored.
    pub sh_precision: Option<ShPrecision>,
    /// How geometry is stored.
    pub precision: Option<Precision>,
    /// How splats are projected.
    pub projection: Option<Projection>,
}

impl Overrides {
    /// Everything that can be switched on: what a viewer without plans does.
    pub const EVERYTHING: Self = Self {
        sh_degree: Some(3),
        sh_precision: Some(ShPrecision::F32),
        precision: Some(Precision::F32),
        projection: Some(Projection::Tangent),
    };
}

/// What a scene gets.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Plan {
    /// Storage on the device.
    #[serde(skip)]
    pub packing: Packing,
    /// Whether splats move.
    pub motion: bool,
    /// How splats are projected.
    pub projection: Projection,
    /// Every decision, with its reason.
    pub decisions: Vec<Decision>,
}

impl Plan {
    /// Pictures by plan and with everything switched on are at least this alike, dB.
    pub const BOUND_DB: f64 = 45.0;

    /// Bytes that each splat takes where every buffer exists in full precision, whatever the scene: geometry, three
    /// degrees of harmonics, motion.
    pub const FULL_BYTES: u64 = 4 * (GEOMETRY_WORDS_F32 + sh_words(3, 32) + MOTION_WORDS_F32) as u64;

    /// Decides for a scene.
    pub fn of(statement: &Statement, overrides: &Overrides) -> Self {
        let mut decisions = Vec::new();
        let mut decide = |topic, on, choice: String, reason: String, bytes_per_splat, overridden| {
            decisions.push(Decision { topic, on, choice, reason, bytes_per_splat, overridden });
        };

        let seen = |b: &&motes_scenes::statement::Band| b.visible >= BAND_VISIBLE || b.rms >= BAND_RMS;
        let needed = statement.bands.iter().filter(seen).map(|b| b.degree).max().unwrap_or(0);
        let sh_degree = overrides.sh_degree.unwrap_or(needed).min(statement.sh_degree);
        let precision = overrides.precision.unwrap_or_else(|| precision_for(&statement.size));
        let sh_precision = overrides.sh_precision.unwrap_or(ShPrecision::U8);
        let packing = Packing { precision, sh_precision, sh_degree };

        let motion = statement.motion.is_some();
        let reason = match &statement.motion {
            None => "no splat has motion: neither buffer nor instruction".to_owned(),
            Some(m) => format!(
                "{:.1} % of the splats leave their place, {:.1} % turn, {:.1} % are there all the time",
                100.0 * m.moving,
                100.0 * m.turning,
                100.0 * m.permanent
            ),
        };
        let choice = if motion { "moving" } else { "still" };
        decide(
            Topic::Motion,
            motion,
            choice.into(),
            reason,
            if motion { 4 * packing.motion_words() as u64 } else { 0 },
            false,
        );

        let bands: Vec<_> = statement
            .bands
            .iter()
            .filter(|b| b.degree > 0)
            .map(|b| format!("degree {}: {:.2} % of the splats show it", b.degree, 100.0 * b.visible))
            .collect();
        let reason = match statement.sh_degree {
            0 => "the colours depend on no direction: neither buffer nor instruction".to_owned(),
            stored if sh_degree < stored && overrides.sh_degree.is_none() => {
                format!("{}; what lies above degree {sh_degree} changes no 8-bit image", bands.join(", "))
            }
            _ => bands.join(", "),
        };
        let (on, asked) = (sh_degree > 0, overrides.sh_degree.is_some());
        decide(Topic::Harmonics, on, sh_degree.to_string(), reason, 0, asked);
        if on {
            let reason = match sh_precision {
                ShPrecision::U8 => {
                    "bytes over a scale per splat: an error of 1/254 of its largest coefficient"
                }
                ShPrecision::F16 => "half floats: an error of 1/2048 of each coefficient",
                ShPrecision::F32 => "as in the file",
            };
            let (compact, asked) = (sh_precision != ShPrecision::F32, overrides.sh_precision.is_some());
            let bytes = 4 * packing.sh_words() as u64;
            decide(Topic::HarmonicsStorage, compact, sh_precision.to_string(), reason.into(), bytes, asked);
        }

        let largest = statement.size.max;
        let reason = match precision {
            Precision::F16 => format!(
                "means stay 32-bit, and the largest splat, {largest:.3} m, is within 16-bit log-scales (to {:.0} m)",
                f64::from(LOG_SCALE_RANGE.1).exp()
            ),
            Precision::F32 => format!("the largest splat is {largest:.3} m"),
            Precision::F16Naive => "to show what half floats do to covariances".to_owned(),
        };
        let bytes = 4 * packing.geometry_words() as u64;
        let (compact, asked) = (precision != Precision::F32, overrides.precision.is_some());
        decide(Topic::Precision, compact, precision.to_string(), reason, bytes, asked);

        let wide = wide_share(statement);
        let fitting = if wide >= WIDE_SHARE { Projection::Tangent } else { Projection::Affine };
        let projection = overrides.projection.unwrap_or(fitting);
        let reason = format!(
            "{:.2} % of the splats are wider than {:.1}° from half the scene's extent, and at 110° of view linearising \
             shows there",
            100.0 * wide,
            NARROW.to_degrees()
        );
        let (corrected, asked) = (projection != Projection::Affine, overrides.projection.is_some());
        decide(Topic::Projection, corrected, projection.to_string(), reason, 0, asked);
        Self { packing, motion, projection, decisions }
    }

    /// A configuration that follows the plan.
    pub fn apply(&self, config: &RenderConfig) -> RenderConfig {
        RenderConfig {
            projection: self.projection,
            precision: self.packing.precision,
            sh_precision: self.packing.sh_precision,
            sh_degree: self.packing.sh_degree,
            ..config.clone()
        }
    }

    /// Bytes a splat on the device.
    pub fn bytes_per_splat(&self) -> u64 {
        self.decisions.iter().map(|d| d.bytes_per_splat).sum()
    }
}

fn precision_for(size: &Histogram) -> Precision {
    // NaN and ∞ fail the comparison, and are kept as they are.
    if size.max < f64::from(LOG_SCALE_RANGE.1).exp() { Precision::F16 } else { Precision::F32 }
}

/// Share of the splats that look wider than [`NARROW`] from half the scene's extent away.
fn wide_share(statement: &Statement) -> f64 {
    let Some(b) = &statement.bounds else { return 0.0 };
    let distance = 0.5 * (0..3).map(|k| (b.inner_max[k] - b.inner_min[k]).powi(2)).sum::<f64>().sqrt();
    // Whole bins: those that reach beyond it count.
    let wide: usize = statement.size.bins.iter().filter(|b| b.to > NARROW * distance).map(|b| b.count).sum();
    wide as f64 / statement.size.count.max(1) as f64
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for d in &self.decisions {
            let (name, on) = (d.topic.name(), if d.on { "on" } else { "off" });
            let asked = if d.overridden { " (asked for)" } else { "" };
            writeln!(f, "  {name:18} {on:3}  {:9} {:4} B  {}{asked}", d.choice, d.bytes_per_splat, d.reason)?;
        }
        writeln!(
            f,
            "  {:18} {:3}  {:9} {:4} B  a splat on the device",
            "together",
            "",
            "",
            self.bytes_per_splat()
        )
    }
}

impl Topic {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Motion => "motion",
            Self::Harmonics => "harmonics",
            Self::HarmonicsStorage => "compact harmonics",
            Self::Precision => "compact geometry",
            Self::Projection => "wide projection",
        }
    }

    /// The option that decides it regardless of the scene, as on the command line; `None` where nobody can: a scene
    /// that does not move has no motion to switch on, and one that moves is wrong without.
    pub fn option(self) -> Option<&'static str> {
        match self {
            Self::Motion => None,
            Self::Harmonics => Some("sh-degree"),
            Self::HarmonicsStorage => Some(ShPrecision::NAME),
            Self::Precision => Some(Precision::NAME),
            Self::Projection => Some(Projection::NAME),
        }
    }
}
