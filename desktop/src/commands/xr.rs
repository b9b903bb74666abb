//! `motes xr`: a scene in a headset.

use std::path::PathBuf;
use std::time::Duration;

use motes_app::governor::Budget;
use motes_app::headset::HeadsetSettings;
use motes_app::loader::{SceneSource, Storage};
use motes_app::opened::Opened;
use motes_renderer::{Lens, Packing, RenderConfig, pipeline_cache};
use motes_scenes::LoadOptions;
use motes_xr::bindings::Bindings;
use motes_xr::{RuntimeOptions, Script, SessionOptions, ShowError, ShowOptions, show};

use super::lod_walk::lod_target;
use crate::config_args::ConfigArgs;
use crate::error::CommandError;
use crate::replay::{ReplayOptions, replay};
use crate::scene_args::SceneArgs;
use crate::studio::DeviceArgs;
use crate::window::{self, WindowOptions};

/// Show scenes in a headset (any OpenXR runtime)
#[derive(Clone, Debug, clap::Args)]
pub struct XrArgs {
    /// Which scenes
    #[command(flatten)]
    pub scenes: SceneArgs,
    /// Comfort options and bindings (a JSON file; the defaults, where there is none)
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// Everything on the other hand
    #[arg(long)]
    pub left_handed: bool,
    /// Record the session into a file, for --replay
    #[arg(long, value_name = "FILE", conflicts_with = "replay")]
    pub record: Option<PathBuf>,
    /// Draw a recorded session of the same scene again, without a headset. With the options that it was recorded with,
    /// and without --budget, every pixel is the same. In a window, or by -o into files
    #[arg(long, value_name = "FILE")]
    pub replay: Option<PathBuf>,
    /// Where the replayed session's pictures go, both eyes side by side: a folder, or an animated picture (.png)
    #[arg(short, long, value_name = "OUT", requires = "replay")]
    pub output: Option<PathBuf>,
    /// End after as many frames (0: when the user ends it)
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub frames: u64,
    /// How long a runtime that is lost in mid-session is waited for
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    pub patience: u64,
    /// A folder whose scenes the panel offers
    #[arg(long, value_name = "FOLDER")]
    pub folder: Option<PathBuf>,
    /// A folder for what the panel's button Measure finds out, in the form of `motes bench`
    #[arg(long, value_name = "FOLDER")]
    pub measurements: Option<PathBuf>,
    /// Write what the headset's device offers here, for `motes device`
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Fail where there is no headset, instead of opening a window
    #[arg(long)]
    pub no_window: bool,
    /// Hold a budget: layers of splats per pixel, or predicted milliseconds of a Quest 3 (like 9ms)
    #[arg(long, value_name = "LAYERS|MS")]
    pub budget: Option<Budget>,
    /// Ask the display for as many frames a second: the nearest of the rates that it offers
    #[arg(long, value_name = "HZ")]
    pub refresh_rate: Option<f32>,
    /// Tell the headset's compositor how far away pixels are, where it wants to know: between two frames it then follows
    /// the head's steps, not its turns alone. Costs a fragment a pixel and batch
    #[arg(long)]
    pub depth_layer: bool,
    /// Let the budget be held by coarser rims of the images, too, where headset and device offer that. (No device has run
    /// it yet)
    #[arg(long)]
    pub foveation: bool,
    /// Of a file of levels: SSIM to keep, as a share of the finest level's; the panel changes it
    #[arg(long, value_name = "SSIM", default_value_t = 0.97, value_parser = lod_target)]
    pub lod_target: f64,
    /// Read a file of levels, or a streamed SOG scene, on the way, in the order of need, into so much memory
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    pub lod_memory: Option<u64>,
    /// With OpenXR's and Vulkan's validation layers
    #[arg(long)]
    pub validation: bool,
    #[command(flatten)]
    config: ConfigArgs,
}

impl XrArgs {
    /// How a frame is drawn.
    pub fn config(&self) -> RenderConfig {
        self.config.config()
    }

    /// Where the scene comes from.
    fn source(&self) -> Result<SceneSource, CommandError> {
        let paths = self.scenes.paths();
        match (self.lod_memory, paths.as_slice()) {
            (None, _) => Ok(SceneSource::Files(paths)),
            (Some(mebibytes), [path]) => Ok(SceneSource::Within(path.clone(), mebibytes << 20)),
            _ => Err(CommandError::Usage(
                "--lod-memory reads one file of levels, or one streamed scene".into(),
            )),
        }
    }
}

/// How `motes xr` ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The user ended the session, or it was replayed.
    Shown,
    /// There is no headset, for this reason: a window is to be opened instead.
    Window(String),
}

/// Shows scenes in the headset until the user leaves.
///
/// # Errors
/// A scene or settings file cannot be used, or the runtime was lost for good; without a headset only where no window
/// may stand in.
pub fn run(args: &XrArgs) -> Result<Outcome, CommandError> {
    args.scenes.check()?;
    let mut settings = match &args.settings {
        Some(file) => {
            std::fs::metadata(file).map_err(CommandError::io(file))?;
            HeadsetSettings::<Bindings>::load(file).map_err(|e| CommandError::Usage(e.to_string()))?
        }
        None => HeadsetSettings::default(),
    };
    settings.comfort.left_handed |= args.left_handed;
    let config = args.config();
    if config.lens != Lens::Perspective {
        let what =
            format!("--lens {}: a headset shows perspective; motes render takes the picture", config.lens);
        return Err(CommandError::Usage(what));
    }
    let storage = match args.config.by_plan() {
        Some(overrides) => Storage::Planned(overrides),
        None => Storage::As(Packing::of_config(&config)),
    };
    let budget = args.budget.or(settings.budget);
    // The session draws at this size: nothing is left to bring back to full size.
    let at_full_size = RenderConfig { resolution_scale: 1.0, ..config.clone() };
    if let Some(session) = &args.replay {
        let script = Script::read(session)?;
        let opened = Opened::load_to_play(&args.scenes.paths(), &LoadOptions::default())?;
        let device = DeviceArgs { device: None, validation: args.validation };
        let options = ReplayOptions { storage, config: at_full_size, comfort: settings.comfort, budget };
        let Some(output) = &args.output else {
            window::preview(script, opened, options, args.validation)?;
            return Ok(Outcome::Shown);
        };
        let frames = replay(&device.offscreen()?, &opened, script, &options, output)?;
        eprintln!("{frames} frames: {}", output.display());
        return Ok(Outcome::Shown);
    }
    let options = ShowOptions {
        source: args.source()?,
        storage,
        comfort: settings.comfort,
        budget,
        detail_target: args.lod_target,
        pipelines: pipeline_cache::default_folder(),
        session: SessionOptions {
            resolution_scale: config.resolution_scale,
            left_handed: settings.comfort.left_handed,
            bindings: settings.bindings,
            whole_images: false,
            refresh_rate: args.refresh_rate.or(settings.refresh_rate),
        },
        config: at_full_size,
        runtime: RuntimeOptions {
            validation: args.validation,
            readable: false,
            depth_layer: args.depth_layer || settings.depth_layer,
            foveation: args.foveation || settings.foveation,
        },
        record: args.record.clone(),
        frames: args.frames,
        patience: Duration::from_secs(args.patience),
        folder: args.folder.clone(),
        measurements: args.measurements.clone(),
        thumbnails: pipeline_cache::default_folder().map(|folder| folder.with_file_name("thumbnails")),
        report: args.report.clone(),
    };
    match show(&(), &options, &mut || false) {
        Ok(visit) => {
            eprintln!(
                "{} frames; the runtime was lost and found again {} times",
                visit.frames, visit.recoveries
            );
            Ok(Outcome::Shown)
        }
        Err(error) if error.is_absent() && !args.no_window => Ok(Outcome::Window(error.to_string())),
        Err(ShowError::Headset(error)) => Err(CommandError::Headset(error)),
        Err(error) => Err(CommandError::Usage(error.to_string())),
    }
}

/// Opens the desktop's window with what was to be shown in the headset.
///
/// # Errors
/// There is no display or device either.
pub fn open_window(args: &XrArgs) -> Result<(), CommandError> {
    window::run(WindowOptions {
        scenes: args.scenes.paths(),
        config: args.config(),
        suit_device: args.config.leaves_expansion(),
        by_plan: args.config.by_plan(),
        budget: args.budget,
        lod_target: args.lod_target,
        lod_memory: args.lod_memory.map(|mebibytes| mebibytes << 20),
        stereo: false,
        panel: true,
        size: [1600, 900],
        pictures: PathBuf::from("."),
        device: None,
        validation: args.validation,
        paced: true,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: XrArgs,
    }

    #[test]
    fn one_scene_is_read_within_a_memory() {
        let source = |words: &[&str]| {
            Cli::try_parse_from([&["xr"], words].concat())
                .map(|cli| cli.args.source().map_err(|e| e.to_string()))
        };
        let within = source(&["a.mlod", "--lod-memory", "64"]).unwrap().unwrap();
        assert!(
            matches!(within, SceneSource::Within(path, bytes) if path == std::path::Path::new("a.mlod") && bytes == 64 << 20)
        );
        assert!(
            matches!(source(&["a.mlod"]).unwrap().unwrap(), SceneSource::Files(paths) if paths.len() == 1)
        );
        let two = source(&["a.mlod", "b.mlod", "--lod-memory", "64"]).unwrap();
        assert!(two.unwrap_err().contains("one file of levels"));
        assert!(source(&["a.mlod", "--lod-memory", "0"]).is_err());
    }
}
