//! From pixels to splats.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::container::Place;
use super::image::Image;
use super::meta::{
    CENTROIDS, LABELS, Layout, MEANS_HIGH, MEANS_LOW, PALETTE_ROW, Palette, QUATS, SCALES, SH0, Table,
};
use crate::{SceneError, Splats, sh_coefficients};

/// Where splats go: equally long pieces of [`Splats`]' arrays, all zero.
pub(in crate::formats) struct Target<'a> {
    pub(in crate::formats) means: &'a mut [[f32; 3]],
    pub(in crate::formats) rotations: &'a mut [[f32; 4]],
    pub(in crate::formats) log_scales: &'a mut [[f32; 3]],
    pub(in crate::formats) opacities: &'a mut [f32],
    pub(in crate::formats) sh: &'a mut [[f32; 3]],
    /// Degree of `sh`, at least that of what is unpacked: the coefficients beyond stay zero.
    pub(in crate::formats) sh_degree: u8,
}

impl<'a> Target<'a> {
    /// All of them.
    pub(in crate::formats) fn of(splats: &'a mut Splats) -> Self {
        Self {
            means: &mut splats.means,
            rotations: &mut splats.rotations,
            log_scales: &mut splats.log_scales,
            opacities: &mut splats.opacities,
            sh: &mut splats.sh,
            sh_degree: splats.sh_degree,
        }
    }
}

/// Splats per unit of work.
const CHUNK: usize = 1 << 13;

/// Turns decoded images into splats.
pub(super) fn unpack(
    place: &Place,
    layout: &Layout,
    images: &[Image],
    target: Target<'_>,
) -> Result<(), SceneError> {
    let [low, high, scales, quats, sh0, higher @ ..] = images else {
        return Err(place.wrong("meta.json", "the images", "are too few", "Export the scene again"));
    };
    debug_assert_eq!([MEANS_LOW, MEANS_HIGH, SCALES, QUATS, SH0, CENTROIDS, LABELS], [0, 1, 2, 3, 4, 5, 6]);
    let higher = match (&layout.palette, higher) {
        (Some(palette), [centroids, labels]) => Some((decode_palette(palette, centroids), palette, labels)),
        _ => None,
    };
    let stride = sh_coefficients(target.sh_degree);
    let bad_label = AtomicU32::new(u32::MAX);
    let axis: [Axis; 3] = std::array::from_fn(|k| Axis::new(layout.mins[k], layout.maxs[k]));
    (
        target.means.par_chunks_mut(CHUNK),
        target.rotations.par_chunks_mut(CHUNK),
        target.log_scales.par_chunks_mut(CHUNK),
        target.opacities.par_chunks_mut(CHUNK),
        target.sh.par_chunks_mut(CHUNK * stride),
    )
        .into_par_iter()
        .enumerate()
        .for_each(|(chunk, (means, rotations, log_scales, opacities, sh))| {
            let first = chunk * CHUNK;
            for (i, mean) in means.iter_mut().enumerate() {
                let (l, h) = (low.pixel(first + i), high.pixel(first + i));
                *mean = std::array::from_fn(|k| axis[k].value(u16::from_le_bytes([l[k], h[k]])));
            }
            for (i, rotation) in rotations.iter_mut().enumerate() {
                *rotation = quaternion(quats.pixel(first + i));
            }
            for (i, log_scale) in log_scales.iter_mut().enumerate() {
                *log_scale = look_up(&layout.scales, scales.pixel(first + i));
            }
            for (i, (opacity, sh)) in opacities.iter_mut().zip(sh.chunks_exact_mut(stride)).enumerate() {
                let pixel = sh0.pixel(first + i);
                *opacity = layout.opacity[usize::from(pixel[3])];
                let Some((constant, rest)) = sh.split_first_mut() else { continue };
                *constant = look_up(&layout.sh0, pixel);
                if let Some((values, palette, labels)) = &higher {
                    let [low, high, ..] = labels.pixel(first + i);
                    let label = usize::from(u16::from_le_bytes([low, high]));
                    let n = palette.coefficients;
                    match values.get(label * n..(label + 1) * n) {
                        Some(entry) => rest[..n].copy_from_slice(entry),
                        None => bad_label.store(label as u32, Ordering::Relaxed),
                    }
                }
            }
        });
    match bad_label.into_inner() {
        u32::MAX => Ok(()),
        label => Err(place.wrong(
            &layout.files().get(LABELS).map(|name| (*name).to_owned()).unwrap_or_default(),
            "the image",
            format!(
                "refers to entry {label} of a palette of {}",
                layout.palette.as_ref().map_or(0, |palette| palette.count)
            ),
            "It is damaged, or belongs to another scene: export the scene again",
        )),
    }
}

/// The palette's values, [`Palette::coefficients`] per entry.
fn decode_palette(palette: &Palette, centroids: &Image) -> Vec<[f32; 3]> {
    let (n, width) = (palette.coefficients, centroids.width as usize);
    debug_assert!(palette.count.div_ceil(PALETTE_ROW) <= centroids.height as usize);
    let mut values = vec![[0.0; 3]; palette.count * n];
    values.par_chunks_mut(PALETTE_ROW * n).enumerate().for_each(|(row, values)| {
        for (column, value) in values.iter_mut().enumerate() {
            let [r, g, b, _] = centroids.pixel(row * width + column);
            *value = [r, g, b].map(|byte| palette.table[usize::from(byte)]);
        }
    });
    values
}

/// One axis of the means: 16 bits between two values of `sign(x) ln(1 + |x|)`.
struct Axis {
    min: f64,
    span: f64,
}

impl Axis {
    fn new(min: f64, max: f64) -> Self {
        // An axis without extent is written with equal ends; readers of the format then take a span of one.
        let span = if max == min { 1.0 } else { max - min };
        Self { min, span }
    }

    fn value(&self, bits: u16) -> f32 {
        let v = self.min + self.span * (f64::from(bits) / 65535.0);
        v.abs().exp_m1().copysign(v) as f32
    }
}

fn look_up(tables: &[Table; 3], pixel: [u8; 4]) -> [f32; 3] {
    std::array::from_fn(|k| tables[k][usize::from(pixel[k])])
}

/// Three components times √2 in a byte each, and which one is left out. A tag that names none gives the zero
/// quaternion, which is dropped and counted later.
fn quaternion([a, b, c, tag]: [u8; 4]) -> [f32; 4] {
    let [a, b, c] =
        [a, b, c].map(|byte| (f32::from(byte) / 255.0 * 2.0 - 1.0) * std::f32::consts::FRAC_1_SQRT_2);
    let largest = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    // Stored in the order (w, x, y, z).
    match tag {
        252 => [a, b, c, largest],
        253 => [largest, b, c, a],
        254 => [b, largest, c, a],
        255 => [b, c, largest, a],
        _ => [0.0; 4],
    }
}
