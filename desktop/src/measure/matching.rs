//! Colours of the test brought near those of the reference before comparing (the thesis `000`, section 5.3.1): a photograph
//! and a render differ in exposure and white balance first of all, and detail is what is asked about.

use super::Picture;

/// How colours are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Matching {
    /// Same mean and standard deviation in every channel.
    Mean,
    /// Same histogram in every channel.
    Histogram,
}

impl Matching {
    /// The test picture with its colours matched to the reference's.
    pub fn apply(self, reference: &Picture, test: &Picture) -> Picture {
        match self {
            Self::Mean => match_mean(reference, test),
            Self::Histogram => match_histogram(reference, test),
        }
    }
}

/// Shifts and scales every channel of the test so that mean and standard deviation are the reference's, then clamps. A
/// channel without any deviation is only shifted.
pub fn match_mean(reference: &Picture, test: &Picture) -> Picture {
    per_channel(test, |c| {
        let (mean, deviation) = statistics(reference, c);
        let (from_mean, from_deviation) = statistics(test, c);
        let scale = if from_deviation > 0.0 { deviation / from_deviation } else { 1.0 };
        move |v| (f64::from(v) - from_mean) * scale + mean
    })
}

fn statistics(picture: &Picture, c: usize) -> (f64, f64) {
    let n = picture.pixels().len() as f64;
    let mean = picture.pixels().iter().map(|p| f64::from(p[c])).sum::<f64>() / n;
    let variance = picture.pixels().iter().map(|p| (f64::from(p[c]) - mean).powi(2)).sum::<f64>() / n;
    (mean, variance.sqrt())
}

/// Gives every 8-bit value of the test the value of the reference at the same quantile (linear between them), channel by
/// channel.
pub fn match_histogram(reference: &Picture, test: &Picture) -> Picture {
    per_channel(test, |c| {
        let target = quantiles(reference, c);
        let source = quantiles(test, c);
        let mut table = [0.0; 256];
        for &(value, quantile) in &source {
            table[usize::from(value)] = interpolate(&target, quantile) / 255.0;
        }
        move |v| table[usize::from(byte(v))]
    })
}

fn byte(v: f32) -> u8 {
    (v * 255.0).round() as u8
}

/// The 8-bit values that occur in a channel, with the share of pixels up to and with each.
fn quantiles(picture: &Picture, c: usize) -> Vec<(u8, f64)> {
    let mut counts = [0u64; 256];
    for p in picture.pixels() {
        counts[usize::from(byte(p[c]))] += 1;
    }
    let mut below = 0;
    let mut quantiles = Vec::new();
    for (value, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        below += count;
        quantiles.push((value as u8, below as f64 / picture.pixels().len() as f64));
    }
    quantiles
}

/// The value at a quantile, linear between the known ones, constant beyond them.
fn interpolate(known: &[(u8, f64)], quantile: f64) -> f64 {
    let after = known.partition_point(|k| k.1 < quantile);
    let value = |i: usize| f64::from(known[i].0);
    if after == 0 {
        return value(0);
    }
    if after == known.len() {
        return value(after - 1);
    }
    let (low, high) = (known[after - 1].1, known[after].1);
    value(after - 1) + (value(after) - value(after - 1)) * (quantile - low) / (high - low)
}

/// A picture with every channel passed through its own function, clamped to `0 ..= 1`.
fn per_channel<F: Fn(f32) -> f64>(picture: &Picture, function: impl Fn(usize) -> F) -> Picture {
    let functions = [function(0), function(1), function(2)];
    let map = |p: &[f32; 3]| [0, 1, 2].map(|c| functions[c](p[c]).clamp(0.0, 1.0) as f32);
    picture.mapped(map)
}

#[cfg(test)]
mod tests {
    use super::super::tests::pair;
    use super::super::{Settings, compare};
    use super::*;

    #[test]
    fn matched_statistics_are_the_references() {
        let (a, b) = pair(64, 48);
        let matched = match_mean(&a, &b);
        for c in 0..3 {
            let (want, got, before) = (statistics(&a, c), statistics(&matched, c), statistics(&b, c));
            // Clamping costs a little.
            assert!((want.0 - got.0).abs() < 2e-3 && (want.1 - got.1).abs() < 2e-3, "{want:?} {got:?}");
            assert!((want.1 - before.1).abs() > 1e-2, "nothing to match");
        }
        let flat = Picture::new([2, 2], vec![[0.2; 3]; 4]).unwrap();
        let bright = Picture::new([2, 2], vec![[0.6; 3], [0.8; 3], [0.6; 3], [0.8; 3]]).unwrap();
        assert!((match_mean(&bright, &flat).pixels()[0][0] - 0.7).abs() < 1e-6);
    }

    #[test]
    fn a_change_of_tone_is_undone() {
        let (a, _) = pair(64, 48);
        let toned = a.mapped(|p| p.map(|v| 0.9 * v.powf(0.7)));
        let error =
            |matching| compare(&a, &toned, &Settings { matching, ..Settings::default() }).unwrap().whole.psnr;
        assert!(error(Some(Matching::Histogram)) > 45.0, "{}", error(Some(Matching::Histogram)));
        assert!(error(Some(Matching::Mean)) > error(None) + 6.0);
        assert!(error(None) < 25.0);
        // Structure is not touched: noise stays noise.
        let (_, noisy) = pair(64, 48);
        assert!(compare(&a, &match_histogram(&a, &noisy), &Settings::default()).unwrap().whole.psnr < 35.0);
    }

    #[test]
    fn a_pictures_own_histogram_changes_nothing() {
        let (a, b) = pair(30, 30);
        assert_eq!(match_histogram(&a, &a).to_rgb8(), a.to_rgb8());
        assert_ne!(match_histogram(&a, &b).to_rgb8(), b.to_rgb8());
    }
}
