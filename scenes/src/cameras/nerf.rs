//! NeRF's `transforms.json`, as instant-ngp, Nerfstudio and the Blender data sets write it.
//!
//! `transform_matrix` is camera-to-scene with OpenGL camera axes (x right, y up, z towards the viewer): its
//! second and third column change sign here. The lens is given for the whole file or per frame: `fl_x`,
//! `fl_y`, `cx`, `cy`, `w`, `h`, or only `camera_angle_x` (and `camera_angle_y`), the field of view in
//! radians. Where the size is missing it is the photograph's.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use serde::de::{DeserializeSeed, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::photographs::Photographs;
use super::{Camera, Refusal, Split, malformed};
use crate::SceneError;

/// What the file states for all frames, or a frame for itself.
#[derive(serde::Deserialize)]
struct Properties {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    is_fisheye: Option<bool>,
    camera_model: Option<String>,
    file_path: Option<String>,
    transform_matrix: Option<Vec<[f64; 4]>>,
    time: Option<f64>,
    frames: Option<IgnoredAny>,
}

/// Camera models of Nerfstudio and COLMAP that are a pinhole once their distortion is zero.
const PINHOLE_MODELS: [&str; 7] =
    ["PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "FULL_OPENCV", "SIMPLE_RADIAL", "RADIAL"];

impl Properties {
    /// Refuses a lens that no pinhole camera can stand for.
    fn refuse_distortion(&self) -> Result<(), Refusal> {
        const UNDISTORT: &str = "Undistort the photographs (COLMAP's image_undistorter, Nerfstudio's ns-process-data) and use the cameras that this gives";
        if let Some(model) = &self.camera_model
            && !PINHOLE_MODELS.contains(&model.to_ascii_uppercase().as_str())
        {
            return Err(Refusal {
                problem: format!("the camera model is {model}, and only pinhole cameras can be shown"),
                remedy: UNDISTORT,
            });
        }
        if self.is_fisheye == Some(true) {
            return Err(Refusal {
                problem: "is_fisheye is true, and only pinhole cameras can be shown".to_owned(),
                remedy: UNDISTORT,
            });
        }
        for (name, value) in [
            ("k1", self.k1),
            ("k2", self.k2),
            ("k3", self.k3),
            ("k4", self.k4),
            ("p1", self.p1),
            ("p2", self.p2),
        ] {
            if let Some(value) = value
                && value != 0.0
            {
                return Err(Refusal {
                    problem: format!(
                        "the lens is distorted ({name} = {value}), and only pinhole cameras can be shown"
                    ),
                    remedy: UNDISTORT,
                });
            }
        }
        Ok(())
    }

    /// The frame's own statement, else the file's, field by field.
    fn camera(&self, file: &Self, photographs: &Photographs) -> Result<Camera, Refusal> {
        self.refuse_distortion()?;
        let photograph = self.file_path.clone().unwrap_or_default();
        let image = photographs.find(&photograph);
        let side = |own: Option<f64>, shared: Option<f64>, measured: Option<usize>| {
            own.or(shared).or(measured.map(|m| m as f64))
        };
        let measured = if (self.w.or(file.w)).is_some() && (self.h.or(file.h)).is_some() {
            None
        } else {
            image.as_ref().and_then(|image| imagesize::size(image).ok())
        };
        let size = |what: &str, value: Option<f64>| match value {
            Some(value) if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) => {
                Ok(value as u32)
            }
            Some(value) => Err(Refusal {
                problem: format!("{what} is {value}, expected a whole number of pixels"),
                remedy: "Give the size of the photographs in pixels",
            }),
            None => Err(Refusal {
                problem: format!(
                    "{what} is missing, and the photograph “{photograph}” that would tell is not there or not readable"
                ),
                remedy: "Add w and h to the file, or put the photographs where file_path says",
            }),
        };
        let width = size("w", side(self.w, file.w, measured.map(|m| m.width)))?;
        let height = size("h", side(self.h, file.h, measured.map(|m| m.height)))?;

        // A frame's own angle outweighs a focal length of the whole file.
        let focal = |length: Option<f64>, angle: Option<f64>, side: u32| {
            length.or(angle.map(|angle| f64::from(side) / 2.0 / (angle / 2.0).tan()))
        };
        let fx = focal(self.fl_x, self.camera_angle_x, width)
            .or(focal(file.fl_x, file.camera_angle_x, width))
            .ok_or_else(|| Refusal {
                problem: "neither fl_x nor camera_angle_x is given".to_owned(),
                remedy: "Add fl_x, the focal length in pixels, to the file or to each frame",
            })?;
        // Where only x is stated, pixels are square.
        let fy = if self.fl_x.is_some() || self.camera_angle_x.is_some() {
            focal(self.fl_y, self.camera_angle_y, height)
        } else {
            focal(self.fl_y, self.camera_angle_y, height).or(focal(file.fl_y, file.camera_angle_y, height))
        }
        .unwrap_or(fx);

        let matrix = self.transform_matrix.as_deref().ok_or_else(|| Refusal {
            problem: "transform_matrix is missing".to_owned(),
            remedy: "Every frame needs its camera-to-scene matrix, four rows of four numbers",
        })?;
        let (rows, position) = match matrix {
            [a, b, c] | [a, b, c, [0.0, 0.0, 0.0, 1.0]] => (
                // OpenGL looks along −z with y up; here the camera looks along +z with y down.
                [a, b, c].map(|row| [row[0], -row[1], -row[2]]),
                [a[3], b[3], c[3]],
            ),
            _ => {
                return Err(Refusal {
                    problem: format!(
                        "transform_matrix has {} rows and ends with {:?}, expected 3 rows, or 4 with (0, 0, 0, 1) last",
                        matrix.len(),
                        matrix.last()
                    ),
                    remedy: "Give a rigid camera-to-scene matrix, by rows",
                });
            }
        };
        let (rotation, translation) = Camera::pose_from_camera_to_scene(rows, position);
        if let Some(time) = self.time
            && !(0.0..=1.0).contains(&time)
        {
            return Err(Refusal {
                problem: format!("the time is {time}, expected 0 to 1"),
                remedy: "Times are fractions of the scene's duration",
            });
        }
        let camera = Camera {
            name: String::new(),
            width,
            height,
            fx,
            fy,
            cx: self.cx.or(file.cx).unwrap_or(f64::from(width) / 2.0),
            cy: self.cy.or(file.cy).unwrap_or(f64::from(height) / 2.0),
            rotation,
            translation,
            photograph,
            image,
            split: None,
            time: self.time,
            inputs: Vec::new(),
        };
        camera.check()?;
        Ok(camera)
    }
}

/// Reads every frame of the file.
pub(super) fn read(path: &Path, text: &[u8]) -> Result<Vec<Camera>, SceneError> {
    let wrong = |error: serde_json::Error| {
        malformed(
            path,
            format!("line {}, column {}", error.line(), error.column()),
            error.to_string(),
            "A camera file is JSON: a transforms.json with “frames”, or a list of cameras",
        )
    };
    let file: Properties = serde_json::from_slice(text).map_err(wrong)?;
    if file.frames.is_none() {
        return Err(malformed(
            path,
            "the top level",
            "has no “frames”",
            "Name a transforms.json, a cameras.json, or a COLMAP model",
        ));
    }
    file.refuse_distortion().map_err(|refusal| refusal.at(path, "the top level"))?;
    let mut frames =
        Frames { file: &file, photographs: Photographs::near(path), cameras: Vec::new(), refusal: None };
    let result = (&mut frames).deserialize(&mut serde_json::Deserializer::from_slice(text));
    if let Some((place, refusal)) = frames.refusal {
        return Err(refusal.at(path, place));
    }
    result.map_err(wrong)?;
    let mut cameras = frames.cameras;
    for (index, camera) in cameras.iter_mut().enumerate() {
        if camera.photograph.is_empty() {
            camera.name = index.to_string();
        }
    }
    assign_splits(path, text, &mut cameras).map_err(wrong)?;
    Ok(cameras)
}

/// Splits: Nerfstudio lists the file names of each, the Blender data sets have a file for each.
fn assign_splits(path: &Path, text: &[u8], cameras: &mut [Camera]) -> Result<(), serde_json::Error> {
    let by_file_name = path
        .file_stem()
        .and_then(|stem| stem.to_str())
        .and_then(|stem| Split::from_word(stem.strip_prefix("transforms_")?));
    for camera in cameras.iter_mut() {
        camera.split = by_file_name;
    }
    let index: HashMap<String, usize> =
        cameras.iter().enumerate().map(|(i, camera)| (camera.photograph.clone(), i)).collect();
    let splits = Splits { cameras, index };
    splits.deserialize(&mut serde_json::Deserializer::from_slice(text))
}

/// Walks over the file's top level and takes the frames one by one: a bad one ends the reading at once.
struct Frames<'a> {
    file: &'a Properties,
    photographs: Photographs,
    cameras: Vec<Camera>,
    refusal: Option<(String, Refusal)>,
}

impl<'de> DeserializeSeed<'de> for &mut Frames<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for &mut Frames<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object with a list of frames")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<Cow<str>>()? {
            if key == "frames" {
                map.next_value_seed(&mut *self)?;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut frames: A) -> Result<(), A::Error> {
        while let Some(frame) = frames.next_element::<Properties>()? {
            match frame.camera(self.file, &self.photographs) {
                Ok(camera) => self.cameras.push(camera),
                Err(refusal) => {
                    let named = frame.file_path.map(|path| format!(" ({path})"));
                    let place = format!("frame {}{}", self.cameras.len(), named.unwrap_or_default());
                    self.refusal = Some((place, refusal));
                    return Err(serde::de::Error::custom("a frame is refused"));
                }
            }
        }
        Ok(())
    }
}

/// Walks over `train_filenames`, `val_filenames` and `test_filenames` without keeping them.
struct Splits<'a> {
    cameras: &'a mut [Camera],
    index: HashMap<String, usize>,
}

impl<'de> DeserializeSeed<'de> for Splits<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Splits<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(mut self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<Cow<str>>()? {
            match key.strip_suffix("_filenames").and_then(Split::from_word) {
                Some(split) => map.next_value_seed(Names { splits: &mut self, split })?,
                None => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(())
    }
}

/// One list of file names.
struct Names<'a, 'b> {
    splits: &'a mut Splits<'b>,
    split: Split,
}

impl<'de> DeserializeSeed<'de> for Names<'_, '_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Names<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a list of file names")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut names: A) -> Result<(), A::Error> {
        while let Some(name) = names.next_element::<Cow<str>>()? {
            if let Some(camera) =
                self.splits.index.get(name.as_ref()).and_then(|&i| self.splits.cameras.get_mut(i))
            {
                camera.split = Some(self.split);
            }
        }
        Ok(())
    }
}
