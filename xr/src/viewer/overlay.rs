//! What lies over the scene: the ring of a landing place, the dark rim, the panel.

use super::Viewer;
use crate::{MOST_QUADS, Quad, RIM_CLEAR, Surface};
use motes_app::headset::{PANEL_SIZE, Pose};

/// Turns a quad's front, +z, upwards.
const FACING_UP: [f32; 4] = [-std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2];
/// Width of the ring that shows where a jump lands, and of those along the arc that leads there, metres.
const LANDING_WIDTH: f32 = 0.6;
const DOT_WIDTH: f32 = 0.04;
/// How far in front of the eyes the dark rim is, metres.
const RIM_DISTANCE: f32 = 0.5;
/// What the rim leaves clear, degrees from the middle: at no strength, and at full.
const RIM_ANGLES: [f32; 2] = [60.0, 22.0];

impl Viewer {
    /// The quads of this frame, and how many they are.
    pub(super) fn quads(&self) -> ([Quad; MOST_QUADS], usize) {
        let nothing =
            Quad { surface: Surface::Rim, pose: Pose::default(), size: [0.0; 2], follows_head: true };
        let (mut quads, mut count) = ([nothing; MOST_QUADS], 0);
        if let Some(locomotion) = &self.locomotion {
            if let Some(landing) = locomotion.landing() {
                let place = locomotion.placement().to_stage(landing);
                quads[count] = Quad {
                    surface: Surface::Landing,
                    pose: Pose { orientation: FACING_UP, position: place.to_array().map(|v| v as f32) },
                    size: [LANDING_WIDTH; 2],
                    follows_head: false,
                };
                count += 1;
            }
            for place in locomotion.arc().into_iter().flatten() {
                // Seen from the front from wherever one looks.
                let pose = Pose { position: place.to_array().map(|v| v as f32), ..self.head };
                let size = [DOT_WIDTH; 2];
                quads[count] = Quad { surface: Surface::Landing, pose, size, follows_head: false };
                count += 1;
            }
            let rim = locomotion.vignette() as f32;
            if rim > 0.01 {
                let [widest, narrowest] = RIM_ANGLES;
                let clear = (widest + (narrowest - widest) * rim).to_radians();
                let width = 2.0 * RIM_DISTANCE * clear.tan() / RIM_CLEAR;
                let position = [0.0, 0.0, -RIM_DISTANCE];
                quads[count] = Quad {
                    surface: Surface::Rim,
                    pose: Pose { position, ..Pose::default() },
                    size: [width; 2],
                    follows_head: true,
                };
                count += 1;
            }
        }
        // On top: neither rim nor ring covers it.
        if self.panel.shown() && self.screen.has_picture() {
            let size = PANEL_SIZE.map(|side| side as f32);
            let pose = *self.panel.pose();
            quads[count] = Quad { surface: Surface::Panel, pose, size, follows_head: false };
            count += 1;
        }
        (quads, count)
    }
}
