//! From ordered candidates to pixels.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::prepare::{TILE, TileRect};
use super::{Layer, ReferenceError, ReferenceImage, ReferenceOptions, ReferenceOrder, ReferencePixel};
use crate::config::Lens;
use crate::projection::{MAX_ALPHA, MIN_ALPHA};
use crate::view::View;

/// How far pixels are from a splat's mean.
pub(super) trait Footprint: Send + Sync {
    /// Squared distance in standard deviations of the pixel with this centre (pixel-edge coordinates) and this ray
    /// from the mean, and the eye depth that the splat has there. A result that is not finite, or a depth that
    /// is not positive, is nothing. The ray is of depth 1; through a lens it is of length 1, and what is wanted is
    /// the distance.
    fn at(&self, pixel: DVec2, ray: DVec3) -> (f64, f64);
}

/// A splat that some pixel may see.
pub(super) struct Candidate<F> {
    /// Its place in the scene.
    pub index: u32,
    /// What it is ordered by.
    pub key: f64,
    /// Tiles that it may reach.
    pub tiles: TileRect,
    /// How it falls off.
    pub footprint: F,
    /// Opacity at the mean, fade and compensation included.
    pub opacity: f64,
    /// Colour from this eye.
    pub colour: [f64; 3],
    /// Squared distance, in standard deviations, beyond which it is not drawn.
    pub limit: f64,
}

impl<F: Footprint> Candidate<F> {
    /// Alpha at a pixel and the depth there, where it is drawn.
    fn alpha(&self, pixel: DVec2, ray: DVec3) -> Option<(f64, f64)> {
        let (square, depth) = self.footprint.at(pixel, ray);
        // The limit is the radius at which alpha is 1/255, or less: a hair more here, and the test on alpha decides.
        if !(square >= 0.0 && square <= self.limit * (1.0 + 1e-12) && depth > 0.0) {
            return None;
        }
        let alpha = (self.opacity * (-0.5 * square).exp()).min(MAX_ALPHA);
        (alpha >= MIN_ALPHA).then_some((alpha, depth))
    }
}

/// Blends candidates, which are in order, into every pixel.
pub(super) fn rasterise<F: Footprint>(
    candidates: &[Candidate<F>],
    view: &View,
    options: &ReferenceOptions,
) -> Result<ReferenceImage, ReferenceError> {
    let [width, height] = view.size;
    let mut pixels = Vec::new();
    let count = width as usize * height as usize;
    pixels.try_reserve_exact(count).map_err(|_| ReferenceError::Memory(width, height))?;
    pixels.resize(count, Blend::default().finish(options));

    let tile_pairs = pixels
        .par_chunks_mut((width * TILE) as usize)
        .enumerate()
        .map(|(row, pixels)| {
            let first = row as u32 * TILE;
            each_pixel(candidates, view, row as u32, |x, y, in_tile| {
                pixels[((y - first) * width + x) as usize] = shade(in_tile, x, y, view, options);
            })
        })
        .sum();
    Ok(ReferenceImage { size: view.size, pixels, visible: candidates.len(), tile_pairs })
}

/// Hands every pixel's layers over instead of blending them; rows of tiles in parallel, in no order.
pub(super) fn follow<F: Footprint>(
    candidates: &[Candidate<F>],
    view: &View,
    options: &ReferenceOptions,
    visit: &(impl Fn([u32; 2], &[Layer]) + Sync),
) {
    (0..view.size[1].div_ceil(TILE)).into_par_iter().for_each(|row| {
        let mut layers = Vec::new();
        each_pixel(candidates, view, row, |x, y, in_tile| {
            layers.clear();
            let mut light = 1.0;
            in_order(in_tile, x, y, view, options, |alpha, _, candidate| {
                let after = light * (1.0 - alpha);
                if after < options.stop_below {
                    return false;
                }
                layers.push(Layer { splat: candidate.index, alpha, light, colour: candidate.colour });
                light = after;
                true
            });
            visit([x, y], &layers);
        });
    });
}

/// Visits the pixels of a row of tiles, each with the candidates of its tile; returns how many those were, over the tiles.
fn each_pixel<F: Footprint>(
    candidates: &[Candidate<F>],
    view: &View,
    row: u32,
    mut visit: impl FnMut(u32, u32, &[&Candidate<F>]),
) -> u64 {
    let [width, height] = view.size;
    // Whole rows and columns of tiles are filtered in place: lists per tile of splats that fill the screen would need
    // memory without bound.
    let in_row: Vec<&Candidate<F>> = candidates.iter().filter(|c| contains(c.tiles.y, row)).collect();
    let mut in_tile = Vec::new();
    let mut pairs = 0;
    for column in 0..width.div_ceil(TILE) {
        in_tile.clear();
        in_tile.extend(in_row.iter().copied().filter(|c| contains(c.tiles.x, column)));
        pairs += in_tile.len() as u64;
        for y in row * TILE..((row + 1) * TILE).min(height) {
            for x in column * TILE..((column + 1) * TILE).min(width) {
                visit(x, y, &in_tile);
            }
        }
    }
    pairs
}

fn contains(range: [u32; 2], value: u32) -> bool {
    range[0] <= value && value < range[1]
}

/// One pixel: all its candidates, front to back.
fn shade<F: Footprint>(
    candidates: &[&Candidate<F>],
    x: u32,
    y: u32,
    view: &View,
    options: &ReferenceOptions,
) -> ReferencePixel {
    let mut blend = Blend::default();
    in_order(candidates, x, y, view, options, |alpha, depth, candidate| {
        blend.add(alpha, depth, candidate.colour, options)
    });
    blend.finish(options)
}

/// Hands over alpha and depth of every candidate that is drawn at a pixel, front to back, until told to stop.
fn in_order<F: Footprint>(
    candidates: &[&Candidate<F>],
    x: u32,
    y: u32,
    view: &View,
    options: &ReferenceOptions,
    mut add: impl FnMut(f64, f64, &Candidate<F>) -> bool,
) {
    let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let fov = &view.fov;
    let place = DVec2::new(
        fov.left + (fov.right - fov.left) * pixel.x / f64::from(view.size[0]),
        fov.up + (fov.down - fov.up) * pixel.y / f64::from(view.size[1]),
    );
    let ray = match options.lens {
        Lens::Perspective => Some(place.extend(1.0)),
        lens => lens.ray(place),
    };
    let Some(ray) = ray else { return };
    if options.order == ReferenceOrder::AlongRay {
        let mut hits: Vec<_> =
            candidates.iter().filter_map(|c| c.alpha(pixel, ray).map(|(a, depth)| (depth, a, c))).collect();
        hits.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (depth, alpha, candidate) in hits {
            if !add(alpha, depth, candidate) {
                break;
            }
        }
    } else {
        for candidate in candidates {
            if let Some((alpha, depth)) = candidate.alpha(pixel, ray)
                && !add(alpha, depth, candidate)
            {
                break;
            }
        }
    }
}

/// A pixel while it is blended.
struct Blend {
    colour: [f64; 3],
    transmittance: f64,
    median_depth: f64,
    layers: u32,
    layers_until: u32,
}

impl Default for Blend {
    fn default() -> Self {
        Self { colour: [0.0; 3], transmittance: 1.0, median_depth: f64::INFINITY, layers: 0, layers_until: 0 }
    }
}

impl Blend {
    /// Blends a layer behind those before; `false` where the pixel is finished and the layer was not blended.
    fn add(&mut self, alpha: f64, depth: f64, colour: [f64; 3], options: &ReferenceOptions) -> bool {
        let after = self.transmittance * (1.0 - alpha);
        if after < options.stop_below {
            return false;
        }
        for (sum, c) in self.colour.iter_mut().zip(colour) {
            *sum += self.transmittance * alpha * c;
        }
        self.layers += 1;
        if self.transmittance >= options.count_until {
            self.layers_until += 1;
        }
        if self.transmittance >= 0.5 && after < 0.5 {
            self.median_depth = depth;
        }
        self.transmittance = after;
        true
    }

    /// Adds the background.
    fn finish(self, options: &ReferenceOptions) -> ReferencePixel {
        let mut colour = self.colour;
        for (sum, b) in colour.iter_mut().zip(options.background) {
            *sum += self.transmittance * b;
        }
        ReferencePixel {
            colour,
            transmittance: self.transmittance,
            median_depth: self.median_depth,
            layers: self.layers,
            layers_until: self.layers_until,
        }
    }
}
