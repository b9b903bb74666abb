//! How long a frame would take on a headset, predicted from counts that any machine can take.
//!
//! A splat renderer's frame on a Quest 3 was profiled once, by the report `002` (Jourdain, Deltenre, Chasseray 2025,
//! figure 5 and its text). Its two stage rates are the model: a frame takes as long as its splats need in the vertex
//! and geometry stages plus as long as its fragments need in the fragment stage.
//!
//! It is a **prediction**, not a measurement, and says so wherever it is shown. The profile is of one renderer (geometry
//! stage, back-to-front, every layer) on one scene. What the model leaves out: the compositor's share, the cost of
//! binning large polygons, memory-bandwidth limits, thermal throttling. [`StageRates::uncertainty`] is the largest
//! deviation from the report's own other points, which the tests of this module hold the model to. Rates that were
//! measured on a device replace these: the structure is read from JSON.

use serde::{Deserialize, Serialize};

use motes_renderer::Expansion;

/// How fast a device's stages are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageRates {
    /// The device.
    pub device: String,
    /// Splats of one eye that the vertex and geometry stages project in a second of their own time.
    pub splats_per_second: f64,
    /// Fragments that are shaded and blended in a second of their own time.
    pub fragments_per_second: f64,
    /// Width and height of one eye's image, pixels.
    pub eye: [u32; 2],
    /// A prediction `t` stands for `t / (1 + u) ..= t · (1 + u)`.
    pub uncertainty: f64,
    /// Where the rates come from.
    pub source: String,
}

/// Vertex-stage invocations per second of the profile (`002`, figure 5): one per splat and eye.
const PROFILED_SPLATS: f64 = 25.9155e6;
/// Share of the time that shades vertices (same place).
const PROFILED_VERTEX_TIME: f64 = 0.25;
/// Fragments shaded per second (same place).
const PROFILED_FRAGMENTS: f64 = 8807.03e6;
/// Share of the time that shades fragments (same place).
const PROFILED_FRAGMENT_TIME: f64 = 0.75;

impl StageRates {
    /// A Quest 3, from the profile of `002`.
    pub fn quest_3() -> Self {
        Self {
            device: "Meta Quest 3".into(),
            splats_per_second: PROFILED_SPLATS / PROFILED_VERTEX_TIME,
            fragments_per_second: PROFILED_FRAGMENTS / PROFILED_FRAGMENT_TIME,
            eye: [1680, 1760],
            uncertainty: 0.25,
            source: "profile of a geometry-stage splat renderer, Jourdain et al. 2025, figure 5".into(),
        }
    }

    /// Pixels of both eyes' images.
    pub fn pixels(&self) -> f64 {
        2.0 * f64::from(self.eye[0]) * f64::from(self.eye[1])
    }

    /// What is wrong with rates that were read from a file, if anything.
    pub fn problem(&self) -> Option<String> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        if !(positive(self.splats_per_second) && positive(self.fragments_per_second)) {
            return Some("rates must be positive numbers per second".into());
        }
        if self.eye.contains(&0) {
            return Some(format!("an eye's image cannot be {} × {} pixels", self.eye[0], self.eye[1]));
        }
        if !(self.uncertainty >= 0.0 && self.uncertainty.is_finite()) {
            return Some(format!("the uncertainty is a ratio, 0 or more, not {}", self.uncertainty));
        }
        None
    }

    /// Predicts a frame of both eyes.
    pub fn predict(&self, load: &FrameLoad) -> Prediction {
        Prediction {
            splats_ms: 1e3 * load.splats / self.splats_per_second,
            fragments_ms: 1e3 * load.layers * self.pixels() / self.fragments_per_second,
            uncertainty: self.uncertainty,
        }
    }

    /// Layers per pixel of both eyes that fit into a frame at so many hertz, after its splats were projected; negative
    /// where not even those fit.
    pub fn layers_at(&self, hertz: f64, splats: f64) -> f64 {
        (1.0 / hertz - splats / self.splats_per_second) * self.fragments_per_second / self.pixels()
    }
}

/// What a frame of both eyes asks of the device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameLoad {
    /// Projections of a splat into an eye: splats × eyes, times the corners where each corner projects anew.
    pub splats: f64,
    /// Fragments per pixel of the full-size image, full-screen passes included.
    pub layers: f64,
}

impl FrameLoad {
    /// The load of a frame whose pictures need `layers` fragments a pixel. The instanced vertex stage projects at each of
    /// `corners`, which is why `002` (5.1.1) found it slower than its geometry stage; the others project once an eye.
    pub fn new(splats: u32, expansion: Expansion, corners: u32, layers: f64) -> Self {
        let times = if expansion == Expansion::Instanced { corners } else { 1 };
        Self { splats: 2.0 * f64::from(splats) * f64::from(times), layers }
    }
}

/// A predicted frame of both eyes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// Vertex and geometry stages, ms.
    pub splats_ms: f64,
    /// Fragment stage and blending, ms.
    pub fragments_ms: f64,
    /// As [`StageRates::uncertainty`].
    pub uncertainty: f64,
}

impl Prediction {
    /// The whole frame, ms.
    pub fn ms(&self) -> f64 {
        self.splats_ms + self.fragments_ms
    }

    /// Frames per second.
    pub fn fps(&self) -> f64 {
        1e3 / self.ms()
    }

    /// Shortest and longest frame that the uncertainty allows, ms.
    pub fn range_ms(&self) -> [f64; 2] {
        [self.ms() / (1.0 + self.uncertainty), self.ms() * (1.0 + self.uncertainty)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The report's garden scenes, splats of both eyes.
    const GARDEN: f64 = 2.0 * 1_119_682.0;
    const GARDEN_MINI: f64 = 2.0 * 730_272.0;

    /// Layers that explain a frame rate.
    fn layers_of(rates: &StageRates, splats: f64, fps: f64) -> f64 {
        rates.layers_at(fps, splats)
    }

    fn fps(splats: f64, layers: f64) -> f64 {
        StageRates::quest_3().predict(&FrameLoad { splats, layers }).fps()
    }

    /// Predictions of the report's points that the rates were not taken from. Returns (point, predicted, published).
    fn other_points() -> Vec<(&'static str, f64, f64)> {
        let rates = StageRates::quest_3();
        let at = |splats, fps| layers_of(&rates, splats, fps);
        let profiled = at(GARDEN, 13.0);
        vec![
            // 5.1.2: diamonds shade half the area: 13 to 21.
            ("diamonds", fps(GARDEN, profiled / 2.0), 21.0),
            // 5.1.2: the same at a reduced resolution, 24 to 37.
            ("diamonds, reduced", fps(GARDEN, at(GARDEN, 24.0) / 2.0), 37.0),
            // 5.1.3: a framebuffer of 75 % of the side, 15 to 25.
            ("framebuffer 75 %", fps(GARDEN, at(GARDEN, 15.0) * 0.75 * 0.75), 25.0),
            // 5.2.1.2: diamonds on the optimised scene: 37 to at least 60, and about 60 to 72.
            ("optimised, dense, diamonds", fps(GARDEN_MINI, at(GARDEN_MINI, 37.0) / 2.0), 60.0),
            ("optimised, sparse, diamonds", fps(GARDEN_MINI, at(GARDEN_MINI, 60.0) / 2.0), 72.0),
        ]
    }

    /// The profile itself: 1.12 M splats and its own fragments make the frame rate at which it was taken.
    #[test]
    fn the_profiled_frame_comes_back() {
        let rates = StageRates::quest_3();
        let load = FrameLoad { splats: GARDEN, layers: PROFILED_FRAGMENTS / 13.0 / rates.pixels() };
        let frame = rates.predict(&load);
        assert!((frame.fps() - 13.0).abs() < 1.0, "{} FPS", frame.fps());
        // It splits 25 : 75 as in the figure.
        let share = frame.splats_ms / frame.ms();
        assert!((share - PROFILED_VERTEX_TIME).abs() < 0.03, "{share}");
    }

    #[test]
    fn the_reports_other_points_lie_within_the_stated_uncertainty() {
        let mut worst = 0.0f64;
        for (point, predicted, published) in other_points() {
            let deviation = (published / predicted).max(predicted / published) - 1.0;
            println!("{point}: predicted {predicted:.1} FPS, published {published} ({:+.0} %)", {
                100.0 * (predicted / published - 1.0)
            });
            worst = worst.max(deviation);
        }
        let stated = StageRates::quest_3().uncertainty;
        assert!(worst <= stated, "off by {worst:.2}, stated {stated}");
        // The statement is not padded either.
        assert!(worst > 0.5 * stated, "off by {worst:.2} at most, stated {stated}");
        // Diamonds at full resolution, the report's headline, are met closely.
        let (_, predicted, published) = other_points()[0];
        assert!((predicted - published).abs() < 1.0, "{predicted}");
        // Control: without the split in two stages, a diamond would double the frame rate.
        assert!((26.0f64 / published - 1.0) > 0.2);
    }

    /// The optimised scene's 37 to 60 FPS are possible at all with its number of splats, with fewer layers than garden's.
    #[test]
    fn the_optimised_scene_is_possible() {
        let rates = StageRates::quest_3();
        assert!(fps(GARDEN_MINI, 0.0) > 60.0);
        let layers = [37.0, 60.0].map(|f| layers_of(&rates, GARDEN_MINI, f));
        let before = layers_of(&rates, GARDEN, 13.0);
        assert!(layers[0] > layers[1] && layers[1] > 0.0 && before > 4.0 * layers[0], "{layers:?} {before}");
        // Control: the scene before could not reach 60 with any number of layers.
        assert!(fps(GARDEN, 0.0) < 60.0);
    }

    /// 9 of the 13.9 ms of a 72 Hz frame afford about 105 M fragments, some 18 layers on two eyes.
    #[test]
    fn budgets_follow_from_the_rates() {
        let rates = StageRates::quest_3();
        let splats = (1.0 / 72.0 - 9e-3) * rates.splats_per_second;
        let layers = rates.layers_at(72.0, splats);
        assert!((layers - 17.9).abs() < 0.1, "{layers}");
        assert!((layers * rates.pixels() - 105.7e6).abs() < 0.2e6);
        assert!(rates.layers_at(90.0, splats) < layers && rates.layers_at(120.0, splats) < layers);
        assert!(rates.layers_at(72.0, GARDEN) < 0.0);
        let [low, high] = rates.predict(&FrameLoad { splats, layers }).range_ms();
        assert!(low < 1e3 / 72.0 && high > 1e3 / 72.0 && (low * high).sqrt() - 1e3 / 72.0 < 1e-9);
    }

    #[test]
    fn an_expansion_that_projects_at_corners_pays_for_them() {
        let load = |e| FrameLoad::new(100, e, 8, 1.0).splats;
        assert_eq!(load(Expansion::Precomputed), 200.0);
        assert_eq!(load(Expansion::Geometry), 200.0);
        assert_eq!(load(Expansion::Instanced), 1600.0);
    }

    #[test]
    fn rates_are_read_and_checked() {
        let rates = StageRates::quest_3();
        let text = serde_json::to_string(&rates).unwrap();
        assert_eq!(serde_json::from_str::<StageRates>(&text).unwrap(), rates);
        assert_eq!(rates.problem(), None);
        for bad in [
            StageRates { splats_per_second: 0.0, ..rates.clone() },
            StageRates { fragments_per_second: f64::INFINITY, ..rates.clone() },
            StageRates { eye: [0, 5], ..rates.clone() },
            StageRates { uncertainty: f64::NAN, ..rates.clone() },
        ] {
            assert!(bad.problem().is_some(), "{bad:?}");
        }
    }
}
