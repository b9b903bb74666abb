//! The layers of many pictures, kept, so that opacities and colours can be changed without looking again.
//!
//! How a splat falls off over a picture's pixels depends neither on its colour nor on its opacity. What tracing finds once, the
//! splats of each pixel in order and each one's *response* there (its alpha for an opacity of 1), is therefore enough to make
//! the picture again with others: for 100 layers in a nanosecond or two each instead of some hundred. What is left out: a
//! splat whose opacity grows reaches pixels that were not recorded. Record again where that matters.
//!
//! Memory: 8 bytes a layer.

use glam::{DVec3, Vec3};
use motes_scenes::{Splats, sh_coefficients};
use rayon::prelude::*;
use std::sync::Mutex;

use super::Importance;
use crate::View;
use crate::projection::{MAX_ALPHA, MIN_ALPHA};
use crate::reference::{self, ReferenceError, ReferenceOptions};
use crate::spherical_harmonics::sh_basis_f32;

/// One splat's part of a recorded pixel.
#[derive(Clone, Copy)]
struct Response {
    /// Place in the picture's list of splats.
    at: u32,
    response: f32,
}

/// One recorded picture.
#[derive(Clone)]
pub(super) struct Recorded {
    /// The eye, relative to the scene's origin.
    eye: DVec3,
    /// The splats that it shows, rising.
    splats: Vec<u32>,
    /// For each pixel, by rows, where its layers end.
    ends: Vec<usize>,
    layers: Vec<Response>,
}

/// The layers of pictures from some views.
#[derive(Clone)]
pub struct Recording {
    views: Vec<Recorded>,
    background: Vec3,
    stop_below: f32,
    degree: u8,
}

/// One layer of a pixel with the scene's present opacities and colours.
#[derive(Clone, Copy)]
pub(super) struct Lit {
    /// Place in the picture's list of splats.
    pub at: usize,
    /// Visible blending weight, `T α`.
    pub weight: f32,
    alpha: f32,
    /// `T α (c − B)`: what the pixel would lose without it, and the derivative by the logarithm of its opacity.
    pub change: Vec3,
}

impl Lit {
    /// Whether a change of opacity shows: beyond the largest alpha it does not.
    pub fn free(&self) -> bool {
        self.alpha < MAX_ALPHA as f32
    }
}

impl Recording {
    /// Looks from every view.
    ///
    /// # Errors
    /// The reference's.
    pub fn of<'a>(
        splats: &Splats,
        views: impl IntoIterator<Item = &'a View>,
        options: &ReferenceOptions,
    ) -> Result<Self, ReferenceError> {
        let views = views.into_iter().map(|view| record(splats, view, options)).collect::<Result<_, _>>()?;
        Ok(Self {
            views,
            background: DVec3::from_array(options.background).as_vec3(),
            stop_below: options.stop_below as f32,
            degree: options.sh_degree.min(splats.sh_degree),
        })
    }

    /// The pictures.
    pub(super) fn views(&self) -> &[Recorded] {
        &self.views
    }

    /// Highest degree of spherical harmonics that the pictures show.
    pub(super) fn degree(&self) -> u8 {
        self.degree
    }

    /// Forgets the splats for which `keep` does not say so; those that stay are counted anew, as in [`Splats::retain`].
    pub fn retain(&mut self, splats: usize, keep: impl Fn(usize) -> bool) {
        let mut next = 0;
        let places: Vec<Option<u32>> = (0..splats)
            .map(|i| {
                let place = keep(i).then_some(next);
                next += u32::from(place.is_some());
                place
            })
            .collect();
        for view in &mut self.views {
            let mut stayed = Vec::new();
            let here: Vec<Option<u32>> = (view.splats.iter())
                .map(|&splat| {
                    let splat = places[splat as usize]?;
                    stayed.push(splat);
                    Some(stayed.len() as u32 - 1)
                })
                .collect();
            view.splats = stayed;
            let (mut from, mut to) = (0, 0);
            for end in &mut view.ends {
                for k in from..*end {
                    let layer = view.layers[k];
                    if let Some(at) = here[layer.at as usize] {
                        view.layers[to] = Response { at, ..layer };
                        to += 1;
                    }
                }
                from = std::mem::replace(end, to);
            }
            view.layers.truncate(to);
            view.layers.shrink_to_fit();
        }
    }

    /// The pictures, with the present opacities and colours: sRGB-encoded colours by rows, background included.
    pub fn pictures(&self, splats: &Splats) -> Vec<Vec<[f32; 3]>> {
        let picture = |view: &Recorded| {
            let mut pixels = Vec::with_capacity(view.pixels());
            let colours = view.colours(splats, self.degree);
            self.each_pixel(view, splats, &colours, |_, colour, _| pixels.push(colour.to_array()));
            pixels
        };
        self.views.par_iter().map(picture).collect()
    }

    /// How far each eye is from what it shows: the median over the pixels of the distance to the mean of the splat that takes
    /// the light below one half; ∞ where none does. Scene units.
    pub fn distances(&self, splats: &Splats) -> Vec<f64> {
        let median = |view: &Recorded| {
            let mut found = Vec::new();
            let colours = vec![Vec3::ZERO; view.splats.len()];
            self.each_pixel(view, splats, &colours, |_, _, layers| {
                let mut light = 1.0;
                let opaque = layers.iter().find(|layer| {
                    light -= layer.weight;
                    light < 0.5
                });
                found.extend(opaque.map(|layer| {
                    let mean = splats.means[view.splats[layer.at] as usize];
                    Vec3::from(mean).as_dvec3().distance(view.eye)
                }));
            });
            let middle = found.len() / 2;
            if found.is_empty() {
                f64::INFINITY
            } else {
                *found.select_nth_unstable_by(middle, f64::total_cmp).1
            }
        };
        self.views.par_iter().map(median).collect()
    }

    /// What each splat gives to the pictures, as [`super::Census`] finds it, with the present opacities and colours.
    pub fn importance(&self, splats: &Splats) -> Importance {
        let n = splats.len();
        let zeros = || vec![0.0; n];
        let mut found = Importance {
            weight: zeros(),
            peak: zeros(),
            change: zeros(),
            covered: zeros(),
            ..Importance::default()
        };
        let mut largest = zeros();
        for view in &self.views {
            let colours = view.colours(splats, self.degree);
            let mut here = vec![0.0; colours.len()];
            self.each_pixel(view, splats, &colours, |_, _, layers| {
                found.pixels += 1;
                found.layers += layers.len() as u64;
                for layer in layers {
                    here[layer.at] += f64::from(layer.weight);
                    let (i, weight) = (view.splats[layer.at] as usize, f64::from(layer.weight));
                    found.weight[i] += weight;
                    found.peak[i] = found.peak[i].max(weight);
                    found.change[i] += f64::from(layer.change.length_squared());
                    found.covered[i] += 1.0;
                }
            });
            for (&i, weight) in view.splats.iter().zip(here) {
                largest[i as usize] = weight.max(largest[i as usize]);
            }
        }
        let share = |(&largest, &sum): (&f64, &f64)| if sum > 0.0 { largest / sum } else { 0.0 };
        found.favourite = largest.iter().zip(&found.weight).map(share).collect();
        found
    }

    /// Makes a picture again: every pixel's place, colour (background included), and layers from front to back. The colours are
    /// those of the picture's splats ([`Recorded::colours`]).
    pub(super) fn each_pixel(
        &self,
        view: &Recorded,
        splats: &Splats,
        colours: &[Vec3],
        mut each: impl FnMut(usize, Vec3, &[Lit]),
    ) {
        let opacities: Vec<f32> = view.splats.iter().map(|&i| splats.opacities[i as usize]).collect();
        let mut layers: Vec<Lit> = Vec::new();
        let mut from = 0;
        for (pixel, &end) in view.ends.iter().enumerate() {
            layers.clear();
            let mut light = 1.0;
            for &Response { at, response } in &view.layers[from..end] {
                let alpha = (response * opacities[at as usize]).min(MAX_ALPHA as f32);
                let after = light * (1.0 - alpha);
                if alpha < MIN_ALPHA as f32 {
                    continue;
                }
                if after < self.stop_below {
                    break;
                }
                layers.push(Lit { at: at as usize, weight: light * alpha, alpha, change: Vec3::ZERO });
                light = after;
            }
            let mut behind = self.background;
            for layer in layers.iter_mut().rev() {
                let colour = colours[layer.at];
                layer.change = (colour - behind) * layer.weight;
                behind = behind.lerp(colour, layer.alpha);
            }
            each(pixel, behind, &layers);
            from = end;
        }
    }
}

impl Recorded {
    /// Pixels of the picture.
    pub fn pixels(&self) -> usize {
        self.ends.len()
    }

    /// The splats that it shows, rising.
    pub fn splats(&self) -> &[u32] {
        &self.splats
    }

    /// The basis functions of the direction from the eye to a splat; its colour is `max(0, ½ + Σ sh[k] · Y_k)`.
    pub fn basis(&self, splats: &Splats, i: usize) -> [f32; 16] {
        let from_eye = Vec3::from(splats.means[i]).as_dvec3() - self.eye;
        sh_basis_f32(from_eye.normalize_or(DVec3::Z).as_vec3())
    }

    /// The colour of each of its splats from the eye.
    pub fn colours(&self, splats: &Splats, degree: u8) -> Vec<Vec3> {
        let used = sh_coefficients(degree);
        let colour = |&i: &u32| {
            let basis = self.basis(splats, i as usize);
            let sum = |sum: Vec3, (sh, y): (&[f32; 3], f32)| sum + Vec3::from(*sh) * y;
            let coefficients = &splats.sh_of(i as usize)[..used];
            coefficients.iter().zip(basis).fold(Vec3::splat(0.5), sum).max(Vec3::ZERO)
        };
        self.splats.iter().map(colour).collect()
    }
}

fn record(splats: &Splats, view: &View, options: &ReferenceOptions) -> Result<Recorded, ReferenceError> {
    // A row is visited by one thread, from left to right: no lock is ever waited for.
    let rows: Vec<Mutex<(Vec<usize>, Vec<Response>)>> = (0..view.size[1]).map(|_| Mutex::default()).collect();
    reference::trace(splats, view, options, |[_, y], layers| {
        let mut row = match rows[y as usize].lock() {
            Ok(row) => row,
            Err(poisoned) => poisoned.into_inner(),
        };
        let of = |layer: &reference::Layer| {
            let opacity = f64::from(splats.opacities[layer.splat as usize]);
            Response { at: layer.splat, response: (layer.alpha / opacity) as f32 }
        };
        row.1.extend(layers.iter().map(of));
        let end = row.1.len();
        row.0.push(end);
    })?;
    let mut recorded = Recorded {
        eye: view.eye - DVec3::from_array(splats.origin),
        ends: Vec::with_capacity(view.size[0] as usize * view.size[1] as usize),
        layers: Vec::new(),
        splats: Vec::new(),
    };
    for row in rows {
        let (ends, layers) = row.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let before = recorded.layers.len();
        recorded.ends.extend(ends.into_iter().map(|end| before + end));
        recorded.layers.extend(layers);
    }
    recorded.layers.shrink_to_fit();
    let mut seen = vec![false; splats.len()];
    recorded.layers.iter().for_each(|layer| seen[layer.at as usize] = true);
    recorded.splats = (0..splats.len() as u32).filter(|&i| seen[i as usize]).collect();
    let mut places = vec![0; splats.len()];
    recorded.splats.iter().zip(0..).for_each(|(&i, at)| places[i as usize] = at);
    recorded.layers.iter_mut().for_each(|layer| layer.at = places[layer.at as usize]);
    Ok(recorded)
}

#[cfg(test)]
mod tests {
    use super::super::Census;
    use super::super::tests::ahead;
    use super::*;
    use motes_scenes::synthetic::Recipe;

    #[test]
    fn a_recording_shows_what_the_reference_does() {
        let mut splats = Recipe { count: 300, seed: 5, sh_degree: 2, ..Default::default() }.still();
        let options = ReferenceOptions { stop_below: 0.0, background: [0.1, 0.2, 0.3], ..Default::default() };
        let middle = DVec3::from_array(splats.origin);
        let views = [0.0, 2.0].map(|turn: f64| {
            let eye = middle + DVec3::new(turn.sin(), -0.3, turn.cos()) * 12.0;
            View::look_at(eye, middle, DVec3::NEG_Y, ahead().fov, [40, 32])
        });
        let mut recording = Recording::of(&splats, &views, &options).unwrap();
        let largest = |recording: &Recording, splats: &Splats| {
            let mut largest = 0.0f64;
            for (view, recorded) in views.iter().zip(recording.views()) {
                let image = reference::render(splats, view, &options).unwrap();
                let colours = recorded.colours(splats, recording.degree());
                recording.each_pixel(recorded, splats, &colours, |pixel, colour, _| {
                    let expected = DVec3::from_array(image.pixels[pixel].colour);
                    largest = largest.max((expected - colour.as_dvec3()).abs().max_element());
                });
            }
            largest
        };
        assert!(largest(&recording, &splats) < 1e-3);
        let mut census = Census::new(splats.len());
        for view in &views {
            census.look(&splats, view, &options).unwrap();
        }
        let (found, expected) = (recording.importance(&splats), census.finish());
        assert_eq!((found.pixels, found.layers), (expected.pixels, expected.layers));
        assert!(found.favourite.iter().zip(&expected.favourite).all(|(a, b)| (a - b).abs() < 1e-3));
        // The scene's middle is 12 away, and the first that is opaque before it.
        assert!(recording.distances(&splats).iter().all(|d| (10.0..13.0).contains(d)));
        for i in 0..splats.len() {
            assert!((found.weight[i] - expected.weight[i]).abs() < 1e-3 * expected.weight[i].max(1.0));
            assert!((found.change[i] - expected.change[i]).abs() < 1e-3 * expected.change[i].max(1.0));
        }
        // Other colours, fewer splats, and opacities that do not grow: still the same picture, without looking again.
        for i in 0..splats.len() {
            splats.opacities[i] *= 0.5 + 0.5 * (i % 3) as f32 / 2.0;
            splats.sh[i * 9][i % 3] += 0.4;
        }
        assert!(largest(&Recording::of(&splats, &views, &options).unwrap(), &splats) < 1e-3);
        let n = splats.len();
        recording.retain(n, |i| i % 4 != 1);
        splats.retain(|i| i % 4 != 1);
        // What was behind the last recorded layer has a light of 10⁻⁴ at most before others went.
        assert!(largest(&recording, &splats) < 0.03, "{}", largest(&recording, &splats));
        // Control: another scene is another picture.
        let mut other = splats.clone();
        other.sh.rotate_left(9);
        let shown = Recording::of(&splats, &views, &options).unwrap();
        let mut apart = 0.0f64;
        for recorded in shown.views() {
            let colours = recorded.colours(&splats, 2);
            let mut first = Vec::new();
            shown.each_pixel(recorded, &splats, &colours, |_, colour, _| first.push(colour));
            let colours = recorded.colours(&other, 2);
            shown.each_pixel(recorded, &other, &colours, |pixel, colour, _| {
                apart = apart.max(f64::from((first[pixel] - colour).abs().max_element()));
            });
        }
        assert!(apart > 0.2, "{apart}");
    }
}
