//! The way out: splats to a file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::{SceneError, Splats, formats};

/// Writes splats; the extension says how: `.ply` (the trainers' layout, binary little-endian; with motion, the
/// Spacetime Gaussians lite layout), `.splat` (no motion, no spherical harmonics), `.spz` (no motion).
/// What a format cannot hold is lost; labels are in none.
///
/// The file appears under its name only once it is complete.
///
/// # Errors
/// [`SceneError::Unsupported`] for another extension, [`SceneError::Io`] where the disk refuses.
pub fn save(path: &Path, splats: &Splats) -> Result<(), SceneError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if !matches!(extension.as_str(), "ply" | "splat" | "spz") {
        return Err(SceneError::unsupported(
            path,
            format!("scenes cannot be written as '.{extension}'"),
            "Use a name that ends in .ply, .splat or .spz",
        ));
    }
    let mut partial = path.as_os_str().to_owned();
    partial.push(".part");
    let partial = Path::new(&partial);
    let write = || -> std::io::Result<()> {
        let mut out = BufWriter::with_capacity(1 << 18, File::create(partial)?);
        match extension.as_str() {
            "ply" => formats::ply::write(splats, &mut out)?,
            "splat" => formats::splat::write(splats, &mut out)?,
            _ => formats::spz::write(splats, &mut out)?,
        }
        out.flush()?;
        drop(out);
        std::fs::rename(partial, path)
    };
    write().map_err(|error| {
        // Nothing to be done about a leftover that cannot be removed either; the first error is the one to tell.
        let _ = std::fs::remove_file(partial);
        SceneError::io(path)(error)
    })
}
