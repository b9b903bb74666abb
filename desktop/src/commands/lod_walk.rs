//! `motes lod walk`: levels chosen on the way, measured.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use indicatif::ProgressBar;
use motes_app::lod::{Levels, Resident, Tuning};
use motes_renderer::gpu::Gpu;
use motes_renderer::{Offscreen, Packing, SceneOnDevice, View};
use motes_scenes::levels::LevelFile;
use motes_scenes::{CancelToken, cameras};

use super::lod::{say, write_json};
use crate::config_args::ConfigArgs;
use crate::error::CommandError;
use crate::lod::walk::{Compared, Pace, Tripod, path, walk};
use crate::lod::{plots, stream};
use crate::studio::{DeviceArgs, no_complaints};
use crate::vantage::scaled;

/// Walk from camera to camera, levels chosen on the way: what is saved, and whether their changes are seen
#[derive(Clone, Debug, clap::Args)]
pub struct WalkArgs {
    /// A file of levels, with a fit
    pub file: PathBuf,
    /// Cameras to walk past, in their order (else those beside the file)
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Size of the pictures, as a share of the first camera's
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    pub scale: f64,
    /// SSIM to keep, as a share of the finest level's
    #[arg(long, value_name = "SSIM", default_value_t = 0.97, value_parser = lod_target)]
    pub lod_target: f64,
    /// Length of a cross-fade; 0 changes levels at once
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
    pub fade: f64,
    /// Length of the walk
    #[arg(long, value_name = "SECONDS", default_value_t = 12.0, value_parser = seconds)]
    pub seconds: f64,
    /// Frames a second
    #[arg(long, value_name = "N", default_value_t = 72.0, value_parser = seconds)]
    pub rate: f64,
    /// Compare one of so many frames with the finest level
    #[arg(long, value_name = "N", default_value_t = 12)]
    pub every: usize,
    /// Fail where a change of levels makes a larger difference between two frames: the mean over any 16 × 16 pixels, in
    /// steps of 1/255
    #[arg(long, value_name = "STEPS", default_value_t = 2.0)]
    pub bound: f64,
    /// Write all figures here, as JSON (with --memory also a plot beside it)
    #[arg(short, long, value_name = "FILE.json")]
    pub output: Option<PathBuf>,
    /// Read levels on the way, in the order of need, into so much memory; then stand still until nothing is missing
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    pub memory: Option<u64>,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    device: DeviceArgs,
}

/// An SSIM to keep: above 0, at most 1.
pub fn lod_target(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if value > 0.0 && value <= 1.0 { Ok(value) } else { Err("it must be above 0 and at most 1".into()) }
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if (0.0..=3600.0).contains(&value) { Ok(value) } else { Err("it must be 0 to 3600".into()) }
}

/// Walks.
///
/// # Errors
/// A file cannot be read, there is no device, or a check does not hold.
pub fn run(args: &WalkArgs) -> Result<(), CommandError> {
    let list = match args.cameras.clone().or_else(|| cameras::beside(&args.file)) {
        Some(file) => cameras::load(&file)?,
        None => return Err(CommandError::Usage("name cameras to walk past by --cameras".into())),
    };
    let stations: Vec<View> = list.iter().map(|c| scaled(&View::from_camera(c), args.scale)).collect();
    let views = path(&stations, (args.seconds * args.rate).round() as usize + 1);
    let config = args.config.config();
    let gpu = args.device.offscreen()?;
    let tuning = Tuning { target: args.lod_target, fade: args.fade, ..Default::default() };
    if let Some(mebibytes) = args.memory {
        return walk_within(args, mebibytes << 20, &gpu, &views, tuning);
    }
    let levels = Levels::load(&args.file, &CancelToken::default())?;
    if let Some(why) = &levels.unfitted {
        return Err(CommandError::Usage(why.clone()));
    }
    let scene = SceneOnDevice::new(&gpu, &levels.splats, Packing::of_config(&config))?;
    let mut offscreen = Offscreen::new(&gpu)?;
    let mut tripod = Tripod { scene: &scene, offscreen: &mut offscreen, config: &config };
    let pace = Pace { rate: args.rate, every: args.every };
    let bar = ProgressBar::new(views.len() as u64);
    let walked = walk(&levels, &mut tripod, &views, tuning, pace, |k| bar.set_position(k as u64))?;
    bar.finish_and_clear();
    drop((scene, offscreen));
    if let Some(file) = &args.output {
        write_json(file, &walked)?;
    }
    let finest: u64 = levels.finest();
    let mut text =
        format!("{} frames, {} compared with the finest level\n", views.len(), walked.compared.len());
    let mut line = |what: &str, figure: &dyn Fn(&Compared) -> [f64; 2]| {
        let [ours, whole] = [0, 1].map(|k| walked.mean(|c| figure(c)[k]));
        let saved = 100.0 * (1.0 - ours / whole.max(1e-9));
        let _ = writeln!(text, "{what:34} {ours:10.1} of {whole:10.1}   {saved:5.1} % saved");
    };
    line("layers per pixel", &|c| c.layers);
    line("splats sorted and projected", &|c| c.splats.map(f64::from));
    line("  of the whole scene", &|c| [f64::from(c.splats[0]), finest as f64]);
    let least = walked.compared.iter().map(|c| c.ssim).fold(f64::INFINITY, f64::min);
    let _ = writeln!(text, "SSIM to the finest level: mean {:.4}, least {least:.4}", walked.mean(|c| c.ssim));
    let _ = writeln!(
        text,
        "{} changes of level in view; largest difference between two frames by one: {:.2} of 255 in any 16 × 16 pixels \
         (bound {}), at once {:.2}",
        walked.changes, walked.step, args.bound, walked.hard_step
    );
    say(&text)?;
    no_complaints(&gpu)?;
    if walked.step > args.bound {
        return Err(CommandError::Failed("a change of levels exceeds the bound: lengthen --fade".into()));
    }
    Ok(())
}

fn walk_within(
    args: &WalkArgs,
    budget: u64,
    gpu: &Arc<Gpu>,
    views: &[View],
    tuning: Tuning,
) -> Result<(), CommandError> {
    let config = args.config.config();
    let file = LevelFile::open(&args.file)?;
    let (resident, mut choice) = Resident::open(gpu, &args.file, Packing::of_config(&config), budget, tuning)
        .map_err(|e| CommandError::Failed(e.to_string()))?;
    let mut offscreen = Offscreen::new(gpu)?;
    let walked = stream::walk(&file, (&resident, &mut choice), &mut offscreen, views, args.rate, &config)?;
    let memory = resident.memory();
    drop((resident, offscreen));
    if let Some(output) = &args.output {
        write_json(output, &walked)?;
        let points: Vec<_> = walked.strides.iter().map(|s| (s.at, s.memory.resident)).collect();
        plots::memory(&output.with_extension("svg"), args.seconds, &points, budget)?;
    }
    let all: u64 = file.levels().iter().map(|l| l.splats).sum();
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let most = |figure: fn(&stream::Stride) -> usize| walked.strides.iter().map(figure).max().unwrap_or(0);
    let text = format!(
        "{} frames; {all} splats at {} levels, {} of them the finest\n\
         in memory: at most {:.1} MiB of {:.1} (budget {:.1}); {:.1} MiB read\n\
         while walking: up to {} regions in view with nothing there, {} not at their level\n\
         settled after {:.2} s: {} splats drawn, nothing missing; off by {} of 255 from the same levels read whole (by {} \
         where one region is left out)\n",
        walked.strides.len(),
        file.levels().len(),
        file.levels()[0].splats,
        mib(memory.peak),
        mib(memory.budget),
        mib(budget),
        mib(memory.read),
        most(|s| s.nothing),
        most(|s| s.waiting),
        walked.settled_after,
        walked.splats,
        walked.off,
        walked.off_without_one,
    );
    say(&text)?;
    no_complaints(gpu)?;
    if walked.off > 2 {
        return Err(CommandError::Failed("what was read on the way is not what is in the file".into()));
    }
    Ok(())
}
