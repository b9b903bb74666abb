//! Where the stage stands in the world: what locomotion changes.

use super::{Eye, Pose};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use motes_renderer::View;

/// How many world metres a metre of the stage may be: from an ant to a giant.
const SCALES: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// A similarity from stage to world that keeps up up: `world = translation + scale · turn(yaw) · stage`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Turn about the vertical, radians, to the left as seen from above.
    pub yaw: f64,
    /// World metres in a metre of the stage: 2 makes the user twice as large.
    pub scale: f64,
    /// The stage's origin in the world, metres.
    pub translation: DVec3,
}

impl Default for Placement {
    fn default() -> Self {
        Self { yaw: 0.0, scale: 1.0, translation: DVec3::ZERO }
    }
}

impl Placement {
    /// The turn.
    pub fn turn(&self) -> DQuat {
        DQuat::from_rotation_y(self.yaw)
    }

    /// A place of the stage in the world.
    pub fn to_world(&self, stage: DVec3) -> DVec3 {
        self.translation + self.scale * (self.turn() * stage)
    }

    /// A place of the world in the stage.
    pub fn to_stage(&self, world: DVec3) -> DVec3 {
        self.turn().conjugate() * ((world - self.translation) / self.scale)
    }

    /// The same, moved so that a place of the stage is at a place of the world.
    pub fn with_place_at(mut self, stage: DVec3, world: DVec3) -> Self {
        self.translation = world - self.scale * (self.turn() * stage);
        self
    }

    /// The same, turned to the left about a place of the stage that stays where it is.
    pub fn turned_about(mut self, stage: DVec3, angle: f64) -> Self {
        let world = self.to_world(stage);
        self.yaw = wrapped(self.yaw + angle);
        self.with_place_at(stage, world)
    }

    /// The placement in which two places of the stage lie where two of the world do: exactly in distance, in heading,
    /// and in their midpoint. What is undefined (places one above the other, or equal) stays as it is.
    pub fn through(mut self, stage: [DVec3; 2], world: [DVec3; 2]) -> Self {
        let (s, w) = (stage[1] - stage[0], world[1] - world[0]);
        let scale = w.length() / s.length();
        if scale.is_finite() && scale > 0.0 {
            self.scale = scale.clamp(*SCALES.start(), *SCALES.end());
        }
        // Heading: turning about y by a takes (x, z) to (x cos a + z sin a, z cos a − x sin a).
        let flat = |v: DVec3| (v.x * v.x + v.z * v.z).sqrt() > 0.1 * v.length();
        if flat(s) && flat(w) {
            self.yaw = wrapped(s.z.atan2(s.x) - w.z.atan2(w.x));
        }
        self.with_place_at((stage[0] + stage[1]) / 2.0, (world[0] + world[1]) / 2.0)
    }

    /// The view of an eye in the axes and units of a scene that stands in the world as `scene_to_world` says (a
    /// similarity).
    pub fn view(&self, eye: &Eye, scene_to_world: &DAffine3, size: [u32; 2]) -> View {
        let world_to_scene = scene_to_world.inverse();
        let rotation = upright(world_to_scene.matrix3) * self.turn() * eye.pose.rotation();
        let place = world_to_scene.transform_point3(self.to_world(eye.pose.place()));
        View::from_gl_pose(rotation, place, eye.fov.tangents(), size)
    }

    /// Scene units in a metre of the stage.
    pub fn scene_units(&self, scene_to_world: &DAffine3) -> f64 {
        self.scale / scale_of(scene_to_world)
    }

    /// From where a scene is first seen: the stage stands so that the head looks from a place in a direction, both in
    /// the world. With a known floor the user stands on it; else the head is as high as the place.
    pub fn looking_from(place: DVec3, forward: DVec3, head: &Pose, floor_known: bool) -> Self {
        let mut placement =
            Self { yaw: wrapped(yaw_of(forward) - yaw_of(head.forward())), ..Self::default() };
        placement = placement.with_place_at(head.place(), place);
        if floor_known {
            placement.translation.y = 0.0;
        }
        placement
    }
}

/// Heading of a direction: 0 along −z, to the left as seen from above; 0 where it has none.
pub fn yaw_of(forward: DVec3) -> f64 {
    if forward.x == 0.0 && forward.z == 0.0 { 0.0 } else { (-forward.x).atan2(-forward.z) }
}

/// Metres in a unit of the scene.
fn scale_of(scene_to_world: &DAffine3) -> f64 {
    scene_to_world.matrix3.determinant().abs().cbrt()
}

/// The rotation in a similarity.
fn upright(matrix: DMat3) -> DQuat {
    let scale = matrix.determinant().abs().cbrt();
    DQuat::from_mat3(&(matrix * (1.0 / scale))).normalize()
}

/// An angle between −π and π.
fn wrapped(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    if angle.abs() <= turn / 2.0 {
        return angle; // exactly
    }
    let a = angle.rem_euclid(turn);
    if a > turn / 2.0 { a - turn } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::headset::EyeFov;
    use motes_scenes::settings::Settings;

    const PLACES: [DVec3; 2] = [DVec3::new(-0.3, 1.1, -0.4), DVec3::new(0.25, 1.3, -0.5)];

    fn any() -> Placement {
        Placement { yaw: 0.7, scale: 2.5, translation: DVec3::new(3.0, -1.0, 2.0) }
    }

    #[test]
    fn there_and_back() {
        for place in PLACES {
            assert!((any().to_stage(any().to_world(place)) - place).length() < 1e-12);
        }
    }

    #[test]
    fn two_places_lie_where_they_are_wanted() {
        let wanted = any();
        let world = PLACES.map(|p| wanted.to_world(p));
        let found = Placement::default().through(PLACES, world);
        assert!((found.yaw - wanted.yaw).abs() < 1e-12, "{found:?}");
        assert!((found.scale - wanted.scale).abs() < 1e-12, "{found:?}");
        assert!((found.translation - wanted.translation).length() < 1e-12, "{found:?}");
        // One above the other: the heading stays.
        let column = [DVec3::ZERO, DVec3::Y];
        let found = any().through(column, [DVec3::X, DVec3::X + 3.0 * DVec3::Y]);
        assert_eq!((found.yaw, found.scale), (0.7, 3.0));
        // Equal places: only the midpoint moves.
        let found = any().through([DVec3::ZERO; 2], [DVec3::X; 2]);
        assert_eq!((found.yaw, found.scale, found.translation), (0.7, 2.5, DVec3::X));
    }

    #[test]
    fn a_turn_leaves_the_head_where_it_is() {
        let before = any().to_world(PLACES[0]);
        let turned = any().turned_about(PLACES[0], 0.5);
        assert!((turned.to_world(PLACES[0]) - before).length() < 1e-12);
        assert!((turned.to_world(PLACES[1]) - any().to_world(PLACES[1])).length() > 0.1);
    }

    #[test]
    fn a_view_sees_what_the_eye_sees() {
        let settings = Settings { scale: 0.5, ..Settings::default() };
        let scene_to_world = settings.scene_to_world();
        let fov = EyeFov { left: -0.9, right: 0.7, up: 0.8, down: -0.85 };
        let turn = DQuat::from_rotation_y(0.3);
        let pose = Pose {
            orientation: turn.to_array().map(|v| v as f32),
            position: PLACES[0].to_array().map(|v| v as f32),
        };
        let eye = Eye { pose, fov };
        let view = any().view(&eye, &scene_to_world, [320, 240]);
        // 2 m ahead of the eye and 0.1 m to its right and above, through stage and world into the scene.
        let stage = pose.place() + pose.rotation() * DVec3::new(0.1, 0.2, -2.0);
        let scene = scene_to_world.inverse().transform_point3(any().to_world(stage));
        let seen = view.to_eye(scene) / any().scene_units(&scene_to_world);
        assert!((seen - DVec3::new(0.1, -0.2, 2.0)).length() < 1e-9, "{seen}");
        assert!(
            (any().scene_units(&scene_to_world) - 5.0).abs() < 1e-12,
            "2.5 m of the world, 5 units of the scene"
        );
        assert!((view.fov.right - 0.7f64.tan()).abs() < 1e-7 && (view.fov.up + 0.8f64.tan()).abs() < 1e-7);
    }

    #[test]
    fn the_first_view_is_where_it_is_wanted() {
        let turn = DQuat::from_rotation_y(-1.1);
        let head = Pose { orientation: turn.to_array().map(|v| v as f32), position: [0.4, 1.7, 0.1] };
        let (place, forward) = (DVec3::new(5.0, 1.2, -3.0), DVec3::new(1.0, -0.4, 1.0));
        let loose = Placement::looking_from(place, forward, &head, false);
        assert!((loose.to_world(head.place()) - place).length() < 1e-9);
        let ahead = loose.turn() * head.forward();
        assert!((yaw_of(ahead) - yaw_of(forward)).abs() < 1e-6, "{ahead}");
        let standing = Placement::looking_from(place, forward, &head, true);
        assert!((standing.to_world(head.place()).y - 1.7).abs() < 1e-6, "the floor is the floor");
    }
}
