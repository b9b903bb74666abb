//! The table of qualities that the viewer's `--quality` uses, from the measured fronts of all scenes of a bench.

use motes_app::quality::{Point, Provenance, Table};

use super::BenchError;
use super::front::pareto;
use super::outcome::{Outcome, is_candidate};
use super::record::Record;

/// Choices that headsets and some PCs lack, or that need more than one frame to look as they should: they cannot be what
/// a quality stands for. (32-bit sums can: PCs blend them, and half floats alone miss 0.01 on dense scenes.)
const NOT_EVERYWHERE: &[(&str, &str)] =
    &[("expansion", "geometry"), ("sort", "stochastic"), ("upscale", "interleaved-temporal")];

/// The table: configurations that were measured on every scene, by their largest error and their mean cost over the
/// default's.
///
/// # Errors
/// No scene, or none of them with the default.
pub fn table(
    record: &Record,
    outcomes: &[Outcome],
    command: String,
    pixels_per_degree: f32,
) -> Result<Table, BenchError> {
    let scenes: Vec<&str> =
        record.scenes.iter().filter(|s| s.only.is_none()).map(|s| s.scene.as_str()).collect();
    let find = |scene: &str, name: &str| {
        outcomes.iter().find(|o| o.scene == scene && o.configuration == name).filter(|o| is_candidate(o))
    };
    let mut points = Vec::new();
    for name in &record.configurations {
        let everywhere =
            !NOT_EVERYWHERE.iter().any(|(choice, value)| name.contains(&format!("{choice}={value}")));
        let of_scenes: Option<Vec<(f64, f64)>> = scenes
            .iter()
            .map(|scene| {
                let (o, default) = (find(scene, name)?, find(scene, "default")?);
                Some((o.flip, o.predicted.ms() / default.predicted.ms()))
            })
            .collect();
        if let (true, Some(of_scenes)) = (everywhere, of_scenes)
            && !of_scenes.is_empty()
        {
            points.push(Point {
                configuration: name.clone(),
                flip: of_scenes.iter().map(|p| p.0).fold(0.0, f64::max),
                cost: of_scenes.iter().map(|p| p.1).sum::<f64>() / of_scenes.len() as f64,
            });
        }
    }
    let front = pareto(&points.iter().map(|p| (p.flip, p.cost)).collect::<Vec<_>>());
    let (Some(machine), Some(truth)) = (record.machines.last(), record.truths.first()) else {
        return Err(BenchError::Setting("nothing was measured that qualities could come from".into()));
    };
    if front.is_empty() {
        return Err(BenchError::Setting("no configuration was measured on every scene".into()));
    }
    Ok(Table {
        provenance: Provenance {
            command,
            date: machine.date.clone(),
            commit: machine.commit.clone(),
            device: format!("{}, {}", machine.device, machine.driver),
            scenes: scenes.into_iter().map(str::to_owned).collect(),
            size: truth.size,
            pixels_per_degree,
        },
        points: front.into_iter().map(|i| points[i].clone()).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::outcome::tests::{parsed, record};
    use super::super::outcome::{self};
    use super::super::record::{Machine, TruthRecord};
    use super::*;
    use motes_app::prediction::StageRates;

    #[test]
    fn the_table_is_the_front_of_what_runs_everywhere() {
        let mut record = parsed(&record(&[
            ("default", 0.001, 5000, 10.0),
            ("shape=diamond", 0.02, 2500, 5.0),
            ("shape=square", 0.02, 6000, 5.0),
            ("expansion=geometry", 0.0, 4000, 5.0),
            ("sort-interval=30", 0.0, 10, 5.0),
        ]));
        let outcomes = outcome::outcomes(&record, &StageRates::quest_3()).unwrap();
        assert!(table(&record, &outcomes, "x".into(), 67.0).is_err(), "nobody says where it was measured");
        record.machines.push(Machine {
            device: "d".into(),
            driver: "v".into(),
            api: "1.3".into(),
            software: true,
            processor: "p".into(),
            threads: 2,
            system: "s".into(),
            version: "0".into(),
            commit: None,
            date: "today".into(),
        });
        record.truths.push(TruthRecord {
            scene: "plant".into(),
            view: "a".into(),
            size: [4, 3],
            what: String::new(),
            seconds: 0.0,
            layers: None,
            hidden: None,
            stand_in_psnr: None,
        });
        let table = table(&record, &outcomes, "motes bench".into(), 67.0).unwrap();
        let names: Vec<_> = table.points.iter().map(|p| p.configuration.as_str()).collect();
        assert_eq!(names, ["default", "shape=diamond"]);
        assert_eq!((table.points[0].cost, table.points[1].flip), (1.0, 0.02));
        assert!(table.points[1].cost < 0.6 && table.provenance.scenes == ["plant"]);
    }
}
