//! Classes of splats: a list of classes with names and colours, and a class per splat. Saved beside the scene as
//! `SCENE.labels.json`.
//!
//! ```json
//! {"version": 1, "classes": [{"id": 1, "name": "plant", "colour": [38, 139, 210]}], "labels": [1, 0, 1]}
//! ```
//!
//! [`Labels::load`] also reads what other tools write: a plain list of ids; an object with a list `labels` and perhaps an
//! object `classes` from id to name; and point annotations of labelling services (`point_annotations`, `categories`, at
//! whatever depth). Class 0 is “unlabelled” everywhere.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use crate::{SceneError, Splats};

/// The version that is written.
const VERSION: u64 = 1;
/// A file longer than this is none: labels of 10⁸ splats fit.
const MAX_LENGTH: u64 = 1 << 30;
/// How deep annotations are looked for.
const MAX_DEPTH: u32 = 16;
const REMEDY: &str = "Give a list of class ids, one per splat, or a file that `motes label` wrote";

/// A class.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Class {
    /// Its number, 1 and up.
    pub id: u16,
    /// What it is called.
    pub name: String,
    /// Its colour in maps, sRGB.
    pub colour: [u8; 3],
}

/// A class per splat, and the list of classes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Labels {
    /// The classes, by rising id; ids without an entry have no name.
    pub classes: Vec<Class>,
    /// A class per splat, 0: unlabelled.
    pub ids: Vec<u16>,
}

/// A colour for a class that nobody chose one for: hues a golden angle apart; grey for 0.
pub fn class_colour(id: u16) -> [u8; 3] {
    if id == 0 {
        return [96; 3];
    }
    let hue = f64::from(id) * 137.507_764 % 360.0 / 60.0;
    // Every second turn around the wheel is darker, so that near hues differ.
    let value = if id.is_multiple_of(2) { 0.65 } else { 0.95 };
    [5.0, 3.0, 1.0].map(|shift: f64| {
        let k = (shift + hue) % 6.0;
        (255.0 * value * (1.0 - 0.75 * k.min(4.0 - k).clamp(0.0, 1.0))).round() as u8
    })
}

impl Labels {
    /// Of ids alone: every class that occurs is called by its number.
    pub fn of_ids(ids: Vec<u16>) -> Self {
        let mut labels = Self { classes: Vec::new(), ids };
        labels.name_the_rest();
        labels
    }

    /// The labels that a scene has in memory, with this list of classes.
    pub fn of_splats(splats: &Splats, classes: &[Class]) -> Option<Self> {
        let ids = splats.labels.clone()?;
        let mut labels = Self { classes: classes.to_vec(), ids };
        labels.name_the_rest();
        Some(labels)
    }

    /// Lists every class that occurs but has no entry.
    fn name_the_rest(&mut self) {
        let mut occurs = vec![false; usize::from(u16::MAX) + 1];
        for &id in &self.ids {
            occurs[usize::from(id)] = true;
        }
        for class in &self.classes {
            occurs[usize::from(class.id)] = false;
        }
        let new = (1..=u16::MAX).filter(|&id| occurs[usize::from(id)]);
        self.classes.extend(new.map(|id| Class {
            id,
            name: format!("class {id}"),
            colour: class_colour(id),
        }));
        self.classes.sort_by_key(|c| c.id);
    }

    /// The class with an id.
    pub fn class(&self, id: u16) -> Option<&Class> {
        self.classes.iter().find(|c| c.id == id)
    }

    /// Splats per id, up to the highest that occurs.
    pub fn counts(&self) -> Vec<usize> {
        let mut counts = vec![0; usize::from(self.ids.iter().copied().max().unwrap_or(0)) + 1];
        for &id in &self.ids {
            counts[usize::from(id)] += 1;
        }
        counts
    }

    /// Where a scene's labels are: `SCENE.labels.json` beside it.
    pub fn path_of(scene: &Path) -> PathBuf {
        let settings = crate::settings::Settings::path_of(scene).into_os_string();
        let name = settings.to_string_lossy();
        PathBuf::from(format!("{}.labels.json", name.strip_suffix(".motes.json").unwrap_or(&name)))
    }

    /// Reads the labels beside a scene; `None` where there are none.
    ///
    /// # Errors
    /// As [`Labels::load`].
    pub fn beside(scene: &Path) -> Result<Option<Self>, SceneError> {
        let path = Self::path_of(scene);
        if path.is_file() { Self::load(&path).map(Some) } else { Ok(None) }
    }

    /// Reads labels in any of the forms above.
    ///
    /// # Errors
    /// [`SceneError`] where the file cannot be read or holds no class ids, or was written by a later version.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let length = std::fs::metadata(path).map_err(SceneError::io(path))?.len();
        if length > MAX_LENGTH {
            let problem = format!("has {length} bytes, too many for labels");
            return Err(SceneError::malformed(path, "the file", problem, REMEDY));
        }
        Self::parse(path, &std::fs::read(path).map_err(SceneError::io(path))?)
    }

    /// Reads labels from text; `path` is for messages.
    ///
    /// # Errors
    /// As [`Labels::load`].
    pub fn parse(path: &Path, text: &[u8]) -> Result<Self, SceneError> {
        let refuse = |place: &str, problem: String| SceneError::malformed(path, place, problem, REMEDY);
        let value: Value = serde_json::from_slice(text).map_err(|e| {
            refuse(&format!("line {}, column {}", e.line(), e.column()), format!("is no JSON: {e}"))
        })?;
        if let Some(version) = value.get("version").and_then(Value::as_u64).filter(|&v| v > VERSION) {
            return Err(SceneError::unsupported(
                path,
                format!("labels of version {version}, and this program knows {VERSION}"),
                "Use a newer version of Motes",
            ));
        }
        let list = match &value {
            Value::Array(list) => Some(list),
            Value::Object(object) => match object.get("labels") {
                Some(Value::Array(list)) => Some(list),
                _ => match search(&value, "point_annotations", 0) {
                    Some(Value::Array(list)) => Some(list),
                    _ => None,
                },
            },
            _ => None,
        };
        let list = list.ok_or_else(|| refuse("the file", "holds no list of class ids".to_owned()))?;
        let id_of = |(i, value): (usize, &Value)| {
            let number = value.as_f64().filter(|v| v.fract() == 0.0 && (0.0..=65535.0).contains(v));
            number.map(|v| v as u16).ok_or_else(|| {
                refuse(&format!("label {i}"), format!("is {value}, expected a class id, 0 to 65535"))
            })
        };
        let ids = list.iter().enumerate().map(id_of).collect::<Result<_, _>>()?;
        let mut labels = Self { classes: classes(&value), ids };
        labels.name_the_rest();
        Ok(labels)
    }

    /// Writes labels. A reader sees the old file or the new one, never a part.
    ///
    /// # Errors
    /// [`SceneError::Io`] where the disk refuses.
    pub fn save(&self, path: &Path) -> Result<(), SceneError> {
        let classes: Vec<Value> =
            self.classes.iter().map(|c| json!({"id": c.id, "name": c.name, "colour": c.colour})).collect();
        let text = json!({"version": VERSION, "classes": classes, "labels": self.ids}).to_string();
        let mut partial = path.as_os_str().to_owned();
        partial.push(format!(".{}.part", std::process::id()));
        let partial = PathBuf::from(partial);
        let write = || {
            let mut file = std::fs::File::create(&partial)?;
            file.write_all(text.as_bytes())?;
            file.write_all(b"\n")?;
            std::fs::rename(&partial, path)
        };
        write().map_err(|error| {
            // Nothing to be done about a leftover that cannot be removed either; the first error is the one to tell.
            let _ = std::fs::remove_file(&partial);
            SceneError::io(path)(error)
        })
    }

    /// Gives the ids to a scene's splats.
    ///
    /// # Errors
    /// [`SceneError::Malformed`] where there are more or fewer ids than splats.
    pub fn apply(&self, splats: &mut Splats, path: &Path) -> Result<(), SceneError> {
        if self.ids.len() != splats.len() {
            return Err(SceneError::malformed(
                path,
                "the labels",
                format!("are {}, and the scene has {} splats", self.ids.len(), splats.len()),
                "Labels belong to the very scene that they were made for; label this one anew",
            ));
        }
        splats.labels = Some(self.ids.clone());
        Ok(())
    }
}

/// The value of a key, wherever it is.
fn search<'a>(value: &'a Value, key: &str, depth: u32) -> Option<&'a Value> {
    if depth > MAX_DEPTH {
        return None;
    }
    match value {
        Value::Object(object) => {
            object.get(key).or_else(|| object.values().find_map(|v| search(v, key, depth + 1)))
        }
        // Lists of objects, not of a million numbers.
        Value::Array(list) => list.iter().take(64).find_map(|v| search(v, key, depth + 1)),
        _ => None,
    }
}

/// The list of classes, in any of the forms; entries that make no sense have no name, which is no reason to refuse labels.
fn classes(value: &Value) -> Vec<Class> {
    let mut found: Vec<Class> = match value.get("classes") {
        Some(Value::Object(names)) => names.iter().filter_map(named).collect(),
        Some(Value::Array(list)) => list.iter().filter_map(Value::as_object).filter_map(described).collect(),
        _ => match search(value, "categories", 0) {
            Some(Value::Array(list)) => {
                list.iter().filter_map(Value::as_object).filter_map(described).collect()
            }
            _ => Vec::new(),
        },
    };
    found.retain(|c| c.id > 0);
    found.sort_by_key(|c| c.id);
    found.dedup_by_key(|c| c.id);
    found
}

fn named((id, name): (&String, &Value)) -> Option<Class> {
    let id = id.parse().ok()?;
    Some(Class { id, name: name.as_str()?.to_owned(), colour: class_colour(id) })
}

fn described(entry: &Map<String, Value>) -> Option<Class> {
    let id = u16::try_from(entry.get("id")?.as_u64()?).ok()?;
    let name = entry.get("name").and_then(Value::as_str).map_or_else(|| format!("class {id}"), str::to_owned);
    let colour = entry.get("colour").or_else(|| entry.get("color")).and_then(Value::as_array);
    let channel = |v: &Value| v.as_u64().and_then(|v| u8::try_from(v).ok());
    let colour = colour.and_then(|c| Some([channel(c.first()?)?, channel(c.get(1)?)?, channel(c.get(2)?)?]));
    Some(Class { id, name, colour: colour.unwrap_or_else(|| class_colour(id)) })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Labels, String> {
        Labels::parse(Path::new("x.json"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn every_form_is_read() {
        assert_eq!(parse("[3, 0, 1]").unwrap().ids, [3, 0, 1]);
        let named =
            parse(r#"{"classes": {"1": "plush", "7": "wall"}, "counts": [], "labels": [1, 7, 7]}"#).unwrap();
        assert_eq!((named.ids.as_slice(), named.class(7).unwrap().name.as_str()), (&[1, 7, 7][..], "wall"));
        let service = r#"{"dataset": {"task_attributes": {"categories": [
            {"name": "letter", "id": 2, "color": [1, 2, 3]}]},
            "samples": [{"labels": {"truth": {"attributes": {"point_annotations": [0.0, 2.0, 2]}}}}]}}"#;
        let service = parse(service).unwrap();
        assert_eq!(service.ids, [0, 2, 2]);
        assert_eq!(service.classes, [Class { id: 2, name: "letter".into(), colour: [1, 2, 3] }]);
        // What occurs without an entry is called by its number.
        assert_eq!(parse("[5]").unwrap().classes[0].name, "class 5");
    }

    #[test]
    fn what_is_no_class_is_refused_with_its_place() {
        for (text, part) in [
            ("[1, 2.5]", "label 1: is 2.5"),
            ("[1, -1]", "label 1: is -1"),
            ("[65536]", "label 0: is 65536"),
            (r#"[1, "a"]"#, "label 1"),
            ("{}", "no list of class ids"),
            ("7", "no list of class ids"),
            ("[1,", "line 1"),
            (r#"{"version": 2, "labels": []}"#, "version 2"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
        // Nesting without end is an error, not a crash.
        assert!(parse(&"[".repeat(100_000)).is_err());
    }

    #[test]
    fn labels_are_saved_and_applied() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("a.ply");
        assert_eq!(Labels::beside(&scene).unwrap(), None);
        let labels = parse(r#"{"classes": {"1": "plush"}, "labels": [1, 0, 2]}"#).unwrap();
        labels.save(&Labels::path_of(&scene)).unwrap();
        assert!(folder.path().join("a.ply.labels.json").is_file());
        assert_eq!(Labels::beside(&scene).unwrap().unwrap(), labels);
        assert_eq!(labels.counts(), [1, 1, 1]);
        let mut splats = Splats::zeroed(3, 0, false);
        labels.apply(&mut splats, &scene).unwrap();
        assert_eq!(Labels::of_splats(&splats, &labels.classes).unwrap(), labels);
        let mut other = Splats::zeroed(2, 0, false);
        assert!(labels.apply(&mut other, &scene).unwrap_err().to_string().contains("3, and the scene has 2"));
        assert_eq!(other.labels, None);
    }

    #[test]
    fn classes_have_colours_of_their_own() {
        let mut colours: Vec<_> = (0..40).map(class_colour).collect();
        colours.sort_unstable();
        colours.dedup();
        assert_eq!(colours.len(), 40);
    }
}
