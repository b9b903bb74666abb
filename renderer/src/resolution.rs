//! Which pixels a frame of reduced resolution renders. Twin: shaders/glsl/interleaved.glsl.
//!
//! Bilinear: both sides shrink, every rendered pixel samples its centre, and the low-pass filter is that of the rendered
//! pixels. Interleaved (after Keller and Heidrich 2001): only the columns shrink. Each row is cut into as many cells
//! as it has rendered pixels, and a rendered pixel samples the centre of one of the shown pixels in its cell: which one
//! differs from row to row, and from frame to frame in the temporal form. A share of the shown pixels is therefore
//! exactly what full resolution would show, and the low-pass filter is that of the shown pixels.
//! At `1/√2` each cell holds two pixels, and the samples are a checkerboard.

use crate::config::{RenderConfig, Upscale};

/// Frames after which the samples' places come round again.
pub const CYCLE: u32 = 8;
/// Fixed point of [`Resolution::pitch`].
const ONE: u32 = 1 << 16;
/// Interleaved scales this near to `1/√2` become it: the checkerboard is worth the 2 % of pixels.
const CHECKERBOARD_SNAP: f32 = 0.0075;

/// Where in its pixel a sample lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum Sampling {
    /// At the centre.
    Centers = 0,
    /// At one of the shown pixels in its cell.
    Interleaved = 1,
    /// The same where every cell holds two: samples are a checkerboard.
    Checkerboard = 2,
}

/// What is rendered of what is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// Width and height of the shown image, pixels.
    pub shown: [u32; 2],
    /// Width and height of the rendered image, pixels.
    pub rendered: [u32; 2],
    /// Where in its pixel a sample lies.
    pub sampling: Sampling,
    /// Interleaved: shown columns per rendered column, 16.16 fixed point.
    pub pitch: u32,
    /// Interleaved: place in the cycle, `0 .. CYCLE`.
    pub step: u32,
}

impl Resolution {
    /// What a configuration renders of an image, at one step of the temporal form's cycle.
    pub fn of(config: &RenderConfig, shown: [u32; 2], step: u32) -> Self {
        let scale = config.resolution_scale.clamp(0.5, 1.0);
        let whole = Self { shown, rendered: shown, sampling: Sampling::Centers, pitch: ONE, step: 0 };
        if !(scale < 1.0) {
            return whole;
        }
        if config.upscale == Upscale::Bilinear {
            let side = |s: u32| ((s as f32 * scale).round() as u32).max(1);
            return Self { rendered: shown.map(side), ..whole };
        }
        let checkerboard = (scale - std::f32::consts::FRAC_1_SQRT_2).abs() <= CHECKERBOARD_SNAP;
        let pitch =
            if checkerboard { 2 * ONE } else { (f64::from(ONE) / f64::from(scale).powi(2)).round() as u32 };
        // The least number of cells that covers a row.
        let columns = ((u64::from(shown[0]) * u64::from(ONE) - u64::from(ONE / 2)).div_ceil(pitch.into()))
            .max(1) as u32;
        Self {
            rendered: [columns, shown[1]],
            sampling: if pitch == 2 * ONE { Sampling::Checkerboard } else { Sampling::Interleaved },
            pitch,
            step: if config.upscale == Upscale::InterleavedTemporal { step % CYCLE } else { 0 },
            ..whole
        }
    }

    /// Whether samples lie beside the centres of their pixels.
    pub fn interleaved(&self) -> bool {
        self.sampling != Sampling::Centers
    }

    /// Whether fewer pixels are rendered than shown.
    pub fn reduced(&self) -> bool {
        self.rendered != self.shown
    }

    /// The image that the rendered pixels cover, in shown pixels: a last cell may reach beyond the shown image.
    pub fn covered(&self) -> [f64; 2] {
        match self.sampling {
            Sampling::Centers => self.shown.map(f64::from),
            Sampling::Interleaved | Sampling::Checkerboard => {
                let width = f64::from(self.rendered[0]) * f64::from(self.pitch) / f64::from(ONE);
                [width, f64::from(self.shown[1])]
            }
        }
    }

    /// First shown column of a cell.
    pub fn cell_begin(&self, cell: u32) -> u32 {
        ((u64::from(cell) * u64::from(self.pitch) + u64::from(ONE / 2)) >> 16) as u32
    }

    /// The cell of a shown column.
    pub fn cell_of(&self, column: u32) -> u32 {
        ((u64::from(column + 1) * u64::from(ONE) - u64::from(ONE / 2) - 1) / u64::from(self.pitch)) as u32
    }

    /// The shown column that a rendered pixel samples. Rows follow each other as a checkerboard does; in eight
    /// frames every column of a cell of up to four is sampled.
    pub fn sample_column(&self, cell: u32, row: u32) -> u32 {
        let begin = self.cell_begin(cell);
        let count = self.cell_begin(cell + 1) - begin;
        let t = self.step;
        let eighths = 4 * ((row + t) & 1) + 2 * (((row >> 1) + (t >> 1)) & 1) + ((t >> 2) & 1);
        begin + ((eighths * count) >> 3)
    }

    /// How far a sample lies to the right of its rendered pixel's centre, rendered pixels.
    pub fn offset(&self, cell: u32, row: u32) -> f64 {
        let pitch = f64::from(self.pitch) / f64::from(ONE);
        (f64::from(self.sample_column(cell, row)) + 0.5) / pitch - (f64::from(cell) + 0.5)
    }

    /// A bound of the distance between samples and their rendered pixels' centres, shown pixels. Polygons grow by it.
    pub fn largest_offset(&self) -> f64 {
        match self.sampling {
            Sampling::Centers => 0.0,
            Sampling::Interleaved | Sampling::Checkerboard => {
                let pitch = f64::from(self.pitch) / f64::from(ONE);
                let uneven = if self.pitch.is_multiple_of(ONE) { 0.0 } else { 0.5 };
                0.5 * (pitch - 1.0) + uneven
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolution(scale: f32, upscale: Upscale, shown: [u32; 2], step: u32) -> Resolution {
        let config = RenderConfig { resolution_scale: scale, upscale, ..Default::default() };
        Resolution::of(&config, shown, step)
    }

    #[test]
    fn at_half_the_pixels_samples_are_a_checkerboard() {
        for scale in [0.7, 0.707, std::f32::consts::FRAC_1_SQRT_2] {
            let r = resolution(scale, Upscale::Interleaved, [33, 8], 0);
            assert_eq!(r.rendered, [17, 8]);
            for row in 0..8 {
                for cell in 0..17 {
                    assert_eq!(r.sample_column(cell, row), 2 * cell + (row & 1));
                    assert_eq!(r.offset(cell, row), if row & 1 == 0 { -0.25 } else { 0.25 });
                }
            }
            assert_eq!(r.largest_offset(), 0.5);
        }
        // Control: a little beside, cells of three turn up.
        let r = resolution(0.69, Upscale::Interleaved, [200, 8], 0);
        assert!((0..r.rendered[0]).any(|c| r.cell_begin(c + 1) - r.cell_begin(c) == 3));
    }

    #[test]
    fn cells_tile_a_row_and_eight_frames_sample_every_pixel() {
        for percent in 50..100 {
            for width in [1, 2, 7, 64, 641] {
                let at =
                    |step| resolution(percent as f32 / 100.0, Upscale::InterleavedTemporal, [width, 8], step);
                let r = at(0);
                let n = r.rendered[0];
                assert!(r.cell_begin(n) >= width && r.cell_begin(n - 1) < width, "{percent} % of {width}");
                assert!(r.covered()[0] >= f64::from(width) - 0.5);
                for row in 0..8 {
                    let mut seen = vec![false; width as usize];
                    for step in 0..CYCLE {
                        let r = at(step);
                        for cell in 0..n {
                            let x = r.sample_column(cell, row);
                            assert!((r.cell_begin(cell)..r.cell_begin(cell + 1)).contains(&x));
                            assert_eq!(r.cell_of(x), cell, "{percent} %, column {x}");
                            assert!(
                                r.offset(cell, row).abs() * f64::from(r.pitch) / 65536.0
                                    <= r.largest_offset() + 1e-9
                            );
                            if let Some(s) = seen.get_mut(x as usize) {
                                *s = true;
                            }
                        }
                    }
                    assert!(seen.iter().all(|&s| s), "{percent} % of {width}, row {row}");
                }
            }
        }
        // Control: one frame does not.
        let r = resolution(0.5, Upscale::Interleaved, [64, 8], 0);
        assert_eq!(r.rendered, [16, 8]);
    }

    #[test]
    fn bilinear_shrinks_both_sides_and_full_size_neither() {
        assert_eq!(resolution(0.5, Upscale::Bilinear, [640, 481], 0).rendered, [320, 241]);
        for upscale in [Upscale::Bilinear, Upscale::Interleaved] {
            let r = resolution(1.0, upscale, [640, 480], 3);
            assert!(!r.reduced() && r.sampling == Sampling::Centers);
        }
    }
}
