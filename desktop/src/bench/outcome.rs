//! What came of it: medians, spreads and ratios per scene and configuration.

use std::collections::BTreeMap;

use motes_app::prediction::{FrameLoad, Prediction, StageRates};
use serde::{Deserialize, Serialize};

use super::record::{ErrorRecord, FrameRecord, Record};
use super::{BenchError, front, sweep};

/// Mean FLIP errors that a picture is judged by, by convention: very close, close, rough.
pub const LIMITS: [f64; 3] = [0.002, 0.01, 0.05];

/// A median and its spread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Median of the absolute deviations from it.
    pub mad: f64,
    /// A quarter of the values lies below.
    pub low: f64,
    /// A quarter of the values lies above.
    pub high: f64,
    /// How many values.
    pub count: usize,
}

impl Spread {
    /// Of values; `None` where there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        // Between neighbours, as the usual definition of quantiles interpolates.
        let at = |v: &[f64], share: f64| {
            let place = share * (v.len() - 1) as f64;
            let (low, high) = (v[place.floor() as usize], v[place.ceil() as usize]);
            low + (high - low) * place.fract()
        };
        if sorted.is_empty() {
            return None;
        }
        let median = at(&sorted, 0.5);
        let mut deviations: Vec<f64> = sorted.iter().map(|v| (v - median).abs()).collect();
        deviations.sort_by(f64::total_cmp);
        Some(Self {
            median,
            mad: at(&deviations, 0.5),
            low: at(&sorted, 0.25),
            high: at(&sorted, 0.75),
            count: sorted.len(),
        })
    }
}

/// What a configuration came to on a scene: errors are means over its views, counts are of the mean view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Scene.
    pub scene: String,
    /// Configuration.
    pub configuration: String,
    /// The choices that it changes in the default.
    pub changed: Vec<String>,
    /// Mean FLIP error.
    pub flip: f64,
    /// FLIP's weighted median.
    pub flip_median: f64,
    /// FLIP's weighted quartiles.
    pub flip_quartiles: [f64; 2],
    /// FLIP's least and largest error over all views.
    pub flip_range: [f64; 2],
    /// PSNR, dB; absent where nothing differs in some view.
    pub psnr: Option<f64>,
    /// SSIM.
    pub ssim: Option<f64>,
    /// Largest difference of a channel, `0 ..= 1`.
    pub worst: f64,
    /// Mean FLIP by angle from the middle of the view, where one view was measured.
    pub rings: Vec<f64>,
    /// Fragments per pixel of the shown image, full-screen passes (marks of early stop, upscaling) among them.
    pub layers: f64,
    /// Of those, the ones that were blended, where they were counted.
    pub blended: Option<f64>,
    /// Whether the fragments of splats were counted one by one, or taken from the device's statistics.
    pub exactly_counted: bool,
    /// Fragments.
    pub fragments: f64,
    /// Primitives.
    pub primitives: f64,
    /// Vertex-stage invocations.
    pub vertices: f64,
    /// Splats drawn; 0 where the expansion does not count them.
    pub visible: f64,
    /// Draw calls.
    pub draws: f64,
    /// Compute dispatches.
    pub dispatches: f64,
    /// Subpasses.
    pub passes: f64,
    /// Bytes read and written, by [`motes_renderer::Traffic`].
    pub bytes: f64,
    /// Those of them that a tile-based device cannot keep on chip.
    pub off_chip: f64,
    /// Bytes of the scene on the device.
    pub scene_bytes: u64,
    /// Bytes allocated on the device.
    pub memory: u64,
    /// Device time of a frame, ms.
    pub device_ms: Spread,
    /// Device time of the order's upload, of the preparation, of drawing: medians, ms.
    pub passes_ms: [f64; 3],
    /// Device time over the default's of the same round.
    pub ratio: Option<Spread>,
    /// Wall time of a frame, ms.
    pub wall_ms: Spread,
    /// Sorting on the processor, ms.
    pub sort_ms: Option<Spread>,
    /// **Predicted** frame of a headset.
    pub predicted: Prediction,
    /// Whether picture and counts are the default's: the choice does nothing here.
    pub no_effect: bool,
}

/// The outcomes of a record, by scene and configuration in the order of measuring. Configurations without a frame are
/// left out: they are not finished.
///
/// # Errors
/// A record of configurations that this version does not know.
pub fn outcomes(record: &Record, rates: &StageRates) -> Result<Vec<Outcome>, BenchError> {
    let mut frames: BTreeMap<(&str, &str), Vec<&FrameRecord>> = BTreeMap::new();
    for f in &record.frames {
        frames.entry((&f.scene, &f.configuration)).or_default().push(f);
    }
    let mut errors: BTreeMap<(&str, &str), Vec<&ErrorRecord>> = BTreeMap::new();
    for e in &record.errors {
        errors.entry((&e.scene, &e.configuration)).or_default().push(e);
    }
    let mut outcomes: Vec<Outcome> = Vec::new();
    for scene in &record.scenes {
        for configuration in &record.configurations {
            let key = (scene.scene.as_str(), configuration.as_str());
            let (Some(frames_here), Some(errors_here)) = (frames.get(&key), errors.get(&key)) else {
                continue;
            };
            let default = frames.get(&(key.0, "default")).map(Vec::as_slice).unwrap_or_default();
            let mut outcome = outcome(scene.splats, frames_here, errors_here, default, rates)?;
            let plain = errors.get(&(key.0, "default"));
            outcome.no_effect = configuration != "default"
                && plain.is_some_and(|p| p.iter().map(|e| e.hash).eq(errors_here.iter().map(|e| e.hash)))
                && outcomes.iter().find(|o| o.scene == key.0 && o.configuration == "default").is_some_and(
                    |d| {
                        (d.fragments, d.primitives, d.vertices, d.scene_bytes)
                            == (outcome.fragments, outcome.primitives, outcome.vertices, outcome.scene_bytes)
                    },
                );
            outcomes.push(outcome);
        }
    }
    Ok(outcomes)
}

fn outcome(
    splats: u32,
    frames: &[&FrameRecord],
    errors: &[&ErrorRecord],
    default: &[&FrameRecord],
    rates: &StageRates,
) -> Result<Outcome, BenchError> {
    let name = &errors[0].configuration;
    let config = sweep::parse(name)?;
    let n = errors.len() as f64;
    let mean = |value: &dyn Fn(&ErrorRecord) -> f64| errors.iter().map(|e| value(e)).sum::<f64>() / n;
    let count = |value: &dyn Fn(&FrameRecord) -> f64| {
        frames.iter().map(|f| value(f)).sum::<f64>() / frames.len() as f64
    };
    // Times of the views are added up per round first: a round is one measurement.
    let per_round = |frames: &[&FrameRecord], value: &dyn Fn(&FrameRecord) -> f64| {
        let mut rounds: BTreeMap<u32, (f64, usize)> = BTreeMap::new();
        for f in frames {
            let sum = rounds.entry(f.round).or_default();
            *sum = (sum.0 + value(f), sum.1 + 1);
        }
        let most = rounds.values().map(|r| r.1).max().unwrap_or(0);
        rounds.retain(|_, r| r.1 == most);
        rounds.into_iter().map(|(round, (sum, n))| (round, sum / n as f64)).collect::<BTreeMap<u32, f64>>()
    };
    let spread = |value: &dyn Fn(&FrameRecord) -> f64| {
        Spread::of(&per_round(frames, value).into_values().collect::<Vec<_>>()).unwrap_or_default()
    };
    let device = |f: &FrameRecord| f.report.device_ns() / 1e6;
    let (own, base) = (per_round(frames, &device), per_round(default, &device));
    let ratios: Vec<f64> =
        own.iter().filter_map(|(round, ms)| Some(ms / base.get(round)?)).filter(|r| r.is_finite()).collect();
    let sorts: Vec<f64> = frames.iter().filter_map(|f| f.sort_ms).collect();
    // Counted exactly, where that was possible; else by the device's statistics (which on some leave out fragments that
    // end early); else what the preparation predicted.
    let pixels = |f: &FrameRecord| f.report.shown_pixels.max(f.report.pixels).max(1) as f64;
    let upscaled = count(&|f| if f.report.shown_pixels > f.report.pixels { 1.0 } else { 0.0 });
    let full_screen = upscaled + count(&|f| f.report.full_screen_fragments as f64 / pixels(f));
    let shaded = all(errors, |e| e.layers.map(|l| l[0]));
    let layers = full_screen
        + shaded.unwrap_or_else(|| {
            count(&|f| match f.report.fragments {
                0 => f64::from(f.report.predicted_fragments) / pixels(f),
                counted => counted as f64 / pixels(f),
            })
        });
    let fragments = layers * count(&pixels);
    let corners = config.shape.corners();
    let load = FrameLoad::new(splats, config.expansion, corners, layers);
    Ok(Outcome {
        scene: errors[0].scene.clone(),
        configuration: name.clone(),
        changed: sweep::changed(&config).into_iter().map(str::to_owned).collect(),
        flip: mean(&|e| e.flip.mean),
        flip_median: mean(&|e| e.flip.weighted_median),
        flip_quartiles: [0, 1].map(|q| mean(&|e| e.flip.weighted_quartiles[q])),
        flip_range: [
            errors.iter().map(|e| e.flip.min).fold(f64::INFINITY, f64::min),
            errors.iter().map(|e| e.flip.max).fold(0.0, f64::max),
        ],
        psnr: all(errors, |e| e.psnr),
        ssim: all(errors, |e| e.ssim),
        blended: all(errors, |e| e.layers.map(|l| l[1])),
        exactly_counted: shaded.is_some(),
        worst: errors.iter().map(|e| f64::from(e.worst.difference)).fold(0.0, f64::max),
        rings: if let [one] = errors { one.rings.clone() } else { Vec::new() },
        layers,
        fragments,
        primitives: count(&|f| f.report.primitives as f64),
        vertices: count(&|f| f.report.vertices as f64),
        visible: count(&|f| f.report.visible.into()),
        draws: count(&|f| f.report.draws.into()),
        dispatches: count(&|f| f.report.dispatches.into()),
        passes: count(&|f| f.report.passes.into()),
        bytes: count(&|f| f.traffic.total() as f64),
        off_chip: count(&|f| f.traffic.off_chip() as f64),
        scene_bytes: errors[0].scene_bytes,
        memory: errors.iter().map(|e| e.memory).max().unwrap_or(0),
        device_ms: spread(&device),
        passes_ms: [
            spread(&|f| f.report.upload_ns / 1e6).median,
            spread(&|f| f.report.prepare_ns / 1e6).median,
            spread(&|f| f.report.draw_ns / 1e6).median,
        ],
        ratio: Spread::of(&ratios),
        wall_ms: spread(&|f| f.wall_ms),
        sort_ms: Spread::of(&sorts),
        predicted: rates.predict(&load),
        no_effect: false,
    })
}

/// The mean of what every view has.
fn all(errors: &[&ErrorRecord], value: fn(&ErrorRecord) -> Option<f64>) -> Option<f64> {
    let values: Option<Vec<f64>> = errors.iter().map(|e| value(e)).collect();
    values.map(|v| v.iter().sum::<f64>() / v.len().max(1) as f64)
}

/// Names of the choices that show nothing about a frame's own quality and cost (a stand-in for another moment, or a form
/// that only other drivers reward); configurations that change them are measured, but no candidates for the front.
const NO_CANDIDATES: &[&str] = &["sort-interval", "time", "background", "near", "near-fade"];

/// Whether a configuration may be on the front.
pub fn is_candidate(outcome: &Outcome) -> bool {
    !outcome.changed.iter().any(|c| NO_CANDIDATES.contains(&c.as_str()))
}

/// Indices of a scene's outcomes on its front of FLIP error against the predicted headset frame, from the most exact.
pub fn front_of(outcomes: &[Outcome], scene: &str) -> Vec<usize> {
    let (indices, points) = candidates(outcomes, scene);
    front::pareto(&points).into_iter().map(|i| indices[i]).collect()
}

/// Index of the cheapest outcome of a scene within an error.
pub fn cheapest_within(outcomes: &[Outcome], scene: &str, limit: f64) -> Option<usize> {
    let (indices, points) = candidates(outcomes, scene);
    front::cheapest(&points, limit).map(|i| indices[i])
}

fn candidates(outcomes: &[Outcome], scene: &str) -> (Vec<usize>, Vec<(f64, f64)>) {
    let of_scene = |(_, o): &(usize, &Outcome)| o.scene == scene && is_candidate(o);
    outcomes.iter().enumerate().filter(of_scene).map(|(i, o)| (i, (o.flip, o.predicted.ms()))).unzip()
}

/// How two runs agree on the ranking of what they share.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// Scene.
    pub scene: String,
    /// Configurations that both measured.
    pub shared: usize,
    /// Rank correlation of the predicted headset frames of the configurations on either front.
    pub front: Option<f64>,
    /// Of the predicted headset frames of all.
    pub predicted: Option<f64>,
    /// Of the device times of all.
    pub device: Option<f64>,
    /// Of the device times of the configurations on either front.
    pub device_front: Option<f64>,
}

/// Compares two runs, scene by scene.
pub fn agreement(a: &[Outcome], b: &[Outcome]) -> Vec<Agreement> {
    let mut scenes: Vec<&str> = a.iter().map(|o| o.scene.as_str()).collect();
    scenes.dedup();
    let mut found = Vec::new();
    for scene in scenes {
        let pairs: Vec<(&Outcome, &Outcome)> = a
            .iter()
            .filter(|o| o.scene == scene)
            .filter_map(|o| {
                Some((o, b.iter().find(|p| p.scene == scene && p.configuration == o.configuration)?))
            })
            .collect();
        if pairs.is_empty() {
            continue;
        }
        let on_front = |o: &[Outcome]| -> Vec<String> {
            front_of(o, scene).into_iter().map(|i| o[i].configuration.clone()).collect()
        };
        let (front_a, front_b) = (on_front(a), on_front(b));
        let on_either: Vec<_> = pairs
            .iter()
            .filter(|(o, _)| front_a.contains(&o.configuration) || front_b.contains(&o.configuration))
            .copied()
            .collect();
        let correlation = |pairs: &[(&Outcome, &Outcome)], value: fn(&Outcome) -> f64| {
            let (x, y): (Vec<_>, Vec<_>) = pairs.iter().map(|(a, b)| (value(a), value(b))).unzip();
            front::rank_correlation(&x, &y)
        };
        found.push(Agreement {
            scene: scene.to_owned(),
            shared: pairs.len(),
            front: correlation(&on_either, |o| o.predicted.ms()),
            predicted: correlation(&pairs, |o| o.predicted.ms()),
            device: correlation(&pairs, |o| o.device_ms.median),
            device_front: correlation(&on_either, |o| o.device_ms.median),
        });
    }
    found
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::record::{Line, Refusal, SceneRecord};
    use super::*;
    use crate::measure::{Flip, Worst};
    use motes_renderer::FrameReport;

    /// A record as a run of two views and three rounds leaves it.
    pub fn record(configurations: &[(&str, f64, u64, f64)]) -> Vec<Line> {
        let mut lines = vec![Line::Scene(SceneRecord {
            scene: "plant".into(),
            splats: 1000,
            sh_degree: 0,
            moving: false,
            only: None,
        })];
        for &(name, flip, fragments, ms) in configurations {
            for view in ["a", "b"] {
                lines.push(Line::Error(ErrorRecord {
                    scene: "plant".into(),
                    view: view.into(),
                    configuration: name.into(),
                    psnr: (flip > 0.0).then_some(40.0),
                    ssim: Some(1.0 - flip),
                    flip: Flip {
                        mean: flip,
                        weighted_median: flip,
                        weighted_quartiles: [flip / 2.0, flip * 2.0],
                        min: 0.0,
                        max: 4.0 * flip,
                    },
                    worst: Worst {
                        x: 0,
                        y: 0,
                        channel: 1,
                        reference: 0.0,
                        test: flip as f32,
                        difference: flip as f32,
                    },
                    rings: vec![flip],
                    layers: None,
                    hash: fragments,
                    scene_bytes: 56_000,
                    memory: 1 << 20,
                }));
                for round in 1..=3 {
                    let report = FrameReport {
                        views: 1,
                        pixels: 100,
                        shown_pixels: 100,
                        fragments,
                        draw_ns: 1e6 * ms * f64::from(round),
                        ..Default::default()
                    };
                    lines.push(Line::Frame(FrameRecord {
                        scene: "plant".into(),
                        view: view.into(),
                        configuration: name.into(),
                        round,
                        report,
                        traffic: Default::default(),
                        wall_ms: ms,
                        sort_ms: (round == 1).then_some(2.0),
                    }));
                }
            }
        }
        lines.push(Line::Refused(Refusal {
            scene: "plant".into(),
            configuration: "sort=gpu".into(),
            reason: "it is not there".into(),
        }));
        lines
    }

    pub fn parsed(lines: &[Line]) -> Record {
        let folder = std::env::temp_dir().join(format!(
            "motes-outcome-{}-{:?}",
            std::process::id(),
            std::thread::current().id()
        ));
        let _ = std::fs::remove_dir_all(&folder);
        let mut journal = super::super::record::Journal::open(&folder).unwrap();
        for line in lines {
            journal.write(line.clone()).unwrap();
        }
        journal.record
    }

    #[test]
    fn spreads_are_quantiles() {
        let s = Spread::of(&[4.0, 1.0, 3.0, 2.0, 100.0]).unwrap();
        assert_eq!((s.median, s.low, s.high, s.mad, s.count), (3.0, 2.0, 4.0, 1.0, 5));
        assert_eq!(Spread::of(&[1.0, 2.0]).unwrap().median, 1.5);
        assert_eq!(Spread::of(&[]), None);
    }

    #[test]
    fn ratios_cancel_drift_and_counts_lead() {
        let lines = record(&[
            ("default", 0.001, 5000, 10.0),
            ("shape=diamond", 0.02, 2500, 5.0),
            ("stop-below=0.02", 0.004, 4000, 30.0),
            ("radius=full", 0.0, 9000, 20.0),
            ("sort-interval=10", 0.0, 10, 1.0),
        ]);
        let rates = StageRates::quest_3();
        let all = outcomes(&parsed(&lines), &rates).unwrap();
        assert_eq!(all.len(), 5);
        let diamond = &all[1];
        // Rounds grow slower threefold; the ratio of every round is one half.
        assert_eq!(diamond.ratio.unwrap(), Spread { median: 0.5, mad: 0.0, low: 0.5, high: 0.5, count: 3 });
        assert_eq!((diamond.device_ms.median, diamond.layers, diamond.flip), (10.0, 25.0, 0.02));
        assert_eq!(diamond.changed, ["shape"]);
        assert!((diamond.predicted.fragments_ms / all[0].predicted.fragments_ms - 0.5).abs() < 1e-12);
        assert_eq!(diamond.sort_ms.unwrap().median, 2.0);
        // The front goes by error and counts; slow device time does not push the third off, an old order is none.
        let front: Vec<_> =
            front_of(&all, "plant").into_iter().map(|i| all[i].configuration.as_str()).collect();
        assert_eq!(front, ["radius=full", "default", "stop-below=0.02", "shape=diamond"]);
        let at = |limit| cheapest_within(&all, "plant", limit).map(|i| all[i].configuration.as_str());
        assert_eq!(LIMITS.map(at), [Some("default"), Some("stop-below=0.02"), Some("shape=diamond")]);
        assert_eq!(at(-1.0), None);
    }

    #[test]
    fn a_choice_without_effect_is_told() {
        let lines = record(&[
            ("default", 0.001, 5000, 10.0),
            ("sh-degree=0", 0.001, 5000, 9.0),
            ("shape=square", 0.001, 5001, 9.0),
        ]);
        let all = outcomes(&parsed(&lines), &StageRates::quest_3()).unwrap();
        assert_eq!(all.iter().map(|o| o.no_effect).collect::<Vec<_>>(), [false, true, false]);
    }

    #[test]
    fn two_runs_are_compared_by_ranks() {
        let names = ["default", "shape=diamond", "shape=square", "stop-below=0.02"];
        let run = |times: [f64; 4]| {
            let row = |(i, (name, ms)): (usize, (&&'static str, f64))| {
                (*name, 0.01 * i as f64, 5000 - 500 * i as u64, ms)
            };
            let rows: Vec<_> = names.iter().zip(times).enumerate().map(row).collect();
            outcomes(&parsed(&record(&rows)), &StageRates::quest_3()).unwrap()
        };
        let (a, b) = (run([4.0, 3.0, 2.0, 1.0]), run([1.0, 2.0, 3.0, 4.0]));
        let same = &agreement(&a, &a)[0];
        assert_eq!((same.shared, same.front, same.device), (4, Some(1.0), Some(1.0)));
        let other = &agreement(&a, &b)[0];
        assert_eq!((other.front, other.device, other.device_front), (Some(1.0), Some(-1.0), Some(-1.0)));
    }
}
