//! JSON lists of cameras: the trainer's `cameras.json`, and the form of reference pictures.
//!
//! The trainer (Kerbl et al. 2023, `cameras.json` beside `point_cloud/`) writes `position` and `rotation` of
//! the camera in the scene, so `rotation` is camera-to-scene, by rows. Reference pictures state `R_w2c` and
//! `t_w2c`, scene-to-camera. Both write the principal point only where it is not the middle.

use std::path::Path;

use serde::de::{DeserializeSeed, SeqAccess, Visitor};

use super::{Camera, Refusal, Split, malformed};
use crate::SceneError;

/// Every property that either form has; which form an entry is in, its properties say.
#[derive(serde::Deserialize)]
struct Entry {
    name: Option<String>,
    img_name: Option<String>,
    width: Option<u32>,
    height: Option<u32>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    position: Option<[f64; 3]>,
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(rename = "R_w2c")]
    r_w2c: Option<[[f64; 3]; 3]>,
    t_w2c: Option<[f64; 3]>,
    split: Option<String>,
    time: Option<f64>,
    #[serde(default)]
    inputs: Vec<String>,
}

impl Entry {
    fn camera(self) -> Result<Camera, Refusal> {
        let missing = |property: &str| Refusal {
            problem: format!("the property “{property}” is missing"),
            remedy: "A camera needs width, height, fx, fy, and either position and rotation (camera to scene) or R_w2c and t_w2c",
        };
        let width = self.width.ok_or_else(|| missing("width"))?;
        let height = self.height.ok_or_else(|| missing("height"))?;
        let (rotation, translation) = match (self.r_w2c, self.t_w2c, self.rotation, self.position) {
            (Some(r), Some(t), ..) => (r, t),
            (Some(_), None, ..) => return Err(missing("t_w2c")),
            (None, _, Some(rows), Some(position)) => Camera::pose_from_camera_to_scene(rows, position),
            (None, _, Some(_), None) => return Err(missing("position")),
            (None, _, None, _) => return Err(missing("rotation")),
        };
        let split = match self.split.as_deref() {
            None => None,
            Some(word) => Some(Split::from_word(word).ok_or_else(|| Refusal {
                problem: format!("the split “{word}” is none of train, val and test"),
                remedy: "Name one of these, or leave the property out",
            })?),
        };
        if let Some(time) = self.time
            && !(0.0..=1.0).contains(&time)
        {
            return Err(Refusal {
                problem: format!("the time is {time}, expected 0 to 1"),
                remedy: "Times are fractions of the scene's duration",
            });
        }
        let camera = Camera {
            name: self.name.unwrap_or_default(),
            width,
            height,
            fx: self.fx.ok_or_else(|| missing("fx"))?,
            fy: self.fy.ok_or_else(|| missing("fy"))?,
            cx: self.cx.unwrap_or(f64::from(width) / 2.0),
            cy: self.cy.unwrap_or(f64::from(height) / 2.0),
            rotation,
            translation,
            photograph: self.img_name.unwrap_or_default(),
            image: None,
            split,
            time: self.time,
            inputs: self.inputs,
        };
        camera.check()?;
        Ok(camera)
    }
}

/// Reads the list entry by entry, so that a file of empty entries fails at the first and never fills memory.
pub(super) fn read(path: &Path, text: &[u8]) -> Result<Vec<Camera>, SceneError> {
    let mut list = List { cameras: Vec::new(), refusal: None };
    let mut json = serde_json::Deserializer::from_slice(text);
    let result = list.deserialize_list(&mut json);
    if let Some((index, refusal)) = list.refusal {
        return Err(refusal.at(path, format!("camera {index} of the list")));
    }
    result.and_then(|()| json.end()).map_err(|error| {
        malformed(
            path,
            format!("line {}, column {}", error.line(), error.column()),
            error.to_string(),
            "A camera list is a JSON array of objects, such as the trainer's cameras.json",
        )
    })?;
    for (index, camera) in list.cameras.iter_mut().enumerate() {
        if camera.name.is_empty() && camera.photograph.is_empty() {
            camera.name = index.to_string();
        }
    }
    Ok(list.cameras)
}

struct List {
    cameras: Vec<Camera>,
    refusal: Option<(usize, Refusal)>,
}

impl List {
    fn deserialize_list<'de, R: serde_json::de::Read<'de>>(
        &mut self,
        json: &mut serde_json::Deserializer<R>,
    ) -> Result<(), serde_json::Error> {
        self.deserialize(json)
    }
}

impl<'de> DeserializeSeed<'de> for &mut List {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for &mut List {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a list of cameras")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<(), A::Error> {
        while let Some(entry) = entries.next_element::<Entry>()? {
            match entry.camera() {
                Ok(camera) => self.cameras.push(camera),
                Err(refusal) => {
                    self.refusal = Some((self.cameras.len(), refusal));
                    return Err(serde::de::Error::custom("a camera is refused"));
                }
            }
        }
        Ok(())
    }
}
