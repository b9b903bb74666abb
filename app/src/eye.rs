//! The eye of a viewer on a flat screen: flying, or orbiting a point. In scene axes and units, upright by default.

use glam::{DMat3, DVec3};
use motes_renderer::{Fov, View};

use crate::framing::Framing;

/// How motions are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EyeMode {
    /// The eye turns and moves.
    Fly,
    /// The eye goes round a point that it looks at.
    Orbit,
}

/// A motion of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EyeMotion {
    /// Right, down and forward, in eye axes and scene units. Orbit: forward approaches the point, the others move both.
    pub shift: DVec3,
    /// To the right, radians.
    pub turn: f64,
    /// Upwards, radians.
    pub lift: f64,
}

impl EyeMotion {
    /// Whether there is any.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Where the eye is and where it looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// How motions are meant.
    pub mode: EyeMode,
    /// Full vertical field of view, radians.
    pub vertical_fov: f64,
    position: DVec3,
    /// To the right, radians.
    yaw: f64,
    /// Upwards, radians, within a right angle.
    pitch: f64,
    /// Clockwise, radians: of data sets' cameras; the first turn by hand ends it.
    roll: f64,
    /// Distance of the point that orbiting goes round; positive.
    distance: f64,
    /// Right, down and forward of an eye that looks straight ahead.
    level: DMat3,
}

/// The nearest that an orbiting eye comes to its point, scene units.
const NEAREST: f64 = 1e-4;
/// Straight up and down are left out: there the way to turn would be lost.
const MOST_PITCH: f64 = 1.55;

impl Eye {
    /// An eye that sees the dense part of a scene.
    pub fn of(framing: &Framing, mode: EyeMode, vertical_fov: f64) -> Self {
        let start = framing.view(0.6, 0.3, vertical_fov, [16, 9]);
        let down = -framing.up;
        let ahead = framing.up.any_orthonormal_vector();
        let level = DMat3::from_cols(down.cross(ahead), down, ahead);
        let distance = (framing.center - start.eye).length();
        let mut eye = Self {
            mode,
            vertical_fov,
            position: start.eye,
            yaw: 0.0,
            pitch: 0.0,
            roll: 0.0,
            distance,
            level,
        };
        eye.face(start.rotation);
        eye
    }

    /// Puts the eye where a view is taken from, looking the same way, tilted as it is.
    pub fn take(&mut self, view: &View) {
        self.position = view.eye;
        self.face(view.rotation);
        let [_, fy] = view.focal();
        self.vertical_fov = 2.0 * (0.5 * f64::from(view.size[1]) / fy).atan();
    }

    /// Turns to a world-to-eye rotation.
    fn face(&mut self, rotation: DMat3) {
        let forward = self.level.transpose() * rotation.row(2);
        self.yaw = forward.x.atan2(forward.z);
        self.pitch = (-forward.y).clamp(-1.0, 1.0).asin().clamp(-MOST_PITCH, MOST_PITCH);
        self.roll = 0.0;
        let right = self.upright() * rotation.row(0);
        self.roll = right.y.atan2(right.x);
    }

    /// World-to-eye rotation without the tilt.
    fn upright(&self) -> DMat3 {
        let (yaw, pitch) = (DMat3::from_rotation_y(-self.yaw), DMat3::from_rotation_x(-self.pitch));
        pitch * yaw * self.level.transpose()
    }

    /// World-to-eye rotation.
    pub fn rotation(&self) -> DMat3 {
        DMat3::from_rotation_z(-self.roll) * self.upright()
    }

    /// Where the eye is.
    pub fn position(&self) -> DVec3 {
        self.position
    }

    /// The point that orbiting goes round.
    pub fn target(&self) -> DVec3 {
        self.position + self.rotation().row(2) * self.distance
    }

    /// Goes round another point, at the same distance at least as the scene's size asks for.
    pub fn set_distance(&mut self, distance: f64) {
        if distance > 0.0 && distance.is_finite() {
            self.distance = distance;
        }
    }

    /// Moves. Values that are no numbers change nothing.
    pub fn move_by(&mut self, motion: &EyeMotion) {
        if motion.is_none()
            || !(motion.shift.is_finite() && motion.turn.is_finite() && motion.lift.is_finite())
        {
            return;
        }
        let target = self.target();
        if motion.turn != 0.0 || motion.lift != 0.0 {
            self.roll = 0.0;
            self.yaw = (self.yaw + motion.turn) % std::f64::consts::TAU;
            self.pitch = (self.pitch + motion.lift).clamp(-MOST_PITCH, MOST_PITCH);
            if self.mode == EyeMode::Orbit {
                self.position = target - self.rotation().row(2) * self.distance;
            }
        }
        let rotation = self.rotation();
        match self.mode {
            EyeMode::Fly => self.position += rotation.transpose() * motion.shift,
            EyeMode::Orbit => {
                let sideways = DVec3::new(motion.shift.x, motion.shift.y, 0.0);
                self.position += rotation.transpose() * sideways;
                // Approaching slows down near the point and never passes it.
                let step = (motion.shift.z / self.distance).clamp(-1.0, 1.0);
                let nearer = (self.distance * (-step).exp()).max(NEAREST);
                self.position += rotation.row(2) * (self.distance - nearer);
                self.distance = nearer;
            }
        }
    }

    /// What it sees, in an image of this size.
    pub fn view(&self, size: [u32; 2]) -> View {
        let fov = Fov::vertical(self.vertical_fov, size);
        View { rotation: self.rotation(), eye: self.position, fov, size }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    fn framing() -> Framing {
        Framing { center: DVec3::new(1.0, 2.0, 3.0), radius: 2.0, up: DVec3::NEG_Y }
    }

    #[test]
    fn the_first_view_is_the_framings() {
        let eye = Eye::of(&framing(), EyeMode::Orbit, 1.0);
        let wanted = framing().view(0.6, 0.3, 1.0, [640, 480]);
        let view = eye.view([640, 480]);
        assert!((view.eye - wanted.eye).length() < 1e-9);
        assert!((view.rotation - wanted.rotation).to_cols_array().iter().all(|d| d.abs() < 1e-9));
        assert!((eye.target() - framing().center).length() < 1e-9);
    }

    #[test]
    fn orbiting_keeps_the_point_in_the_middle() {
        let mut eye = Eye::of(&framing(), EyeMode::Orbit, 1.0);
        for _ in 0..200 {
            eye.move_by(&EyeMotion { turn: 0.3, lift: 0.1, shift: DVec3::new(0.0, 0.0, 0.4) });
            let seen = eye.view([100, 100]).to_eye(framing().center);
            assert!(seen.x.abs() < 1e-9 && seen.y.abs() < 1e-9 && seen.z >= 0.9 * NEAREST, "{seen}");
        }
        // Pushed to the side, the point goes along.
        eye.move_by(&EyeMotion { shift: DVec3::X, ..Default::default() });
        assert!((eye.view([100, 100]).to_eye(framing().center).x + 1.0).abs() < 1e-9);
    }

    #[test]
    fn flying_turns_to_the_right_and_moves_ahead() {
        let mut eye = Eye::of(&framing(), EyeMode::Fly, 1.0);
        let ahead = eye.target();
        let place = eye.position();
        eye.move_by(&EyeMotion { turn: 0.2, ..Default::default() });
        assert_eq!(eye.position(), place);
        // What was in the middle is now on the left.
        assert!(eye.view([100, 100]).to_eye(ahead).x < 0.0);
        eye.move_by(&EyeMotion { lift: 0.2, ..Default::default() });
        assert!(eye.view([100, 100]).to_eye(ahead).y > 0.0, "and below");
        let to = eye.target();
        let before = (to - eye.position()).length();
        eye.move_by(&EyeMotion { shift: DVec3::new(0.0, 0.0, 0.5), ..Default::default() });
        assert!(((to - eye.position()).length() - (before - 0.5)).abs() < 1e-9);
    }

    #[test]
    fn a_cameras_tilt_is_taken_over_until_the_eye_is_turned() {
        let mut eye = Eye::of(&framing(), EyeMode::Orbit, 1.0);
        let fov = Fov::vertical(0.7, [640, 480]);
        let level = View::look_at(DVec3::new(5.0, 1.0, -2.0), DVec3::ZERO, DVec3::NEG_Y, fov, [640, 480]);
        let tilted = View { rotation: DMat3::from_rotation_z(0.4) * level.rotation, ..level };
        eye.take(&tilted);
        let view = eye.view([640, 480]);
        assert!((view.rotation - tilted.rotation).to_cols_array().iter().all(|d| d.abs() < 1e-9));
        assert!((eye.vertical_fov - 0.7).abs() < 1e-9);
        eye.move_by(&EyeMotion { turn: 1e-6, ..Default::default() });
        assert!(eye.rotation().row(0).dot(DVec3::NEG_Y).abs() < 1e-9, "upright again");
        eye.move_by(&EyeMotion { turn: f64::NAN, ..Default::default() });
        assert!(eye.position().is_finite());
    }
}
