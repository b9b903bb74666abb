//! `motes render`: pictures of a scene, without a window.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use motes_app::opened::Opened;
use motes_app::viewer::{eyes, in_scene_units};
use motes_renderer::{FrameReport, RenderConfig, View};
use motes_scenes::LoadOptions;

use crate::config_args::ConfigArgs;
use crate::error::CommandError;
use crate::heat::Heat;
use crate::measure::Picture;
use crate::shots::{Shot, ShotArgs};
use crate::studio::{DeviceArgs, Studio, no_complaints, reference_pictures, side_by_side};

/// Render pictures of a scene into PNG files
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArgs {
    /// Scene files or folders, merged (the sample, where none is named)
    pub scenes: Vec<PathBuf>,
    /// The picture, or the folder for several
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Level of a streamed scene, 0 is the finest
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub level: u32,
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
    /// Print the figures of each picture as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    shots: ShotArgs,
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

/// Renders.
///
/// # Errors
/// A file cannot be read or written, or there is no device.
pub fn run(args: &RenderArgs) -> Result<(), CommandError> {
    if !args.ipd.is_finite() {
        return Err(CommandError::Usage(format!("--ipd is a distance in metres, not {}", args.ipd)));
    }
    let options = LoadOptions { level: args.level, ..Default::default() };
    let mut opened = Opened::load(&args.scenes, &options)?;
    for warning in &opened.scene.report.warnings {
        eprintln!("{warning}");
    }
    args.shots.apply(&mut opened.settings);
    let shots = args.shots.shots(&opened)?;
    let config = in_scene_units(&args.config.config(), opened.settings.scale);
    let splats = &opened.scene.splats;
    let mut device = if args.reference {
        None
    } else {
        let gpu = args.device.offscreen()?;
        let studio = Studio::new(&gpu, splats, &config)?;
        Some((studio, gpu))
    };
    let trainers = args.config.preset() == Some("inria");
    for shot in &shots {
        let config = at_time(&config, shot, args.config.names("time"));
        let views: Vec<View> = if args.stereo {
            eyes(&shot.view, args.ipd / opened.settings.scale).to_vec()
        } else {
            vec![shot.view]
        };
        let painted = match args.heat {
            Some(heat) => heat.of_splats(splats, &views[0])?,
            None => None,
        };
        let (mut pictures, report) = match (&mut device, &painted) {
            (Some((_, gpu)), Some(painted)) => {
                let (pictures, report) = Studio::new(gpu, painted, &config)?.take(&views, &config)?;
                (pictures, Some(report))
            }
            (Some((studio, _)), None) => studio.take(&views, &config).map(|(p, report)| (p, Some(report)))?,
            (None, painted) => {
                let splats = painted.as_ref().unwrap_or(splats);
                (reference_pictures(splats, &views, &config, trainers)?, None)
            }
        };
        if let Some(heat) = args.heat {
            let drawn = if args.reference { &[][..] } else { &pictures };
            if let Some(maps) = heat.of_pixels(splats, &views, &config, drawn)? {
                pictures = maps;
            }
        }
        let file = file_of(args, shot);
        save(&side_by_side(&pictures)?, &file)?;
        say(&Line { file: &file, report }, args.json)?;
    }
    match device {
        Some((studio, gpu)) => {
            drop(studio);
            no_complaints(&gpu)
        }
        None => Ok(()),
    }
}

/// The camera's moment, unless one was given.
fn at_time(config: &RenderConfig, shot: &Shot, given: bool) -> RenderConfig {
    let time = if given { config.time } else { shot.time.unwrap_or(config.time) };
    RenderConfig { time, ..config.clone() }
}

/// Cameras' names may hold folders; they stay below the output folder.
fn file_of(args: &RenderArgs, shot: &Shot) -> PathBuf {
    if !args.shots.several() {
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
