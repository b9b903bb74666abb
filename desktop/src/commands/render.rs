//! `motes render`: pictures of a scene, without a window.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use motes_app::lod::{LevelChoice, Levels, Tuning};
use motes_app::opened::Opened;
use motes_app::viewer::{eyes, in_scene_units};
use motes_renderer::plan::Plan;
use motes_renderer::{FrameReport, Lens, RenderConfig, View};
use motes_scenes::statement::Statement;
use motes_scenes::{CancelToken, LoadOptions, Splats};
use std::sync::Arc;

use super::lod_walk::lod_target;
use crate::config_args::ConfigArgs;
use crate::error::CommandError;
use crate::heat::{Given, Heat};
use crate::measure::Picture;
use crate::scene_args::SceneArgs;
use crate::shots::{Shot, ShotArgs};
use crate::studio::{DeviceArgs, Studio, no_complaints, reference_pictures, side_by_side};
use crate::video::{Animation, Footage, VideoArgs, is_animated};

/// Render pictures of a scene into PNG files
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArgs {
    /// Which scenes
    #[command(flatten)]
    pub scenes: SceneArgs,
    /// The picture, or the folder for several
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Level of a streamed scene, 0 is the finest
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub level: u32,
    /// Of a file of levels (.mlod): each region at the coarsest level that keeps this share of the finest level's SSIM
    #[arg(long, value_name = "SSIM", value_parser = lod_target, conflicts_with = "level")]
    pub lod_target: Option<f64>,
    /// Both eyes, side by side
    #[arg(long)]
    pub stereo: bool,
    /// Distance of the eyes, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.063)]
    pub ipd: f64,
    /// By the f64 reference renderer on the CPU (with --preset inria: the trainers' semantics exactly)
    #[arg(long)]
    pub reference: bool,
    /// A heat map instead of colours
    #[arg(long, value_name = "WHAT")]
    pub heat: Option<Heat>,
    /// With --heat density: side of a voxel (a 64th of the scene, where it is not named)
    #[arg(long, value_name = "METRES", requires = "heat", value_parser = voxel)]
    pub voxel: Option<f64>,
    /// Print the figures of each picture as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    shots: ShotArgs,
    #[command(flatten)]
    video: VideoArgs,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    device: DeviceArgs,
}

/// What is printed of a picture.
#[derive(serde::Serialize)]
struct Line<'a> {
    file: &'a Path,
    #[serde(skip_serializing_if = "Option::is_none")]
    report: Option<FrameReport>,
}

/// The side of a voxel, metres.
pub fn voxel(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if (1e-6..=1e6).contains(&value) { Ok(value) } else { Err("it must be 0.000001 to 1000000".into()) }
}

/// Renders.
///
/// # Errors
/// A file cannot be read or written, or there is no device.
pub fn run(args: &RenderArgs) -> Result<(), CommandError> {
    if !args.ipd.is_finite() {
        return Err(CommandError::Usage(format!("--ipd is a distance in metres, not {}", args.ipd)));
    }
    let options = LoadOptions { level: args.level, ..Default::default() };
    let scenes = args.scenes.paths();
    let frames = args.video.sequence(&scenes)?;
    // A sequence stands as its first frame does.
    let paths = frames.as_deref().map_or(scenes.as_slice(), |f| &f[..f.len().min(1)]);
    let mut opened = Opened::load(paths, &options)?;
    for warning in &opened.scene.report.warnings {
        eprintln!("{warning}");
    }
    args.shots.apply(&mut opened.settings);
    let chosen = args.config.config();
    if chosen.lens != Lens::Perspective && args.heat == Some(Heat::ProjectionError) {
        let what = "the classic projection's error is one of perspective: leave --lens out";
        return Err(CommandError::Usage(what.into()));
    }
    let shots = args.at_times(args.shots.shots(&opened, chosen.lens)?)?;
    let planned = match args.config.by_plan() {
        Some(overrides) => Plan::of(&Statement::of(&opened.scene), &overrides).apply(&chosen),
        None => chosen,
    };
    let config = in_scene_units(&planned, opened.settings.scale);
    let mut leveled = args.lod_target.map(|target| leveled(paths, target)).transpose()?;
    let mut footage = Footage::new(&mut opened, frames, &options, args.video.read_ahead)?;
    let gpu = if args.reference { None } else { Some(args.device.offscreen()?) };
    let mut studio: Option<(Arc<Splats>, Studio)> = None;
    let of_times = args.video.times().is_some();
    let mut animation = (of_times && is_animated(&args.output))
        .then(|| Animation::new(&args.output, shots.len() as u32, args.video.fps));
    let trainers = args.config.preset() == Some("inria");
    for shot in &shots {
        let config = at_time(&config, shot, args.config.names("time") && !of_times);
        let views: Vec<View> = if args.stereo {
            eyes(&shot.view, args.ipd / opened.settings.scale).to_vec()
        } else {
            vec![shot.view]
        };
        let (stored, parts) = match &mut leveled {
            None => (footage.at(config.time)?, None),
            Some((levels, choice)) => {
                choice.settle(&views);
                (levels.splats.clone(), Some(levels.parts(choice.shares())))
            }
        };
        let config = match &gpu {
            Some(gpu) => args.config.on(config, gpu, stored.len() as u32, &views),
            None => config,
        };
        if let Some(gpu) = &gpu
            && studio.as_ref().is_none_or(|(shown, _)| !Arc::ptr_eq(shown, &stored))
        {
            // The one before goes first: two need not fit.
            drop(studio.take());
            studio = Some((stored.clone(), Studio::new(gpu, &stored, &config)?));
        }
        // What is shown of what is stored, by itself.
        let splats = match (&leveled, &parts) {
            (Some((levels, _)), Some(parts)) => Arc::new(levels.drawn(parts)),
            _ => stored,
        };
        let fineness = match (&leveled, &parts) {
            (Some((levels, _)), Some(parts)) => Some(levels.fineness(parts)),
            _ => None,
        };
        if let Some((_, studio)) = &studio {
            studio.scene().positions.choose(parts);
        }
        let painted = match args.heat {
            Some(heat) => {
                let given = Given { fineness, voxel: args.voxel.map(|v| v / opened.settings.scale) };
                heat.of_splats(&splats, &views[0], &opened.classes, given)?
            }
            None => None,
        };
        let (mut pictures, report) = match (&gpu, &mut studio, &painted) {
            (Some(gpu), _, Some(painted)) => {
                let (pictures, report) = Studio::new(gpu, painted, &config)?.take(&views, &config)?;
                (pictures, Some(report))
            }
            (_, Some((_, studio)), _) => studio.take(&views, &config).map(|(p, report)| (p, Some(report)))?,
            (_, None, painted) => {
                let splats = painted.as_ref().unwrap_or(&splats);
                (reference_pictures(splats, &views, &config, trainers)?, None)
            }
        };
        if let Some(heat) = args.heat {
            let drawn = if args.reference { &[][..] } else { &pictures };
            if let Some(maps) = heat.of_pixels(&splats, &views, &config, drawn)? {
                pictures = maps;
            }
        }
        let picture = side_by_side(&pictures)?;
        let file = file_of(args, shot);
        match &mut animation {
            Some(animation) => animation.add(&picture)?,
            None => save(&picture, &file)?,
        }
        say(&Line { file: &file, report }, args.json)?;
    }
    if let Some(animation) = animation {
        animation.finish()?;
    }
    drop(studio);
    gpu.as_deref().map_or(Ok(()), no_complaints)
}

/// The levels of the one file that was named, and their choice.
fn leveled(paths: &[PathBuf], target: f64) -> Result<(Levels, LevelChoice), CommandError> {
    let [file] = paths else {
        return Err(CommandError::Usage("--lod-target is for one file of levels (.mlod)".into()));
    };
    let levels = Levels::load(file, &CancelToken::default())?;
    if let Some(why) = &levels.unfitted {
        return Err(CommandError::Usage(why.clone()));
    }
    let choice = levels.choice(Tuning { target, ..Default::default() });
    Ok((levels, choice))
}

impl RenderArgs {
    /// Each shot at each time: as many pictures as times, of one view, or of as many views as times.
    fn at_times(&self, shots: Vec<Shot>) -> Result<Vec<Shot>, CommandError> {
        let Some(times) = self.video.times() else { return Ok(shots) };
        if shots.len() != 1 && shots.len() != times.len() {
            let (views, times) = (shots.len(), times.len());
            let what =
                format!("{views} views and {times} times do not fit: give one view, or as many as times");
            return Err(CommandError::Usage(what));
        }
        let shot = |(i, &time): (usize, &f32)| Shot {
            name: format!("frame-{i:05}"),
            time: Some(time),
            ..shots[i.min(shots.len() - 1)].clone()
        };
        Ok(times.iter().enumerate().map(shot).collect())
    }
}

/// The camera's moment, unless one was given.
fn at_time(config: &RenderConfig, shot: &Shot, given: bool) -> RenderConfig {
    let time = if given { config.time } else { shot.time.unwrap_or(config.time) };
    RenderConfig { time, ..config.clone() }
}

/// Cameras' names may hold folders; they stay below the output folder.
fn file_of(args: &RenderArgs, shot: &Shot) -> PathBuf {
    let one = match args.video.times() {
        Some(_) => is_animated(&args.output),
        None => !args.shots.several(),
    };
    if one {
        return args.output.clone();
    }
    let parts = shot.name.split(['/', '\\']).filter(|p| !p.is_empty() && *p != "." && *p != "..");
    let mut file: PathBuf = args.output.join(parts.collect::<PathBuf>()).into_os_string().into();
    file.as_mut_os_string().push(".png");
    file
}

fn save(picture: &Picture, file: &Path) -> Result<(), CommandError> {
    if let Some(folder) = file.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(CommandError::io(folder))?;
    }
    Ok(picture.save(file)?)
}

fn say(line: &Line<'_>, json: bool) -> Result<(), CommandError> {
    let mut text = if json {
        serde_json::to_string(line).map_err(|e| CommandError::Print(e.into()))?
    } else {
        line.file.display().to_string()
    };
    if let (Some(report), false) = (&line.report, json) {
        text += &format!(
            ": {:.1} ms, {} splats, {:.1} layers a pixel",
            report.device_ns() / 1e6,
            report.visible,
            report.layers()
        );
    }
    text.push('\n');
    std::io::stdout().write_all(text.as_bytes()).map_err(CommandError::Print)
}
