//! `motes SCENE`: the window.

use std::path::PathBuf;

use motes_app::governor::Budget;

use super::lod_walk::lod_target;
use crate::config_args::ConfigArgs;
use crate::error::CommandError;
use crate::scene_args::SceneArgs;
use crate::shots::Size;
use crate::studio::DeviceArgs;
use crate::window::{self, KEYS, WindowOptions};

/// Show scenes in a window
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = format!("Keys:\n{KEYS}"))]
pub struct ViewArgs {
    /// Which scenes
    #[command(flatten)]
    pub scenes: SceneArgs,
    /// Both eyes, side by side
    #[arg(long)]
    pub stereo: bool,
    /// Without the panel (Tab shows it)
    #[arg(long)]
    pub no_panel: bool,
    /// Size of the window
    #[arg(long, value_name = "WxH", default_value = "1600x900")]
    pub size: Size,
    /// Where pictures are saved
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    pub pictures: PathBuf,
    /// As many frames as there can be, without waiting for the screen
    #[arg(long)]
    pub unpaced: bool,
    /// Hold a budget: layers of splats per pixel, or predicted milliseconds of a Quest 3 (like 9ms). Frames that would
    /// take more are drawn less exactly, step by step
    #[arg(long, value_name = "LAYERS|MS")]
    pub budget: Option<Budget>,
    /// Of a file of levels: SSIM to keep, as a share of the finest level's
    #[arg(long, value_name = "SSIM", default_value_t = 0.97, value_parser = lod_target)]
    pub lod_target: f64,
    /// Read a file of levels, or a streamed SOG scene, on the way, in the order of need, into so much memory
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    pub lod_memory: Option<u64>,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Shows the window until it is closed.
///
/// # Errors
/// There is no display or device, or a scene that was named is not there.
pub fn run(args: &ViewArgs) -> Result<(), CommandError> {
    args.scenes.check()?;
    window::run(WindowOptions {
        scenes: args.scenes.paths(),
        config: args.config.config(),
        suit_device: args.config.leaves_expansion(),
        by_plan: args.config.by_plan(),
        budget: args.budget,
        lod_target: args.lod_target,
        lod_memory: args.lod_memory.map(|mebibytes| mebibytes << 20),
        stereo: args.stereo,
        panel: !args.no_panel,
        size: args.size.0,
        pictures: args.pictures.clone(),
        device: args.device.device.clone(),
        validation: args.device.validation,
        paced: !args.unpaced,
    })
}
