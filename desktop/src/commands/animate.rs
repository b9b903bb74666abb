//! `motes animate`: makes a moving scene from a still one.

use std::io::Write as _;
use std::path::PathBuf;

use motes_app::opened::Opened;
use motes_scenes::synthetic::{Animation, animate};
use motes_scenes::{LoadOptions, save};

use crate::error::CommandError;
use crate::shots::Point;

/// Make a moving scene (Spacetime Gaussians lite) from a still one: a turn, a way, a wave, splats that come and go
#[derive(Clone, Debug, clap::Args)]
pub struct AnimateArgs {
    /// Scene files or folders, merged (the sample, where none is named)
    pub scenes: Vec<PathBuf>,
    /// The moving scene, a .ply
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Axis of the turn and direction of the wave, through the scene's middle
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub axis: Option<Point>,
    /// The turn from beginning to end, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 30.0, allow_hyphen_values = true)]
    pub turn: f32,
    /// The way from beginning to end, scene units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub travel: Option<Point>,
    /// How far the wave reaches, scene units
    #[arg(long, value_name = "UNITS", default_value_t = 0.02)]
    pub wave: f32,
    /// Length of the wave, scene units
    #[arg(long, value_name = "UNITS", default_value_t = 0.5)]
    pub wave_length: f32,
    /// Part of the splats that come and go, 0 to 1
    #[arg(long, value_name = "PART", default_value_t = 0.0)]
    pub fleeting: f32,
    /// Part of the time after which those have faded to 1/e
    #[arg(long, value_name = "TIME", default_value_t = 0.1)]
    pub width: f32,
    /// Equal seeds let the same splats come and go
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

impl AnimateArgs {
    fn animation(&self) -> Result<Animation, CommandError> {
        let point = |p: &Option<Point>, otherwise| p.map_or(otherwise, |p| p.0.as_vec3().to_array());
        let numbers = [self.turn, self.wave, self.wave_length, self.fleeting, self.width];
        let makes_sense = numbers.iter().all(|n| n.is_finite())
            && self.wave_length > 0.0
            && (0.0..=1.0).contains(&self.fleeting)
            && self.width > 0.0;
        if !makes_sense {
            let what = "--turn and --wave are numbers, --wave-length and --width positive ones, --fleeting is 0 to 1";
            return Err(CommandError::Usage(what.to_owned()));
        }
        Ok(Animation {
            axis: point(&self.axis, [0.0, 1.0, 0.0]),
            turn: self.turn.to_radians(),
            travel: point(&self.travel, [0.0; 3]),
            wave: self.wave,
            wave_length: self.wave_length,
            fleeting: self.fleeting,
            width: self.width,
        })
    }
}

/// Writes the moving scene.
///
/// # Errors
/// The scene cannot be read, moves already, or cannot be written.
pub fn run(args: &AnimateArgs) -> Result<(), CommandError> {
    let animation = args.animation()?;
    if !args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) {
        let what = format!("{}: motion is written as .ply only", args.output.display());
        return Err(CommandError::Usage(what));
    }
    let opened = Opened::load(&args.scenes, &LoadOptions::default())?;
    let mut splats = opened.scene.splats;
    if splats.motion.is_some() {
        return Err(CommandError::Usage(format!("{} moves already", opened.name)));
    }
    // The format has a colour, and no harmonics.
    let lost = splats.sh_degree > 0;
    animate(&mut splats, &animation, args.seed);
    save(&args.output, &splats)?;
    let harmonics = if lost { "; view-dependent colour is left out, as the format has none" } else { "" };
    writeln!(std::io::stdout(), "{}: {} splats{harmonics}", args.output.display(), splats.len())
        .map_err(CommandError::Print)
}
