//! Scenes far from their origin: an f32 resolves 1 mm at 10 km and 6 cm at 1000 km, too coarse for a splat.

use crate::Splats;

/// Distance of a scene's centre from the origin, metres along any axis, from which it is recentred.
pub(crate) const FAR: f64 = 1e4;

/// How many splats are asked for the centre.
pub(crate) const SAMPLES: usize = 1023;

/// Moves a far scene to its centre and says so in [`Splats::origin`]; leaves others as they are.
/// A reader that sees the means in f64 does it before rounding them ([`centre`]) and sets `origin` itself.
pub(crate) fn recentre(splats: &mut Splats) {
    let step = splats.len().div_ceil(SAMPLES).max(1);
    let shift = centre(splats.means.iter().step_by(step).map(|m| m.map(f64::from)));
    if shift == [0.0; 3] {
        return;
    }
    for mean in &mut splats.means {
        *mean = std::array::from_fn(|k| (f64::from(mean[k]) - shift[k]) as f32);
    }
    splats.origin = std::array::from_fn(|k| splats.origin[k] + shift[k]);
}

/// The origin for a scene of which these means are a sample: their median, rounded to whole metres, where that
/// is [`FAR`]; else zero. The median, because a few splats fly off to anywhere in most trained scenes.
pub(crate) fn centre(samples: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let mut samples: Vec<[f64; 3]> =
        samples.filter(|m| m.iter().all(|v| v.abs() <= f64::from(crate::MAX_LENGTH))).collect();
    if samples.is_empty() {
        return [0.0; 3];
    }
    let middle = samples.len() / 2;
    let median: [f64; 3] = std::array::from_fn(|k| {
        let (_, m, _) = samples.select_nth_unstable_by(middle, |a, b| a[k].total_cmp(&b[k]));
        m[k].round()
    });
    if median.iter().any(|v| v.abs() > FAR) { median } else { [0.0; 3] }
}
