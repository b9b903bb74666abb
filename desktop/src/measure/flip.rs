//! FLIP (Andersson et al. 2020): the error that a person sees when two pictures are shown in turn.

use std::ops::RangeInclusive;

use super::{MeasureError, Picture};

/// Pixels per degree of FLIP's own tool, 67.02: 3840 pixels on 0.7 m, seen from 0.7 m.
pub const DEFAULT_PIXELS_PER_DEGREE: f32 = 3840.0 * std::f32::consts::PI / 180.0;

/// Pixels per degree that make sense: filters grow with them.
pub const PIXELS_PER_DEGREE: RangeInclusive<f32> = 1.0..=500.0;

/// FLIP errors of a picture, pooled as its own tool does.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Flip {
    /// Mean error, the authors' choice where one number must do.
    pub mean: f64,
    /// Half of the sum of all errors comes from pixels with errors up to this.
    pub weighted_median: f64,
    /// The same for a quarter and three quarters of the sum.
    pub weighted_quartiles: [f64; 2],
    /// Smallest error.
    pub min: f64,
    /// Largest error.
    pub max: f64,
}

/// FLIP error per pixel, `0 ..= 1`, by rows. Works on 8-bit values; both pictures have one size.
///
/// # Errors
/// Where the pixels per degree are out of [`PIXELS_PER_DEGREE`], or the sizes differ.
pub fn flip_map(
    reference: &Picture,
    test: &Picture,
    pixels_per_degree: f32,
) -> Result<Vec<f32>, MeasureError> {
    if !PIXELS_PER_DEGREE.contains(&pixels_per_degree) {
        return Err(MeasureError::Setting(format!(
            "pixels per degree are {pixels_per_degree}; they can be {} to {}",
            PIXELS_PER_DEGREE.start(),
            PIXELS_PER_DEGREE.end()
        )));
    }
    super::same_size("the test picture", reference.size(), test.size())?;
    let image = |p: &Picture| nv_flip::FlipImageRgb8::with_data(p.size()[0], p.size()[1], &p.to_rgb8());
    Ok(nv_flip::flip(image(reference), image(test), pixels_per_degree).to_vec())
}

impl Flip {
    /// Pools a map of errors (not empty).
    pub fn of_map(map: &[f32]) -> Self {
        let mut sorted = map.to_vec();
        sorted.sort_by(f32::total_cmp);
        let sum: f64 = sorted.iter().map(|&e| f64::from(e)).sum();
        let percentile = |share: f64| {
            let mut running = 0.0;
            let over = sorted.iter().find(|&&e| {
                running += f64::from(e);
                running > share * sum
            });
            over.map_or(0.0, |&e| f64::from(e))
        };
        Self {
            mean: sum / sorted.len() as f64,
            weighted_median: percentile(0.5),
            weighted_quartiles: [percentile(0.25), percentile(0.75)],
            min: sorted.first().map_or(0.0, |&e| f64::from(e)),
            max: sorted.last().map_or(0.0, |&e| f64::from(e)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::pair;
    use super::*;

    /// Against FLIP's own tool (PyPI flip-evaluator 1.7), on the pictures of the script in the tests of `ssim`:
    /// ```python
    /// for ppd in (67.02064, 20.0):
    ///     f = lambda p: (p / 255).astype(np.float32)
    ///     m, mean, _ = flip_evaluator.evaluate(f(a), f(b), "LDR", inputsRGB=True, applyMagma=False,
    ///                                          computeMeanError=True, parameters={"ppd": ppd})
    ///     o = np.sort(np.array(m).ravel().astype(float))
    ///     q = lambda share: o[np.argmax(np.cumsum(o) > share * o.sum())]  # as its command pools them
    ///     print(mean, q(.25), q(.5), q(.75), o[0], o[-1])
    /// ```
    #[test]
    fn agrees_with_its_own_tool() {
        // Size, pixels per degree; mean, weighted quartiles and median between them, min, max.
        let tool = [
            (
                [64, 48],
                67.020_64,
                [0.152_209_0, 0.126_733_2, 0.150_239_4, 0.216_077_3, 0.059_725_5, 0.327_919_2],
            ),
            ([64, 48], 20.0, [0.218_930_5, 0.186_684_1, 0.243_197_8, 0.322_551_7, 0.024_755_2, 0.544_964_3]),
            (
                [97, 61],
                67.020_64,
                [0.150_383_4, 0.123_515_2, 0.148_923_5, 0.215_187_3, 0.050_707_8, 0.341_290_8],
            ),
            ([97, 61], 20.0, [0.219_482_8, 0.186_443_2, 0.243_141_8, 0.326_102_0, 0.023_227_1, 0.545_120_8]),
        ];
        for ([w, h], ppd, expected) in tool {
            let (a, b) = pair(w, h);
            let flip = Flip::of_map(&flip_map(&a, &b, ppd).unwrap());
            let [first, third] = flip.weighted_quartiles;
            for (got, want) in
                [flip.mean, first, flip.weighted_median, third, flip.min, flip.max].iter().zip(expected)
            {
                assert!((got - want).abs() < 1e-4, "{w}×{h} at {ppd}: {flip:?} is not {expected:?}");
            }
            // Control: another distance.
            assert!((Flip::of_map(&flip_map(&a, &b, 0.9 * ppd).unwrap()).mean - expected[0]).abs() > 1e-4);
        }
        assert!((DEFAULT_PIXELS_PER_DEGREE - 67.020_64).abs() < 1e-4);
    }

    #[test]
    fn pools_by_the_share_of_the_sum() {
        let flip = Flip::of_map(&[0.1, 0.4, 0.0, 0.2, 0.3]);
        assert!((flip.mean - 0.2).abs() < 1e-7);
        assert_eq!([flip.min, flip.max].map(|v| v as f32), [0.0, 0.4]);
        // Running sums of the sorted errors: 0, 0.1, 0.3, 0.6, 1.0.
        assert_eq!(flip.weighted_median as f32, 0.3);
        assert_eq!(flip.weighted_quartiles.map(|v| v as f32), [0.2, 0.4]);
    }
}
