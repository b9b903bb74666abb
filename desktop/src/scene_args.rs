//! Which scenes a command is about.

use std::path::PathBuf;

use motes_scenes::sample;
use motes_scenes::settings::Settings;

use crate::error::CommandError;

/// The embedded sample, as it is or in motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Sample {
    /// A potted plant
    Still,
    /// The plant sways, and one splat in five comes and goes
    Moving,
}

/// Scenes: files, or a sample.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct SceneArgs {
    /// Scene files or folders, merged (the sample, where none is named)
    pub scenes: Vec<PathBuf>,
    /// An embedded sample
    #[arg(long, value_name = "NAME", conflicts_with = "scenes")]
    pub sample: Option<Sample>,
}

impl SceneArgs {
    /// What to open; nothing stands for the sample as it is.
    pub fn paths(&self) -> Vec<PathBuf> {
        match self.sample {
            Some(Sample::Moving) => vec![PathBuf::from(sample::MOVING)],
            Some(Sample::Still) | None => self.scenes.clone(),
        }
    }

    /// Says at once, rather than in a window or a headset, where a scene is not there or its settings are no good.
    ///
    /// # Errors
    /// That.
    pub fn check(&self) -> Result<(), CommandError> {
        for scene in &self.scenes {
            std::fs::metadata(scene).map_err(CommandError::io(scene))?;
            Settings::load(scene)?;
        }
        Ok(())
    }
}
