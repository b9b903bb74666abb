//! What several test programs share.
#![allow(dead_code, reason = "every test program uses a part of it")]

pub mod allocation;
pub mod encode;
pub mod pack;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use motes_scenes::{LoadOptions, Scene, SceneError, Splats, load_bytes, sh_coefficients};

/// The folder of large sample scenes.
pub fn samples() -> PathBuf {
    let folder = std::env::var_os("MOTES_SCENES")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes"), PathBuf::from);
    assert!(
        folder.join("MANIFEST.md").is_file(),
        "the sample scenes are missing: set MOTES_SCENES to their folder (looked for {}/MANIFEST.md)",
        folder.display()
    );
    folder
}

/// Loads bytes as a file of that name.
pub fn read(name: &str, bytes: &[u8]) -> Result<Scene, SceneError> {
    load_bytes(Path::new(name), Arc::from(bytes), &LoadOptions::default())
}

/// Why a scene breaks the promises of [`Splats`], if it does.
pub fn defect(splats: &Splats) -> Option<String> {
    let n = splats.len();
    let lengths = [
        splats.rotations.len(),
        splats.log_scales.len(),
        splats.opacities.len(),
        splats.sh.len() / sh_coefficients(splats.sh_degree),
    ];
    if lengths.iter().any(|l| *l != n) || splats.sh.len() != n * sh_coefficients(splats.sh_degree) {
        return Some(format!("arrays of unequal length: {n} means, {lengths:?}"));
    }
    let finite = |name: &str, values: &[f32]| {
        values.iter().position(|v| !v.is_finite()).map(|i| format!("{name}[{i}] is {}", values[i]))
    };
    let mut found = finite("means", splats.means.as_flattened())
        .or_else(|| finite("rotations", splats.rotations.as_flattened()))
        .or_else(|| finite("log_scales", splats.log_scales.as_flattened()))
        .or_else(|| finite("sh", splats.sh.as_flattened()))
        .or_else(|| {
            let i = splats.opacities.iter().position(|v| !(0.0..=1.0).contains(v))?;
            Some(format!("opacities[{i}] is {}", splats.opacities[i]))
        })
        .or_else(|| {
            let i = splats.rotations.iter().position(|q| {
                let squared: f32 = q.iter().map(|v| v * v).sum();
                !((squared - 1.0).abs() < 1e-5)
            })?;
            Some(format!("rotations[{i}] is {:?}", splats.rotations[i]))
        });
    if let (None, Some(motion)) = (&found, &splats.motion) {
        let lengths =
            [motion.centers.len(), motion.widths.len(), motion.polynomials.len(), motion.omegas.len()];
        if lengths.iter().any(|l| *l != n) {
            return Some(format!("motion of unequal length: {n} means, {lengths:?}"));
        }
        found = finite("centers", &motion.centers)
            .or_else(|| finite("widths", &motion.widths))
            .or_else(|| finite("polynomials", motion.polynomials.as_flattened().as_flattened()))
            .or_else(|| finite("omegas", motion.omegas.as_flattened()))
            .or_else(|| {
                let i = motion.widths.iter().position(|w| !(*w > 0.0))?;
                Some(format!("widths[{i}] is {}", motion.widths[i]))
            });
    }
    found
}

/// Largest difference of two arrays; NaN where one is.
pub fn difference<'a>(a: impl IntoIterator<Item = &'a f32>, b: impl IntoIterator<Item = &'a f32>) -> f32 {
    a.into_iter().zip(b).fold(0.0, |worst, (x, y)| {
        let d = (x - y).abs();
        if d > worst || d.is_nan() { d } else { worst }
    })
}

/// The angle between two rotations (quaternions of either sign), radians.
pub fn angle(a: [f32; 4], b: [f32; 4]) -> f64 {
    let (a, b) = (a.map(f64::from), b.map(f64::from));
    // From the chord, not the cosine, which is blind below 1e-4.
    let chord = |sign: f64| (0..4).map(|k| (a[k] - sign * b[k]).powi(2)).sum::<f64>().sqrt();
    4.0 * (chord(1.0).min(chord(-1.0)) / 2.0).asin()
}
