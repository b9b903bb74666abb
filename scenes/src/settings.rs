//! What a scene file does not say and a viewer must know: which way is up, how long a unit is, where the floor lies,
//! from where to look first. Saved beside the scene as `SCENE.motes.json`.
//!
//! The **world** that the settings lead to has y up and metres, the floor at y = 0; without a pose of its own a viewer
//! looks along −z, with x to the right (OpenXR's axes).
//!
//! ```json
//! {
//!   "version": 1,
//!   "up": "-y",
//!   "scale": 1.0,
//!   "floor": -1.2,
//!   "first_view": {"position": [0, 0, -2], "rotation": [0, 0, 0, 1]},
//!   "views": [{"name": "window", "position": [1, 0, 0], "rotation": [0, 0, 0, 1], "vertical_fov": 55}]
//! }
//! ```
//!
//! Instead of `up` there may be `rotation`, a quaternion `[x, y, z, w]` from scene to world. Every property but
//! `version` may be left out. Properties that this version does not know are kept as they are.

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde_json::{Map, Value};

use crate::{Format, SceneError};

/// The version that is written.
const VERSION: u64 = 1;

/// A settings file longer than this is none.
const MAX_LENGTH: u64 = 16 << 20;

/// Scales outside of this range are mistakes: an atom, and the way to the moon.
const SCALES: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

const REMEDY: &str = "Correct it, or delete the file to start from the defaults";

/// An axis of the scene, with its direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Axis {
    PlusX,
    MinusX,
    PlusY,
    MinusY,
    PlusZ,
    MinusZ,
}

impl Axis {
    const ALL: [(Self, &'static str); 6] = [
        (Self::PlusX, "+x"),
        (Self::MinusX, "-x"),
        (Self::PlusY, "+y"),
        (Self::MinusY, "-y"),
        (Self::PlusZ, "+z"),
        (Self::MinusZ, "-z"),
    ];

    /// `+x`, `-x`, `+y`, `-y`, `+z` or `-z`; the plus may be left out.
    pub fn from_name(name: &str) -> Option<Self> {
        let name = name.trim().to_ascii_lowercase();
        Self::ALL
            .into_iter()
            .find(|(_, known)| *known == name || known.strip_prefix('+') == Some(&name))
            .map(|a| a.0)
    }

    /// Its name, with sign.
    pub fn name(self) -> &'static str {
        Self::ALL.into_iter().find(|(axis, _)| *axis == self).map_or("", |a| a.1)
    }
}

/// How the scene stands in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Orientation {
    /// This axis of the scene is up. The turn is about x where that can be (a scene with y down is turned by 180°
    /// about x, so that what was ahead of its first camera, z, is ahead in the world, −z), else about z.
    Up(Axis),
    /// Quaternion `(x, y, z, w)`, of length 1, from scene to world axes.
    Rotation([f64; 4]),
}

impl Orientation {
    /// The turn from scene to world axes.
    pub fn rotation(self) -> DQuat {
        // Rows: what becomes of x, y and z in the world.
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
        match self {
            Self::Up(Axis::PlusY) => DQuat::IDENTITY,
            Self::Up(Axis::MinusY) => DQuat::from_mat3(&DMat3::from_cols(x, -y, -z)),
            Self::Up(Axis::PlusZ) => DQuat::from_mat3(&DMat3::from_cols(x, -z, y)),
            Self::Up(Axis::MinusZ) => DQuat::from_mat3(&DMat3::from_cols(x, z, -y)),
            Self::Up(Axis::PlusX) => DQuat::from_mat3(&DMat3::from_cols(y, -x, z)),
            Self::Up(Axis::MinusX) => DQuat::from_mat3(&DMat3::from_cols(-y, x, z)),
            Self::Rotation(q) => DQuat::from_array(q),
        }
    }
}

/// A place to look from, in scene axes and units: it stays right when orientation or scale are corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedView {
    /// What it is called; may be empty.
    pub name: String,
    /// The eye, scene units.
    pub position: [f64; 3],
    /// Unit quaternion `(x, y, z, w)` from camera axes (x right, y down, z forward, as [`crate::cameras`]) to scene
    /// axes.
    pub rotation: [f64; 4],
    /// Vertical field of view, degrees, between 0 and 180.
    pub vertical_fov: Option<f64>,
    /// Moment of a moving scene, `0 ..= 1`.
    pub time: Option<f64>,
    /// Properties that this version does not know.
    pub other: Map<String, Value>,
}

/// The settings of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// How the scene stands in the world.
    pub orientation: Orientation,
    /// Metres per scene unit, positive.
    pub scale: f64,
    /// Height of the floor in the oriented and scaled scene, metres; `None` where nobody said so.
    pub floor: Option<f64>,
    /// Where to look from at first.
    pub first_view: Option<SavedView>,
    /// Saved places.
    pub views: Vec<SavedView>,
    /// Properties that this version does not know.
    pub other: Map<String, Value>,
}

impl Default for Settings {
    /// COLMAP's axes, which most trained scenes have: y down; one unit is a metre.
    fn default() -> Self {
        Self {
            orientation: Orientation::Up(Axis::MinusY),
            scale: 1.0,
            floor: None,
            first_view: None,
            views: Vec::new(),
            other: Map::new(),
        }
    }
}

impl Settings {
    /// What to assume of a scene that has no settings: SPZ is y up by definition, others are y down by custom.
    pub fn for_format(format: Format) -> Self {
        let up = if format == Format::Spz { Axis::PlusY } else { Axis::MinusY };
        Self { orientation: Orientation::Up(up), ..Default::default() }
    }

    /// Where a scene's settings are: `SCENE.motes.json` beside it, with the scene's extension in the name. The
    /// `meta.json` and `lod-meta.json` of a folder stand for the folder.
    pub fn path_of(scene: &Path) -> PathBuf {
        let stands_for_folder =
            matches!(scene.file_name().and_then(|name| name.to_str()), Some("meta.json" | "lod-meta.json"));
        // The folder of a bare `meta.json` has no name: its settings lie in it.
        let named = match scene.parent() {
            Some(folder) if stands_for_folder && folder.file_name().is_some() => folder,
            _ => scene,
        };
        let mut name = named.file_name().map(std::ffi::OsStr::to_owned).unwrap_or_else(|| "scene".into());
        name.push(".motes.json");
        named.parent().map_or_else(|| PathBuf::from(&name), |parent| parent.join(&name))
    }

    /// Reads the settings beside a scene; `None` where there are none.
    ///
    /// # Errors
    /// [`SceneError`] where the file cannot be read, is no settings file, or was written by a later version.
    pub fn load(scene: &Path) -> Result<Option<Self>, SceneError> {
        let path = Self::path_of(scene);
        let length = match std::fs::metadata(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            metadata => metadata.map_err(SceneError::io(&path))?.len(),
        };
        if length > MAX_LENGTH {
            return Err(SceneError::malformed(
                &path,
                "the file",
                format!("has {length} bytes, too many for settings"),
                REMEDY,
            ));
        }
        let text = std::fs::read(&path).map_err(SceneError::io(&path))?;
        Self::parse(&path, &text).map(Some)
    }

    /// Writes the settings beside a scene. A reader sees the old file or the new one, never a part.
    ///
    /// # Errors
    /// [`SceneError::Malformed`] where a value is out of range (nothing is written then), [`SceneError::Io`] where the
    /// disk refuses.
    pub fn save(&self, scene: &Path) -> Result<(), SceneError> {
        let path = Self::path_of(scene);
        let mut text = serde_json::to_string_pretty(&Value::Object(self.to_json()))
            .map_err(|error| SceneError::io(&path)(error.into()))?;
        text.push('\n');
        // What cannot be read back is not written.
        Self::parse(&path, text.as_bytes())?;

        let mut partial = path.clone().into_os_string();
        partial.push(format!(".{}.part", std::process::id()));
        let partial = PathBuf::from(partial);
        let write = || {
            let mut file = std::fs::File::create(&partial)?;
            file.write_all(text.as_bytes())?;
            file.sync_all()?;
            std::fs::rename(&partial, &path)
        };
        write().map_err(|error| {
            // Nothing to be done about a leftover that cannot be removed either; the first error is the one to tell.
            let _ = std::fs::remove_file(&partial);
            SceneError::io(&path)(error)
        })
    }

    /// From scene to world: turned, scaled, and moved so that the floor lies at y = 0.
    pub fn scene_to_world(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::splat(self.scale),
            self.orientation.rotation(),
            DVec3::new(0.0, -self.floor.unwrap_or(0.0), 0.0),
        )
    }

    fn parse(path: &Path, text: &[u8]) -> Result<Self, SceneError> {
        let value: Value = serde_json::from_slice(text).map_err(|error| {
            let place = format!("line {}, column {}", error.line(), error.column());
            SceneError::malformed(path, place, error.to_string(), REMEDY)
        })?;
        let mut object = Object::new(path, "", value)?;
        match object.take("version") {
            Some(Value::Number(version)) if version.as_u64() == Some(VERSION) => {}
            Some(Value::Number(version)) if version.as_u64().is_some_and(|version| version > VERSION) => {
                return Err(SceneError::unsupported(
                    path,
                    format!("settings of version {version} (this Motes writes {VERSION})"),
                    "Use the newer Motes that wrote it, or delete the file",
                ));
            }
            Some(other) => return Err(object.wrong("version", format!("is {other}, expected {VERSION}"))),
            None => return Err(object.wrong("version", format!("is missing, expected {VERSION}"))),
        }
        let orientation = match (object.take("up"), object.take("rotation")) {
            (None, None) => Self::default().orientation,
            (Some(_), Some(_)) => {
                return Err(
                    object.wrong("up", "and rotation are both there: one decides which way is up".to_owned())
                );
            }
            (Some(up), None) => {
                let axis = up.as_str().and_then(Axis::from_name);
                Orientation::Up(axis.ok_or_else(|| {
                    object.wrong("up", format!("is {up}, expected one of +x -x +y -y +z -z"))
                })?)
            }
            (None, Some(rotation)) => Orientation::Rotation(object.unit_quaternion("rotation", rotation)?),
        };
        let scale = object.number("scale", SCALES)?.unwrap_or(1.0);
        let floor = object.number("floor", -1e12..=1e12)?;
        let first_view = match object.take("first_view") {
            None => None,
            Some(view) => Some(SavedView::parse(path, "first_view", view)?),
        };
        let views = match object.take("views") {
            None => Vec::new(),
            Some(Value::Array(views)) => views
                .into_iter()
                .enumerate()
                .map(|(i, view)| SavedView::parse(path, &format!("views[{i}]"), view))
                .collect::<Result<_, _>>()?,
            Some(other) => return Err(object.wrong("views", format!("is {}, expected a list", kind(&other)))),
        };
        Ok(Self { orientation, scale, floor, first_view, views, other: object.rest })
    }

    /// The settings as they stand in the file.
    pub fn to_json(&self) -> Map<String, Value> {
        let mut json = self.other.clone();
        json.insert("version".into(), VERSION.into());
        match self.orientation {
            Orientation::Up(axis) => json.insert("up".into(), axis.name().into()),
            Orientation::Rotation(q) => json.insert("rotation".into(), q.to_vec().into()),
        };
        json.insert("scale".into(), self.scale.into());
        json.extend(self.floor.map(|floor| ("floor".to_owned(), floor.into())));
        json.extend(self.first_view.as_ref().map(|view| ("first_view".to_owned(), view.to_json())));
        if !self.views.is_empty() {
            json.insert("views".into(), self.views.iter().map(SavedView::to_json).collect());
        }
        json
    }
}

impl SavedView {
    fn parse(path: &Path, place: &str, value: Value) -> Result<Self, SceneError> {
        let mut object = Object::new(path, place, value)?;
        let required = |object: &mut Object<'_>, key: &str| {
            object.take(key).ok_or_else(|| object.wrong(key, "is missing".to_owned()))
        };
        let position = required(&mut object, "position")?;
        let rotation = required(&mut object, "rotation")?;
        let name = match object.take("name") {
            None => String::new(),
            Some(Value::String(name)) => name,
            Some(other) => return Err(object.wrong("name", format!("is {}, expected a text", kind(&other)))),
        };
        Ok(Self {
            name,
            position: object.numbers("position", position)?,
            rotation: object.unit_quaternion("rotation", rotation)?,
            vertical_fov: object.number("vertical_fov", f64::MIN_POSITIVE..=179.999)?,
            time: object.number("time", 0.0..=1.0)?,
            other: object.rest,
        })
    }

    fn to_json(&self) -> Value {
        let mut json = self.other.clone();
        if !self.name.is_empty() {
            json.insert("name".into(), self.name.clone().into());
        }
        json.insert("position".into(), self.position.to_vec().into());
        json.insert("rotation".into(), self.rotation.to_vec().into());
        json.extend(self.vertical_fov.map(|fov| ("vertical_fov".to_owned(), fov.into())));
        json.extend(self.time.map(|time| ("time".to_owned(), time.into())));
        Value::Object(json)
    }
}

/// An object whose known properties are taken out one by one.
struct Object<'a> {
    path: &'a Path,
    place: &'a str,
    rest: Map<String, Value>,
}

impl<'a> Object<'a> {
    fn new(path: &'a Path, place: &'a str, value: Value) -> Result<Self, SceneError> {
        match value {
            Value::Object(rest) => Ok(Self { path, place, rest }),
            other => {
                let place = if place.is_empty() { "the top level" } else { place };
                let problem = format!("is {}, expected an object", kind(&other));
                Err(SceneError::malformed(path, place, problem, REMEDY))
            }
        }
    }

    fn take(&mut self, key: &str) -> Option<Value> {
        self.rest.remove(key)
    }

    fn wrong(&self, key: &str, problem: String) -> SceneError {
        let dot = if self.place.is_empty() { "" } else { "." };
        SceneError::malformed(self.path, format!("{}{dot}{key}", self.place), problem, REMEDY)
    }

    fn number(&mut self, key: &str, range: std::ops::RangeInclusive<f64>) -> Result<Option<f64>, SceneError> {
        let Some(value) = self.take(key) else { return Ok(None) };
        match value.as_f64() {
            Some(number) if range.contains(&number) => Ok(Some(number)),
            _ => Err(self.wrong(
                key,
                format!("is {value}, expected a number from {} to {}", range.start(), range.end()),
            )),
        }
    }

    fn numbers<const N: usize>(&self, key: &str, value: Value) -> Result<[f64; N], SceneError> {
        let numbers: Option<Vec<f64>> =
            value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        numbers
            .and_then(|numbers| <[f64; N]>::try_from(numbers).ok())
            .filter(|numbers| numbers.iter().all(|v| v.is_finite()))
            .ok_or_else(|| self.wrong(key, format!("is {value}, expected a list of {N} numbers")))
    }

    fn unit_quaternion(&self, key: &str, value: Value) -> Result<[f64; 4], SceneError> {
        let q = self.numbers::<4>(key, value)?;
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !((length - 1.0).abs() <= 1e-3) {
            return Err(
                self.wrong(key, format!("is {q:?} of length {length}, expected a quaternion of length 1"))
            );
        }
        // What is as good as 1 stays as it is, so that saving and loading changes nothing.
        Ok(if (length - 1.0).abs() <= 1e-15 { q } else { q.map(|v| v / length) })
    }
}

/// What a value is, for messages.
fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("a.spz");
        std::fs::write(Settings::path_of(&scene), text).unwrap();
        (folder, scene)
    }

    fn parse(text: &str) -> Result<Settings, String> {
        let (_folder, scene) = write(text);
        Settings::load(&scene).map(Option::unwrap).map_err(|error| error.to_string())
    }

    #[test]
    fn the_file_lies_beside_the_scene() {
        for (scene, settings) in [
            ("/s/skull.sog", "/s/skull.sog.motes.json"),
            ("biker.spz", "biker.spz.motes.json"),
            ("/s/garden", "/s/garden.motes.json"),
            ("/s/garden/", "/s/garden.motes.json"),
            ("/s/playbot/lod-meta.json", "/s/playbot.motes.json"),
            ("playbot/meta.json", "playbot.motes.json"),
            ("meta.json", "meta.json.motes.json"),
        ] {
            assert_eq!(Settings::path_of(Path::new(scene)), Path::new(settings), "{scene}");
        }
    }

    #[test]
    fn what_is_saved_is_loaded_with_what_others_wrote() {
        let text = r#"{"version": 1, "up": "z", "scale": 0.25, "floor": -1.5, "quality": {"preset": "high"},
            "first_view": {"position": [1, 2.5, -3], "rotation": [0, 0, 0.6, 0.8], "lens": "wide"},
            "views": [{"name": "door", "position": [0, 0, 0], "rotation": [1, 0, 0, 0], "vertical_fov": 60, "time": 0.5}]}"#;
        let (folder, scene) = write(text);
        let mut settings = Settings::load(&scene).unwrap().unwrap();
        assert_eq!(settings.orientation, Orientation::Up(Axis::PlusZ));
        assert_eq!((settings.scale, settings.floor), (0.25, Some(-1.5)));
        assert_eq!(settings.other["quality"]["preset"], "high");
        let first = settings.first_view.as_ref().unwrap();
        assert_eq!((first.position, first.other["lens"].as_str()), ([1.0, 2.5, -3.0], Some("wide")));
        assert_eq!((settings.views[0].vertical_fov, settings.views[0].time), (Some(60.0), Some(0.5)));

        settings.orientation = Orientation::Rotation([0.5, -0.5, 0.5, 0.5]);
        settings.views.push(settings.first_view.clone().unwrap());
        settings.save(&scene).unwrap();
        assert_eq!(Settings::load(&scene).unwrap().unwrap(), settings);
        // Nothing else is left in the folder.
        let left: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["a.spz.motes.json"]);
        assert_eq!(Settings::load(&folder.path().join("b.spz")).unwrap(), None);
    }

    #[test]
    fn what_cannot_be_read_back_is_not_written() {
        let (_folder, scene) = write(r#"{"version": 1}"#);
        let good = Settings::load(&scene).unwrap().unwrap();
        assert_eq!(good, Settings::default());
        for bad in [
            Settings { scale: 0.0, ..good.clone() },
            Settings { scale: f64::NAN, ..good.clone() },
            Settings { floor: Some(f64::INFINITY), ..good.clone() },
            Settings { orientation: Orientation::Rotation([0.0; 4]), ..good.clone() },
        ] {
            let error = bad.save(&scene).unwrap_err().to_string();
            assert!(error.contains("a.spz.motes.json"), "{error}");
            assert_eq!(Settings::load(&scene).unwrap().unwrap(), good);
        }
        let nowhere = Path::new("/no/such/folder/a.spz");
        assert!(matches!(good.save(nowhere), Err(SceneError::Io { .. })));
    }

    #[test]
    fn mistakes_are_named() {
        for (text, words) in [
            ("", "line 1"),
            ("[]", "the top level: is a list"),
            ("{}", "version: is missing"),
            (r#"{"version": 2}"#, "settings of version 2"),
            (r#"{"version": "1"}"#, "version: is \"1\", expected 1"),
            (r#"{"version": 1, "up": "north"}"#, "up: is \"north\", expected one of +x"),
            (r#"{"version": 1, "up": "y", "rotation": [0, 0, 0, 1]}"#, "up: and rotation are both there"),
            (
                r#"{"version": 1, "rotation": [0, 0, 1]}"#,
                "rotation: is [0,0,1], expected a list of 4 numbers",
            ),
            (r#"{"version": 1, "rotation": [0, 0, 0, 2]}"#, "of length 2"),
            (r#"{"version": 1, "scale": -1}"#, "scale: is -1"),
            (r#"{"version": 1, "scale": 1e300}"#, "scale: is 1e"),
            (r#"{"version": 1, "views": {}}"#, "views: is an object, expected a list"),
            (r#"{"version": 1, "views": [3]}"#, "views[0]: is a number"),
            (r#"{"version": 1, "views": [{"position": [0, 0, 0]}]}"#, "views[0].rotation: is missing"),
            (
                r#"{"version": 1, "first_view": {"position": [0, 0, "x"], "rotation": [0, 0, 0, 1]}}"#,
                "first_view.position: is [0,0,\"x\"]",
            ),
            (
                r#"{"version": 1, "first_view": {"position": [0, 0, 0], "rotation": [0, 0, 0, 1], "time": 7}}"#,
                "first_view.time: is 7, expected a number from 0 to 1",
            ),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(words) && error.contains("a.spz.motes.json"), "{text}: {error}");
        }
    }

    #[test]
    fn every_orientation_brings_up_to_y_and_is_a_rotation() {
        let up = |axis| match axis {
            Axis::PlusX => DVec3::X,
            Axis::MinusX => -DVec3::X,
            Axis::PlusY => DVec3::Y,
            Axis::MinusY => -DVec3::Y,
            Axis::PlusZ => DVec3::Z,
            Axis::MinusZ => -DVec3::Z,
        };
        for (axis, name) in Axis::ALL {
            assert_eq!(Axis::from_name(name), Some(axis));
            let rotation = Orientation::Up(axis).rotation();
            assert!((rotation * up(axis)).abs_diff_eq(DVec3::Y, 1e-12), "{name}");
            assert!((rotation.length() - 1.0).abs() < 1e-12);
        }
        // Negative control: another axis does not come to y.
        assert!(!(Orientation::Up(Axis::PlusZ).rotation() * up(Axis::MinusY)).abs_diff_eq(DVec3::Y, 0.5));
        // What a scene with y down has ahead (+z) is ahead in the world (−z).
        let ahead = Orientation::Up(Axis::MinusY).rotation() * DVec3::Z;
        assert!(ahead.abs_diff_eq(-DVec3::Z, 1e-12));

        let settings = Settings {
            orientation: Orientation::Up(Axis::PlusZ),
            scale: 2.0,
            floor: Some(-3.0),
            ..Default::default()
        };
        let world = settings.scene_to_world();
        assert!(
            world.transform_point3(DVec3::new(1.0, 2.0, -1.5)).abs_diff_eq(DVec3::new(2.0, 0.0, -4.0), 1e-12)
        );
    }
}
