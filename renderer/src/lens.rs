//! Lenses: how directions become places in the image, and back.
//!
//! A *place* is a point of the image before it is cut into pixels. Its unit is the lens's own: slopes `x/z`, `y/z` for
//! perspective, radians for the others, and a view's [`Fov`] bounds the places that it shows. Axes are the
//! eye's: x right, y down, z forward.
//!
//! Splatting on the plane tangent to the unit sphere at a splat's mean (Huang et al. 2024, section 5.2) does not ask how
//! the image is made: a pixel is a ray, and the ray meets that plane. Only two things depend on the lens: which pixels
//! a splat can reach, and how large a pixel is there, which the low-pass filter follows. The shaders' twin is
//! `shaders/glsl/lens.glsl`.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec2, DVec3};

use crate::config::{ConfigError, Lens};
use crate::view::{Fov, View};

/// What rounding may add to an angle.
const SPARE: f64 = 1e-6;

impl Lens {
    /// The place of a direction (any length but 0). For perspective only what lies ahead has one.
    pub fn place(self, d: DVec3) -> DVec2 {
        match self {
            Self::Perspective => DVec2::new(d.x / d.z, d.y / d.z),
            Self::Fisheye => {
                let across = d.x.hypot(d.y);
                if across > 0.0 { d.truncate() * (across.atan2(d.z) / across) } else { DVec2::ZERO }
            }
            Self::Equirectangular => DVec2::new(d.x.atan2(d.z), d.y.atan2(d.x.hypot(d.z))),
        }
    }

    /// The unit vector of a place's ray; `None` beyond the sphere, where the image shows nothing.
    pub fn ray(self, place: DVec2) -> Option<DVec3> {
        match self {
            Self::Perspective => Some(place.extend(1.0).normalize()),
            Self::Fisheye => {
                let angle = place.length();
                let across = if angle > 0.0 { place * (angle.sin() / angle) } else { place };
                (angle <= PI).then(|| across.extend(angle.cos()))
            }
            Self::Equirectangular => {
                let (sx, cx) = place.x.sin_cos();
                let (sy, cy) = place.y.sin_cos();
                (place.y.abs() <= FRAC_PI_2).then(|| DVec3::new(sx * cy, sy, cx * cy))
            }
        }
    }

    /// How the direction moves with one unit of the place's x and y, at the unit vector `m`: two tangents of the unit
    /// sphere. Towards a lens's poles (fisheye: straight back; equirectangular: up and down) one of them vanishes.
    pub fn steps(self, m: DVec3) -> [DVec3; 2] {
        match self {
            Self::Perspective => {
                // d(unit vector) for a step of the point at depth 1.
                let flat = |axis: DVec3| (axis - m * m.dot(axis)) * m.z.max(0.0);
                [flat(DVec3::X), flat(DVec3::Y)]
            }
            Self::Fisheye => {
                let across = m.x.hypot(m.y);
                let p = if across > 0.0 { m.truncate() / across } else { DVec2::X };
                let angle = across.atan2(m.z);
                let squeeze = if angle > 0.0 { across / angle } else { 1.0 };
                let radial = (p * m.z).extend(-across);
                let round = DVec3::new(-p.y, p.x, 0.0) * squeeze;
                [radial * p.x - round * p.y, radial * p.y + round * p.x]
            }
            Self::Equirectangular => {
                let level = m.x.hypot(m.z);
                let (s, c) = if level > 0.0 { (m.x / level, m.z / level) } else { (0.0, 1.0) };
                [DVec3::new(m.z, 0.0, -m.x), DVec3::new(-s * m.y, level, -c * m.y)]
            }
        }
    }

    /// The field of view whose width shows `angle` radians, middle ahead, with square pixels.
    pub fn fov(self, angle: f64, size: [u32; 2]) -> Fov {
        let half = if self == Self::Perspective { (angle / 2.0).tan() } else { angle / 2.0 };
        let down = half * f64::from(size[1]) / f64::from(size[0]);
        Fov { left: -half, right: half, up: -down, down }
    }

    /// The angle of a picture's width where none is asked for, radians: all that is ahead, or all around.
    pub fn usual_angle(self) -> f64 {
        match self {
            Self::Perspective => PI / 3.0,
            Self::Fisheye => PI,
            Self::Equirectangular => TAU,
        }
    }

    /// Whether a view can be taken through this lens.
    ///
    /// # Errors
    /// More than the whole sphere is asked for.
    pub fn check(self, view: &View) -> Result<(), ConfigError> {
        let width = view.fov.right - view.fov.left;
        let most = match self {
            Self::Perspective => return Ok(()),
            Self::Fisheye | Self::Equirectangular => TAU,
        };
        if width > most + SPARE {
            let (width, most) = (width.to_degrees(), most.to_degrees());
            return Err(ConfigError(format!(
                "lens {self}: {width:.1}° are more than there are around the eye; choose --fov {most:.0} or less"
            )));
        }
        Ok(())
    }

    /// Whether one pass does not show a view: more than half of the way round.
    pub(crate) fn splits(self, view: &View) -> bool {
        let width = view.size[0];
        // Half of an odd number of columns is one more than half.
        let all_but_one = (view.fov.right - view.fov.left) * (1.0 - 1.0 / f64::from(width.max(1)));
        self == Self::Equirectangular && all_but_one > PI + SPARE && width >= 2
    }

    /// The views that a picture is drawn in, side by side. One, but for an equirectangular one that shows more than half
    /// of the way round: there a splat may lie on both edges, and in halves it lies on one edge of each.
    pub(crate) fn parts(self, view: &View) -> Vec<View> {
        let [width, height] = view.size;
        if !self.splits(view) {
            return vec![*view];
        }
        let left = width.div_ceil(2);
        let f = view.fov;
        let middle = f.left + (f.right - f.left) * f64::from(left) / f64::from(width);
        vec![
            View { fov: Fov { right: middle, ..f }, size: [left, height], ..*view },
            View { fov: Fov { left: middle, ..f }, size: [width - left, height], ..*view },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn directions() -> impl Iterator<Item = DVec3> {
        (0..200).map(|i| {
            let t = f64::from(i);
            DVec3::new((1.3 * t).sin(), (0.7 * t + 1.0).sin(), (2.1 * t).cos()).normalize()
        })
    }

    #[test]
    fn places_and_rays_are_each_others_inverse() {
        for lens in [Lens::Fisheye, Lens::Equirectangular] {
            for d in directions() {
                let back = lens.ray(lens.place(d * 3.0)).unwrap();
                assert!((back - d).length() < 1e-12, "{lens} {d}");
            }
        }
        for d in directions().filter(|d| d.z > 0.01) {
            assert!((Lens::Perspective.ray(Lens::Perspective.place(d)).unwrap() - d).length() < 1e-12);
        }
        // The angle from the axis is the distance from the middle; longitude and latitude are column and row.
        let d = DVec3::new(0.0, 2f64.sin(), 2f64.cos());
        assert!((Lens::Fisheye.place(d) - DVec2::new(0.0, 2.0)).length() < 1e-12);
        assert!((Lens::Equirectangular.place(DVec3::NEG_X) - DVec2::new(-FRAC_PI_2, 0.0)).length() < 1e-12);
        assert_eq!(Lens::Fisheye.ray(DVec2::new(3.0, 1.0)), None);
        assert_eq!(Lens::Equirectangular.ray(DVec2::new(0.0, 1.6)), None);
    }

    #[test]
    fn steps_are_the_rays_derivatives() {
        for lens in [Lens::Perspective, Lens::Fisheye, Lens::Equirectangular] {
            for d in directions().filter(|d| lens != Lens::Perspective || d.z > 0.05) {
                let place = lens.place(d);
                let [x, y] = lens.steps(d);
                for (axis, step) in [(DVec2::X, x), (DVec2::Y, y)] {
                    let h = 1e-6;
                    let (a, b) = (lens.ray(place - axis * h), lens.ray(place + axis * h));
                    let (Some(a), Some(b)) = (a, b) else { continue };
                    let expected = (b - a) / (2.0 * h);
                    assert!((step - expected).length() < 1e-6, "{lens} {d}: {step} {expected}");
                    assert!(step.dot(d).abs() < 1e-12);
                }
                // Control: the steps are not each other's.
                assert!((x - y).length() > 1e-3 || x.length() < 1e-2);
            }
        }
    }

    #[test]
    fn halves_show_what_the_whole_shows() {
        for width in [64, 65] {
            let size = [width, 32];
            let fov = Lens::Equirectangular.fov(TAU, size);
            let view = View { rotation: DMat3::IDENTITY, eye: DVec3::ZERO, fov, size };
            let parts = Lens::Equirectangular.parts(&view);
            assert_eq!(parts.iter().map(|p| p.size[0]).sum::<u32>(), width);
            for part in &parts {
                assert!((part.focal()[0] - view.focal()[0]).abs() < 1e-9, "pixels keep their size");
                assert_eq!(part.focal()[1], view.focal()[1]);
            }
            assert_eq!((parts[0].fov.left, parts[1].fov.right), (fov.left, fov.right));
            assert_eq!(parts[0].fov.right, parts[1].fov.left);
        }
        let size = [64, 64];
        let half = View {
            rotation: DMat3::IDENTITY,
            eye: DVec3::ZERO,
            fov: Lens::Equirectangular.fov(PI, size),
            size,
        };
        assert_eq!(Lens::Equirectangular.parts(&half).len(), 1);
        let fisheye = View { fov: Lens::Fisheye.fov(TAU, size), ..half };
        assert_eq!(Lens::Fisheye.parts(&fisheye).len(), 1);
        assert!(Lens::Fisheye.check(&fisheye).is_ok());
        let more = View { fov: Lens::Fisheye.fov(7.0, size), ..half };
        assert!(Lens::Fisheye.check(&more).unwrap_err().0.contains("--fov 360"));
    }
}
