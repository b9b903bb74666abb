//! Where a scene's files are: beside a `meta.json`, or in a zip.

use std::io::{Cursor, Read};
use std::path::{Component, Path, PathBuf};

use zip::ZipArchive;
use zip::result::ZipError;

use crate::SceneError;
use crate::load::LoadContext;
use crate::source::Source;

const INCOMPLETE: &str = "The scene is incomplete or damaged: copy or export it again";

/// Names a scene's files in messages.
#[derive(Clone, Debug)]
pub(super) enum Place {
    /// The folder of a `meta.json`.
    Folder(PathBuf),
    /// A zip.
    Zip(PathBuf),
}

impl Place {
    /// The scene as a whole.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Folder(path) | Self::Zip(path) => path,
        }
    }

    /// An error with one of the files.
    pub(super) fn wrong(
        &self,
        file: &str,
        place: &str,
        problem: impl Into<String>,
        remedy: &str,
    ) -> SceneError {
        match self {
            Self::Folder(folder) => SceneError::malformed(&folder.join(file), place, problem, remedy),
            Self::Zip(path) => SceneError::malformed(path, format!("{file}, {place}"), problem, remedy),
        }
    }
}

/// The files of one scene.
pub(super) struct Container {
    place: Place,
    files: Files,
}

enum Files {
    Folder {
        /// The text of `meta.json`, where the source is in memory.
        text: Option<Vec<u8>>,
        /// Its name.
        meta: String,
    },
    Zip {
        archive: Box<ZipArchive<Cursor<Vec<u8>>>>,
        /// Folder of `meta.json` within the archive, with its slash, or nothing.
        prefix: String,
        /// Length of the archive.
        length: u64,
    },
}

impl Container {
    /// The container that a source is: a folder, a `meta.json`, or a zip.
    pub(super) fn of(source: &Source) -> Result<Self, SceneError> {
        let path = source.path();
        if source.is_folder() {
            return Ok(Self {
                place: Place::Folder(path.to_owned()),
                files: Files::Folder { text: None, meta: "meta.json".to_owned() },
            });
        }
        if source.head(4)? == b"PK\x03\x04" {
            return Self::zip(path, source.read_all()?);
        }
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let meta = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self {
            place: Place::Folder(folder),
            files: Files::Folder { text: Some(source.read_all()?), meta },
        })
    }

    fn zip(path: &Path, bytes: Vec<u8>) -> Result<Self, SceneError> {
        let length = bytes.len() as u64;
        let archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| {
            SceneError::malformed(path, "the zip's directory", zip_problem(&error), INCOMPLETE)
        })?;
        // Archives made by hand may hold the scene's folder instead of its files: take the outermost one.
        let prefix = archive
            .file_names()
            .flatten()
            .filter_map(|name| name.strip_suffix("meta.json").map(str::to_owned))
            .filter(|prefix| prefix.is_empty() || prefix.ends_with('/'))
            .min_by_key(|prefix| (prefix.matches('/').count(), prefix.clone()));
        let Some(prefix) = prefix else {
            let streamed = archive.file_names().flatten().any(|name| name.ends_with("lod-meta.json"));
            return Err(if streamed {
                SceneError::unsupported(
                    path,
                    "a streamed scene in a zip: its levels are meant to be read one at a time",
                    "Unpack it and name the folder",
                )
            } else {
                SceneError::malformed(path, "the zip's directory", "there is no meta.json in it", INCOMPLETE)
            });
        };
        Ok(Self {
            place: Place::Zip(path.to_owned()),
            files: Files::Zip { archive: Box::new(archive), prefix, length },
        })
    }

    /// Names the files in messages.
    pub(super) fn place(&self) -> &Place {
        &self.place
    }

    /// The name of the description.
    pub(super) fn meta_name(&self) -> String {
        match &self.files {
            Files::Folder { meta, .. } => meta.clone(),
            Files::Zip { prefix, .. } => format!("{prefix}meta.json"),
        }
    }

    /// The text of the description.
    pub(super) fn meta(&mut self, ctx: &LoadContext<'_>) -> Result<Vec<u8>, SceneError> {
        if let Files::Folder { text, .. } = &mut self.files
            && let Some(text) = text.take()
        {
            return Ok(text);
        }
        let name = match &self.files {
            Files::Folder { meta, .. } => meta.clone(),
            Files::Zip { .. } => "meta.json".to_owned(),
        };
        self.read(&name, ctx)
    }

    /// A file by the name that `meta.json` gives it.
    pub(super) fn read(&mut self, name: &str, ctx: &LoadContext<'_>) -> Result<Vec<u8>, SceneError> {
        match &mut self.files {
            Files::Folder { meta, .. } => {
                // A downloaded scene must not make the viewer read files elsewhere on the disk.
                let inside = !name.is_empty()
                    && Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
                if !inside {
                    return Err(self.place.wrong(
                        &meta.clone(),
                        &format!("the file name “{name}”"),
                        "leads out of the scene's folder",
                        "Names of images are relative to meta.json and below it",
                    ));
                }
                let source = Source::open(&self.place.path().join(name))?;
                ctx.add_bytes(source.len());
                source.read_all()
            }
            Files::Zip { archive, prefix, length } => {
                let full = format!("{prefix}{name}");
                let wrong = |problem: String| self.place.wrong(&full, "in the zip", problem, INCOMPLETE);
                let mut file = archive.by_name(&full).map_err(|error| wrong(zip_problem(&error)))?;
                // WebP does not compress further, and the description is small.
                let limit = length.saturating_mul(4).saturating_add(1 << 20);
                let size = file.size();
                if size > limit {
                    return Err(wrong(format!(
                        "claims {size} bytes in an archive of {length}, more than four times as much"
                    )));
                }
                let mut bytes = Vec::with_capacity(size as usize);
                // One byte more than there is: the checksum is compared at the end.
                let read = file.by_ref().take(size + 1).read_to_end(&mut bytes);
                read.map_err(|error| wrong(error.to_string()))?;
                if bytes.len() as u64 != size {
                    return Err(wrong(format!("ends after {} of {size} bytes", bytes.len())));
                }
                Ok(bytes)
            }
        }
    }
}

fn zip_problem(error: &ZipError) -> String {
    match error {
        ZipError::FileNotFound => "is missing".to_owned(),
        other => other.to_string(),
    }
}
