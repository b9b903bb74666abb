//! A walk through a scene that does not fit into memory: what is resident from frame to frame, what is missing meanwhile, and
//! whether anything is once the walker stands still.

use std::time::{Duration, Instant};

use motes_app::lod::{LevelChoice, Memory, Resident};
use motes_renderer::{Offscreen, RenderConfig, SceneOnDevice, View};
use motes_scenes::levels::LevelFile;

use super::observe::combined;
use crate::error::CommandError;

/// How long the rest may take once the walker stands still.
const PATIENCE: Duration = Duration::from_secs(120);

/// A frame of the walk.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Stride {
    /// Seconds of the walk.
    pub at: f64,
    /// What is in memory.
    pub memory: Memory,
    /// Splats sorted and projected.
    pub splats: u32,
    /// Regions in view of which nothing is there yet.
    pub nothing: usize,
    /// Regions in view that are not yet at the level that they should have.
    pub waiting: usize,
}

/// What a walk came to.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Streamed {
    /// By frame.
    pub strides: Vec<Stride>,
    /// Time from the last step until everything was there and every cross-fade done, seconds.
    pub settled_after: f64,
    /// Largest difference of a value (of 255) from the same levels read whole.
    pub off: u8,
    /// The same where the nearest region is left out: what one missing region would do.
    pub off_without_one: u8,
    /// Splats drawn in the end.
    pub splats: u32,
}

/// Walks along views, one a frame, then stands until nothing is missing.
///
/// # Errors
/// The driver's; a level cannot be read; something is still missing after two minutes.
pub fn walk(
    file: &LevelFile,
    (resident, choice): (&Resident, &mut LevelChoice),
    offscreen: &mut Offscreen,
    views: &[View],
    rate: f64,
    config: &RenderConfig,
) -> Result<Streamed, CommandError> {
    let seconds = 1.0 / rate;
    let mut strides = Vec::new();
    for (frame, view) in views.iter().enumerate() {
        let begun = Instant::now();
        resident.advance(choice, &[*view], seconds, 0.0);
        offscreen.sort(resident.scene(), &[*view], config);
        offscreen.draw(resident.scene(), &[*view], config)?;
        let (nothing, waiting) = choice.missing();
        let splats = resident.scene().positions.parts().map_or(0, |p| p.splats());
        strides.push(Stride {
            at: frame as f64 * seconds,
            memory: resident.memory(),
            splats,
            nothing,
            waiting,
        });
        // No faster than the walk: reading takes its time too.
        std::thread::sleep(Duration::from_secs_f64(seconds).saturating_sub(begun.elapsed()));
    }
    let Some(last) = views.last() else { return Err(CommandError::Usage("a walk needs a view".into())) };
    let stood = Instant::now();
    while choice.missing() != (0, 0) || !choice.at_rest() {
        if stood.elapsed() > PATIENCE {
            let (nothing, waiting) = choice.missing();
            let failed = resident.memory().failed;
            return Err(CommandError::Failed(format!(
                "after {PATIENCE:?} nothing is there of {nothing} regions, and {waiting} wait for their level; {failed} \
                 could not be read"
            )));
        }
        std::thread::sleep(Duration::from_secs_f64(seconds));
        resident.advance(choice, &[*last], seconds, 0.0);
    }
    let settled_after = stood.elapsed().as_secs_f64();
    let splats = resident.scene().positions.parts().map_or(0, |p| p.splats());
    let (ours, _) = offscreen.render(resident.scene(), &[*last], config)?;

    // The same levels of the same regions, read whole and without any budget.
    let levels: Vec<Option<usize>> = choice.levels().collect();
    let nearest = choice.wishes().next().map(|(region, _)| region);
    let gpu = offscreen.renderer().gpu().clone();
    let mut whole = |without: Option<usize>| -> Result<Vec<motes_renderer::Picture>, CommandError> {
        let drawn = |group: usize| levels[group].filter(|_| Some(group) != without);
        let splats = combined(file, drawn)?;
        let scene = SceneOnDevice::new(&gpu, &splats, resident.scene().packing)?;
        Ok(offscreen.render(&scene, &[*last], config)?.0)
    };
    let off = |theirs: &[motes_renderer::Picture]| {
        let values =
            |p: &[motes_renderer::Picture]| p.iter().flat_map(|p| p.pixels.concat()).collect::<Vec<u8>>();
        values(&ours).iter().zip(values(theirs)).map(|(a, b)| a.abs_diff(b)).max().unwrap_or(u8::MAX)
    };
    let (off, off_without_one) = (off(&whole(None)?), off(&whole(nearest)?));
    Ok(Streamed { strides, settled_after, off, off_without_one, splats })
}
