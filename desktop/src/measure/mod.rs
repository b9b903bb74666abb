//! How alike two pictures are: PSNR, SSIM, FLIP, the worst pixel; over the whole, over classes of a mask, over blocks.
//!
//! One picture is the **reference**, the other the **test**: FLIP's weights and the matching of colours depend on which is
//! which. Both are sRGB-encoded, as shown. Every figure is a mean over a [map](Maps) of the picture, so that what is
//! said of a part is the same quantity as what is said of the whole.

mod colours;
mod flip;
mod mask;
mod matching;
mod picture;
pub mod plots;
mod psnr;
mod ssim;

use std::path::PathBuf;

pub use colours::{ColourMap, coloured};
pub use flip::{DEFAULT_PIXELS_PER_DEGREE, Flip, PIXELS_PER_DEGREE, flip_map};
pub use mask::ClassMask;
pub use matching::{Matching, match_histogram, match_mean};
pub use picture::{MAX_PIXELS, Picture};
pub use psnr::{Worst, psnr, squared_errors, worst};
pub use ssim::{SSIM_WINDOW, SsimMap};

/// Why pictures cannot be read, written or compared.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's word.
        source: std::io::Error,
    },
    /// A file is not a picture that can be used here.
    #[error("{}: {problem}. {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What was found.
        problem: String,
        /// What the user can do.
        remedy: &'static str,
    },
    /// Pixels that make no picture.
    #[error("not a picture: {0}")]
    Pixels(String),
    /// Two pictures, or a picture and a mask, of different sizes.
    #[error("{what} is {} × {} pixels, the reference {} × {}; only pictures of one size can be compared",
        found[0], found[1], expected[0], expected[1])]
    Size {
        /// What does not fit.
        what: &'static str,
        /// Its width and height.
        found: [u32; 2],
        /// The reference's.
        expected: [u32; 2],
    },
    /// A setting out of its range.
    #[error("{0}")]
    Setting(String),
}

/// How to compare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Pixels per degree of the visual field, for FLIP: [`DEFAULT_PIXELS_PER_DEGREE`] is a 4K screen at 0.7 m; a
    /// headset has 18 to 25. Range [`PIXELS_PER_DEGREE`].
    pub pixels_per_degree: f32,
    /// Brings the test's colours near the reference's first.
    pub matching: Option<Matching>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { pixels_per_degree: DEFAULT_PIXELS_PER_DEGREE, matching: None }
    }
}

/// Errors pixel by pixel, by rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Mean over the channels of the squared difference, `0 ..= 1`.
    pub squared_error: Vec<f64>,
    /// Structural similarity; absent where the pictures are smaller than its window.
    pub ssim: Option<SsimMap>,
    /// FLIP error, `0 ..= 1`.
    pub flip: Vec<f32>,
}

/// Figures over some of the pixels.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Region {
    /// Pixels that were counted.
    pub pixels: usize,
    /// Peak signal-to-noise ratio, dB; ∞ (in JSON: null) where nothing differs.
    pub psnr: f64,
    /// Mean structural similarity (whole windows inside the picture only); absent where no window lies in the region.
    pub ssim: Option<f64>,
    /// Mean FLIP error, `0 ..= 1`.
    pub flip: f64,
}

/// All figures of a pair of pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Over the whole picture.
    pub whole: Region,
    /// FLIP in the form of its own tool.
    pub flip: Flip,
    /// The pixel that differs most.
    pub worst: Worst,
    /// What the figures are means of.
    pub maps: Maps,
}

/// Compares a test picture with a reference.
///
/// # Errors
/// Where the sizes differ or a setting is out of its range.
pub fn compare(reference: &Picture, test: &Picture, settings: &Settings) -> Result<Comparison, MeasureError> {
    same_size("the test picture", reference.size(), test.size())?;
    let matched;
    let test = match settings.matching {
        None => test,
        Some(matching) => {
            matched = matching.apply(reference, test);
            &matched
        }
    };
    let maps = Maps {
        size: reference.size(),
        squared_error: squared_errors(reference, test),
        ssim: SsimMap::new(reference, test),
        flip: flip_map(reference, test, settings.pixels_per_degree)?,
    };
    let whole = maps.region(|_, _| true).ok_or_else(|| MeasureError::Pixels("no pixels".to_owned()))?;
    Ok(Comparison { whole, flip: Flip::of_map(&maps.flip), worst: worst(reference, test), maps })
}

fn same_size(what: &'static str, expected: [u32; 2], found: [u32; 2]) -> Result<(), MeasureError> {
    if expected == found { Ok(()) } else { Err(MeasureError::Size { what, found, expected }) }
}

impl Maps {
    /// Figures over the pixels that a predicate of column and row picks; `None` where it picks none.
    pub fn region(&self, contains: impl Fn(u32, u32) -> bool) -> Option<Region> {
        let width = self.size[0] as usize;
        let (mut pixels, mut error, mut flip) = (0usize, 0.0, 0.0);
        for (i, (&e, &f)) in self.squared_error.iter().zip(&self.flip).enumerate() {
            if contains((i % width) as u32, (i / width) as u32) {
                pixels += 1;
                error += e;
                flip += f64::from(f);
            }
        }
        (pixels > 0).then(|| Region {
            pixels,
            psnr: psnr(error / pixels as f64),
            ssim: self.ssim.as_ref().and_then(|s| s.mean(&contains)),
            flip: flip / pixels as f64,
        })
    }

    /// Figures per class of a mask, in the order of the classes that occur.
    ///
    /// # Errors
    /// Where the mask has another size.
    pub fn by_class(&self, mask: &ClassMask) -> Result<Vec<(u8, Region)>, MeasureError> {
        same_size("the mask", self.size, mask.size())?;
        Ok((0..=u8::MAX).filter_map(|c| Some((c, self.region(|x, y| mask.class(x, y) == c)?))).collect())
    }

    /// Figures per block of a grid, by rows. Blocks differ by a pixel in size where the grid does not divide the picture.
    ///
    /// # Errors
    /// Where the grid is empty or finer than the pixels.
    pub fn by_block(&self, columns: u32, rows: u32) -> Result<Vec<Region>, MeasureError> {
        let [w, h] = self.size;
        if !(1..=w).contains(&columns) || !(1..=h).contains(&rows) {
            return Err(MeasureError::Setting(format!(
                "{columns} × {rows} blocks do not fit into {w} × {h} pixels; at least one, at most one per pixel"
            )));
        }
        let edge = |i: u32, n: u32, size: u32| (u64::from(i) * u64::from(size) / u64::from(n)) as u32;
        let mut blocks = Vec::new();
        for row in 0..rows {
            for column in 0..columns {
                let xs = edge(column, columns, w)..edge(column + 1, columns, w);
                let ys = edge(row, rows, h)..edge(row + 1, rows, h);
                blocks.extend(self.region(|x, y| xs.contains(&x) && ys.contains(&y)));
            }
        }
        Ok(blocks)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Two deterministic test pictures with gradients, edges and noise; the script in the tests of `ssim` makes the same.
    pub(crate) fn pair(width: u32, height: u32) -> (Picture, Picture) {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for y in 0..height {
            for x in 0..width {
                for c in 0..3u32 {
                    let base = (x * 3 + y * 2 + c * 40) % 200 + if (x / 8 + y / 8) % 2 == 0 { 40 } else { 0 };
                    let noise = (x * 7919 + y * 104_729 + c * 1_299_709) % 31;
                    a.push(base.min(255) as u8);
                    b.push((base * 9 / 10 + noise).min(255) as u8);
                }
            }
        }
        (Picture::from_rgb8([width, height], &a).unwrap(), Picture::from_rgb8([width, height], &b).unwrap())
    }

    #[test]
    fn identical_pictures_have_no_error() {
        let (a, b) = pair(40, 30);
        let same = compare(&a, &a, &Settings::default()).unwrap();
        assert_eq!(same.whole, Region { pixels: 1200, psnr: f64::INFINITY, ssim: Some(1.0), flip: 0.0 });
        assert_eq!((same.flip.mean, same.flip.max, same.flip.weighted_median), (0.0, 0.0, 0.0));
        assert_eq!(same.worst.difference, 0.0);
        // Control.
        let other = compare(&a, &b, &Settings::default()).unwrap();
        assert!(other.whole.psnr < 40.0 && other.whole.ssim.unwrap() < 0.99 && other.whole.flip > 0.01);
    }

    #[test]
    fn parts_add_up_to_the_whole() {
        let (a, b) = pair(50, 37);
        let maps = compare(&a, &b, &Settings::default()).unwrap().maps;
        let whole = maps.region(|_, _| true).unwrap();
        for parts in [
            maps.by_block(4, 3).unwrap(),
            maps.by_class(
                &ClassMask::new([50, 37], (0..50 * 37).map(|i| (i % 7 + i / 400) as u8).collect()).unwrap(),
            )
            .unwrap()
            .into_iter()
            .map(|(_, r)| r)
            .collect(),
        ] {
            assert!(parts.len() > 6);
            assert_eq!(parts.iter().map(|p| p.pixels).sum::<usize>(), 50 * 37);
            let mean = |value: fn(&Region) -> f64| {
                parts.iter().map(|p| value(p) * p.pixels as f64).sum::<f64>() / whole.pixels as f64
            };
            assert!((mean(|p| p.flip) - whole.flip).abs() < 1e-9);
            assert!((psnr(mean(|p| 10f64.powf(-p.psnr / 10.0))) - whole.psnr).abs() < 1e-9);
        }
    }

    #[test]
    fn a_class_sees_only_its_own_errors() {
        let (a, _) = pair(40, 40);
        let mut damaged: Vec<[f32; 3]> = a.pixels().to_vec();
        for y in 0..40 {
            for x in 0..20 {
                damaged[y * 40 + x] = [0.0; 3];
            }
        }
        let damaged = Picture::new([40, 40], damaged).unwrap();
        let mask =
            ClassMask::new([40, 40], (0..1600).map(|i| if i % 40 < 20 { 3 } else { 9 }).collect()).unwrap();
        let classes = compare(&a, &damaged, &Settings::default()).unwrap().maps.by_class(&mask).unwrap();
        assert_eq!(classes.iter().map(|c| c.0).collect::<Vec<_>>(), [3, 9]);
        assert!(classes[0].1.psnr < 10.0 && classes[0].1.ssim.unwrap() < 0.5);
        assert_eq!(classes[1].1.psnr, f64::INFINITY);
        // Windows of the SSIM reach five pixels over the border.
        assert!(classes[1].1.ssim.unwrap() > 0.7);
    }

    #[test]
    fn misfits_are_refused_by_name() {
        let (a, _) = pair(20, 20);
        let (b, _) = pair(20, 21);
        let error = compare(&a, &b, &Settings::default()).unwrap_err().to_string();
        assert_eq!(
            error,
            "the test picture is 20 × 21 pixels, the reference 20 × 20; only pictures of one size can be compared"
        );
        let maps = compare(&a, &a, &Settings::default()).unwrap().maps;
        assert!(maps.by_class(&ClassMask::new([1, 1], vec![0]).unwrap()).is_err());
        assert!(
            maps.by_block(0, 1).is_err() && maps.by_block(21, 1).is_err() && maps.by_block(20, 20).is_ok()
        );
        for bad in [f32::NAN, 0.0, -5.0, f32::INFINITY, 1e6] {
            let settings = Settings { pixels_per_degree: bad, ..Settings::default() };
            assert!(matches!(compare(&a, &a, &settings), Err(MeasureError::Setting(_))), "{bad}");
        }
        // Smaller than its window, a picture has no SSIM, but everything else.
        let (small, _) = pair(10, 30);
        assert_eq!(compare(&small, &small, &Settings::default()).unwrap().whole.ssim, None);
    }
}
