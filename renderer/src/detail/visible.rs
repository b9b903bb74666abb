//! What each splat gives to pictures.

use glam::DVec3;
use motes_scenes::Splats;
use std::sync::atomic::{AtomicU64, Ordering};

use super::sums::Sums;
use crate::View;
use crate::reference::{self, Layer, ReferenceError, ReferenceOptions};

/// What each splat gave to all pictures together; arrays of one entry a splat.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Importance {
    /// Sum of `T α` over all pixels, in pixels.
    pub weight: Vec<f64>,
    /// The largest `T α` at one pixel, `0 ..= 1`.
    pub peak: Vec<f64>,
    /// How much the pictures would change without the splat: sum over pixels of `|T α (c − B)|²`, `c` its colour and `B` that
    /// of all that lies behind it. A splat of its background's colour is not missed, however much it covers.
    pub change: Vec<f64>,
    /// Layers that it is: pixels in which it is blended.
    pub covered: Vec<f64>,
    /// Share of its weight that comes from the one view that sees most of it, `0 ..= 1`.
    pub favourite: Vec<f64>,
    /// Pixels that were looked at.
    pub pixels: u64,
    /// Layers that were blended in them.
    pub layers: u64,
}

impl Importance {
    /// Blended layers per pixel.
    pub fn layers_per_pixel(&self) -> f64 {
        self.layers as f64 / self.pixels.max(1) as f64
    }
}

/// Looks at a scene from one view after another and adds up what each splat gives.
pub struct Census {
    found: Importance,
    largest_view: Vec<f64>,
    weight: Sums,
    peak: Sums,
    change: Sums,
    covered: Sums,
}

impl Census {
    /// For a scene of so many splats; takes some 80 bytes each.
    pub fn new(splats: usize) -> Self {
        let found = Importance { weight: vec![0.0; splats], ..Importance::default() };
        let sums = || Sums::new(splats);
        let largest_view = vec![0.0; splats];
        Self { found, largest_view, weight: sums(), peak: sums(), change: sums(), covered: sums() }
    }

    /// Looks from one more view.
    ///
    /// # Errors
    /// [`ReferenceError`] where the view, the options or the scene make no sense; a scene of another size than was
    /// announced is one that does not.
    pub fn look(
        &mut self,
        splats: &Splats,
        view: &View,
        options: &ReferenceOptions,
    ) -> Result<(), ReferenceError> {
        let n = self.largest_view.len();
        if splats.len() != n {
            return Err(ReferenceError::Scene {
                splats: splats.len(),
                array: "sums of a census",
                found: n,
                expected: splats.len(),
            });
        }
        let layers = AtomicU64::new(0);
        let background = DVec3::from_array(options.background);
        reference::trace(splats, view, options, |_, pixel| {
            layers.fetch_add(pixel.len() as u64, Ordering::Relaxed);
            each_change(pixel, background, |layer, change| {
                let i = layer.splat as usize;
                self.weight.add(i, layer.weight());
                self.peak.raise(i, layer.weight());
                self.change.add(i, change.length_squared());
                self.covered.add(i, 1.0);
            });
        })?;
        self.found.layers += layers.into_inner();
        self.found.pixels += u64::from(view.size[0]) * u64::from(view.size[1]);
        let each = self.found.weight.iter_mut().zip(&mut self.largest_view);
        for ((sum, largest), weight) in each.zip(self.weight.take()) {
            *sum += weight;
            *largest = weight.max(*largest);
        }
        Ok(())
    }

    /// What was found.
    pub fn finish(mut self) -> Importance {
        self.found.peak = self.peak.values().collect();
        self.found.change = self.change.values().collect();
        self.found.covered = self.covered.values().collect();
        let share = |(&largest, &sum): (&f64, &f64)| if sum > 0.0 { largest / sum } else { 0.0 };
        self.found.favourite = self.largest_view.iter().zip(&self.found.weight).map(share).collect();
        self.found
    }
}

/// Hands over each layer of a pixel with `T α (c − B)`: what the pixel's colour would lose without it, and also the
/// derivative of the colour by the logarithm of the layer's opacity. From back to front.
pub(super) fn each_change(pixel: &[Layer], background: DVec3, mut each: impl FnMut(&Layer, DVec3)) {
    let mut behind = background;
    for layer in pixel.iter().rev() {
        let colour = DVec3::from_array(layer.colour);
        each(layer, (colour - behind) * layer.weight());
        behind = behind.lerp(colour, layer.alpha);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ahead, balls};
    use super::*;

    const RED: [f32; 3] = [1.0, 0.0, 0.0];
    const GREEN: [f32; 3] = [0.0, 1.0, 0.0];

    fn census(splats: &Splats, views: &[View]) -> Importance {
        let mut census = Census::new(splats.len());
        for view in views {
            census.look(splats, view, &ReferenceOptions::default()).unwrap();
        }
        census.finish()
    }

    #[test]
    fn weights_are_shares_of_the_picture() {
        let splats = balls(&[
            ([0.0, 0.0, 3.0], 0.3, 0.8, RED),
            ([0.1, 0.0, 4.0], 0.5, 0.9, GREEN),
            ([0.0, 0.0, -4.0], 0.5, 0.9, GREEN),
        ]);
        let view = ahead();
        let found = census(&splats, &[view]);
        let image = reference::render(&splats, &view, &ReferenceOptions::default()).unwrap();
        // Red comes from the first alone, and green from the second: the sums of colour are the sums of weight.
        let sum = |c: usize| image.pixels.iter().map(|p| p.colour[c]).sum::<f64>();
        assert!((found.weight[0] - sum(0)).abs() < 1e-4, "{} {}", found.weight[0], sum(0));
        assert!((found.weight[1] - sum(1)).abs() < 1e-4 && found.weight[1] > 1.0);
        assert_eq!((found.weight[2], found.peak[2], found.change[2]), (0.0, 0.0, 0.0));
        assert_eq!(found.covered.iter().sum::<f64>(), found.layers as f64);
        assert!((found.layers_per_pixel() - image.mean(|p| f64::from(p.layers))).abs() < 1e-12);
        assert!(found.peak[0] > 0.7 && found.peak[0] <= 0.8 && found.favourite[0] == 1.0);
        // Two views see the same: the sums double, the largest stays, and neither is the favourite.
        let twice = census(&splats, &[view, view]);
        assert!((twice.weight[0] - 2.0 * found.weight[0]).abs() < 1e-9 && twice.peak == found.peak);
        assert_eq!(twice.favourite[0], 0.5);
    }

    #[test]
    fn the_change_is_what_leaving_a_splat_out_changes() {
        let splats = balls(&[
            ([0.0, 0.0, 3.0], 0.3, 0.8, RED),
            ([0.1, 0.0, 4.0], 0.5, 0.9, [0.9, 0.1, 0.0]),
            ([0.0, 0.1, 5.0], 0.9, 0.9, GREEN),
        ]);
        let (view, options) = (ahead(), ReferenceOptions::default());
        let found = census(&splats, &[view]);
        let whole = reference::render(&splats, &view, &options).unwrap();
        for i in 0..3 {
            let mut without = splats.clone();
            without.retain(|k| k != i);
            let image = reference::render(&without, &view, &options).unwrap();
            let change: f64 = (whole.pixels.iter().zip(&image.pixels))
                .map(|(a, b)| DVec3::from(a.colour).distance_squared(b.colour.into()))
                .sum();
            assert!((found.change[i] - change).abs() < 1e-5 * change.max(1.0), "{i}");
        }
        // Control: what is before its own colour is missed less for what it covers.
        let missed = |i: usize| found.change[i] / found.weight[i];
        assert!(missed(0) < 0.6 * missed(2), "{} {}", missed(0), missed(2));
    }

    #[test]
    fn the_census_of_another_scene_is_refused() {
        let splats = balls(&[([0.0, 0.0, 3.0], 0.3, 0.8, RED)]);
        let error = Census::new(2).look(&splats, &ahead(), &ReferenceOptions::default()).unwrap_err();
        assert!(error.to_string().contains("sums of a census"), "{error}");
    }
}
