//! The report of a bench: one HTML file that needs nothing else, and the same as CSV and JSON.

mod pages;
mod pictures;
mod table;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use motes_app::prediction::StageRates;
use motes_renderer::CHOICES;
use serde::Serialize;

use super::outcome::{self, LIMITS, Outcome};
use super::record::{Machine, Record, Refusal, SceneRecord, TruthRecord};
use super::{BenchError, measure, truth};
use pages::{ExperimentPage, Surface};
use pictures::Album;

/// Refresh rates that budgets are stated for, Hz.
pub const REFRESH_RATES: [f64; 3] = [72.0, 90.0, 120.0];

/// Bytes of pictures that the HTML file holds, at most: what is on a front comes first.
const ALBUM_BYTES: usize = 14 << 20;

/// Files of a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Files {
    /// The page.
    pub html: PathBuf,
    /// A row for every scene and configuration.
    pub csv: PathBuf,
    /// Everything that the page shows, without the pictures.
    pub json: PathBuf,
}

/// A scene in the report.
#[derive(Serialize)]
struct SceneSummary<'a> {
    #[serde(flatten)]
    scene: &'a SceneRecord,
    truths: Vec<&'a TruthRecord>,
    /// Layers per pixel that fit into a frame of a headset at each of the refresh rates, splats of both eyes paid.
    budgets: [f64; 3],
    /// Configurations on the front, from the most exact.
    front: Vec<&'a str>,
    /// The cheapest configuration within each of the limits.
    answers: [Option<&'a str>; 3],
}

#[derive(Serialize)]
struct Report<'a> {
    limits: [f64; 3],
    refresh_rates: [f64; 3],
    rates: &'a StageRates,
    machines: &'a [Machine],
    pixels_per_degree: f32,
    choices: Vec<(&'static str, &'static str)>,
    scenes: Vec<SceneSummary<'a>>,
    outcomes: &'a [Outcome],
    refusals: &'a [Refusal],
    experiments: Vec<ExperimentPage>,
    surface: Surface,
    agreement: &'a [outcome::Agreement],
}

/// What a report is made of.
pub struct Contents<'a> {
    /// The bench's folder.
    pub folder: &'a Path,
    /// What was measured.
    pub record: &'a Record,
    /// What came of it.
    pub outcomes: &'a [Outcome],
    /// The headset that is predicted for.
    pub rates: &'a StageRates,
    /// For FLIP.
    pub pixels_per_degree: f32,
    /// How an earlier run agrees.
    pub agreement: &'a [outcome::Agreement],
}

/// Writes the report into the bench's folder.
///
/// # Errors
/// The file system's, or a picture of the bench that is gone.
pub fn write(contents: &Contents<'_>) -> Result<Files, BenchError> {
    let Contents { folder, record, outcomes, rates, .. } = *contents;
    let names =
        |indices: Vec<usize>| indices.into_iter().map(|i| outcomes[i].configuration.as_str()).collect();
    let scenes: Vec<SceneSummary<'_>> = record
        .scenes
        .iter()
        .map(|scene| SceneSummary {
            scene,
            truths: record.truths.iter().filter(|t| t.scene == scene.scene).collect(),
            budgets: REFRESH_RATES.map(|hz| rates.layers_at(hz, 2.0 * f64::from(scene.splats))),
            front: names(outcome::front_of(outcomes, &scene.scene)),
            answers: LIMITS.map(|limit| {
                outcome::cheapest_within(outcomes, &scene.scene, limit)
                    .map(|i| outcomes[i].configuration.as_str())
            }),
        })
        .collect();
    let report = Report {
        limits: LIMITS,
        refresh_rates: REFRESH_RATES,
        rates,
        machines: &record.machines,
        pixels_per_degree: contents.pixels_per_degree,
        choices: CHOICES.iter().map(|c| (c.name, c.about)).collect(),
        outcomes,
        refusals: &record.refusals,
        experiments: pages::experiments(contents)?,
        surface: Surface::new(),
        agreement: contents.agreement,
        scenes,
    };
    let album = album(contents, &report)?;
    let json = serde_json::to_string(&report).map_err(|e| BenchError::Setting(format!("report: {e}")))?;
    let pictures =
        serde_json::to_string(&album.pictures).map_err(|e| BenchError::Setting(format!("report: {e}")))?;
    let html = include_str!("page.html")
        .replace("/*STYLE*/", include_str!("page.css"))
        .replace("/*SCRIPT*/", include_str!("page.js"))
        // Whatever stands in a name, it cannot end the element that holds it.
        .replace("/*REPORT*/", &json.replace('<', "\\u003c"))
        .replace("/*PICTURES*/", &pictures.replace('<', "\\u003c"));
    let files = Files {
        html: folder.join("report.html"),
        csv: folder.join("results.csv"),
        json: folder.join("results.json"),
    };
    let save = |path: &Path, text: &str| std::fs::write(path, text).map_err(BenchError::io(path));
    save(&files.html, &html)?;
    save(&files.json, &json)?;
    save(&files.csv, &table::csv(outcomes, &record.refusals))?;
    Ok(files)
}

/// Thumbnails: of every scene's truth and layers, then of configurations, the fronts first, as many as fit.
fn album(contents: &Contents<'_>, report: &Report<'_>) -> Result<Album, BenchError> {
    let mut album = Album::new(ALBUM_BYTES);
    let mut wanted: Vec<(&str, &str)> = Vec::new();
    for scene in &report.scenes {
        let name = scene.scene.scene.as_str();
        let Some(first) = scene.truths.first() else { continue };
        album.add(&format!("{name}|truth"), &truth::path(contents.folder, name, &first.view))?;
        if first.layers.is_some() {
            let path = truth::layers_path(contents.folder, name, &first.view);
            album.add(&format!("{name}|layers"), &path)?;
        }
        wanted.extend(scene.answers.iter().flatten().map(|c| (name, *c)));
    }
    for scene in &report.scenes {
        let name = scene.scene.scene.as_str();
        wanted.push((name, "default"));
        wanted.extend(scene.front.iter().map(|c| (name, *c)));
    }
    wanted.extend(contents.outcomes.iter().map(|o| (o.scene.as_str(), o.configuration.as_str())));
    let mut seen: BTreeMap<(&str, &str), ()> = BTreeMap::new();
    for (scene, configuration) in wanted {
        if seen.insert((scene, configuration), ()).is_some() {
            continue;
        }
        let summary = report.scenes.iter().find(|s| s.scene.scene == scene);
        let Some(view) = summary.and_then(|s| s.truths.first()) else { continue };
        let picture = measure::picture_path(contents.folder, scene, configuration);
        let truth = truth::path(contents.folder, scene, &view.view);
        let layers = measure::layers_path(contents.folder, scene, configuration);
        let key = format!("{scene}|{configuration}");
        if !album.add_pair(&key, &picture, &truth, &layers, contents.pixels_per_degree)? {
            break;
        }
    }
    Ok(album)
}

#[cfg(test)]
mod tests {
    use super::super::outcome::tests::{parsed, record};
    use super::*;
    use crate::measure::Picture;

    /// A whole report of a made-up run: every figure is in all three files, and nothing in the page asks for a network.
    #[test]
    fn a_report_is_whole() {
        let lines = record(&[
            ("default", 0.001, 5000, 10.0),
            ("shape=diamond", 0.02, 2500, 5.0),
            (
                "expansion=geometry projection=affine shape=square radius=sqrt8 order=depth composite=back-to-front",
                0.0,
                9000,
                1.0,
            ),
        ]);
        let mut record = parsed(&lines);
        let folder = std::env::temp_dir().join(format!("motes-report-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        for sub in ["truth", "pictures"] {
            std::fs::create_dir_all(folder.join(sub)).unwrap();
        }
        record.truths.push(TruthRecord {
            scene: "plant".into(),
            view: "a".into(),
            size: [32, 24],
            what: "reference </script> by name".into(),
            seconds: 1.0,
            layers: Some([12.5, 99.0]),
            hidden: Some(2.0),
            stand_in_psnr: None,
        });
        let picture = |v: f32| Picture::new([32, 24], vec![[v; 3]; 32 * 24]).unwrap();
        picture(0.5).save(&truth::path(&folder, "plant", "a")).unwrap();
        picture(0.1).save(&truth::layers_path(&folder, "plant", "a")).unwrap();
        for (name, v) in record.configurations.iter().zip([0.5, 0.6, 0.4]) {
            picture(v).save(&measure::picture_path(&folder, "plant", name)).unwrap();
        }
        let rates = StageRates::quest_3();
        let outcomes = outcome::outcomes(&record, &rates).unwrap();
        let contents = Contents {
            folder: &folder,
            record: &record,
            outcomes: &outcomes,
            rates: &rates,
            pixels_per_degree: 67.0,
            agreement: &[],
        };
        let files = write(&contents).unwrap();
        let html = std::fs::read_to_string(&files.html).unwrap();
        for needle in ["http://", "https://", "src=\"/", "@import", "/*REPORT*/", "/*SCRIPT*/"] {
            assert!(!html.contains(needle), "the page has {needle}");
        }
        assert_eq!(html.matches("</script>").count(), 3, "a name has ended an element");
        assert_eq!(html.matches("data:image/png;base64,").count(), 2 + 2 * 3);
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(&files.json).unwrap()).unwrap();
        assert_eq!(json["outcomes"].as_array().unwrap().len(), 3);
        assert_eq!(json["refusals"][0]["reason"], "it is not there");
        assert_eq!(json["scenes"][0]["answers"][0].as_str().unwrap(), "default");
        assert_eq!(json["scenes"][0]["answers"][2].as_str().unwrap(), "shape=diamond");
        let shape = json["experiments"].as_array().unwrap().iter().find(|e| e["name"] == "shape").unwrap();
        // The diamond of the report's own viewer was not measured here; its rows say so rather than guess.
        assert!(shape["rows"][0]["ours"][0]["text"].as_str().unwrap().contains("not measured"), "{shape}");
        let csv = std::fs::read_to_string(&files.csv).unwrap();
        assert_eq!(csv.lines().count(), 1 + 3 + 1);
        let row = csv.lines().find(|l| l.contains("shape=diamond")).unwrap();
        assert!(row.contains("0.02") && row.starts_with("plant,"), "{row}");
        assert!(csv.contains("it is not there"));
    }
}
