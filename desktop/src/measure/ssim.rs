//! Structural similarity (Wang et al. 2004) with an 11 × 11 Gaussian window of σ 1.5, `K1 = 0.01`, `K2 = 0.03`, population
//! covariances; per channel, then the mean over the channels.

use rayon::prelude::*;

use super::Picture;

/// Side of the window, pixels: the Gaussian ends at 3.5 σ.
pub const SSIM_WINDOW: u32 = 11;

const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Similarity around every pixel, mean over the channels, `−1 ..= 1`.
#[derive(Clone, Debug, PartialEq)]
pub struct SsimMap {
    size: [u32; 2],
    values: Vec<f64>,
}

impl SsimMap {
    /// Of two pictures of one size; `None` where they are smaller than the window.
    pub fn new(a: &Picture, b: &Picture) -> Option<Self> {
        let size = a.size();
        if size != b.size() || size[0] < SSIM_WINDOW || size[1] < SSIM_WINDOW {
            return None;
        }
        let channels: Vec<Vec<f64>> = (0..3).into_par_iter().map(|c| channel(a, b, c)).collect();
        let values =
            (0..channels[0].len()).map(|i| channels.iter().map(|c| c[i]).sum::<f64>() / 3.0).collect();
        Some(Self { size, values })
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Similarity around every pixel, by rows. Within 5 pixels of the border the picture is continued by reflection.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Mean over the pixels that a predicate of column and row picks and whose whole window lies inside the picture;
    /// `None` where there are none.
    pub fn mean(&self, contains: impl Fn(u32, u32) -> bool) -> Option<f64> {
        let border = SSIM_WINDOW / 2;
        let (mut sum, mut count) = (0.0, 0usize);
        for y in border..self.size[1] - border {
            for x in border..self.size[0] - border {
                if contains(x, y) {
                    sum += self.values[y as usize * self.size[0] as usize + x as usize];
                    count += 1;
                }
            }
        }
        (count > 0).then(|| sum / count as f64)
    }
}

fn channel(a: &Picture, b: &Picture, c: usize) -> Vec<f64> {
    let plane = |f: &dyn Fn(f64, f64) -> f64| {
        let values =
            a.pixels().iter().zip(b.pixels()).map(|(p, q)| f(f64::from(p[c]), f64::from(q[c]))).collect();
        blurred(values, a.size())
    };
    let (ua, ub) = (plane(&|p, _| p), plane(&|_, q| q));
    let (aa, bb, ab) = (plane(&|p, _| p * p), plane(&|_, q| q * q), plane(&|p, q| p * q));
    (0..ua.len())
        .map(|i| {
            let (va, vb, vab) = (aa[i] - ua[i] * ua[i], bb[i] - ub[i] * ub[i], ab[i] - ua[i] * ub[i]);
            let numerator = (2.0 * ua[i] * ub[i] + C1) * (2.0 * vab + C2);
            let denominator = (ua[i] * ua[i] + ub[i] * ub[i] + C1) * (va + vb + C2);
            numerator / denominator
        })
        .collect()
}

/// Gaussian blur along rows, then columns; beyond the border the values are reflected (`c b a | a b c`).
fn blurred(values: Vec<f64>, size: [u32; 2]) -> Vec<f64> {
    let radius = SSIM_WINDOW as isize / 2;
    let weights: Vec<f64> = (-radius..=radius).map(|x| (-0.5 * (x as f64 / SIGMA).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let [width, height] = size.map(|s| s as isize);
    let reflect = |i: isize, n: isize| {
        if i < 0 {
            -1 - i
        } else if i >= n {
            2 * n - 1 - i
        } else {
            i
        }
    };
    let pass = |values: &[f64], dx: isize, dy: isize| -> Vec<f64> {
        let mut out = Vec::with_capacity(values.len());
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                for (k, w) in (-radius..=radius).zip(&weights) {
                    let (sx, sy) = (reflect(x + k * dx, width), reflect(y + k * dy, height));
                    sum += w * values[(sy * width + sx) as usize];
                }
                out.push(sum / total);
            }
        }
        out
    };
    pass(&pass(&values, 1, 0), 0, 1)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::tests::pair;
    use super::super::{Matching, Settings, compare};
    use super::*;

    /// Against scikit-image 0.26. The values are printed by this script:
    /// ```python
    /// import numpy as np
    /// from skimage.metrics import structural_similarity, peak_signal_noise_ratio
    /// from skimage.exposure import match_histograms
    /// def pair(w, h):
    ///     y, x, c = np.mgrid[0:h, 0:w, 0:3]
    ///     base = (x * 3 + y * 2 + c * 40) % 200 + np.where((x // 8 + y // 8) % 2 == 0, 40, 0)
    ///     noise = (x * 7919 + y * 104729 + c * 1299709) % 31
    ///     return (np.minimum(base, 255).astype(np.uint8),
    ///             np.minimum(base * 9 // 10 + noise, 255).astype(np.uint8))
    /// def ssim(a, b):
    ///     return structural_similarity(a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    ///                                  channel_axis=2, data_range=255, full=True)
    /// for w, h in [(64, 48), (97, 61)]:
    ///     a, b = pair(w, h)
    ///     s, full = ssim(a, b)
    ///     mh = match_histograms(b.astype(float), a.astype(float), channel_axis=2)
    ///     mm = np.clip((b - b.mean((0, 1))) / b.std((0, 1)) * a.std((0, 1)) + a.mean((0, 1)), 0, 255)
    ///     psnr = lambda m: peak_signal_noise_ratio(a / 255, m / 255, data_range=1)
    ///     print(psnr(b), s, full.mean(2)[5:h-5, 5:w//2].mean(), full.mean(2)[0, 0], psnr(mh), psnr(mm))
    /// ```
    #[test]
    fn agrees_with_scikit_image() {
        let expected = [
            ([64, 48], [27.186_262, 0.870_036_6, 0.867_610_8, 0.559_203_5, 28.383_924, 28.299_674]),
            ([97, 61], [27.279_116, 0.864_686_7, 0.869_140_8, 0.559_203_5, 28.394_782, 28.300_049]),
        ];
        for ([w, h], [psnr, ssim, left, corner, histogram, mean]) in expected {
            let (a, b) = pair(w, h);
            let figures = |matching| compare(&a, &b, &Settings { matching, ..Settings::default() }).unwrap();
            let plain = figures(None);
            assert!((plain.whole.psnr - psnr).abs() < 1e-4, "{} {psnr}", plain.whole.psnr);
            assert!((plain.whole.ssim.unwrap() - ssim).abs() < 1e-6, "{:?} {ssim}", plain.whole.ssim);
            let map = plain.maps.ssim.unwrap();
            let masked = map.mean(|x, _| x < w / 2).unwrap();
            assert!((masked - left).abs() < 1e-6, "{masked} {left}");
            assert!((map.values()[0] - corner).abs() < 1e-6, "{} {corner}", map.values()[0]);
            assert!((figures(Some(Matching::Histogram)).whole.psnr - histogram).abs() < 1e-3);
            assert!((figures(Some(Matching::Mean)).whole.psnr - mean).abs() < 1e-3);
            // Control: the window and the constants matter at this precision.
            assert!((masked - ssim).abs() > 1e-3);
        }
    }

    #[test]
    fn falls_with_noise_and_tells_structure_from_tone() {
        let (a, _) = pair(40, 40);
        let noisy = |strength: f32| {
            let mut i = 0u32;
            let picture = a.mapped(|p| *p);
            let pixels = picture.pixels().iter().map(|p| {
                i = i.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                p.map(|v| v + strength * ((i >> 8) as f32 / 16_777_216.0 - 0.5))
            });
            let noisy = Picture::new([40, 40], pixels.collect()).unwrap();
            SsimMap::new(&a, &noisy).unwrap().mean(|_, _| true).unwrap()
        };
        assert!(
            noisy(0.0) == 1.0 && noisy(0.05) < 1.0 && noisy(0.2) < noisy(0.05) && noisy(0.6) < noisy(0.2)
        );
        let negative = a.mapped(|p| p.map(|v| 1.0 - v));
        assert!(SsimMap::new(&a, &negative).unwrap().mean(|_, _| true).unwrap() < 0.0);
    }

    #[test]
    fn too_small_pictures_have_none() {
        let (a, b) = pair(10, 40);
        assert_eq!(SsimMap::new(&a, &b), None);
        let (a, b) = pair(11, 11);
        let map = SsimMap::new(&a, &b).unwrap();
        assert_eq!((map.size(), map.values().len()), ([11, 11], 121));
        assert!(map.mean(|x, y| (x, y) == (5, 5)).is_some() && map.mean(|x, _| x != 5).is_none());
    }
}
