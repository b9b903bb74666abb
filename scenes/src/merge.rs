//! Several scenes become one.

use std::path::Path;

use crate::load::Scene;
use crate::{Motion, SceneError, Splats};

/// Appends `next` to `scene`; `path` is where `next` came from.
pub(crate) fn append(scene: &mut Scene, next: Scene, path: &Path) -> Result<(), SceneError> {
    let Scene { mut splats, report, sources } = next;
    let offset = scene.splats.len();
    if scene.sources.is_empty() {
        scene.splats = splats;
    } else {
        if (offset as u64) + (splats.len() as u64) > u64::from(u32::MAX) {
            return Err(SceneError::TooLarge {
                path: path.to_owned(),
                what: format!("{} splats together with the files before it", offset + splats.len()),
                limit: format!("{} splats", u32::MAX),
            });
        }
        let degree = scene.splats.sh_degree.max(splats.sh_degree);
        scene.splats.set_sh_degree(degree);
        splats.set_sh_degree(degree);
        let distance = shift_to(&mut splats, scene.splats.origin);
        if distance > crate::recentre::FAR {
            scene.report.warnings.push(format!(
                "{}: lies {:.0} km from the first file; its details are rounded",
                path.display(),
                distance / 1e3
            ));
        }
        extend(&mut scene.splats, splats);
    }
    scene.report.add(report);
    scene.sources.extend(sources.into_iter().map(|mut source| {
        source.splats = source.splats.start + offset..source.splats.end + offset;
        source
    }));
    Ok(())
}

impl Scene {
    /// Splats of several scenes as those of one, in their order, relative to the first's origin; labels and motion where
    /// any has them.
    pub fn joined(parts: Vec<Splats>) -> Splats {
        let degree = parts.iter().map(|p| p.sh_degree).max().unwrap_or(0);
        let mut parts = parts.into_iter().filter(|p| !p.is_empty());
        let Some(mut all) = parts.next() else { return Splats::zeroed(0, degree, false) };
        all.set_sh_degree(degree);
        let parts: Vec<Splats> = parts.collect();
        reserve(&mut all, parts.iter().map(Splats::len).sum());
        for mut part in parts {
            part.set_sh_degree(degree);
            shift_to(&mut part, all.origin);
            extend(&mut all, part);
        }
        all
    }
}

/// Makes room for so many more splats at once: many small parts would else move all before them, each.
fn reserve(splats: &mut Splats, more: usize) {
    splats.means.reserve_exact(more);
    splats.rotations.reserve_exact(more);
    splats.log_scales.reserve_exact(more);
    splats.opacities.reserve_exact(more);
    splats.sh.reserve_exact(more * crate::sh_coefficients(splats.sh_degree));
    if let Some(labels) = &mut splats.labels {
        labels.reserve_exact(more);
    }
}

/// Expresses the means relative to another origin; returns the distance between the two along the worst axis.
fn shift_to(splats: &mut Splats, origin: [f64; 3]) -> f64 {
    let shift: [f64; 3] = std::array::from_fn(|k| splats.origin[k] - origin[k]);
    splats.origin = origin;
    if shift != [0.0; 3] {
        for mean in &mut splats.means {
            *mean = std::array::from_fn(|k| (f64::from(mean[k]) + shift[k]) as f32);
        }
    }
    shift.iter().fold(0.0, |worst, v| v.abs().max(worst))
}

/// Concatenates, both of one degree and relative to one origin. Every array of `b` is freed as soon as it is copied.
fn extend(a: &mut Splats, b: Splats) {
    fn join<T: Copy>(a: &mut Vec<T>, b: Vec<T>) {
        a.reserve_exact(b.len());
        a.extend_from_slice(&b);
    }
    let (old, added) = (a.len(), b.len());
    let motion = match (a.motion.take(), b.motion) {
        (None, None) => None,
        (x, y) => {
            Some((x.unwrap_or_else(|| Motion::zeroed(old)), y.unwrap_or_else(|| Motion::zeroed(added))))
        }
    };
    a.motion = motion.map(|(mut x, y)| {
        join(&mut x.centers, y.centers);
        join(&mut x.widths, y.widths);
        join(&mut x.polynomials, y.polynomials);
        join(&mut x.omegas, y.omegas);
        x
    });
    a.labels = match (a.labels.take(), b.labels) {
        (None, None) => None,
        (x, y) => {
            let mut x = x.unwrap_or_else(|| vec![0; old]);
            join(&mut x, y.unwrap_or_else(|| vec![0; added]));
            Some(x)
        }
    };
    join(&mut a.means, b.means);
    join(&mut a.rotations, b.rotations);
    join(&mut a.log_scales, b.log_scales);
    join(&mut a.opacities, b.opacities);
    join(&mut a.sh, b.sh);
}
