//! Which format a file is in: its content decides, its name only where the content cannot.

use std::fmt;
use std::path::Path;

use crate::SceneError;
use crate::source::Source;

/// A scene file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Format {
    /// The trainers' layout (Kerbl et al. 2023): one PLY element `vertex`, one property per number.
    Ply,
    /// Spacetime Gaussians, lite model (Li et al. 2023): a PLY with motion.
    SpacetimePly,
    /// PlayCanvas's `.compressed.ply`: chunks of 256 splats, 16 bytes a splat.
    CompressedPly,
    /// antimatter15's `.splat`: 32 bytes a splat, no header.
    Splat,
    /// splaTV's `.splatv`: Spacetime Gaussians, lite model, in half floats.
    SplatV,
    /// mkkellogg's `.ksplat`, compression levels 0, 1 and 2.
    KSplat,
    /// Niantic's `.spz`, versions 1 to 4.
    Spz,
    /// PlayCanvas's SOG, versions 1 and 2: a zip or a folder of images with a `meta.json`.
    Sog,
    /// A streamed SOG scene: a folder with a `lod-meta.json`.
    StreamedSog,
    /// Levels of detail, `.mlod` ([`crate::levels`]), one of which is read.
    Levels,
    /// A folder of scene files that belong together, merged.
    Folder,
    /// Generated, not read.
    Synthetic,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ply => "PLY",
            Self::SpacetimePly => "Spacetime Gaussians PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Splat => "splat",
            Self::SplatV => "splatv",
            Self::KSplat => "ksplat",
            Self::Spz => "SPZ",
            Self::Sog => "SOG",
            Self::StreamedSog => "streamed SOG",
            Self::Levels => "levels of detail",
            Self::Folder => "folder of scenes",
            Self::Synthetic => "synthetic",
        })
    }
}

/// Names of files that a scene can be read from, for file dialogues and folder listings.
pub(crate) const EXTENSIONS: [&str; 7] = ["ply", "splat", "splatv", "ksplat", "spz", "sog", "mlod"];

impl Format {
    /// The format of a file or folder, from its first bytes, then from its extension.
    ///
    /// # Errors
    /// [`SceneError::Io`] where it cannot be read, [`SceneError::Unsupported`] where it is none of ours.
    pub fn detect(path: &Path) -> Result<Self, SceneError> {
        Self::of(&Source::open(path)?)
    }

    /// Whether a file of this name may be a scene (by extension, or `meta.json` and `lod-meta.json`).
    pub fn is_scene_name(path: &Path) -> bool {
        extension(path).is_some_and(|e| EXTENSIONS.contains(&e.as_str()))
            || matches!(file_name(path).as_str(), "meta.json" | "lod-meta.json")
    }

    pub(crate) fn of(source: &Source) -> Result<Self, SceneError> {
        let path = source.path();
        if source.is_folder() {
            return Ok(if path.join("lod-meta.json").is_file() {
                Self::StreamedSog
            } else if path.join("meta.json").is_file() {
                Self::Sog
            } else {
                Self::Folder
            });
        }
        let head = source.head(16)?;
        let extension = extension(path);
        if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
            return crate::formats::ply::header::Header::read(source)?.format(path);
        }
        if head.starts_with(b"PK\x03\x04") {
            return Ok(Self::Sog);
        }
        if head.starts_with(&[0x1f, 0x8b]) || head.starts_with(b"NGSP") {
            return Ok(Self::Spz);
        }
        if head.starts_with(&crate::formats::splatv::MAGIC.to_le_bytes()) {
            return Ok(Self::SplatV);
        }
        if head.starts_with(crate::levels::MAGIC) {
            return Ok(Self::Levels);
        }
        match file_name(path).as_str() {
            "lod-meta.json" => return Ok(Self::StreamedSog),
            "meta.json" => return Ok(Self::Sog),
            _ => {}
        }
        match extension.as_deref() {
            // Neither has a magic number.
            Some("splat") => Ok(Self::Splat),
            Some("ksplat") => Ok(Self::KSplat),
            Some(e @ ("ply" | "splatv" | "spz" | "sog" | "mlod")) => Err(SceneError::malformed(
                path,
                "byte 0",
                format!("a .{e} file does not begin like this ({})", preview(&head)),
                "It is another kind of file, or was damaged: export or download it again",
            )),
            _ => Err(SceneError::unsupported(
                path,
                format!("not a known scene format (it begins with {})", preview(&head)),
                "Motes reads .ply, .compressed.ply, .splat, .splatv, .ksplat, .spz, .sog, .mlod, and SOG folders",
            )),
        }
    }
}

/// The extension in lower case.
fn extension(path: &Path) -> Option<String> {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase())
}

/// The file's name in lower case.
fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// The first bytes for a message.
fn preview(head: &[u8]) -> String {
    if head.is_empty() {
        return "nothing: the file is empty".to_owned();
    }
    let n = head.len().min(8);
    format!("\"{}\"", head[..n].escape_ascii())
}
