//! `motes optimize`: the same scene with fewer splats, without training.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use motes_app::opened::Opened;
use motes_renderer::View;
use motes_renderer::detail::merge::Alike;
use motes_renderer::detail::parasites::{Rule, parasites};
use motes_renderer::detail::recording::Recording;
use motes_renderer::detail::refit::{Effort, Goal};
use motes_renderer::detail::{Done, Rank, Simplify, opacity_cut, simplify};
use motes_scenes::labels::Labels;
use motes_scenes::{LoadOptions, Splats, save};

use super::label::options;
use crate::error::CommandError;
use crate::judge::{Bench, Figures};
use crate::measure::{ColourMap, DEFAULT_PIXELS_PER_DEGREE, Picture, Settings, coloured, flip_map};
use crate::studio::side_by_side;
use crate::vantage::{JudgeArgs, LookArgs, Seat, Vantage};

/// Make a scene cheaper to draw: prune and merge what is hardly seen, fit the rest, and say what it cost
#[derive(Clone, Debug, clap::Args)]
pub struct OptimizeArgs {
    /// Scene files or folders, merged
    #[arg(required = true)]
    pub scenes: Vec<PathBuf>,
    /// The new scene: .ply, .spz or .splat
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Keep this share of the splats (0.65, where no aim is named)
    #[arg(long, value_name = "SHARE", group = "aim")]
    pub keep: Option<f64>,
    /// Keep as few splats as this mean FLIP error allows
    #[arg(long, value_name = "ERROR", group = "aim")]
    pub flip: Option<f64>,
    /// Come down to so many layers per pixel (until a pixel is opaque), or refuse
    #[arg(long, value_name = "N", group = "aim")]
    pub layers: Option<f64>,
    /// With --layers: refuse beyond this mean FLIP error
    #[arg(long, value_name = "ERROR", default_value_t = 0.05)]
    pub at_most: f64,
    /// What goes first
    #[arg(long, value_enum, default_value_t = By::Change)]
    pub by: By,
    /// Do not merge neighbours
    #[arg(long)]
    pub no_merge: bool,
    /// Keep splats that hang before a camera
    #[arg(long)]
    pub keep_parasites: bool,
    /// Rounds of ranking, pruning and fitting
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Steps that fit colours and opacities at the end (one after each other round; 0: none at all)
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub steps: u32,
    /// Passes over all layers in each step
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub passes: u32,
    /// Write pictures of up to four views here: original, ours, opacity cut, and their errors
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
    /// Pixels per degree of the visual field, for FLIP
    #[arg(long, value_name = "N", default_value_t = DEFAULT_PIXELS_PER_DEGREE)]
    pub ppd: f32,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    judging: JudgeArgs,
}

/// What goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum By {
    /// What would change the pictures least
    Change,
    /// What would change the pictures least for each layer that it is: layers become few
    Layers,
    /// What has the least visible blending weight, summed over all pixels
    Weight,
    /// What has the least visible blending weight at its best pixel
    Peak,
}

impl By {
    /// As a rank.
    pub fn rank(self) -> Rank {
        match self {
            Self::Change => Rank::Change,
            Self::Layers => Rank::ChangePerLayer,
            Self::Weight => Rank::Weight,
            Self::Peak => Rank::Peak,
        }
    }
}

/// Every so manyth of the views to look from is kept for choosing how much to keep.
const TUNING: usize = 6;
/// Steps of the search for how much to keep: to 1.6 % of the splats.
const STEPS: u32 = 6;
/// Pictures that are written.
const SHOWN: usize = 4;
/// FLIP error that the last colour of an error map stands for.
const ERROR_SHOWN: f64 = 0.2;

/// What is said at the end.
#[derive(Debug, serde::Serialize)]
struct Report {
    file: PathBuf,
    views: String,
    parasites: usize,
    merged: usize,
    pruned: usize,
    original: Figures,
    ours: Figures,
    /// As many splats, those with the highest opacity.
    opacity_cut: Figures,
}

/// Optimises.
///
/// # Errors
/// A file cannot be read or written, or the aim cannot be met; the error says why.
pub fn run(args: &OptimizeArgs) -> Result<(), CommandError> {
    check(args)?;
    let opened = Opened::load(&args.scenes, &LoadOptions::default())?;
    for warning in &opened.scene.report.warnings {
        eprintln!("{warning}");
    }
    if opened.scene.splats.motion.is_some() {
        let what = "a moving scene cannot be optimised: what is hidden now may show later. Give a still one";
        return Err(CommandError::Usage(what.into()));
    }
    let Vantage { look, judge, said } = args.look.vantage(&opened, &args.judging)?;
    let optimised = optimise(&opened.scene.splats, &look, args)?;
    let settings = Settings { pixels_per_degree: args.ppd, ..Settings::default() };
    let progress = spinner("judging");
    let bench = Bench::new(&opened.scene.splats, &judge, &options(), settings)?;
    let (original, _) = bench.judge(&opened.scene.splats)?;
    let (ours, our_pictures) = bench.judge(&optimised.splats)?;
    let cut = opacity_cut(&opened.scene.splats, optimised.splats.len());
    let (opacity_cut, cut_pictures) = bench.judge(&cut)?;
    progress.finish_and_clear();
    if let Some(folder) = &args.pictures {
        let pictures = [bench.originals(), &our_pictures, &cut_pictures];
        write_pictures(folder, &judge, pictures, args.ppd)?;
    }
    save(&args.output, &optimised.splats)?;
    if let Some(labels) = Labels::of_splats(&optimised.splats, &opened.classes) {
        labels.save(&Labels::path_of(&args.output))?;
    }
    let report = Report {
        file: args.output.clone(),
        views: said,
        parasites: optimised.parasites,
        merged: optimised.done.merged,
        pruned: optimised.done.pruned,
        original,
        ours,
        opacity_cut,
    };
    print(&report, args.json)
}

fn check(args: &OptimizeArgs) -> Result<(), CommandError> {
    let usage = |what: String| Err(CommandError::Usage(what));
    if let Some(keep) = args.keep.filter(|k| !(*k > 0.0 && *k <= 1.0)) {
        return usage(format!("--keep is a share of the splats, above 0 and up to 1, not {keep}"));
    }
    for (name, error) in [("flip", args.flip.unwrap_or(0.01)), ("at-most", args.at_most)] {
        if !(error > 0.0 && error <= 1.0) {
            return usage(format!("--{name} is a FLIP error, above 0 and up to 1, not {error}"));
        }
    }
    if let Some(layers) = args.layers.filter(|l| !(*l > 0.0 && l.is_finite())) {
        return usage(format!("--layers is a number of layers above 0, not {layers}"));
    }
    let name = args.output.to_string_lossy().to_ascii_lowercase();
    if ![".ply", ".spz", ".splat"].iter().any(|e| name.ends_with(e)) {
        return usage(format!("{}: use a name that ends in .ply, .spz or .splat", args.output.display()));
    }
    Ok(())
}

/// A scene with fewer splats.
pub struct Optimised {
    /// The splats.
    pub splats: Splats,
    /// Splats that hung before a camera.
    pub parasites: usize,
    /// What was done to the rest.
    pub done: Done,
}

/// Brings a still scene to the aim that the arguments name, looking from these views.
///
/// # Errors
/// The aim cannot be met, or the reference's.
pub fn optimise(original: &Splats, look: &[View], args: &OptimizeArgs) -> Result<Optimised, CommandError> {
    let options = options();
    let progress = spinner("looking");
    let mut splats = original.clone();
    let mut recording = Recording::of(&splats, look, &options)?;
    // With what parasites gave: the rest is to give it, as far as it can.
    let goals = Goal::of_recording(&splats, look, &recording);
    let removed = match args.keep_parasites {
        true => 0,
        false => remove_parasites(&mut splats, look, &mut recording),
    };
    let how = |keep: usize| Simplify {
        keep,
        rank: args.by.rank(),
        merge: (!args.no_merge).then(Alike::default),
        rounds: args.rounds as usize,
        effort: Effort { steps: args.steps as usize, passes: args.passes as usize },
    };
    let run = |recording: Recording, goals: &[Goal], keep: usize| {
        let mut smaller = splats.clone();
        let done = simplify(&mut smaller, recording, goals, &options, &how(keep), |what| {
            progress.set_message(format!("{what}, {keep} splats"));
            progress.tick();
        })?;
        Ok::<_, CommandError>((smaller, done))
    };
    let n = original.len();
    let (splats, done) = if args.flip.is_none() && args.layers.is_none() {
        let keep = (args.keep.unwrap_or(0.65) * n as f64).floor() as usize;
        run(recording, &goals, keep)?
    } else {
        // Chosen on views that nothing is fitted to; the final one is fitted to all.
        let seats: Vec<Seat> = look
            .iter()
            .step_by(TUNING)
            .map(|v| Seat { name: String::new(), view: *v, photograph: None })
            .collect();
        let settings = Settings { pixels_per_degree: args.ppd, ..Settings::default() };
        let bench = Bench::new(original, &seats, &options, settings)?;
        let fitted = |i: usize| !i.is_multiple_of(TUNING) || look.len() < TUNING;
        let some: Vec<View> = (0..look.len()).filter(|i| fitted(*i)).map(|i| look[i]).collect();
        let of_some = Recording::of(&splats, &some, &options)?;
        let some_goals = goals.iter().enumerate().filter(|(i, _)| fitted(*i)).map(|(_, goal)| goal.clone());
        let goals_of_some: Vec<Goal> = some_goals.collect();
        let keep =
            search(n, args, |keep| Ok(bench.judge(&run(of_some.clone(), &goals_of_some, keep)?.0)?.0))?;
        drop(of_some);
        run(recording, &goals, keep)?
    };
    progress.finish_and_clear();
    Ok(Optimised { splats, parasites: removed, done })
}

/// How many splats to keep: as few as the error allows, or as many as the layers allow.
fn search(
    n: usize,
    args: &OptimizeArgs,
    judge: impl Fn(usize) -> Result<Figures, CommandError>,
) -> Result<usize, CommandError> {
    // Figures of what is known to be too little, and enough.
    let (mut low, mut high) = (0.0, 1.0);
    let mut reached: Option<Figures> = None;
    for _ in 0..STEPS {
        let share = 0.5 * (low + high);
        let figures = judge(((share * n as f64) as usize).max(1))?;
        match (args.flip, args.layers) {
            (Some(flip), _) if figures.flip <= flip => high = share,
            (Some(_), _) => low = share,
            (None, Some(layers)) if figures.layers <= layers => {
                low = share;
                reached = Some(figures);
            }
            (None, _) => high = share,
        }
    }
    if let (None, Some(layers)) = (args.flip, args.layers) {
        let refuse = |what: String| {
            let what = format!("{layers} layers per pixel cannot be had: {what}");
            Err(CommandError::Failed(what))
        };
        let whole = judge(n)?;
        if whole.layers <= layers {
            return Ok(n);
        }
        let Some(found) = reached else {
            return refuse(format!(
                "even {:.1} % of the splats need more. The scene has {:.1}; its splats are large, and a pixel needs them",
                100.0 * high,
                whole.layers
            ));
        };
        if found.flip > args.at_most {
            return refuse(format!(
                "it takes removing all but {:.1} % of the splats, which errs by FLIP {:.4}, more than {} (--at-most). \
                 The scene has {:.1} layers",
                100.0 * low,
                found.flip,
                args.at_most,
                whole.layers
            ));
        }
        return Ok((low * n as f64) as usize);
    }
    Ok((high * n as f64).ceil() as usize)
}

fn remove_parasites(splats: &mut Splats, look: &[View], recording: &mut Recording) -> usize {
    let distances = recording.distances(splats);
    let found = parasites(splats, look, &distances, &recording.importance(splats), Rule::default());
    let mut gone = vec![false; splats.len()];
    for &i in &found {
        gone[i as usize] = true;
    }
    recording.retain(splats.len(), |i| !gone[i]);
    splats.retain(|i| !gone[i]);
    found.len()
}

fn spinner(message: &'static str) -> ProgressBar {
    let bar = ProgressBar::new_spinner().with_message(message);
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} ({elapsed})") {
        bar.set_style(style);
    }
    bar.tick();
    bar
}

/// Original, ours, the cut; below them the errors of the last two.
fn write_pictures(
    folder: &Path,
    seats: &[Seat],
    [originals, ours, cut]: [&[Picture]; 3],
    ppd: f32,
) -> Result<(), CommandError> {
    std::fs::create_dir_all(folder).map_err(CommandError::io(folder))?;
    let step = seats.len().div_ceil(SHOWN).max(1);
    for i in (0..seats.len()).step_by(step) {
        let error = |test: &Picture| {
            let map = flip_map(&originals[i], test, ppd)?;
            coloured(test.size(), map.into_iter().map(f64::from), [0.0, ERROR_SHOWN], ColourMap::Magma)
        };
        let row = [originals[i].clone(), ours[i].clone(), cut[i].clone(), error(&ours[i])?, error(&cut[i])?];
        let name: String = seats[i].name.replace(['/', '\\'], "-");
        side_by_side(&row)?.save(&folder.join(format!("{name}.png")))?;
    }
    Ok(())
}

fn print(report: &Report, json: bool) -> Result<(), CommandError> {
    let text = if json {
        serde_json::to_string_pretty(report).map_err(|e| CommandError::Print(e.into()))? + "\n"
    } else {
        let mut text = format!(
            "{} parasites removed, {} pairs merged, {} splats pruned; from {}\n\n",
            report.parasites, report.merged, report.pruned, report.views
        );
        text += "                 splats   visible   layers   every layer   frame (Quest 3, predicted)     FLIP      PSNR     SSIM";
        let photos = report.original.photo_psnr.is_some();
        text += if photos { "   against photographs\n" } else { "\n" };
        for (name, f) in [
            ("original", &report.original),
            ("optimised", &report.ours),
            ("opacity cut", &report.opacity_cut),
        ] {
            let psnr = if f.psnr.is_finite() { format!("{:.2} dB", f.psnr) } else { "–".into() };
            let _ = write!(
                text,
                "{name:12} {:10} {:9.0} {:8.1} {:13.1} {:23.1} ms {:8.4} {psnr:>9} {:8.4}",
                f.splats, f.visible, f.layers, f.every_layer, f.frame_ms, f.flip, f.ssim
            );
            if let (Some(psnr), Some(ssim)) = (f.photo_psnr, f.photo_ssim) {
                let _ = write!(text, "   {psnr:.2} dB, SSIM {ssim:.4}");
            }
            text.push('\n');
        }
        let _ = writeln!(text, "\n{}", report.file.display());
        text
    };
    std::io::stdout().write_all(text.as_bytes()).map_err(CommandError::Print)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use glam::DVec3;
    use motes_renderer::Fov;
    use motes_renderer::detail::refit::residual;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: OptimizeArgs,
    }

    fn args(words: &[&str]) -> OptimizeArgs {
        Cli::try_parse_from(["optimize", "a.ply", "-o", "b.ply"].iter().chain(words)).unwrap().args
    }

    /// A scene whose error falls and whose layers grow with the share that is kept.
    fn figures(keep: usize) -> Result<Figures, CommandError> {
        let share = keep as f64 / 1000.0;
        Ok(Figures { flip: 0.1 * (1.0 - share), layers: 5.0 + 40.0 * share, ..Figures::default() })
    }

    #[test]
    fn searches_end_at_the_aim_or_say_why_not() {
        let keep = search(1000, &args(&["--flip", "0.03"]), figures).unwrap();
        assert!((700..=720).contains(&keep), "{keep}");
        let keep = search(1000, &args(&["--layers", "30"]), figures).unwrap();
        assert!((600..=625).contains(&keep), "{keep}");
        let error = search(1000, &args(&["--layers", "18"]), figures).unwrap_err().to_string();
        assert!(
            error.contains("18 layers per pixel cannot be had") && error.contains("FLIP 0.06"),
            "{error}"
        );
        let error = search(1000, &args(&["--layers", "4"]), figures).unwrap_err().to_string();
        assert!(error.contains("its splats are large"), "{error}");
        assert!(search(1000, &args(&["--layers", "18", "--at-most", "0.1"]), figures).is_ok());
        assert_eq!(search(1000, &args(&["--layers", "50"]), figures).unwrap(), 1000);
    }

    /// A wall, and a veil before one of the cameras that look at it.
    #[test]
    fn what_a_parasite_gave_is_given_by_the_rest() {
        let mut scene = Splats::zeroed(101, 1, false);
        for i in 0..101 {
            let (x, y) = ((i % 10) as f32 - 4.5, (i / 10) as f32 - 4.5);
            let veil = i == 100;
            scene.means[i] = if veil { [0.0, 0.0, 0.4] } else { [0.4 * x, 0.4 * y, 4.0] };
            scene.log_scales[i] = [if veil { 0.1f32 } else { 0.3 }.ln(); 3];
            scene.rotations[i] = [0.0, 0.0, 0.0, 1.0];
            scene.opacities[i] = if veil { 0.3 } else { 0.9 };
            scene.sh[4 * i] = if veil { [1.0; 3] } else { [0.02 * x, 0.0, 0.02 * y] };
        }
        let fov = Fov { left: -0.4, right: 0.4, up: -0.4, down: 0.4 };
        let look = [-2.0, 0.0, 2.0].map(|x| {
            View::look_at(DVec3::new(x, 0.0, 0.0), DVec3::new(0.0, 0.0, 4.0), DVec3::NEG_Y, fov, [32, 32])
        });
        let goals = look.map(|view| Goal::of(&scene, &view, &options()).unwrap());
        let ours = optimise(&scene, &look, &args(&["--keep", "0.98", "--no-merge"])).unwrap();
        assert_eq!((ours.parasites, ours.splats.len()), (1, 98));
        let mut bare = scene.clone();
        bare.retain(|i| i != 100);
        let [ours, bare] = [&ours.splats, &bare].map(|s| residual(s, &goals, &options()).unwrap());
        assert!(ours < 0.7 * bare && bare > 1e-4, "{ours} {bare}");
        let kept =
            optimise(&scene, &look, &args(&["--keep", "0.98", "--no-merge", "--keep-parasites"])).unwrap();
        assert_eq!(kept.parasites, 0);
    }

    #[test]
    fn senseless_aims_are_refused() {
        for words in [
            &["--keep", "0"][..],
            &["--keep", "1.5"],
            &["--flip", "nan"],
            &["--layers", "-3"],
            &["--at-most", "2", "--layers", "4"],
        ] {
            let words: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
            let joined: Vec<String> = words.chunks(2).map(|w| format!("{}={}", w[0], w[1])).collect();
            let joined: Vec<&str> = joined.iter().map(String::as_str).collect();
            assert!(check(&args(&joined)).is_err(), "{joined:?}");
        }
        assert!(check(&OptimizeArgs { output: "x.sog".into(), ..args(&[]) }).is_err());
        assert!(check(&args(&["--keep", "0.5"])).is_ok());
        let both = ["optimize", "a.ply", "-o", "b.ply", "--keep", "0.5", "--flip", "0.1"];
        assert!(Cli::try_parse_from(both).is_err());
    }
}
