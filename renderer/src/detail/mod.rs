//! Detail where it counts: which splats make the pictures, which class they belong to, and scenes with fewer of them.
//!
//! Everything rests on one quantity, a splat's **visible blending weight** at a pixel, `T α` of volume rendering: its
//! share of the pixel's colour. The reference renderer hands it over layer by layer ([`crate::reference::trace`]), so
//! what is said here holds for the very pictures that the reference makes. Sums over pixels are kept in fixed point: they
//! are the same on every run, in whatever order threads finish.
//!
//! * [`Census`]: what each splat gives to pictures from many views.
//! * [`mark`]: what a region of a picture shows.
//! * [`vote`]: from classes of pixels to classes of splats.
//! * [`recording`]: the layers of many pictures, kept for [`refit`].
//! * [`parasites`], [`merge`], [`refit`], and [`simplify()`], which uses them: scenes that look the same with less.

pub mod mark;
pub mod merge;
pub mod parasites;
pub mod recording;
pub mod refit;
mod simplify;
mod sums;
mod visible;
pub mod vote;

pub use simplify::{Done, Rank, Simplify, lowest_first, opacity_cut, simplify};
pub use visible::{Census, Importance};

#[cfg(test)]
pub(crate) mod tests {
    use glam::DVec3;
    use motes_scenes::{SH_C0, Splats};

    use crate::{Fov, View};

    /// A view along +z from the origin of a 32 × 32 picture, 53° wide.
    pub(crate) fn ahead() -> View {
        let fov = Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 };
        View::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov, [32, 32])
    }

    /// Round splats of degree 0: mean, standard deviation, opacity, colour.
    pub(crate) fn balls(list: &[([f32; 3], f32, f32, [f32; 3])]) -> Splats {
        let mut splats = Splats::zeroed(list.len(), 0, false);
        for (i, &(mean, deviation, opacity, colour)) in list.iter().enumerate() {
            splats.means[i] = mean;
            splats.rotations[i] = [0.0, 0.0, 0.0, 1.0];
            splats.log_scales[i] = [deviation.ln(); 3];
            splats.opacities[i] = opacity;
            splats.sh[i] = colour.map(|c| (c - 0.5) / SH_C0);
        }
        splats
    }
}
