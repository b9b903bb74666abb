//! Where the eyes of a recorded session were in a scene: what [`Viewer`](crate::Viewer) finds, without a device.

use crate::{FirstView, Script, ScriptStep};
use glam::DAffine3;
use motes_app::headset::{Comfort, Locomotion, Panel, Placement, Pose};
use motes_renderer::View;

impl Script {
    /// Both eyes' views of every frame that was drawn of a scene that stands so in the world, in scene axes.
    pub fn views(
        &self,
        scene_to_world: &DAffine3,
        first_view: &FirstView,
        comfort: &Comfort,
    ) -> Vec<[View; 2]> {
        // Sessions that were written by hand name no orders, and show the scene from the first frame on.
        let first = self.first_drawn().unwrap_or(0);
        let (mut panel, mut head, mut before) = (Panel::default(), Pose::default(), None);
        let mut locomotion: Option<Locomotion> = None;
        let mut views = Vec::new();
        for (at, step) in self.steps.iter().enumerate() {
            let ScriptStep::Frame(frame) = step else { continue };
            let time = frame.time.display_time;
            let elapsed = before.map_or(0, |before| time.saturating_sub(before));
            let dt = (elapsed as f64 / 1e9).clamp(0.0, 0.1);
            before = Some(time);
            panel.update(&frame.input, &head, comfort, dt);
            if let Some(locomotion) = &mut locomotion {
                locomotion.update(&frame.input, panel.busy(), &head, comfort, dt);
            }
            let (Some(eyes), true) = (&frame.eyes, frame.time.should_render) else { continue };
            head = Pose::between(&eyes[0].pose, &eyes[1].pose);
            if at < first {
                continue;
            }
            let locomotion = locomotion.get_or_insert_with(|| {
                let FirstView { place, forward, floor_known } = *first_view;
                Locomotion::new(Placement::looking_from(place, forward, &head, floor_known))
            });
            let placement = locomotion.placement();
            views.push(eyes.each_ref().map(|eye| placement.view(eye, scene_to_world, self.images.size)));
        }
        views
    }
}
