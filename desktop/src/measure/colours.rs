//! Values as colours.

use super::{MeasureError, Picture};

/// A scale from values to colours whose lightness grows with the value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ColourMap {
    /// Black over purple to light yellow: FLIP's own.
    Magma,
    /// Violet over green to yellow.
    Viridis,
}

impl ColourMap {
    /// The colour (8-bit sRGB) of a value; values beyond `0 ..= 1` and NaN take the nearer end's.
    pub fn colour(self, value: f64) -> [u8; 3] {
        let scale = match self {
            Self::Magma => colorous::MAGMA,
            Self::Viridis => colorous::VIRIDIS,
        };
        let value = if value.is_nan() { 0.0 } else { value.clamp(0.0, 1.0) };
        scale.eval_continuous(value).as_array()
    }
}

/// A map of values, by rows, as a picture; `low` has the scale's first colour, `high` its last.
///
/// # Errors
/// Where the number of values is not width × height, or not `low < high`.
pub fn coloured(
    size: [u32; 2],
    values: impl IntoIterator<Item = f64>,
    [low, high]: [f64; 2],
    map: ColourMap,
) -> Result<Picture, MeasureError> {
    if !(low < high && (high - low).is_finite()) {
        return Err(MeasureError::Setting(format!("a colour scale needs low < high, not {low} … {high}")));
    }
    let bytes: Vec<u8> = values.into_iter().flat_map(|v| map.colour((v - low) / (high - low))).collect();
    Picture::from_rgb8(size, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lightness_grows_with_the_value() {
        for map in [ColourMap::Magma, ColourMap::Viridis] {
            let light = |v: f64| {
                let [r, g, b] = map.colour(v).map(f64::from);
                0.2126 * r + 0.7152 * g + 0.0722 * b
            };
            for i in 0..100 {
                assert!(light(f64::from(i + 1) / 100.0) > light(f64::from(i) / 100.0) - 1.0, "{map:?} {i}");
            }
            assert!(light(1.0) > light(0.0) + 100.0);
            assert_eq!(map.colour(-3.0), map.colour(0.0));
            assert_eq!(map.colour(f64::NAN), map.colour(0.0));
            assert_eq!(map.colour(f64::INFINITY), map.colour(1.0));
        }
        assert_ne!(ColourMap::Magma.colour(0.5), ColourMap::Viridis.colour(0.5));
    }

    #[test]
    fn scales_have_their_ends_and_misfits_are_refused() {
        let picture = coloured([3, 1], [2.0, 3.0, 4.0], [2.0, 4.0], ColourMap::Magma).unwrap().to_rgb8();
        assert_eq!(picture[..3], ColourMap::Magma.colour(0.0));
        assert_eq!(picture[3..6], ColourMap::Magma.colour(0.5));
        assert_eq!(picture[6..], ColourMap::Magma.colour(1.0));
        assert!(coloured([2, 1], [1.0], [0.0, 1.0], ColourMap::Magma).is_err());
        assert!(coloured([1, 1], [1.0], [1.0, 1.0], ColourMap::Magma).is_err());
        assert!(coloured([1, 1], [1.0], [0.0, f64::NAN], ColourMap::Magma).is_err());
    }
}
