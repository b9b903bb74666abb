//! From where a picture is taken.

use glam::{DMat3, DQuat, DVec3};

use crate::ConfigError;
use motes_scenes::cameras::Camera;

/// Largest tangent of a view's half-angles: 89.94°. Its square times a splat's fits an f32.
const MAX_TANGENT: f64 = 1e3;
/// Farthest an eye may be from the data's origin, metres: the square of the distance fits an f32.
const MAX_EYE: f64 = 1e15;

/// Tangents of the four half-angles of a (possibly asymmetric) perspective frustum, each measured from the
/// forward axis: `left` and `up` are usually negative (x points right, y points **down**). Through another
/// [`Lens`](crate::Lens) the angles themselves, radians: the image's edges as places of that lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fov {
    /// Tangent of the angle to the left edge (x = left at depth 1).
    pub left: f64,
    /// Tangent of the angle to the right edge.
    pub right: f64,
    /// Tangent of the angle to the upper edge (negative: y points down).
    pub up: f64,
    /// Tangent of the angle to the lower edge.
    pub down: f64,
}

/// One picture to take: pose, field of view and size.
///
/// Eye axes are the trainers' (COLMAP's): x right, y down, z forward. Pixel `(i, j)` has its centre at `(i + ½, j + ½)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// World-to-eye rotation.
    pub rotation: DMat3,
    /// The eye, in scene axes (metres).
    pub eye: DVec3,
    /// Field of view.
    pub fov: Fov,
    /// Width and height, pixels.
    pub size: [u32; 2],
}

impl Fov {
    /// A symmetric field of view with square pixels, from the full vertical angle in radians.
    pub fn vertical(angle: f64, size: [u32; 2]) -> Self {
        let t = (angle / 2.0).tan();
        let s = t * f64::from(size[0]) / f64::from(size[1]);
        Self { left: -s, right: s, up: -t, down: t }
    }

    /// From pinhole intrinsics in pixels; `cx`, `cy` in pixel-edge coordinates (the image's centre is `width / 2`).
    pub fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64, size: [u32; 2]) -> Self {
        Self {
            left: -cx / fx,
            right: (f64::from(size[0]) - cx) / fx,
            up: -cy / fy,
            down: (f64::from(size[1]) - cy) / fy,
        }
    }
}

impl View {
    /// A view from `eye` towards `target`; `up` is the world's upward direction.
    /// Where `up` and the line of sight are parallel another direction is taken for `up`.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, fov: Fov, size: [u32; 2]) -> Self {
        let forward = (target - eye).try_normalize().unwrap_or(DVec3::Z);
        let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        let down = forward.cross(right);
        Self { rotation: DMat3::from_cols(right, down, forward).transpose(), eye, fov, size }
    }

    /// From an orientation that turns eye axes (x right, **y up, z back**, as in OpenXR and OpenGL) to the world.
    pub fn from_gl_pose(orientation: DQuat, eye: DVec3, fov: Fov, size: [u32; 2]) -> Self {
        let world_to_gl = DMat3::from_quat(orientation.conjugate());
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Self { rotation: flip * world_to_gl, eye, fov, size }
    }

    /// The view of a data set's camera, at the size of its photograph.
    pub fn from_camera(camera: &Camera) -> Self {
        let size = [camera.width, camera.height];
        Self {
            rotation: DMat3::from_cols_array_2d(&camera.rotation).transpose(),
            eye: DVec3::from_array(camera.position()),
            fov: Fov::pinhole(camera.fx, camera.fy, camera.cx, camera.cy, size),
            size,
        }
    }

    /// Whether a picture can be taken from here: finite numbers, a field of view that opens, a rotation that is one.
    ///
    /// # Errors
    /// What is wrong, and with which figures.
    pub fn check(&self) -> Result<(), ConfigError> {
        let f = self.fov;
        let sides = [f.left, f.right, f.up, f.down];
        if !(sides.iter().all(|s| s.abs() <= MAX_TANGENT) && f.left < f.right && f.up < f.down) {
            return Err(ConfigError(format!(
                "a view's field of view is {f:?}: it needs tangents of at most {MAX_TANGENT:.0e}, left < right and up < down"
            )));
        }
        if !(self.eye.abs().max_element() <= MAX_EYE) {
            return Err(ConfigError(format!(
                "a view's eye is at {}: it needs a place within {MAX_EYE:.0e} m",
                self.eye
            )));
        }
        let off = self.rotation * self.rotation.transpose() - DMat3::IDENTITY;
        if !off.to_cols_array().iter().all(|d| d.abs() < 1e-3) {
            return Err(ConfigError(format!(
                "a view's rotation is none, its rows are not at right angles and of length 1: {}",
                self.rotation
            )));
        }
        Ok(())
    }

    /// Focal lengths in pixels, horizontal and vertical: pixels per unit of slope, or per radian through another lens.
    pub fn focal(&self) -> [f64; 2] {
        [
            f64::from(self.size[0]) / (self.fov.right - self.fov.left),
            f64::from(self.size[1]) / (self.fov.down - self.fov.up),
        ]
    }

    /// Principal point in pixel-edge coordinates.
    pub fn principal_point(&self) -> [f64; 2] {
        let [fx, fy] = self.focal();
        [-self.fov.left * fx, -self.fov.up * fy]
    }

    /// A world position in eye axes.
    pub fn to_eye(&self, world: DVec3) -> DVec3 {
        self.rotation * (world - self.eye)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera's own pinhole equation, applied to a point, lands where the view's focal lengths and principal point say.
    #[test]
    fn a_cameras_view_projects_as_the_camera_does() {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.1, -0.4, 0.2, 0.9).normalize());
        let camera = Camera {
            name: "one".to_owned(),
            width: 640,
            height: 360,
            fx: 500.0,
            fy: 450.0,
            cx: 300.0,
            cy: 190.0,
            rotation: turn.transpose().to_cols_array_2d(),
            translation: [0.5, -1.0, 2.0],
            photograph: String::new(),
            image: None,
            split: None,
            time: None,
            inputs: Vec::new(),
        };
        let view = View::from_camera(&camera);
        let world = DVec3::new(0.3, 0.2, 5.0);
        let eye = turn * world + DVec3::from_array(camera.translation);
        assert!((view.to_eye(world) - eye).length() < 1e-12);
        let ([fx, fy], [cx, cy]) = (view.focal(), view.principal_point());
        let pixel = [fx * eye.x / eye.z + cx, fy * eye.y / eye.z + cy];
        let expected = [500.0 * eye.x / eye.z + 300.0, 450.0 * eye.y / eye.z + 190.0];
        assert!((pixel[0] - expected[0]).abs() < 1e-9 && (pixel[1] - expected[1]).abs() < 1e-9);
        // Control: rows and columns of the rotation are not the same thing.
        let transposed = View { rotation: view.rotation.transpose(), ..view };
        assert!((transposed.to_eye(world) - eye).length() > 0.1);
    }
}
