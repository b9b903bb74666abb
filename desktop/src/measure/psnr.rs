//! Plain differences of values: peak signal-to-noise ratio, and the pixel that is off most.

use super::Picture;

/// Per pixel, the mean over the channels of the squared difference; `0 ..= 1`. Both pictures have one size.
pub fn squared_errors(a: &Picture, b: &Picture) -> Vec<f64> {
    let square = |(p, q): (&[f32; 3], &[f32; 3])| {
        (0..3).map(|c| (f64::from(p[c]) - f64::from(q[c])).powi(2)).sum::<f64>() / 3.0
    };
    a.pixels().iter().zip(b.pixels()).map(square).collect()
}

/// Peak signal-to-noise ratio in dB of a mean squared error of values with peak 1: `−10 log10(mse)`; ∞ at 0.
pub fn psnr(mean_squared_error: f64) -> f64 {
    -10.0 * mean_squared_error.log10()
}

/// Where two pictures differ most.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Worst {
    /// Column of the pixel.
    pub x: u32,
    /// Row of the pixel.
    pub y: u32,
    /// Channel: 0 red, 1 green, 2 blue.
    pub channel: usize,
    /// Its value in the reference, `0 ..= 1`.
    pub reference: f32,
    /// Its value in the test.
    pub test: f32,
    /// Absolute difference of the two.
    pub difference: f32,
}

/// The first pixel, by rows, with the largest difference in one channel. Both pictures have one size.
pub fn worst(reference: &Picture, test: &Picture) -> Worst {
    let width = reference.size()[0] as usize;
    let mut worst = Worst { x: 0, y: 0, channel: 0, reference: 0.0, test: 0.0, difference: -1.0 };
    for (i, (p, q)) in reference.pixels().iter().zip(test.pixels()).enumerate() {
        for channel in 0..3 {
            let difference = (p[channel] - q[channel]).abs();
            if difference > worst.difference {
                let (x, y) = ((i % width) as u32, (i / width) as u32);
                worst = Worst { x, y, channel, reference: p[channel], test: q[channel], difference };
            }
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::super::tests::pair;
    use super::*;

    #[test]
    fn a_known_difference_has_a_known_ratio() {
        let a = Picture::new([4, 4], vec![[0.5; 3]; 16]).unwrap();
        let b = Picture::new([4, 4], vec![[0.6, 0.5, 0.4]; 16]).unwrap();
        let mean = squared_errors(&a, &b).iter().sum::<f64>() / 16.0;
        assert!((psnr(mean) - 10.0 * (3.0f64 / 0.02).log10()).abs() < 1e-5);
        assert_eq!(psnr(0.0), f64::INFINITY);
    }

    #[test]
    fn the_worst_pixel_is_found() {
        let (a, _) = pair(20, 10);
        let mut changed = a.pixels().to_vec();
        changed[3 * 20 + 7][2] = (a.pixels()[67][2] + 0.7) % 1.0;
        changed[5][0] = (a.pixels()[5][0] - 0.05).abs();
        let found = worst(&a, &Picture::new([20, 10], changed).unwrap());
        assert_eq!((found.x, found.y, found.channel), (7, 3, 2));
        assert_eq!(found.reference, a.pixels()[67][2]);
    }
}
