//! `motes bench`: what accuracy costs, as a report.

use std::io::Write;
use std::path::PathBuf;

use motes_app::prediction::StageRates;

use crate::bench::measure::{self, Plan};
use crate::bench::outcome::{self, Agreement, LIMITS, Outcome};
use crate::bench::record::{Journal, Record};
use crate::bench::subject::{self, Views, Wanted};
use crate::bench::{BenchError, quality, report, sweep};
use crate::error::CommandError;
use crate::measure::{DEFAULT_PIXELS_PER_DEGREE, Settings};
use crate::shots::Size;
use crate::studio::{DeviceArgs, no_complaints};

/// Measure what accuracy costs: errors, counts and times of many configurations, as HTML, CSV and JSON
#[derive(Clone, Debug, clap::Args)]
pub struct BenchArgs {
    /// Scene files or folders, each measured by itself (those of --views, or the sample, where none is named)
    pub scenes: Vec<PathBuf>,
    /// The folder for the report; a run that was cut off goes on in it
    #[arg(short, long, value_name = "DIR", required_unless_present = "list")]
    pub output: Option<PathBuf>,
    /// What to measure, separated by commas (see --list)
    #[arg(long, value_name = "quick|full|NAME,…", value_delimiter = ',', default_value = "quick")]
    pub sweep: Vec<String>,
    /// From where: a file of cameras, and names of some of them
    #[arg(long, value_name = "FILE[:NAME,…]")]
    pub views: Option<Views>,
    /// From where: what the left eye saw in a recorded headset session (`motes xr --record`), in as many frames as --around
    /// says
    #[arg(long, value_name = "FILE", conflicts_with = "views")]
    pub session: Option<PathBuf>,
    /// Views around each scene, where no cameras are named
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub around: u16,
    /// Size of pictures (a camera's own, else 400x300)
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
    /// Rounds: every configuration is timed once in each
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub rounds: u32,
    /// Pixels per degree of the visual field, for FLIP
    #[arg(long, value_name = "N", default_value_t = DEFAULT_PIXELS_PER_DEGREE)]
    pub ppd: f32,
    /// Rates of a device that was measured, as JSON, instead of the built-in prediction for a Quest 3
    #[arg(long, value_name = "FILE")]
    pub rates: Option<PathBuf>,
    /// An earlier run, to say how the two agree
    #[arg(long, value_name = "DIR")]
    pub against: Option<PathBuf>,
    /// Write the table of qualities that `--quality` uses here
    #[arg(long, value_name = "FILE")]
    pub presets: Option<PathBuf>,
    /// Write the report from what the folder holds, without measuring
    #[arg(long)]
    pub report_only: bool,
    /// List the sweeps
    #[arg(long)]
    pub list: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Benches.
///
/// # Errors
/// A scene, camera, folder or device that cannot be used; configurations that cannot run are part of the report.
pub fn run(args: &BenchArgs) -> Result<(), CommandError> {
    run_to(args, &mut std::io::stdout().lock(), true)
}

fn run_to(args: &BenchArgs, out: &mut impl Write, progress: bool) -> Result<(), CommandError> {
    if args.list {
        for (name, about) in sweep::names() {
            let count = sweep::configurations(&[name.to_owned()])?.len();
            writeln!(out, "{name:<18} {count:>4} configurations: {about}").map_err(CommandError::Print)?;
        }
        return Ok(());
    }
    let Some(folder) = &args.output else {
        return Err(CommandError::Usage("name a folder for the report, by -o".into()));
    };
    let rates = rates(args)?;
    let record = if args.report_only { Record::read(folder)? } else { measured(args, folder, progress)? };
    let outcomes = outcome::outcomes(&record, &rates)?;
    let agreement = match &args.against {
        None => Vec::new(),
        Some(other) => outcome::agreement(&outcomes, &outcome::outcomes(&Record::read(other)?, &rates)?),
    };
    let contents = report::Contents {
        folder,
        record: &record,
        outcomes: &outcomes,
        rates: &rates,
        pixels_per_degree: args.ppd,
        agreement: &agreement,
    };
    if let Some(path) = &args.presets {
        let table = quality::table(&record, &outcomes, command(args), args.ppd)?;
        let text = serde_json::to_string_pretty(&table).map_err(|e| CommandError::Usage(e.to_string()))?;
        std::fs::write(path, text + "\n").map_err(CommandError::io(path))?;
    }
    let files = report::write(&contents)?;
    say(out, &record, &outcomes, &agreement).map_err(CommandError::Print)?;
    writeln!(out, "{}", files.html.display()).map_err(CommandError::Print)?;
    Ok(())
}

/// The command line in short, for whoever reads the table.
fn command(args: &BenchArgs) -> String {
    let mut words = vec!["motes bench".to_owned()];
    let name = |p: &PathBuf| p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    words.extend(args.scenes.iter().map(name));
    if let Some(views) = &args.views {
        words.push(format!("--views {}:{}", name(&views.path), views.names.join(",")));
    }
    if let Some(session) = &args.session {
        words.push(format!("--session {} --around {}", name(session), args.around));
    }
    words.push(format!("--sweep {}", args.sweep.join(",")));
    words.join(" ")
}

fn rates(args: &BenchArgs) -> Result<StageRates, BenchError> {
    let Some(path) = &args.rates else { return Ok(StageRates::quest_3()) };
    let text = std::fs::read_to_string(path).map_err(BenchError::io(path))?;
    let problem = |problem: String| BenchError::File { path: path.clone(), problem };
    let rates: StageRates = serde_json::from_str(&text).map_err(|e| problem(e.to_string()))?;
    rates.problem().map_or(Ok(rates), |p| Err(problem(p)))
}

fn measured(args: &BenchArgs, folder: &std::path::Path, progress: bool) -> Result<Record, CommandError> {
    let points = sweep::configurations(&args.sweep)?;
    // The projection errs towards the rim: its experiment takes a headset's field of view as well.
    let wide = args.sweep.iter().any(|s| s == "projection" || s == "full").then_some("projection");
    let wanted = Wanted {
        scenes: &args.scenes,
        views: args.views.as_ref(),
        session: args.session.as_deref(),
        size: args.size.map(|s| s.0),
        automatic: args.around.into(),
        wide,
    };
    let subjects = subject::subjects(&wanted)?;
    let mut journal = Journal::open(folder)?;
    let gpu = args.device.offscreen()?;
    let plan = Plan {
        subjects: &subjects,
        points: &points,
        of_experiment: &|name| sweep::configurations(&[name.to_owned()]).unwrap_or_default(),
        rounds: args.rounds,
        settings: Settings { pixels_per_degree: args.ppd, ..Settings::default() },
        folder,
        progress,
    };
    measure::run(&plan, &gpu, &mut journal)?;
    no_complaints(&gpu)?;
    Ok(journal.record)
}

/// The answers in words.
fn say(
    out: &mut impl Write,
    record: &Record,
    outcomes: &[Outcome],
    agreement: &[Agreement],
) -> std::io::Result<()> {
    for scene in &record.scenes {
        if scene.only.is_some() {
            continue;
        }
        writeln!(out, "{}: {} splats", scene.scene, scene.splats)?;
        for limit in LIMITS {
            match outcome::cheapest_within(outcomes, &scene.scene, limit).map(|i| &outcomes[i]) {
                Some(o) => writeln!(
                    out,
                    "  FLIP ≤ {limit}: {} ({:.1} layers, predicted {:.1} ms on a headset)",
                    o.configuration,
                    o.layers,
                    o.predicted.ms()
                )?,
                None => writeln!(out, "  FLIP ≤ {limit}: none of the configurations that were measured")?,
            }
        }
    }
    for r in &record.refusals {
        writeln!(out, "{}: {} cannot run: {}", r.scene, r.configuration, r.reason)?;
    }
    for a in agreement {
        let text = |v: Option<f64>| v.map_or_else(|| "–".to_owned(), |v| format!("{v:.3}"));
        writeln!(
            out,
            "{}: rank correlation with the earlier run over {} configurations: front {}, all {}; by time here: \
             front {}, all {}",
            a.scene,
            a.shared,
            text(a.front),
            text(a.predicted),
            text(a.device_front),
            text(a.device)
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: BenchArgs,
    }

    fn bench(words: &[&str]) -> Result<String, String> {
        let line = std::iter::once("bench").chain(words.iter().copied());
        let cli = Cli::try_parse_from(line).map_err(|e| e.to_string())?;
        let mut out = Vec::new();
        run_to(&cli.args, &mut out, false).map_err(|e| e.to_string())?;
        Ok(String::from_utf8(out).unwrap())
    }

    #[test]
    fn sweeps_are_listed_and_mistakes_are_named() {
        let list = bench(&["--list"]).unwrap();
        for (name, _) in sweep::names() {
            assert!(list.contains(name), "{name}");
        }
        assert!(bench(&[]).is_err());
        let folder = std::env::temp_dir().join(format!("motes-bench-command-{}", std::process::id()));
        let folder = folder.to_str().unwrap();
        assert!(bench(&["-o", folder, "--sweep", "quik"]).unwrap_err().contains("quik"));
        assert!(bench(&["-o", folder, "--report-only"]).unwrap_err().contains("measurements.jsonl"));
        assert!(bench(&["-o", folder, "--rates", "none.json"]).unwrap_err().contains("none.json"));
        let bad = std::env::temp_dir().join(format!("motes-rates-{}.json", std::process::id()));
        let rates = StageRates { splats_per_second: -1.0, ..StageRates::quest_3() };
        std::fs::write(&bad, serde_json::to_string(&rates).unwrap()).unwrap();
        let error = bench(&["-o", folder, "--rates", bad.to_str().unwrap()]).unwrap_err();
        assert!(error.contains("positive"), "{error}");
    }
}
