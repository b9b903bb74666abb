//! Boxes around splats: how near they are, and whether a view sees them.

use glam::DVec3;
use motes_renderer::View;

/// Lowest and highest corner, scene axes and units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds(pub [DVec3; 2]);

impl Bounds {
    /// Around nothing.
    pub const EMPTY: Self = Self([DVec3::INFINITY, DVec3::NEG_INFINITY]);

    /// Made wide enough for a ball.
    pub fn include(&mut self, center: DVec3, radius: f64) {
        self.0[0] = self.0[0].min(center - radius);
        self.0[1] = self.0[1].max(center + radius);
    }

    /// Of a point from the box: 0 inside; ∞ from an empty box.
    pub fn distance(&self, point: DVec3) -> f64 {
        let [low, high] = self.0;
        (low - point).max(point - high).max(DVec3::ZERO).length()
    }

    /// Whether a view that is wider by `margin` (radians) on all sides may see something of it: false only where all of it
    /// lies beyond one of the view's planes.
    pub fn may_be_seen(&self, view: &View, margin: f64) -> bool {
        let [low, high] = self.0;
        if low.cmpgt(high).any() {
            return false;
        }
        let corner = |i: usize| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
            view.to_eye(DVec3::new(pick(0), pick(1), pick(2)))
        };
        let corners: [DVec3; 8] = std::array::from_fn(corner);
        let sides = [
            (0, -1.0, view.fov.left),
            (0, 1.0, view.fov.right),
            (1, -1.0, view.fov.up),
            (1, 1.0, view.fov.down),
        ]
        .map(|(axis, sign, tangent)| (axis, sign, f64::atan(sign * tangent) + margin));
        if sides.iter().any(|(_, _, angle)| *angle >= std::f64::consts::FRAC_PI_2) {
            // Wider than a half-space: no plane has all of the view before it.
            return true;
        }
        // Each side as a plane through the eye.
        let beyond = |&(axis, sign, angle): &(usize, f64, f64)| {
            corners.iter().all(|c| angle.sin() * c.z - sign * angle.cos() * c[axis] < 0.0)
        };
        corners.iter().any(|c| c.z >= 0.0) && !sides.iter().any(beyond)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_renderer::Fov;

    fn ball(center: DVec3, radius: f64) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        bounds.include(center, radius);
        bounds
    }

    #[test]
    fn distances_are_from_the_nearest_side() {
        let b = ball(DVec3::ZERO, 1.0);
        assert_eq!([b.distance(DVec3::ZERO), b.distance(DVec3::X * 3.0)], [0.0, 2.0]);
        assert!((b.distance(DVec3::splat(2.0)) - 3f64.sqrt()).abs() < 1e-12);
        assert_eq!(Bounds::EMPTY.distance(DVec3::ZERO), f64::INFINITY);
    }

    /// Nothing whose projection lies in the picture is ever called unseen.
    #[test]
    fn what_a_view_sees_is_never_left_out() {
        let fov = Fov { left: -0.4, right: 0.9, up: -0.3, down: 0.5 };
        let eye = DVec3::new(0.3, -0.2, 1.0);
        let view = View::look_at(eye, DVec3::new(2.0, 0.5, 4.0), DVec3::NEG_Y, fov, [64, 48]);
        let (mut seen, mut left_out) = (0, 0);
        let mut random = motes_scenes::synthetic::Random::new(3);
        let mut unit = || f64::from(random.uniform(0.0, 1.0));
        for _ in 0..4000 {
            let at = eye + DVec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5) * 8.0;
            let bounds = ball(at, 0.2 * unit());
            let c = view.to_eye(at);
            let inside = c.z > 0.0
                && (fov.left..fov.right).contains(&(c.x / c.z))
                && (fov.up..fov.down).contains(&(c.y / c.z));
            assert!(!inside || bounds.may_be_seen(&view, 0.0), "{at}");
            seen += usize::from(inside);
            left_out += usize::from(!bounds.may_be_seen(&view, 0.0));
            assert!(
                !bounds.may_be_seen(&view, 0.0) || bounds.may_be_seen(&view, 0.2),
                "a margin only widens"
            );
        }
        // Most of what lies around is left out, a tenth or so is in the picture.
        assert!(seen > 50 && left_out > 2500, "{seen} {left_out}");
        assert!(!Bounds::EMPTY.may_be_seen(&view, 0.3));
        assert!(ball(eye - DVec3::X * 9.0, 0.1).may_be_seen(&view, 1.5), "all around, nothing is left out");
    }
}
