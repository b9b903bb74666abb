//! Folders of scene files: frames of a sequence, or parts of one scene.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use crate::{Format, SceneError};

/// The frames of a sequence: every scene in a folder (files, and sub-folders with a `meta.json`), in the order of
/// their names with numbers compared as numbers.
///
/// # Errors
/// [`SceneError::Io`] where the folder cannot be listed, [`SceneError::Unsupported`] where there is no scene in it or
/// it is one scene itself.
pub fn sequence_frames(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    if folder.join("meta.json").is_file() || folder.join("lod-meta.json").is_file() {
        return Err(SceneError::unsupported(
            folder,
            "this folder is one scene, not a sequence of frames",
            "Load it as a scene, or name the folder above it",
        ));
    }
    folder_parts(folder)
}

/// Whether a folder's scenes look like frames (`monkey_0001.sog`, `monkey_0002.sog`, … or `0001.ply`, …): at least
/// two, one common prefix, each with its own number. Names such as `2_0`, `2_1` are level and part, not frames.
pub fn looks_like_sequence(folder: &Path) -> bool {
    let Ok(frames) = sequence_frames(folder) else { return false };
    let split = |path: &PathBuf| -> Option<(String, u64)> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let stem = name.split('.').next()?;
        let digits = stem.len() - stem.bytes().rev().take_while(u8::is_ascii_digit).count();
        Some((stem[..digits].to_owned(), stem[digits..].parse().ok()?))
    };
    let Some(names) = frames.iter().map(split).collect::<Option<Vec<_>>>() else { return false };
    let Some((prefix, _)) = names.first() else { return false };
    let is_level =
        prefix.strip_suffix('_').is_some_and(|p| !p.is_empty() && p.bytes().all(|b| b.is_ascii_digit()));
    names.len() >= 2
        && !is_level
        && names.iter().all(|(p, _)| p == prefix)
        && names.windows(2).all(|pair| pair[0].1 < pair[1].1)
}

/// Every scene directly in a folder, in the order of their names.
pub(crate) fn folder_parts(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let mut parts = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(SceneError::io(folder))? {
        let path = entry.map_err(SceneError::io(folder))?.path();
        let is_scene =
            if path.is_dir() { path.join("meta.json").is_file() } else { Format::is_scene_name(&path) };
        if is_scene {
            parts.push(path);
        }
    }
    if parts.is_empty() {
        return Err(SceneError::unsupported(
            folder,
            "there is no scene file in this folder",
            "Name a folder with .ply, .compressed.ply, .splat, .splatv, .ksplat, .spz or .sog files, or a SOG folder",
        ));
    }
    parts.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()).then_with(|| a.cmp(b)));
    Ok(parts)
}

/// Compares names with runs of digits as numbers: `frame2` before `frame10`.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.as_bytes(), b.as_bytes());
    loop {
        match (a.first(), b.first()) {
            (None, None) => return Ordering::Equal,
            (None, _) => return Ordering::Less,
            (_, None) => return Ordering::Greater,
            (Some(x), Some(y)) if x.is_ascii_digit() && y.is_ascii_digit() => {
                let run = |s: &[u8]| s.iter().take_while(|c| c.is_ascii_digit()).count();
                let (m, n) = (run(a), run(b));
                let (left, right) = (a[..m].trim_ascii_start_zeros(), b[..n].trim_ascii_start_zeros());
                let order = left.len().cmp(&right.len()).then_with(|| left.cmp(right));
                if order != Ordering::Equal {
                    return order;
                }
                (a, b) = (&a[m..], &b[n..]);
            }
            (Some(x), Some(y)) if x == y => (a, b) = (&a[1..], &b[1..]),
            (Some(x), Some(y)) => return x.cmp(y),
        }
    }
}

trait TrimZeros {
    fn trim_ascii_start_zeros(&self) -> &[u8];
}

impl TrimZeros for [u8] {
    fn trim_ascii_start_zeros(&self) -> &[u8] {
        &self[self.iter().take_while(|&&c| c == b'0').count()..]
    }
}
