//! A recorded headset session, drawn again without a headset.

use std::path::Path;
use std::sync::Arc;

use motes_app::governor::{Budget, Governor};
use motes_app::headset::Comfort;
use motes_app::loader::Storage;
use motes_app::opened::Opened;
use motes_renderer::RenderConfig;
use motes_renderer::gpu::Gpu;
use motes_xr::{Content, Script, ScriptedHeadset, Viewer};

use crate::error::CommandError;
use crate::studio::{no_complaints, picture_of, side_by_side};
use crate::video::{Animation, is_animated};

/// How a session is drawn again; as it was recorded, for the same pixels.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// How the scene is stored. By plan, what the scene calls for goes before `config`.
    pub storage: Storage,
    /// How it is drawn; `near` and `near_fade` in metres.
    pub config: RenderConfig,
    /// Comfort options.
    pub comfort: Comfort,
    /// What a frame may take; nothing is held without.
    pub budget: Option<Budget>,
}

impl ReplayOptions {
    /// How a scene is drawn.
    pub fn config_for(&self, opened: &Opened) -> RenderConfig {
        let (_, plan) = self.storage.of(opened);
        plan.map_or_else(|| self.config.clone(), |plan| plan.apply(&self.config))
    }
}

/// Writes what the eyes saw in each frame of a session, side by side: into a folder, a picture a frame, or into an animated
/// picture where `output` ends in `.png`. Returns how many frames there were.
///
/// A recording holds what the headset and the hands said, and in which order of splats each frame was drawn. It does not
/// hold the panel, nor what was chosen on it, nor the governor's steps. The scene appears with the first frame that was
/// drawn of it, in one piece.
///
/// # Errors
/// The device cannot draw it, the disk refuses, or nothing was drawn in the session.
pub fn replay(
    gpu: &Arc<Gpu>,
    opened: &Opened,
    script: Script,
    options: &ReplayOptions,
    output: &Path,
) -> Result<u32, CommandError> {
    let (drawn, first) = (script.drawn(), script.first_drawn());
    let Some(first) = first else {
        return Err(CommandError::Usage("no frame of the session shows a scene".into()));
    };
    let fps = script.frames_per_second();
    let (packing, _) = options.storage.of(opened);
    let config = options.config_for(opened);
    let mut headset = ScriptedHeadset::new(gpu, script)?;
    let mut viewer = Viewer::new(&headset, config, options.comfort)?;
    viewer.governor = options.budget.map(Governor::new);
    viewer.read_back(&headset, true)?;
    let mut animation = is_animated(output).then(|| Animation::new(output, drawn, fps));
    if animation.is_none() {
        std::fs::create_dir_all(output).map_err(CommandError::io(output))?;
    }
    let mut written = 0;
    for step in 0.. {
        if step == first {
            viewer.show(Content::new(gpu, opened, packing)?)?;
        }
        let ended = viewer.step(&mut headset)?.is_some();
        if let Some(eyes) = viewer.pictures() {
            let eyes = [picture_of(&eyes[0])?, picture_of(&eyes[1])?];
            let picture = side_by_side(&eyes)?;
            match &mut animation {
                Some(animation) => animation.add(&picture)?,
                None => picture.save(&output.join(format!("{written:05}.png")))?,
            }
            written += 1;
        }
        if ended {
            break;
        }
    }
    if let Some(animation) = animation {
        animation.finish()?;
    }
    drop((viewer, headset));
    no_complaints(gpu)?;
    Ok(written)
}
