//! Photographs on disk: where data sets keep them, relative to the camera file.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::{file_name, stem};

/// Extensions that photographs of data sets have, lower case.
const EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "webp", "tif", "tiff", "exr"];

/// Whether a file extension (without dot, any case) is one of a photograph.
pub(super) fn is_extension(extension: &str) -> bool {
    EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension))
}

/// The photographs near a camera file. Each folder is listed once, for data sets have thousands.
pub(super) struct Photographs {
    root: PathBuf,
    by_name: HashMap<String, PathBuf>,
    by_stem: HashMap<String, PathBuf>,
}

impl Photographs {
    /// Looks into `images` and `input` beside the camera file, and beside the project that COLMAP's
    /// `sparse/0` belongs to.
    pub(super) fn near(camera_file: &Path) -> Self {
        let root = match camera_file.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        let mut photographs = Self { root: root.clone(), by_name: HashMap::new(), by_stem: HashMap::new() };
        for folder in ["images", "input", "../images", "../../images"] {
            photographs.list(&root.join(folder));
        }
        photographs
    }

    /// Adds a folder's photographs; a folder that is not there has none. What was added first stays.
    fn list(&mut self, folder: &Path) {
        let Ok(entries) = std::fs::read_dir(folder) else {
            return;
        };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        // The order of a folder is the file system's; of `a.jpg` and `a.png` the same one must win everywhere.
        paths.sort();
        for path in paths {
            let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
                continue;
            };
            let short = stem(name);
            if short == name {
                continue;
            }
            self.by_stem.entry(short.to_owned()).or_insert_with(|| path.clone());
            self.by_name.entry(name.to_owned()).or_insert(path);
        }
    }

    /// The photograph that a camera file calls `written`: relative to the file, or by name in a known folder.
    pub(super) fn find(&self, written: &str) -> Option<PathBuf> {
        let direct = self.root.join(written);
        if is_extension(Path::new(written).extension().and_then(|e| e.to_str()).unwrap_or_default())
            && direct.is_file()
        {
            return Some(direct);
        }
        // The Blender data sets write `./train/r_0` for `train/r_0.png`.
        for extension in EXTENSIONS {
            let candidate = self.root.join(format!("{written}.{extension}"));
            if candidate.is_file() {
                return Some(candidate);
            }
        }
        let name = file_name(written);
        self.by_name.get(name).or_else(|| self.by_stem.get(stem(name))).cloned()
    }
}
