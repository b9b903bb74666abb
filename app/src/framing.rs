//! Where to look from when nobody says so: at the middle of a scene, from outside of its dense part.

use glam::DVec3;
use motes_renderer::{Fov, View};
use motes_scenes::Splats;
use motes_scenes::settings::Settings;

/// The dense part of a scene, in scene axes and units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Its middle: per axis, half-way between what a twentieth of the means lies below and above.
    pub center: DVec3,
    /// The distance from there within which most splats lie; positive.
    pub radius: f64,
    /// Upwards, of length 1.
    pub up: DVec3,
}

/// Splats that are looked at, at most.
const SAMPLES: usize = 1 << 16;

impl Framing {
    /// Looks at a scene.
    pub fn of(splats: &Splats, settings: &Settings) -> Self {
        let up = settings.orientation.rotation().inverse() * DVec3::Y;
        let step = splats.len().div_ceil(SAMPLES).max(1);
        // Without motion's spread and without dust: what hardly shows does not count.
        let visible = |i: &usize| splats.opacities[*i] > 0.1;
        let indices: Vec<usize> = (0..splats.len()).step_by(step).filter(visible).collect();
        let middle = |mut values: Vec<f64>, share: f64| {
            let at = ((values.len().saturating_sub(1)) as f64 * share) as usize;
            if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
        };
        let mean = |i: &usize| DVec3::from_array(splats.mean_of(*i));
        let axis = |k: usize| {
            let at = |share| middle(indices.iter().map(|i| mean(i)[k]).collect(), share);
            0.5 * (at(0.05) + at(0.95))
        };
        let center = DVec3::new(axis(0), axis(1), axis(2));
        let within = |share| middle(indices.iter().map(|i| mean(i).distance(center)).collect(), share);
        // A thing on its own is shown whole; of a scene with much around it, its middle.
        let radius = within(0.95).min(2.0 * within(0.5));
        Self { center, radius: if radius > 0.0 { radius } else { 1.0 }, up }
    }

    /// An eye around the scene: `turn` in radians about the up axis, `lift` in radians above the horizon; far enough
    /// for the dense part to fill a view of this vertical angle (radians).
    pub fn eye(&self, turn: f64, lift: f64, vertical_fov: f64) -> DVec3 {
        let (ahead, aside) = self.horizontal();
        let direction = (ahead * turn.cos() + aside * turn.sin()) * lift.cos() + self.up * lift.sin();
        self.center + direction * (1.2 * self.radius / (vertical_fov / 2.0).sin())
    }

    /// A view from such an eye to the middle.
    pub fn view(&self, turn: f64, lift: f64, vertical_fov: f64, size: [u32; 2]) -> View {
        let eye = self.eye(turn, lift, vertical_fov);
        View::look_at(eye, self.center, self.up, Fov::vertical(vertical_fov, size), size)
    }

    /// Two horizontal directions at right angles: from the middle towards where the data set's first camera usually
    /// stands (−z of a scene with y down), and to the right of who looks from there.
    fn horizontal(&self) -> (DVec3, DVec3) {
        let back = if self.up.z.abs() > 0.9 { DVec3::NEG_Y } else { DVec3::NEG_Z };
        let ahead = (back - self.up * back.dot(self.up)).try_normalize().unwrap_or(DVec3::X);
        (ahead, self.up.cross(ahead))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use motes_scenes::synthetic::Recipe;

    #[test]
    fn the_dense_part_fills_the_view_from_every_side() {
        let mut splats = Recipe { count: 4000, ..Default::default() }.still();
        for mean in &mut splats.means {
            *mean = [mean[0] + 7.0, mean[1], mean[2] - 3.0];
        }
        let settings = Settings::default();
        let framing = Framing::of(&splats, &settings);
        // Far outliers change nothing.
        let mut dirty = splats.clone();
        dirty.means[0] = [1e6; 3];
        assert!((Framing::of(&dirty, &settings).radius / framing.radius - 1.0).abs() < 0.01);
        for turn in [0.0, 1.0, 2.5, 4.0] {
            let view = framing.view(turn, 0.3, 1.0, [640, 480]);
            let inside = splats.means.iter().filter(|m| {
                let p = view.to_eye(glam::Vec3::from(**m).as_dvec3());
                let (x, y) = (p.x / p.z, p.y / p.z);
                p.z > 0.0 && x > view.fov.left && x < view.fov.right && y > view.fov.up && y < view.fov.down
            });
            let share = inside.count() as f64 / splats.len() as f64;
            assert!(share > 0.8, "{share} from {turn}");
            // Up is up: y points down in an eye's axes.
            assert!((view.rotation * framing.up).y < -0.5);
        }
    }
}
