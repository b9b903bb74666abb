//! The embedded sample: a scene to look at when none is named.
//!
//! “Plant” by Marcel Padilla, CC BY 4.0; see `samples/ATTRIBUTION.md`, which [`ATTRIBUTION`] holds.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use crate::settings::{Axis, Orientation, Settings};
use crate::synthetic::{Animation, animate};
use crate::{LoadOptions, Scene, SceneError, load_bytes};

/// What the sample is called in messages.
pub const NAME: &str = "plant.spz";

/// What stands for the sample in motion where a scene's path is asked for.
pub const MOVING: &str = "sample:moving";

/// The sample's file.
#[cfg(feature = "sample")]
pub const BYTES: &[u8] = include_bytes!("../samples/plant.spz");

/// The file as [`provide`] was given it.
static PROVIDED: OnceLock<Arc<[u8]>> = OnceLock::new();

/// Hands the sample's file over, in a program that does not hold it: an APK has it as an asset.
pub fn provide(bytes: Arc<[u8]>) {
    // A second time it is the same.
    let _ = PROVIDED.set(bytes);
}

fn bytes() -> Result<Arc<[u8]>, SceneError> {
    if let Some(bytes) = PROVIDED.get() {
        return Ok(bytes.clone());
    }
    #[cfg(feature = "sample")]
    return Ok(Arc::from(BYTES));
    #[cfg(not(feature = "sample"))]
    Err(SceneError::unsupported(
        Path::new(NAME),
        "this program does not hold the sample",
        "Name a scene, or build with the feature `sample`",
    ))
}

/// Whose work it is, its licence, and what was changed: to be shown where the program says what it is made of.
pub const ATTRIBUTION: &str = include_str!("../samples/ATTRIBUTION.md");

/// Loads the sample.
///
/// # Errors
/// As [`load_bytes`]: the options' limits and cancellation apply; the file itself is sound.
pub fn sample(options: &LoadOptions) -> Result<Scene, SceneError> {
    load_bytes(Path::new(NAME), bytes()?, options)
}

/// The sample's settings: y is down in it, whatever its format is meant for, and the pot stands at the lowest point.
pub fn settings() -> Settings {
    Settings { orientation: Orientation::Up(Axis::MinusY), floor: Some(-0.5), ..Default::default() }
}

/// The sample in motion: it sways, and one splat in five comes and goes. Made from the still one, so it takes no space.
///
/// # Errors
/// As [`sample`].
pub fn moving(options: &LoadOptions) -> Result<Scene, SceneError> {
    let mut scene = sample(options)?;
    let sway = Animation {
        turn: 0.5,
        travel: [0.0; 3],
        // Small: half a scene away from its centre a cubic follows a wave only roughly.
        wave: 0.006,
        wave_length: 1.0,
        fleeting: 0.2,
        ..Animation::default()
    };
    animate(&mut scene.splats, &sway, 1);
    Ok(scene)
}
