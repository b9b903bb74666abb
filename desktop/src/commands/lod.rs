//! `motes lod`: levels of detail by class – built, fitted, evaluated, listed.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use motes_app::lod::{ClassQuality, Model, Quality};
use motes_app::opened::{Opened, name_of};
use motes_renderer::View;
use motes_renderer::detail::recording::Recording;
use motes_renderer::detail::refit::Goal;
use motes_renderer::detail::{Simplify, simplify};
use motes_scenes::labels::{Class, Labels, class_colour};
use motes_scenes::levels::{self, LevelFile, NewLevel, Storage};
use motes_scenes::{LoadOptions, Splats, cameras, load};
use serde_json::json;

use super::label::{Vote, elect, options};
use super::lod_walk::{self, WalkArgs};
use super::optimize::By;
use crate::error::CommandError;
use crate::lod::cross::{Summary, Trial, summary, trial};
use crate::lod::fit::{self, LEAST_VIEWS, Line, line, means};
use crate::lod::observe::{self, Against, Target};
use crate::lod::plots;
use crate::measure::Matching;
use crate::vantage::{JudgeArgs, LookArgs, Seat};

/// Levels of detail by class: build them, fit their quality, test what the fit promises
#[derive(Clone, Debug, clap::Args)]
pub struct LodArgs {
    #[command(subcommand)]
    command: LodCommand,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum LodCommand {
    Build(BuildArgs),
    Fit(FitArgs),
    Eval(EvalArgs),
    Walk(WalkArgs),
    Info(InfoArgs),
}

/// Write a file of levels, from training snapshots or by simplifying one scene
#[derive(Clone, Debug, clap::Args)]
pub struct BuildArgs {
    /// Snapshots of one training, with the iteration as the last number of each name; or one scene
    #[arg(required = true)]
    pub scenes: Vec<PathBuf>,
    /// The file, .mlod
    #[arg(short, long, value_name = "OUT.mlod")]
    pub output: PathBuf,
    /// Levels to make of one scene, itself included
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=12))]
    pub levels: u32,
    /// Splats of a level, as a share of the next finer one's
    #[arg(long, value_name = "SHARE", default_value_t = 0.5, value_parser = share)]
    pub ratio: f64,
    /// What goes first for a coarser level
    #[arg(long, value_enum, default_value_t = By::Layers)]
    pub by: By,
    /// Masks that give each splat its class (else the labels beside the scene, else one class)
    #[arg(long, value_name = "FOLDER")]
    pub masks: Option<PathBuf>,
    /// Split classes into cubes with sides of so many scene units, each with levels of its own
    #[arg(long, value_name = "SIDE")]
    pub cell: Option<f64>,
    /// Store every bit, as PLY, instead of SPZ
    #[arg(long)]
    pub exact: bool,
    #[command(flatten)]
    look: LookArgs,
}

/// Observe the levels and fit SSIM over level and distance for each class; the fit is kept in the file
#[derive(Clone, Debug, clap::Args)]
pub struct FitArgs {
    /// A file of levels
    pub file: PathBuf,
    /// Write figures (report.json) and plots (SVG) here
    #[arg(short = 'o', long, value_name = "FOLDER")]
    pub report: Option<PathBuf>,
    /// Observe all views, also those kept for judging
    #[arg(long)]
    pub all_views: bool,
    /// Leave out classes that fewer views saw
    #[arg(long, value_name = "N", default_value_t = LEAST_VIEWS)]
    pub least_views: usize,
    #[command(flatten)]
    judged: Judged,
}

/// Test the fit on views that it has not seen: predicted SSIM against measured, and what is saved
#[derive(Clone, Debug, clap::Args)]
pub struct EvalArgs {
    /// A file of levels
    pub file: PathBuf,
    /// Take the fit of another file, whose classes have the same names (cross-model test)
    #[arg(long, value_name = "FILE.mlod")]
    pub model: Option<PathBuf>,
    /// SSIM to reach, separated by commas
    #[arg(long, value_name = "SSIM,…", value_delimiter = ',', default_value = "0.5,0.6,0.7,0.8")]
    pub targets: Vec<f64>,
    /// Write every trial (trials.json) here
    #[arg(short = 'o', long, value_name = "FOLDER")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    judged: Judged,
}

/// How views are judged.
#[derive(Clone, Debug, clap::Args)]
pub struct Judged {
    /// Masks of the photographs (else made from the finest level's classes)
    #[arg(long, value_name = "FOLDER")]
    pub masks: Option<PathBuf>,
    /// What SSIM is against
    #[arg(long, value_enum, default_value_t = Against::Photographs)]
    pub against: Against,
    /// Bring the colours of pictures near the photographs' first
    #[arg(long = "match", value_name = "HOW")]
    pub matching: Option<Matching>,
    /// Cameras of the views (those beside the file)
    #[arg(long, value_name = "FILE", help_heading = "From where")]
    pub cameras: Option<PathBuf>,
    #[command(flatten)]
    judging: JudgeArgs,
}

/// List a file's levels, classes, groups and fit
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// A file of levels
    pub file: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if value > 0.0 && value < 1.0 { Ok(value) } else { Err("it must be above 0 and below 1".into()) }
}

/// Runs a subcommand.
///
/// # Errors
/// A file cannot be read or written, or views are missing.
pub fn run(args: &LodArgs) -> Result<(), CommandError> {
    match &args.command {
        LodCommand::Build(args) => build(args),
        LodCommand::Fit(args) => fit(args),
        LodCommand::Eval(args) => eval(args),
        LodCommand::Walk(args) => lod_walk::run(args),
        LodCommand::Info(args) => info(args),
    }
}

pub(super) fn say(text: &str) -> Result<(), CommandError> {
    std::io::stdout().write_all(text.as_bytes()).map_err(CommandError::Print)
}

/// The last number in a file's name.
fn iteration(path: &Path) -> Option<f64> {
    let name = path.file_stem()?.to_string_lossy().into_owned();
    name.split(|c: char| !c.is_ascii_digit()).rfind(|n| !n.is_empty())?.parse().ok().filter(|n| *n > 0.0)
}

fn build(args: &BuildArgs) -> Result<(), CommandError> {
    if let Some(cell) = args.cell.filter(|c| !(*c > 0.0 && c.is_finite())) {
        return Err(CommandError::Usage(format!("--cell is a length above 0, not {cell}")));
    }
    let finest = args
        .scenes
        .iter()
        .max_by(|a, b| iteration(a).partial_cmp(&iteration(b)).unwrap_or(std::cmp::Ordering::Equal));
    let finest = finest.ok_or_else(|| CommandError::Usage("no scene is named".into()))?;
    let opened = Opened::load(std::slice::from_ref(finest), &LoadOptions::default())?;
    let loaded = args.look.cameras.as_deref().map(cameras::load).transpose()?;
    let all_cameras = loaded.as_deref().unwrap_or(&opened.cameras);
    let mut classes = opened.classes.clone();
    let mut label = |splats: &mut Splats| -> Result<(), CommandError> {
        if let Some(masks) = &args.masks {
            let labels = Labels::of_ids(elect(splats, all_cameras, masks, Vote::default())?.0.labels);
            for class in labels.classes {
                if !classes.iter().any(|c| c.id == class.id) {
                    classes.push(class);
                }
            }
            splats.labels = Some(labels.ids);
        }
        if splats.labels.is_none() {
            // A fit is one of a class: here of the class of everything.
            splats.labels = Some(vec![1; splats.len()]);
            if !classes.iter().any(|c| c.id == 1) {
                classes.push(Class { id: 1, name: "everything".into(), colour: class_colour(1) });
            }
        }
        Ok(())
    };
    let mut list = Vec::new();
    if args.scenes.len() == 1 {
        let mut splats = opened.scene.splats.clone();
        label(&mut splats)?;
        let (look, _) = args.look.views(&opened)?;
        list = simplified(splats, &opened.name, &look, args)?;
    } else {
        for path in &args.scenes {
            let step = iteration(path).ok_or_else(|| {
                CommandError::Usage(format!(
                    "{}: its name holds no iteration, like iteration_00500.spz",
                    path.display()
                ))
            })?;
            let mut splats = load(path, &LoadOptions::default())?.splats;
            label(&mut splats)?;
            list.push(NewLevel { name: name_of(path), step, splats });
        }
        list.sort_by(|a, b| b.step.total_cmp(&a.step));
    }
    classes.sort_by_key(|c: &Class| c.id);
    let storage = if args.exact { Storage::Ply } else { Storage::Spz };
    levels::save(&args.output, &list, &classes, args.cell, storage)?;
    drop(list);
    say(&listing(&LevelFile::open(&args.output)?))
}

/// Levels of one scene: each is made from the finer one before it, so that they look alike where they differ little.
fn simplified(
    splats: Splats,
    name: &str,
    look: &[View],
    args: &BuildArgs,
) -> Result<Vec<NewLevel>, CommandError> {
    let whole = splats.len() as f64;
    let goals: Vec<Goal> = look.iter().map(|v| Goal::of(&splats, v, &options())).collect::<Result<_, _>>()?;
    let mut list = vec![NewLevel { name: name.to_owned(), step: 1000.0, splats }];
    let bar = ProgressBar::new(u64::from(args.levels));
    for level in 1..args.levels {
        bar.inc(1);
        let share = args.ratio.powi(level as i32);
        let mut coarser = list[level as usize - 1].splats.clone();
        let keep = ((whole * share) as usize).max(1);
        let how = Simplify { keep, rank: args.by.rank(), rounds: 2, ..Simplify::default() };
        let recording = Recording::of(&coarser, look, &options())?;
        simplify(&mut coarser, recording, &goals, &options(), &how, |_| ())?;
        let name = format!("{name}, {:.1} %", 100.0 * share);
        list.push(NewLevel { name, step: 1000.0 * share, splats: coarser });
    }
    bar.finish_and_clear();
    Ok(list)
}

/// The views to fit to and those to judge by.
fn seats(file: &LevelFile, judged: &Judged) -> Result<(Splats, Vec<Seat>, Vec<Seat>), CommandError> {
    let finest = observe::level(file, 0)?;
    let path = file.path().to_owned();
    let list = match &judged.cameras {
        Some(file) => cameras::load(file)?,
        None => cameras::beside(&path).map(|f| cameras::load(&f)).transpose()?.unwrap_or_default(),
    };
    if list.is_empty() {
        return Err(CommandError::Usage(
            "the levels' cameras are not known: name a file of them by --cameras".into(),
        ));
    }
    let (fit, judge) = judged.judging.seats(&list)?;
    Ok((finest, fit, judge))
}

/// A class's line over `ln i`, for the report.
#[derive(serde::Serialize)]
struct OverIterations {
    class: u16,
    name: String,
    means: Vec<[f64; 2]>,
    line: Option<Line>,
}

fn fit(args: &FitArgs) -> Result<(), CommandError> {
    let file = LevelFile::open(&args.file)?;
    let (finest, mut seats, judge) = seats(&file, &args.judged)?;
    if args.all_views {
        seats.extend(judge);
    }
    let Judged { masks, against, matching, .. } = &args.judged;
    let targets = observe::targets(&finest, &seats, masks.as_ref(), *against, &options())?;
    let bar = ProgressBar::new(file.levels().len() as u64);
    let observations =
        observe::observe(&file, &targets, *matching, &options(), |k| bar.set_position(k as u64))?;
    bar.finish_and_clear();
    let mut text = format!("{} views, {} levels\n\n", targets.len(), file.levels().len());
    let mut lines = Vec::new();
    text += "mean SSIM over iterations, a ln(i) + b\n";
    let named = Labels { classes: file.classes(), ids: finest.labels.clone().unwrap_or_default() };
    let mut model = Model { classes: Vec::new(), against: word(*against).to_owned() };
    for (id, _) in named.counts().iter().enumerate().skip(1).filter(|(_, n)| **n > 0) {
        let class = id as u16;
        let name = named.class(class).map_or_else(|| format!("class {class}"), |c| c.name.clone());
        let means = means(&observations, class);
        let points: Vec<[f64; 2]> = means.iter().map(|p| [p[0].max(1.0).ln(), p[1]]).collect();
        let found = line(&points);
        if let Some(l) = found {
            let Line { a, b, residual, r2, .. } = l;
            let _ = writeln!(text, "  {name:24} a {a:8.4}  b {b:8.4}  residual {residual:.4}  R² {r2:.3}");
        }
        lines.push(OverIterations { class, name: name.clone(), means, line: found });
        match fit::fit(&observations, class, &name, args.least_views) {
            Some(quality) => model.classes.push(quality),
            None => {
                let _ = writeln!(text, "  {name:24} left out: fewer than {} views saw it", args.least_views);
            }
        }
    }
    text += "\nSSIM over iterations and minimum distance, equation 6.4\n";
    for c in &model.classes {
        let _ = writeln!(
            text,
            "  {:24} residual {:.4}  R² {:.3}  {} views  {}",
            c.name,
            c.residual,
            c.r2,
            c.views,
            form(c)
        );
    }
    if let Some(folder) = &args.report {
        std::fs::create_dir_all(folder).map_err(CommandError::io(folder))?;
        for quality in &model.classes {
            plots::class(folder, quality, &observations)?;
        }
        let report = json!({"lines": lines, "model": model, "observations": observations,
            "views": targets.iter().map(|t| &t.name).collect::<Vec<_>>()});
        write_json(&folder.join("report.json"), &report)?;
    }
    let kept = serde_json::to_value(&model).map_err(|e| CommandError::Print(e.into()))?;
    file.save_with(&args.file, json!({"model": kept}))?;
    say(&text)
}

fn word(against: Against) -> &'static str {
    match against {
        Against::Photographs => "photographs",
        Against::Finest => "finest",
    }
}

fn form(c: &ClassQuality) -> String {
    match &c.quality {
        Quality::Curve { near, far, beta, b } => {
            let branch = |x: &motes_app::lod::Branch| {
                format!("K {:.4} γ {:.3} μ {:.2} α {:.2}", x.k, x.gamma, x.mu, x.alpha)
            };
            format!("{} | {} | β {beta:.2} b {b:.4}", branch(near), branch(far))
        }
        Quality::Logarithm { a, b } => format!("{a:.4} ln(i) + {b:.4}: distances say too little"),
        Quality::Steps { .. } => "means of the levels, made to rise: no logarithm fits".into(),
    }
}

pub(super) fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(value).map_err(|e| CommandError::Print(e.into()))?;
    std::fs::write(path, text + "\n").map_err(CommandError::io(path))
}

fn eval(args: &EvalArgs) -> Result<(), CommandError> {
    if let Some(bad) = args.targets.iter().find(|t| !(0.0..=1.0).contains(*t)) {
        return Err(CommandError::Usage(format!("--targets are SSIM, 0 to 1, not {bad}")));
    }
    let file = LevelFile::open(&args.file)?;
    let mut model = match &args.model {
        Some(other) => Model::of_file(&LevelFile::open(other)?),
        None => Model::of_file(&file),
    }
    .map_err(CommandError::Usage)?;
    if args.model.is_some() {
        // Classes are carried over by name.
        let own = file.classes();
        model.classes.retain_mut(|c| match own.iter().find(|o| o.name == c.name) {
            Some(o) => {
                c.class = o.id;
                true
            }
            None => false,
        });
        if model.classes.is_empty() {
            return Err(CommandError::Usage("the two files have no class of one name".into()));
        }
    }
    let (finest, _, seats) = seats(&file, &args.judged)?;
    let Judged { masks, against, matching, .. } = &args.judged;
    if model.against != word(*against) {
        let (fitted, now) = (&model.against, word(*against));
        return Err(CommandError::Usage(format!(
            "the fit is against {fitted}, not {now}: say --against {fitted}"
        )));
    }
    let targets: Vec<Target> = observe::targets(&finest, &seats, masks.as_ref(), *against, &options())?;
    // Whether the fit knew of those that are named, nobody can say here.
    let named = args.judged.judging.judge.is_some();
    let which = if named { "named" } else { "not fitted to" };
    let mut text = format!("{} views that were {which}\n\n", targets.len());
    text += "target   splats   SSIM of pictures   |predicted − measured|   of views    bias   of means   target kept\n";
    let (mut all, mut summaries): (Vec<Trial>, Vec<Summary>) = (Vec::new(), Vec::new());
    let bar = ProgressBar::new((args.targets.len() * targets.len()) as u64);
    for &wanted in &args.targets {
        let mut trials = Vec::new();
        for target in &targets {
            trials.push(trial(&file, &model, target, wanted, *matching, &options())?);
            bar.inc(1);
        }
        let s = summary(&trials);
        let _ = writeln!(
            text,
            "{wanted:6.2} {:7.1} % {:18.4} {:24.4} {:10.4} {:+7.4} {:10.4} {:11.1} %",
            100.0 * s.splats,
            s.whole,
            s.absolute,
            s.of_views,
            s.bias,
            s.of_means,
            100.0 * s.kept
        );
        summaries.push(s);
        all.extend(trials);
    }
    bar.finish_and_clear();
    text +=
        "\nper class, over all targets: levels used, predicted and measured SSIM, mean absolute difference\n";
    for class in &model.classes {
        let mine: Vec<_> = all.iter().flat_map(|t| &t.classes).filter(|p| p.class == class.class).collect();
        let mean = |f: &dyn Fn(&crate::lod::cross::Promise) -> f64| {
            mine.iter().map(|p| f(p)).sum::<f64>() / mine.len().max(1) as f64
        };
        let _ = writeln!(
            text,
            "  {:24} level {:.1}   {:.4}   {:.4}   {:.4}",
            class.name,
            mean(&|p| p.level as f64),
            mean(&|p| p.predicted),
            mean(&|p| p.measured),
            mean(&|p| (p.predicted - p.measured).abs())
        );
    }
    if let Some(folder) = &args.report {
        std::fs::create_dir_all(folder).map_err(CommandError::io(folder))?;
        write_json(&folder.join("trials.json"), &json!({"summaries": summaries, "trials": all}))?;
    }
    say(&text)
}

fn info(args: &InfoArgs) -> Result<(), CommandError> {
    let file = LevelFile::open(&args.file)?;
    if !args.json {
        return say(&listing(&file));
    }
    let classes: Vec<_> = file.classes().iter().map(|c| json!({"id": c.id, "name": c.name})).collect();
    let value = json!({"levels": file.levels(), "classes": classes, "groups": file.groups(),
        "bytes": file.bytes(), "extra": file.extra()});
    say(&format!("{value:#}\n"))
}

fn listing(file: &LevelFile) -> String {
    let mut text = String::new();
    for (k, level) in file.levels().iter().enumerate() {
        let bytes: u64 = file.groups().iter().map(|g| g.ranges[k].bytes).sum();
        let _ = writeln!(
            text,
            "level {k}: {:28} step {:8.1} {:9} splats {:8.2} MB",
            level.name,
            level.step,
            level.splats,
            bytes as f64 / 1e6
        );
    }
    for class in file.classes() {
        let groups: Vec<_> = file.groups().iter().filter(|g| g.class == class.id).collect();
        let splats: u64 = groups.iter().map(|g| g.ranges[0].splats).sum();
        let _ = writeln!(
            text,
            "class {:3}: {:24} {} groups, {splats} splats",
            class.id,
            class.name,
            groups.len()
        );
    }
    if let Ok(model) = Model::of_file(file) {
        let _ = writeln!(text, "fit against {}", model.against);
        for c in &model.classes {
            let _ = writeln!(text, "  {:24} residual {:.4}  R² {:.3}  {}", c.name, c.residual, c.r2, form(c));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iterations_are_the_last_numbers_of_names() {
        let of = |name: &str| iteration(Path::new(name));
        assert_eq!(of("a/iteration_00500.spz"), Some(500.0));
        assert_eq!(of("scene2_run3_30000.ply"), Some(30000.0));
        assert_eq!((of("scene.ply"), of("x_0.ply")), (None, None));
    }
}
