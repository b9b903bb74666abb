//! Where bytes come from: a file, memory, or a folder of files.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::SceneError;

/// An open scene: random access to its bytes from several threads at once, without mapping it into memory
/// (a mapped file that another program truncates kills the process).
#[derive(Debug)]
pub(crate) struct Source {
    path: PathBuf,
    body: Body,
}

#[derive(Debug)]
enum Body {
    File { file: File, len: u64 },
    Bytes(Arc<[u8]>),
    Folder,
}

impl Source {
    /// Opens a file or a folder.
    pub(crate) fn open(path: &Path) -> Result<Self, SceneError> {
        let metadata = std::fs::metadata(path).map_err(SceneError::io(path))?;
        let body = if metadata.is_dir() {
            Body::Folder
        } else {
            let file = File::open(path).map_err(SceneError::io(path))?;
            Body::File { file, len: metadata.len() }
        };
        Ok(Self { path: path.to_owned(), body })
    }

    /// A file that is already in memory; `name` stands for its path in messages and for its extension.
    pub(crate) fn from_bytes(name: &Path, bytes: Arc<[u8]>) -> Self {
        Self { path: name.to_owned(), body: Body::Bytes(bytes) }
    }

    /// The same once more, with a handle of its own.
    pub(crate) fn again(&self) -> Result<Self, SceneError> {
        match &self.body {
            Body::Bytes(bytes) => Ok(Self::from_bytes(&self.path, bytes.clone())),
            Body::File { .. } | Body::Folder => Self::open(&self.path),
        }
    }

    /// The path, for messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether this is a folder; a folder has length 0.
    pub(crate) fn is_folder(&self) -> bool {
        matches!(self.body, Body::Folder)
    }

    /// Length in bytes.
    pub(crate) fn len(&self) -> u64 {
        match &self.body {
            Body::File { len, .. } => *len,
            Body::Bytes(bytes) => bytes.len() as u64,
            Body::Folder => 0,
        }
    }

    /// Fills `buffer` from `offset` on; a file that ends before that is [`SceneError::Malformed`].
    pub(crate) fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<(), SceneError> {
        let wanted = offset.saturating_add(buffer.len() as u64);
        if wanted > self.len() {
            return Err(self.ends_early(offset, wanted));
        }
        match &self.body {
            Body::File { file, .. } => read_file_at(file, offset, buffer).map_err(|error| {
                if error.kind() == std::io::ErrorKind::UnexpectedEof {
                    self.ends_early(offset, wanted)
                } else {
                    SceneError::io(&self.path)(error)
                }
            }),
            Body::Bytes(bytes) => {
                let start = offset as usize;
                buffer.copy_from_slice(&bytes[start..start + buffer.len()]);
                Ok(())
            }
            Body::Folder => Err(self.ends_early(offset, wanted)),
        }
    }

    /// The first `n` bytes, fewer where the file is shorter.
    pub(crate) fn head(&self, n: usize) -> Result<Vec<u8>, SceneError> {
        let mut head = vec![0; n.min(usize::try_from(self.len()).unwrap_or(usize::MAX))];
        self.read_at(0, &mut head)?;
        Ok(head)
    }

    /// Everything.
    pub(crate) fn read_all(&self) -> Result<Vec<u8>, SceneError> {
        self.head(usize::MAX)
    }

    /// The error for contents that reach beyond the end.
    pub(crate) fn ends_early(&self, offset: u64, wanted: u64) -> SceneError {
        SceneError::malformed(
            &self.path,
            format!("byte {offset}"),
            format!("the file ends at byte {}, but its contents should reach byte {wanted}", self.len()),
            "It was cut off: copy or download it again",
        )
    }
}

#[cfg(unix)]
fn read_file_at(file: &File, offset: u64, buffer: &mut [u8]) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, buffer, offset)
}

#[cfg(windows)]
fn read_file_at(file: &File, mut offset: u64, mut buffer: &mut [u8]) -> std::io::Result<()> {
    use std::os::windows::fs::FileExt;
    while !buffer.is_empty() {
        match file.seek_read(buffer, offset) {
            Ok(0) => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            Ok(n) => {
                offset += n as u64;
                buffer = &mut buffer[n..];
            }
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
