//! COLMAP's sparse model: `cameras` and `images`, binary or text.
//!
//! Layouts from COLMAP's documentation of its output format. Poses are scene-to-camera, with the camera's
//! axes and the pixel-edge coordinates that Motes uses too. The points of the model are not read.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::{Camera, Refusal, malformed, read as read_file};
use crate::SceneError;

/// A lens of the model.
#[derive(Clone, Copy)]
struct Lens {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

/// A camera model of COLMAP.
struct Model {
    name: &'static str,
    /// Number of parameters: focal lengths (one or two), principal point, then distortion.
    parameters: usize,
    /// Whether there is one focal length for both axes.
    one_focal: bool,
    /// Whether the model is a pinhole when its distortion is zero.
    perspective: bool,
}

/// The models by their number in binary files.
const MODELS: [Model; 12] = [
    model("SIMPLE_PINHOLE", 3, true, true),
    model("PINHOLE", 4, false, true),
    model("SIMPLE_RADIAL", 4, true, true),
    model("RADIAL", 5, true, true),
    model("OPENCV", 8, false, true),
    model("OPENCV_FISHEYE", 8, false, false),
    model("FULL_OPENCV", 12, false, true),
    model("FOV", 5, false, false),
    model("SIMPLE_RADIAL_FISHEYE", 4, true, false),
    model("RADIAL_FISHEYE", 5, true, false),
    model("THIN_PRISM_FISHEYE", 12, false, false),
    model("RAD_TAN_THIN_PRISM_FISHEYE", 16, false, false),
];

const fn model(name: &'static str, parameters: usize, one_focal: bool, perspective: bool) -> Model {
    Model { name, parameters, one_focal, perspective }
}

const UNDISTORT: &str =
    "Undistort the photographs (colmap image_undistorter) and use the model that it writes";

impl Model {
    /// The lens that the parameters describe, or why it is no pinhole.
    fn lens(&self, width: u64, height: u64, parameters: &[f64]) -> Result<Lens, Refusal> {
        if !self.perspective {
            return Err(Refusal {
                problem: format!("the camera model is {}, and only pinhole cameras can be shown", self.name),
                remedy: UNDISTORT,
            });
        }
        let (fx, fy, rest) = match parameters {
            [f, rest @ ..] if self.one_focal => (*f, *f, rest),
            [fx, fy, rest @ ..] => (*fx, *fy, rest),
            _ => return Err(self.wrong_count(parameters.len())),
        };
        let [cx, cy, distortion @ ..] = rest else {
            return Err(self.wrong_count(parameters.len()));
        };
        if parameters.len() != self.parameters {
            return Err(self.wrong_count(parameters.len()));
        }
        if !distortion.iter().all(|&k| k == 0.0) {
            return Err(Refusal {
                problem: format!(
                    "the camera model {} is distorted by {distortion:?}, and only pinhole cameras can be shown",
                    self.name
                ),
                remedy: UNDISTORT,
            });
        }
        let side = |size: u64| {
            u32::try_from(size).map_err(|_| Refusal {
                problem: format!("an image side of {size} pixels"),
                remedy: "The file is damaged: export the model again",
            })
        };
        Ok(Lens { width: side(width)?, height: side(height)?, fx, fy, cx: *cx, cy: *cy })
    }

    fn wrong_count(&self, found: usize) -> Refusal {
        Refusal {
            problem: format!(
                "the camera model {} has {} parameters, found {found}",
                self.name, self.parameters
            ),
            remedy: "The file is damaged: export the model again",
        }
    }
}

/// Reads the model that a file (either of its two) belongs to, sorted by photograph.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Vec<Camera>, SceneError> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    // The binary files begin with a 64-bit count, which has zero bytes; the text files have none.
    let binary = bytes.iter().take(8).any(|&b| b == 0);
    let extension = if binary { "bin" } else { "txt" };
    let [cameras, images] = ["cameras", "images"].map(|file| folder.join(file).with_extension(extension));
    if ![&cameras, &images].iter().any(|file| file.file_name() == path.file_name()) {
        return Err(malformed(
            path,
            "the beginning",
            "is neither JSON nor a file of a COLMAP model (cameras.bin and images.bin, or .txt)",
            "Name a cameras.json, a transforms.json, or a folder with a COLMAP model",
        ));
    }
    let camera_bytes = read_file(&cameras)?;
    let image_bytes = read_file(&images)?;
    let mut list = if binary {
        let lenses = binary_lenses(&cameras, &camera_bytes)?;
        binary_images(&images, &image_bytes, &lenses)?
    } else {
        let lenses = text_lenses(&cameras, &camera_bytes)?;
        text_images(&images, &image_bytes, &lenses)?
    };
    list.sort_by(|a, b| a.photograph.cmp(&b.photograph));
    Ok(list)
}

/// Assembles a camera from an image's pose (quaternion w, x, y, z) and its lens.
fn camera(
    lenses: &HashMap<u32, Lens>,
    id: u32,
    q: [f64; 4],
    translation: [f64; 3],
    photograph: String,
) -> Result<Camera, Refusal> {
    let lens = lenses.get(&id).ok_or_else(|| Refusal {
        problem: format!("“{photograph}” refers to camera {id}, which the cameras file does not list"),
        remedy: "Export cameras and images of the same model",
    })?;
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    if !(norm.is_finite() && norm >= 1e-6) {
        return Err(Refusal {
            problem: format!("“{photograph}” has the quaternion {q:?}, which is no rotation"),
            remedy: "The file is damaged: export the model again",
        });
    }
    let [w, x, y, z] = q.map(|c| c / norm);
    let camera = Camera {
        name: String::new(),
        width: lens.width,
        height: lens.height,
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        rotation: [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ],
        translation,
        photograph,
        image: None,
        split: None,
        time: None,
        inputs: Vec::new(),
    };
    camera.check()?;
    Ok(camera)
}

/// A position in a binary file that cannot leave it.
struct Cursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], SceneError> {
        let end = self.at.checked_add(count).filter(|&end| end <= self.bytes.len());
        let Some(end) = end else {
            return Err(malformed(
                self.path,
                format!("byte {}", self.at),
                format!(
                    "the file ends within {what}: {count} bytes expected, {} left",
                    self.bytes.len() - self.at
                ),
                "The file is cut short or damaged: export the model again",
            ));
        };
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], SceneError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, what)?);
        Ok(array)
    }

    fn u32(&mut self, what: &str) -> Result<u32, SceneError> {
        Ok(u32::from_le_bytes(self.array(what)?))
    }

    fn u64(&mut self, what: &str) -> Result<u64, SceneError> {
        Ok(u64::from_le_bytes(self.array(what)?))
    }

    fn f64s<const N: usize>(&mut self, what: &str) -> Result<[f64; N], SceneError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.array(what)?);
        }
        Ok(values)
    }
}

fn binary_lenses(path: &Path, bytes: &[u8]) -> Result<HashMap<u32, Lens>, SceneError> {
    let mut cursor = Cursor { path, bytes, at: 0 };
    let count = cursor.u64("the number of cameras")?;
    let mut lenses = HashMap::new();
    for index in 0..count {
        let start = cursor.at;
        let id = cursor.u32("a camera's number")?;
        let number = cursor.u32("a camera's model")?;
        let width = cursor.u64("a camera's width")?;
        let height = cursor.u64("a camera's height")?;
        let place = format!("camera {index} of {count} (number {id}, byte {start})");
        let model = MODELS.get(number as usize).ok_or_else(|| {
            malformed(path, &place, format!("the camera model {number} is not known"), UNDISTORT)
        })?;
        let parameters: Vec<f64> = cursor
            .take(model.parameters * 8, "a camera's parameters")?
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
            .collect();
        let lens = model.lens(width, height, &parameters).map_err(|refusal| refusal.at(path, place))?;
        lenses.insert(id, lens);
    }
    Ok(lenses)
}

fn binary_images(path: &Path, bytes: &[u8], lenses: &HashMap<u32, Lens>) -> Result<Vec<Camera>, SceneError> {
    /// A 2-D point: two coordinates and the number of a 3-D point, 8 bytes each.
    const POINT: usize = 24;
    let mut cursor = Cursor { path, bytes, at: 0 };
    let count = cursor.u64("the number of images")?;
    let mut cameras = Vec::new();
    for index in 0..count {
        let start = cursor.at;
        cursor.u32("an image's number")?;
        let q = cursor.f64s("an image's rotation")?;
        let t = cursor.f64s("an image's translation")?;
        let id = cursor.u32("an image's camera")?;
        let rest = &bytes[cursor.at..];
        let length = rest.iter().position(|&b| b == 0).unwrap_or(rest.len());
        let name = cursor.take(length, "an image's name")?;
        cursor.take(1, "an image's name")?;
        let points = cursor.u64("the number of an image's points")?;
        let points = usize::try_from(points).unwrap_or(usize::MAX).saturating_mul(POINT);
        cursor.take(points, "an image's points")?;
        let name = String::from_utf8_lossy(name).into_owned();
        let camera = camera(lenses, id, q, t, name)
            .map_err(|refusal| refusal.at(path, format!("image {index} of {count} (byte {start})")))?;
        cameras.push(camera);
    }
    Ok(cameras)
}

/// A text file's lines with their numbers from 1, without comments. Empty lines stay: an image without
/// points has one.
fn lines<'a>(path: &Path, bytes: &'a [u8]) -> Result<impl Iterator<Item = (usize, &'a str)>, SceneError> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        malformed(
            path,
            format!("byte {}", error.valid_up_to()),
            "is no UTF-8 text",
            "The file is damaged: export the model again",
        )
    })?;
    Ok(text
        .lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .filter(|(_, line)| !line.starts_with('#')))
}

/// The fields of a text line, in order.
struct Fields<'a> {
    path: &'a Path,
    line: usize,
    rest: &'a str,
}

impl<'a> Fields<'a> {
    fn word(&mut self, what: &str) -> Result<&'a str, SceneError> {
        let rest = self.rest.trim_start();
        let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(end);
        if word.is_empty() {
            return Err(self.wrong(what, "is missing".to_owned()));
        }
        self.rest = rest;
        Ok(word)
    }

    fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, SceneError> {
        let word = self.word(what)?;
        word.parse().map_err(|_| self.wrong(what, format!("is “{word}”, expected a number")))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N], SceneError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(what)?;
        }
        Ok(numbers)
    }

    fn wrong(&self, what: &str, problem: String) -> SceneError {
        malformed(
            self.path,
            format!("line {}", self.line),
            format!("{what} {problem}"),
            "The file is cut short or damaged: export the model again",
        )
    }
}

fn text_lenses(path: &Path, bytes: &[u8]) -> Result<HashMap<u32, Lens>, SceneError> {
    let mut lenses = HashMap::new();
    for (line, text) in lines(path, bytes)?.filter(|(_, text)| !text.is_empty()) {
        let mut fields = Fields { path, line, rest: text };
        let id = fields.number("the camera's number")?;
        let name = fields.word("the camera's model")?;
        let width = fields.number("the camera's width")?;
        let height = fields.number("the camera's height")?;
        let model = MODELS.iter().find(|model| model.name == name).ok_or_else(|| {
            malformed(
                path,
                format!("line {line}"),
                format!("the camera model {name} is not known"),
                UNDISTORT,
            )
        })?;
        let mut parameters = Vec::new();
        while !fields.rest.trim_start().is_empty() {
            parameters.push(fields.number("a camera's parameter")?);
        }
        let lens = model
            .lens(width, height, &parameters)
            .map_err(|refusal| refusal.at(path, format!("line {line} (camera {id})")))?;
        lenses.insert(id, lens);
    }
    Ok(lenses)
}

fn text_images(path: &Path, bytes: &[u8], lenses: &HashMap<u32, Lens>) -> Result<Vec<Camera>, SceneError> {
    let mut cameras = Vec::new();
    let mut lines = lines(path, bytes)?;
    while let Some((line, text)) = lines.next() {
        if text.is_empty() {
            continue;
        }
        let mut fields = Fields { path, line, rest: text };
        fields.word("the image's number")?;
        let q = fields.numbers("the image's rotation")?;
        let t = fields.numbers("the image's translation")?;
        let id = fields.number("the image's camera")?;
        // The rest of the line, for names may have spaces.
        let name = fields.rest.trim();
        if name.is_empty() {
            return Err(fields.wrong("the image's name", "is missing".to_owned()));
        }
        let camera = camera(lenses, id, q, t, name.to_owned())
            .map_err(|refusal| refusal.at(path, format!("line {line}")))?;
        cameras.push(camera);
        // The image's 2-D points, perhaps an empty line.
        lines.next();
    }
    Ok(cameras)
}
