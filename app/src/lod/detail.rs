//! Levels of detail as a viewer shows them, from frame to frame: all of them in memory, or read on the way.

use std::sync::Arc;

use motes_renderer::parts::Parts;
use motes_renderer::{SceneOnDevice, View};

use super::{LevelChoice, Levels, Memory, Resident, Tuning};

enum Kept {
    Whole(Arc<Levels>, Arc<SceneOnDevice>),
    Within(Resident),
}

/// The levels of a scene that is shown.
pub struct Detail {
    choice: LevelChoice,
    kept: Kept,
}

impl Detail {
    /// Of levels that are all in memory, and on the device as one scene. Nothing of it is drawn before
    /// [`Detail::advance`].
    pub fn whole(levels: Arc<Levels>, scene: Arc<SceneOnDevice>, tuning: Tuning) -> Self {
        scene.positions.choose(Some(Parts::new([])));
        Self { choice: levels.choice(tuning), kept: Kept::Whole(levels, scene) }
    }

    /// Of levels that are read on the way.
    pub fn within(resident: Resident, choice: LevelChoice) -> Self {
        Self { choice, kept: Kept::Within(resident) }
    }

    /// The scene on the device.
    pub fn scene(&self) -> &Arc<SceneOnDevice> {
        match &self.kept {
            Kept::Whole(_, scene) => scene,
            Kept::Within(resident) => resident.scene(),
        }
    }

    /// Goes on by `seconds` for the views of the next frame: the scene's parts are then those to draw. `ease`: by how much
    /// the target is lowered under load.
    pub fn advance(&mut self, views: &[View], seconds: f64, ease: f64, tuning: Tuning) {
        self.choice.tuning = tuning;
        match &self.kept {
            Kept::Within(resident) => drop(resident.advance(&mut self.choice, views, seconds, ease)),
            Kept::Whole(levels, scene) => {
                if self.choice.advance(views, seconds, ease) {
                    scene.positions.choose(Some(levels.parts(self.choice.shares())));
                }
            }
        }
    }

    /// Whether frames change by themselves: levels fade into each other, or are on their way.
    pub fn is_busy(&self) -> bool {
        !self.choice.at_rest() || self.choice.missing() != (0, 0)
    }

    /// Regions in view at each level, the finest first.
    pub fn regions(&self) -> Vec<usize> {
        let mut regions = vec![0; self.choice.count()];
        self.choice.levels().flatten().for_each(|level| regions[level] += 1);
        regions
    }

    /// What is in memory, where levels are read on the way.
    pub fn memory(&self) -> Option<Memory> {
        match &self.kept {
            Kept::Whole(..) => None,
            Kept::Within(resident) => Some(resident.memory()),
        }
    }
}
