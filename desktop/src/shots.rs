//! Which pictures are taken: from cameras of files, from an eye and a target, from all around.

use std::path::PathBuf;
use std::str::FromStr;

use glam::{DQuat, DVec3};
use motes_app::framing::Framing;
use motes_app::opened::{Opened, saved_view};
use motes_renderer::{Fov, Lens, View};
use motes_scenes::cameras::{self, Camera};
use motes_scenes::settings::{Axis, Orientation, Settings};

use crate::error::CommandError;

/// From where pictures are taken.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "From where")]
pub struct ShotArgs {
    /// Cameras: a trainer's cameras.json, COLMAP, NeRF's transforms.json, or a list with R_w2c and t_w2c
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// The camera of this name
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Every camera of the file, into the folder OUT
    #[arg(long, conflicts_with_all = ["name", "eye", "turntable"])]
    pub all_cameras: bool,
    /// So many pictures from all around, into the folder OUT
    #[arg(long, value_name = "N", conflicts_with_all = ["name", "eye", "cameras"],
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub turntable: Option<u32>,
    /// The eye, scene axes and units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with_all = ["name", "cameras"])]
    pub eye: Option<Point>,
    /// What the eye looks at (the scene's middle)
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub target: Option<Point>,
    /// Upwards in the scene: an axis such as +z or -y, or a direction (as the scene's settings say)
    #[arg(long, value_name = "AXIS|X,Y,Z", allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// Field of view, degrees: the vertical one (60), or with --lens the whole width's (fisheye 180, equirectangular 360)
    #[arg(long, value_name = "DEGREES", value_parser = field_of_view)]
    pub fov: Option<f64>,
    /// Size of a picture (a camera's own, else 1280x960); a camera keeps its vertical field of view
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
}

/// One picture to take.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Its name, for files; may hold `/` where cameras lie in folders.
    pub name: String,
    /// From where, in scene axes.
    pub view: View,
    /// When, where the camera says so.
    pub time: Option<f32>,
}

/// Three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point(pub DVec3);

impl FromStr for Point {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = s.split(',').map(|n| n.trim().parse::<f64>()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, z]) if [x, y, z].iter().all(|v| v.is_finite()) => Ok(Self(DVec3::new(x, y, z))),
            _ => Err(format!("'{s}' is not three numbers, like 0,-1.5,2")),
        }
    }
}

/// Which way is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up(pub Orientation);

impl FromStr for Up {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        if let Some(axis) = Axis::from_name(s) {
            return Ok(Self(Orientation::Up(axis)));
        }
        let direction = Point::from_str(s)?.0.try_normalize().ok_or("the zero vector points nowhere")?;
        Ok(Self(Orientation::Rotation(DQuat::from_rotation_arc(direction, DVec3::Y).to_array())))
    }
}

/// Width and height, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub [u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let side = |n: &str| n.trim().parse().ok().filter(|n: &u32| (1..=1 << 15).contains(n));
        s.split_once(['x', '×'])
            .and_then(|(w, h)| Some(Self([side(w)?, side(h)?])))
            .ok_or_else(|| format!("'{s}' is no size; write width and height in pixels, like 1280x960"))
    }
}

fn field_of_view(text: &str) -> Result<f64, String> {
    let degrees: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if degrees > 0.0 && degrees <= 360.0 {
        Ok(degrees)
    } else {
        Err("it must be above 0, and at most 360; without --lens below 179".into())
    }
}

/// The size of pictures whose camera has none.
const SIZE: [u32; 2] = [1280, 960];
/// The vertical field of view where none is given, degrees.
const VERTICAL_FOV: f64 = 60.0;

impl ShotArgs {
    /// The scene's settings, with the upward direction that was given.
    pub fn apply(&self, settings: &mut Settings) {
        if let Some(Up(orientation)) = self.up {
            settings.orientation = orientation;
        }
    }

    /// Whether OUT is a folder.
    pub fn several(&self) -> bool {
        self.all_cameras || self.turntable.is_some()
    }

    /// The pictures to take of a scene whose settings [`ShotArgs::apply`] has changed.
    ///
    /// # Errors
    /// The camera file cannot be read, or holds no camera of the name.
    pub fn shots(&self, opened: &Opened, lens: Lens) -> Result<Vec<Shot>, CommandError> {
        if lens == Lens::Perspective {
            if let Some(degrees) = self.fov.filter(|&d| d >= 179.0) {
                let what =
                    format!("--fov {degrees}: perspective ends below 179; choose --lens fisheye, or less");
                return Err(CommandError::Usage(what));
            }
            return self.perspective(opened);
        }
        // A lens has an angle and a shape of image of its own; the camera gives place and direction.
        let angle = self.fov.map_or(lens.usual_angle(), f64::to_radians);
        let usual = if lens == Lens::Equirectangular { [1280, 640] } else { [960, 960] };
        let size = self.size.map_or(usual, |s| s.0);
        let ahead = Self { fov: None, ..self.clone() };
        let through =
            |shot: Shot| Shot { view: View { fov: lens.fov(angle, size), size, ..shot.view }, ..shot };
        Ok(ahead.perspective(opened)?.into_iter().map(through).collect())
    }

    fn perspective(&self, opened: &Opened) -> Result<Vec<Shot>, CommandError> {
        let size = self.size.map_or(SIZE, |s| s.0);
        let fov = self.fov.unwrap_or(VERTICAL_FOV).to_radians();
        let framing = || Framing::of(&opened.scene.splats, &opened.settings);
        if let Some(count) = self.turntable {
            let framing = framing();
            let turn = |i: u32| f64::from(i) / f64::from(count) * std::f64::consts::TAU;
            let shot = |i| Shot {
                name: format!("turntable-{i:04}"),
                view: framing.view(turn(i), 0.3, fov, size),
                time: None,
            };
            return Ok((0..count).map(shot).collect());
        }
        if self.eye.is_some() || self.target.is_some() {
            let framing = framing();
            let target = self.target.map_or(framing.center, |t| t.0);
            let eye = self.eye.map_or_else(|| framing.eye(0.0, 0.3, fov), |e| e.0);
            let view = View::look_at(eye, target, framing.up, Fov::vertical(fov, size), size);
            return Ok(vec![Shot { name: opened.name.clone(), view, time: None }]);
        }
        let loaded = self.cameras.as_deref().map(cameras::load).transpose()?;
        let list = loaded.as_deref().unwrap_or(&opened.cameras);
        let none = || {
            let what = "there is no camera file beside the scene; name one by --cameras";
            CommandError::Usage(what.to_owned())
        };
        if self.all_cameras {
            if list.is_empty() {
                return Err(none());
            }
            return Ok(list.iter().map(|c| self.shot(c)).collect());
        }
        if let Some(name) = &self.name {
            if list.is_empty() {
                return Err(none());
            }
            return Ok(vec![self.shot(cameras::find(list, name).map_err(CommandError::Usage)?)]);
        }
        if loaded.is_none()
            && let Some(saved) = &opened.settings.first_view
        {
            let view = saved_view(saved, fov, size);
            return Ok(vec![Shot { name: saved.name.clone(), view, time: saved.time.map(|t| t as f32) }]);
        }
        if let Some(camera) = list.first() {
            return Ok(vec![self.shot(camera)]);
        }
        let view = framing().view(0.6, 0.3, fov, size);
        Ok(vec![Shot { name: opened.name.clone(), view, time: None }])
    }

    fn shot(&self, camera: &Camera) -> Shot {
        let view = View::from_camera(camera);
        let view = self.size.map_or(view, |size| resized(&view, size.0));
        Shot { name: camera.name.clone(), view, time: camera.time.map(|t| t as f32) }
    }
}

/// A view at another size: same vertical field of view, same shape of pixels, and the horizontal field that follows.
pub fn resized(view: &View, size: [u32; 2]) -> View {
    let ratio = f64::from(size[1]) / f64::from(view.size[1]);
    let [fx, fy] = view.focal().map(|f| f * ratio);
    let [cx, cy] = view.principal_point();
    let cx = f64::from(size[0]) / 2.0 + (cx - f64::from(view.size[0]) / 2.0) * ratio;
    View { fov: Fov::pinhole(fx, fy, cx, cy * ratio, size), size, ..*view }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    #[test]
    fn another_size_keeps_the_vertical_field_and_the_pixels_shape() {
        let fov = Fov::pinhole(400.0, 420.0, 300.0, 250.0, [640, 480]);
        let view = View::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov, [640, 480]);
        let wide = resized(&view, [1920, 960]);
        assert!((wide.fov.up - view.fov.up).abs() < 1e-12 && (wide.fov.down - view.fov.down).abs() < 1e-12);
        let [fx, fy] = wide.focal();
        assert!((fx - 800.0).abs() < 1e-9 && (fy - 840.0).abs() < 1e-9);
        assert_eq!(resized(&view, [640, 480]).fov.left, view.fov.left);
        // What was 20 pixels left of the middle is 40 left of it at twice the size.
        assert!((wide.principal_point()[0] - (960.0 - 40.0)).abs() < 1e-9);
    }

    #[test]
    fn words_are_read() {
        assert_eq!("0,-1.5, 2".parse::<Point>().unwrap().0, DVec3::new(0.0, -1.5, 2.0));
        assert_eq!("640x480".parse::<Size>().unwrap().0, [640, 480]);
        assert_eq!("-y".parse::<Up>().unwrap().0, Orientation::Up(Axis::MinusY));
        let Up(up) = "0,0,2".parse().unwrap();
        assert!((up.rotation() * DVec3::Z - DVec3::Y).length() < 1e-12);
        assert!("1,2".parse::<Point>().is_err() && "0x5".parse::<Size>().is_err());
        assert!("0,0,0".parse::<Up>().is_err() && "1,nan,2".parse::<Point>().is_err());
    }
}
