//! Cameras of a data set: where the photographs of a scene were taken, and with which lens.
//!
//! One [`Camera`] whatever the file said; [`load`] tells the forms apart by their content:
//! * the trainer's `cameras.json` (INRIA's 3DGS writes one beside every trained scene),
//! * a JSON list with `R_w2c` and `t_w2c` (the form of reference pictures),
//! * NeRF `transforms.json` (instant-ngp, Nerfstudio, the Blender data sets),
//! * COLMAP's sparse model, text or binary.
//!
//! **Axes** are the scene's own, as for [`crate::Splats`]. The camera looks along +z with x to the right and
//! y down (COLMAP's and the trainers' convention); other conventions are turned into it while reading.
//! **Pixels** are in edge coordinates: the top left corner of the image is (0, 0), and the centre of pixel
//! `i` lies at `i + ½`, so a principal point in the middle of the image is `(width / 2, height / 2)`.

mod colmap;
mod list;
mod nerf;
mod photographs;

use std::path::{Path, PathBuf};

use crate::SceneError;
use photographs::Photographs;

/// A calibrated pinhole camera with its pose.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Camera {
    /// What the camera is called: the photograph's file name without extension, with as much of its folder
    /// in front as makes it unique in the file.
    pub name: String,
    /// Width of the image, pixels, positive.
    pub width: u32,
    /// Height of the image, pixels, positive.
    pub height: u32,
    /// Focal length along x, pixels, positive.
    pub fx: f64,
    /// Focal length along y, pixels, positive.
    pub fy: f64,
    /// Principal point from the left edge, pixels.
    pub cx: f64,
    /// Principal point from the top edge, pixels.
    pub cy: f64,
    /// Rotation from scene to camera axes (x right, y down, z forward), rows; orthonormal within 10⁻³.
    pub rotation: [[f64; 3]; 3],
    /// Translation from scene to camera: `x_camera = rotation · x_scene + translation`, scene units.
    pub translation: [f64; 3],
    /// The photograph's name as the file writes it, perhaps with a folder; empty where there is none.
    pub photograph: String,
    /// The photograph on disk, where it was found near the camera file.
    pub image: Option<PathBuf>,
    /// Which part of the data set the photograph belongs to, where the file says so.
    pub split: Option<Split>,
    /// Moment of a moving scene that the picture shows, `0 ..= 1`, where the file says so.
    pub time: Option<f64>,
    /// The scene files that the picture was made from, as the file writes them (reference pictures only).
    pub inputs: Vec<String>,
}

/// Part of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// The scene was trained on this photograph.
    Train,
    /// The photograph was used to choose among trainings.
    Validation,
    /// The photograph was held out.
    Test,
}

impl Split {
    /// The split that a word of a data set means: `train`, `val`, `validation`, `eval` or `test`.
    pub fn from_word(word: &str) -> Option<Self> {
        match word.to_ascii_lowercase().as_str() {
            "train" | "training" => Some(Self::Train),
            "val" | "valid" | "validation" | "eval" => Some(Self::Validation),
            "test" | "testing" => Some(Self::Test),
            _ => None,
        }
    }
}

impl Camera {
    /// The optical centre, scene axes and units: `−rotationᵀ · translation`.
    pub fn position(&self) -> [f64; 3] {
        let (r, t) = (&self.rotation, &self.translation);
        std::array::from_fn(|i| -(r[0][i] * t[0] + r[1][i] * t[1] + r[2][i] * t[2]))
    }

    /// The horizontal and vertical field of view, radians: the angles that the image spans through its
    /// principal point.
    pub fn field_of_view(&self) -> [f64; 2] {
        let span = |size: u32, c: f64, f: f64| (c / f).atan() + ((f64::from(size) - c) / f).atan();
        [span(self.width, self.cx, self.fx), span(self.height, self.cy, self.fy)]
    }

    /// Reads a camera's rotation and translation from camera-to-scene rows and the optical centre.
    fn pose_from_camera_to_scene(rows: [[f64; 3]; 3], position: [f64; 3]) -> ([[f64; 3]; 3], [f64; 3]) {
        let rotation: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| rows[j][i]));
        let translation = std::array::from_fn(|i| {
            -(rotation[i][0] * position[0] + rotation[i][1] * position[1] + rotation[i][2] * position[2])
        });
        (rotation, translation)
    }

    /// What is wrong with the camera, if anything: every reader asks before it hands the camera out.
    fn check(&self) -> Result<(), Refusal> {
        let refuse = |problem: String, remedy: &'static str| Err(Refusal { problem, remedy });
        for (what, size) in [("width", self.width), ("height", self.height)] {
            if !(1..=MAX_IMAGE_SIDE).contains(&size) {
                return refuse(
                    format!("the {what} is {size} pixels, expected 1 to {MAX_IMAGE_SIDE}"),
                    "Give the size of the photographs in pixels",
                );
            }
        }
        for (what, f) in [("fx", self.fx), ("fy", self.fy)] {
            if !(f.is_finite() && f > 0.0) {
                return refuse(
                    format!("the focal length {what} is {f}, expected a positive number of pixels"),
                    "Give the focal length in pixels",
                );
            }
        }
        for (what, c) in [("cx", self.cx), ("cy", self.cy)] {
            if !c.is_finite() {
                return refuse(
                    format!("the principal point {what} is {c}"),
                    "Give it in pixels from the top left corner of the image",
                );
            }
        }
        if !self.translation.iter().all(|t| t.is_finite()) {
            return refuse(
                format!("the position gives the translation {:?}", self.translation),
                "Every number of a pose must be finite",
            );
        }
        let off = distance_from_rotation(&self.rotation);
        if !(0.0..=ROTATION_TOLERANCE).contains(&off) {
            return refuse(
                format!(
                    "the pose's 3 × 3 part is not a rotation (it is off by {off:.3e}, allowed {ROTATION_TOLERANCE:.0e}): {:?}",
                    self.rotation
                ),
                "Remove scale and mirroring from the pose: its columns must be orthonormal and right-handed",
            );
        }
        Ok(())
    }
}

/// A photograph wider or taller than this is a mistake, not a camera.
const MAX_IMAGE_SIDE: u32 = 1 << 20;

/// How far `R Rᵀ` may be from the identity, and the determinant from one: trainers write poses that went
/// through f32 and a few matrix products, which leaves about 10⁻⁶.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// The largest deviation of `R Rᵀ` from the identity and of `det R` from one; NaN where `R` is not finite.
fn distance_from_rotation(r: &[[f64; 3]; 3]) -> f64 {
    let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = [
        r[0][1] * r[1][2] - r[0][2] * r[1][1],
        r[0][2] * r[1][0] - r[0][0] * r[1][2],
        r[0][0] * r[1][1] - r[0][1] * r[1][0],
    ];
    let mut worst = (dot(&cross, &r[2]) - 1.0).abs();
    for i in 0..3 {
        for j in i..3 {
            let off = (dot(&r[i], &r[j]) - f64::from(u8::from(i == j))).abs();
            // `f64::max` drops a NaN; a pose with one must not pass.
            worst = if off.is_nan() { off } else { worst.max(off) };
        }
    }
    worst
}

/// Why an entry of a camera file is not taken, and what to do about it.
struct Refusal {
    problem: String,
    remedy: &'static str,
}

impl Refusal {
    fn at(self, path: &Path, place: impl Into<String>) -> SceneError {
        SceneError::Malformed {
            path: path.to_owned(),
            place: place.into(),
            problem: self.problem,
            remedy: self.remedy.to_owned(),
        }
    }
}

fn malformed(
    path: &Path,
    place: impl Into<String>,
    problem: impl Into<String>,
    remedy: impl Into<String>,
) -> SceneError {
    SceneError::Malformed {
        path: path.to_owned(),
        place: place.into(),
        problem: problem.into(),
        remedy: remedy.into(),
    }
}

fn read(path: &Path) -> Result<Vec<u8>, SceneError> {
    std::fs::read(path).map_err(|source| SceneError::Io { path: path.to_owned(), source })
}

/// Reads every camera of a file or folder, in the file's order (COLMAP's by photograph name, whose own
/// order is arbitrary). Never returns an empty list.
///
/// A folder may hold `cameras.json`, `transforms.json`, `transforms_train.json` or a COLMAP model (in the
/// folder itself, in `sparse/0` or in `sparse`); the first of these that exists is read. A file is told by
/// its content, whatever its name.
///
/// # Errors
/// [`SceneError::Io`] where a file cannot be read, [`SceneError::Malformed`] where it is no camera file, or
/// one with an entry that is no pinhole camera (lens distortion is refused: the renderer has no model of it).
pub fn load(path: &Path) -> Result<Vec<Camera>, SceneError> {
    let path = if path.is_dir() {
        within(path).ok_or_else(|| {
            malformed(
                path,
                "the folder",
                "holds none of cameras.json, transforms.json, transforms_train.json, sparse/0/cameras.bin (or .txt)",
                "Name the camera file itself",
            )
        })?
    } else {
        path.to_owned()
    };
    let bytes = read(&path)?;
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let mut cameras = match text.iter().find(|b| !b.is_ascii_whitespace()) {
        Some(b'[') => list::read(&path, text)?,
        Some(b'{') => nerf::read(&path, text)?,
        _ => colmap::read(&path, &bytes)?,
    };
    if cameras.is_empty() {
        return Err(malformed(&path, "the whole file", "lists no camera", "Export the cameras again"));
    }
    name(&mut cameras);
    let photographs = Photographs::near(&path);
    for camera in &mut cameras {
        if camera.image.is_none() && !camera.photograph.is_empty() {
            camera.image = photographs.find(&camera.photograph);
        }
    }
    Ok(cameras)
}

/// The camera file that belongs to a scene, if there is one: in the scene's folder, or in one of the two
/// above it (the trainers write `point_cloud/iteration_30000/point_cloud.ply` below `cameras.json`).
pub fn beside(scene: &Path) -> Option<PathBuf> {
    let start = if scene.is_dir() { scene } else { scene.parent()? };
    start.ancestors().take(3).find_map(|folder| {
        // The current folder is the parent of a bare file name.
        within(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
    })
}

/// The camera file within a folder, by the names that tools give them.
fn within(folder: &Path) -> Option<PathBuf> {
    ["cameras.json", "transforms.json", "transforms_train.json"]
        .iter()
        .map(|name| folder.join(name))
        .chain(["", "sparse/0", "sparse"].iter().flat_map(|sub| {
            ["cameras.bin", "cameras.txt"].iter().map(move |name| folder.join(sub).join(name))
        }))
        .find(|candidate| candidate.is_file())
}

/// The camera with a name: [`Camera::name`], or the photograph's file name, with or without its folder and
/// extension.
///
/// # Errors
/// A sentence that says which names there are, or which cameras an ambiguous name fits.
pub fn find<'a>(cameras: &'a [Camera], name: &str) -> Result<&'a Camera, String> {
    if let Some(camera) = cameras.iter().find(|camera| camera.name == name) {
        return Ok(camera);
    }
    let fits: Vec<&Camera> = cameras
        .iter()
        .filter(|camera| {
            !camera.photograph.is_empty()
                && [
                    camera.photograph.as_str(),
                    file_name(&camera.photograph),
                    stem(&camera.photograph),
                    stem(file_name(&camera.photograph)),
                ]
                .contains(&name)
        })
        .collect();
    let listed = |cameras: &[&Camera]| {
        const SHOWN: usize = 8;
        let names: Vec<&str> = cameras.iter().take(SHOWN).map(|camera| camera.name.as_str()).collect();
        let more = cameras.len().saturating_sub(SHOWN);
        let tail = if more > 0 { format!(" and {more} more") } else { String::new() };
        names.join(", ") + &tail
    };
    match fits.as_slice() {
        [camera] => Ok(camera),
        [] => Err(format!(
            "no camera is called “{name}”. There are: {}",
            listed(&cameras.iter().collect::<Vec<_>>())
        )),
        several => {
            Err(format!("“{name}” fits {} cameras: {}. Give the whole name", several.len(), listed(several)))
        }
    }
}

/// Names the cameras after their photographs: the file's stem, or with folder where stems repeat.
fn name(cameras: &mut [Camera]) {
    let mut counts = std::collections::HashMap::<&str, usize>::new();
    for camera in cameras.iter() {
        *counts.entry(stem(file_name(&camera.photograph))).or_default() += 1;
    }
    let unique: Vec<bool> =
        cameras.iter().map(|camera| counts.get(stem(file_name(&camera.photograph))) == Some(&1)).collect();
    for (camera, unique) in cameras.iter_mut().zip(unique) {
        if camera.photograph.is_empty() {
            continue;
        }
        let name = if unique { stem(file_name(&camera.photograph)) } else { stem(&camera.photograph) };
        camera.name = name.to_owned();
    }
}

/// The last part of a path as camera files write them, with either slash.
fn file_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

/// A path without the extension of its last part, where that is one that photographs have. Names such as
/// `frame_0.50` keep theirs.
fn stem(path: &str) -> &str {
    match path.rsplit_once('.') {
        Some((stem, extension)) if photographs::is_extension(extension) && !stem.is_empty() => stem,
        _ => path,
    }
}

#[cfg(test)]
mod tests;
