//! Heat maps: a picture in which colour is a quantity, of a pixel or of the splats that are seen there.
//!
//! Quantities of a pixel (layers, hidden layers, error) are coloured by themselves. Quantities of a splat (projection
//! error, density, labels, levels) colour the splats, which are then drawn as usual: what shows is what one looks at.

use std::collections::HashMap;

use motes_renderer::projection_error::epsilon;
use motes_renderer::reference::{self, ReferenceOptions, ReferenceOrder};
use motes_renderer::{OrderKey, RenderConfig, View, midpoint};
use motes_scenes::labels::{Class, class_colour};
use motes_scenes::{SH_C0, Splats};

use crate::density::Density;
use crate::error::CommandError;
use crate::measure::{ColourMap, Picture, coloured, flip_map};
use crate::studio::reference_pictures;

/// What a heat map shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Heat {
    /// Layers blended over a pixel: 0 to 200
    Layers,
    /// Layers of a pixel behind which less than 1/255 of the light is left: 0 to 200
    Hidden,
    /// Visible error against the reference (FLIP): 0 to 0.5
    Error,
    /// Root mean square error of a splat's classic projection: 0.01 to 10 pixels, logarithmic
    ProjectionError,
    /// Splats in the voxel around a splat: 1 to 1000, logarithmic. Voxels have a 64th of the scene's longest side, or that of
    /// --voxel
    Density,
    /// Labels (files of a merged scene, classes), in their colours
    Labels,
    /// The level of detail in use: from yellow, the finest, to violet
    Level,
}

/// What a quantity of splats needs beside them.
#[derive(Clone, Debug, Default)]
pub struct Given {
    /// How fine each splat's level is, 0 to 1; none where there are no levels.
    pub fineness: Option<Vec<f64>>,
    /// Side of a voxel, scene units; none for a share of the scene.
    pub voxel: Option<f64>,
}

/// Layers that the last colour stands for.
const LAYERS: f64 = 200.0;
/// FLIP error that the last colour stands for.
const ERROR: f64 = 0.5;
/// Pixels of projection error between which colours lie.
const PIXELS: [f64; 2] = [0.01, 10.0];
/// Splats a voxel between which colours lie.
const PER_VOXEL: [f64; 2] = [1.0, 1000.0];
/// Half-width of the widest region that a projection error is taken over, radians.
const WIDEST: f64 = 0.5;

impl Heat {
    /// The map of a quantity of pixels from the reference, for each view; `None` for a quantity of splats.
    ///
    /// `drawn` are the pictures whose error is shown.
    ///
    /// # Errors
    /// The reference's.
    pub fn of_pixels(
        self,
        splats: &Splats,
        views: &[View],
        config: &RenderConfig,
        drawn: &[Picture],
    ) -> Result<Option<Vec<Picture>>, CommandError> {
        if !matches!(self, Self::Layers | Self::Hidden | Self::Error) {
            return Ok(None);
        }
        let mut options = ReferenceOptions::of_config(config);
        if config.order == OrderKey::Radial {
            options.order = ReferenceOrder::Radial(Some(midpoint(views)));
        }
        let mut maps = Vec::new();
        for (i, view) in views.iter().enumerate() {
            let image = reference::render(splats, view, &options)?;
            let layers = |count: fn(&reference::ReferencePixel) -> u32| {
                let values = image.pixels.iter().map(|p| f64::from(count(p)));
                coloured(image.size, values, [0.0, LAYERS], ColourMap::Viridis)
            };
            maps.push(match self {
                Self::Layers => layers(|p| p.layers)?,
                Self::Hidden => layers(|p| p.layers.saturating_sub(p.layers_until))?,
                _ => {
                    let truth = Picture::new(image.size, image.to_rgb_f32())?;
                    let test = drawn.get(i).ok_or_else(|| {
                        CommandError::Usage("an error needs a picture: leave --reference out".into())
                    })?;
                    let ppd = crate::measure::DEFAULT_PIXELS_PER_DEGREE;
                    let errors = flip_map(&truth, test, ppd)?;
                    let values = errors.into_iter().map(f64::from);
                    coloured(image.size, values, [0.0, ERROR], ColourMap::Magma)?
                }
            });
        }
        Ok(Some(maps))
    }

    /// The map, whatever it is of, by the reference: a picture for each view.
    ///
    /// `drawn` are the pictures whose error is shown; no other map needs them.
    ///
    /// # Errors
    /// The reference's; a scene without labels, or without levels.
    pub fn pictures(
        self,
        (splats, given): (&Splats, Given),
        classes: &[Class],
        views: &[View],
        config: &RenderConfig,
        drawn: &[Picture],
    ) -> Result<Vec<Picture>, CommandError> {
        if let Some(maps) = self.of_pixels(splats, views, config, drawn)? {
            return Ok(maps);
        }
        let Some(first) = views.first() else { return Ok(Vec::new()) };
        let painted = self.of_splats(splats, first, classes, given)?;
        reference_pictures(painted.as_ref().unwrap_or(splats), views, config, false)
    }

    /// Its colours from the least to the most; none where they are names.
    pub fn colours(self) -> Option<ColourMap> {
        match self {
            Self::Layers | Self::Hidden | Self::ProjectionError | Self::Density | Self::Level => {
                Some(ColourMap::Viridis)
            }
            Self::Error => Some(ColourMap::Magma),
            Self::Labels => None,
        }
    }

    /// The scene with its splats coloured by a quantity of theirs, seen from a view; `None` for a quantity of pixels.
    ///
    /// # Errors
    /// A scene without labels, or without levels.
    pub fn of_splats(
        self,
        splats: &Splats,
        view: &View,
        classes: &[Class],
        given: Given,
    ) -> Result<Option<Splats>, CommandError> {
        let values: Vec<f64> = match self {
            Self::Layers | Self::Hidden | Self::Error => return Ok(None),
            Self::ProjectionError => {
                (0..splats.len()).map(|i| share(projection_error(splats, i, view), PIXELS)).collect()
            }
            Self::Level => given.fineness.ok_or_else(|| {
                let what = "the scene has no levels of detail: open a file of them (.mlod; motes render with --lod-target)";
                CommandError::Usage(what.into())
            })?,
            Self::Density => {
                let counts = Density::of(splats, given.voxel).of_splats;
                counts.into_iter().map(|n| share(f64::from(n), PER_VOXEL)).collect()
            }
            Self::Labels => {
                let labels = splats.labels.as_ref().ok_or_else(|| {
                    CommandError::Usage(
                        "the scene has no labels; merge several files, or label it by motes label".into(),
                    )
                })?;
                let chosen: HashMap<u16, [u8; 3]> = classes.iter().map(|c| (c.id, c.colour)).collect();
                let colour = |id: &u16| chosen.get(id).copied().unwrap_or_else(|| class_colour(*id));
                return Ok(Some(painted(splats, labels.iter().map(colour))));
            }
        };
        Ok(Some(painted(splats, values.into_iter().map(|v| ColourMap::Viridis.colour(v)))))
    }
}

/// The scene with its splats in these colours, from wherever they are seen.
fn painted(splats: &Splats, colours: impl Iterator<Item = [u8; 3]>) -> Splats {
    let mut painted = splats.clone();
    painted.set_sh_degree(0);
    painted.sh = colours.map(|rgb| rgb.map(|c| (f32::from(c) / 255.0 - 0.5) / SH_C0)).collect();
    painted
}

/// Where a value lies between two, on a logarithmic scale: 0 to 1.
fn share(value: f64, [low, high]: [f64; 2]) -> f64 {
    ((value / low).ln() / (high / low).ln()).clamp(0.0, 1.0)
}

/// Root mean square, over the directions within three standard deviations of a splat, of how far the classic projection
/// puts them from where they belong, pixels (003, equation 11, as a mean). Behind the eye and around it: ∞.
fn projection_error(splats: &Splats, i: usize, view: &View) -> f64 {
    let at = view.to_eye(glam::DVec3::from_array(splats.mean_of(i)));
    let distance = at.length();
    if !(at.z > 0.0 && distance > 0.0) {
        return f64::INFINITY;
    }
    let widest = splats.log_scales[i].iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let half = (3.0 * f64::from(widest).exp() / distance).clamp(1e-6, WIDEST);
    let (theta, phi) = ((-at.y / distance).asin(), at.x.atan2(at.z));
    let [fx, fy] = view.focal();
    (epsilon(theta, phi, half) / (4.0 * half * half)).sqrt() * (fx * fy).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use motes_renderer::Fov;
    use motes_scenes::synthetic::Recipe;

    fn view() -> View {
        let fov = Fov { left: -1.5, right: 1.5, up: -1.5, down: 1.5 };
        View::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov, [64, 64])
    }

    fn scene() -> Splats {
        Recipe { count: 50, sh_degree: 3, ..Default::default() }.still()
    }

    #[test]
    fn projection_errors_grow_towards_the_rim_and_with_the_splat() {
        let mut splats = scene();
        splats.origin = Default::default();
        splats.means[0] = [0.0, 0.0, 5.0];
        splats.means[1] = [6.0, 0.0, 5.0];
        splats.means[2] = [6.0, 0.0, 5.0];
        splats.means[3] = [0.0, 0.0, -5.0];
        splats.log_scales[0] = [-3.0; 3];
        splats.log_scales[1] = [-3.0; 3];
        splats.log_scales[2] = [-2.0; 3];
        let error = |i| projection_error(&splats, i, &view());
        assert!(
            error(1) > 2.0 * error(0) && error(2) > 2.0 * error(1),
            "{} {} {}",
            error(0),
            error(1),
            error(2)
        );
        assert_eq!(error(3), f64::INFINITY);
        // The remainder is of second order: a splat of twice the size errs about four times as far.
        splats.log_scales[1] = [-3.0 + std::f32::consts::LN_2; 3];
        let twice = projection_error(&splats, 1, &view());
        splats.log_scales[1] = [-3.0; 3];
        assert!((twice / projection_error(&splats, 1, &view()) - 4.0).abs() < 1.0, "{twice}");
    }

    #[test]
    fn splats_take_the_colour_of_their_quantity() {
        let mut splats = scene();
        assert!(Heat::Labels.of_splats(&splats, &view(), &[], Given::default()).is_err());
        splats.labels = Some((0..50).map(|i| i % 5).collect());
        let classes = [Class { id: 4, name: "four".into(), colour: [10, 20, 30] }];
        let painted = Heat::Labels.of_splats(&splats, &view(), &classes, Given::default()).unwrap().unwrap();
        assert_eq!((painted.sh_degree, painted.sh.len()), (0, 50));
        let colour = |i: usize| painted.sh[i].map(|c| ((0.5 + SH_C0 * c) * 255.0).round() as u8);
        assert_eq!((colour(4), colour(1)), ([10, 20, 30], class_colour(1)));
        let dense = Heat::Density.of_splats(&splats, &view(), &[], Given::default()).unwrap().unwrap();
        let lonely = dense.sh[0].map(|c| ((0.5 + SH_C0 * c) * 255.0).round() as u8);
        assert_eq!(lonely, ColourMap::Viridis.colour(0.0));
        // All of them in one voxel.
        let one = Given { voxel: Some(1e3), ..Given::default() };
        let mut near = splats.clone();
        near.means.iter_mut().flatten().for_each(|v| *v = v.abs());
        let together = Heat::Density.of_splats(&near, &view(), &[], one).unwrap().unwrap();
        assert!(together.sh.iter().all(|c| *c == together.sh[0]) && together.sh[0] != dense.sh[0]);
        assert!(Heat::Level.of_splats(&splats, &view(), &[], Given::default()).is_err());
        let coarsest = Given { fineness: Some(vec![0.0; 50]), ..Given::default() };
        let fine = Heat::Level.of_splats(&splats, &view(), &[], coarsest).unwrap().unwrap();
        assert_eq!(fine.sh[0], dense.sh[0], "the coarsest level has the lowest colour");
        assert!(Heat::Layers.of_splats(&splats, &view(), &[], Given::default()).unwrap().is_none());
        assert!(
            (share(1.0, [0.01, 10.0]) - 2.0 / 3.0).abs() < 1e-12 && share(f64::INFINITY, [1.0, 2.0]) == 1.0
        );
    }

    #[test]
    fn pixels_take_the_colour_of_theirs() {
        let splats = scene();
        let look = View { eye: DVec3::new(0.0, 0.0, -3.0), ..view() };
        let config = RenderConfig::default();
        let layers = Heat::Layers.of_pixels(&splats, &[look], &config, &[]).unwrap().unwrap();
        let hidden = Heat::Hidden.of_pixels(&splats, &[look], &config, &[]).unwrap().unwrap();
        assert_ne!(layers, hidden);
        assert!(Heat::Error.of_pixels(&splats, &[look], &config, &[]).is_err());
        let black = Picture::new([64, 64], vec![[0.0; 3]; 64 * 64]).unwrap();
        let error = &Heat::Error.of_pixels(&splats, &[look], &config, &[black]).unwrap().unwrap()[0];
        // A corner that nothing covers has no error; somewhere there is one.
        assert_eq!(error.to_rgb8()[..3], ColourMap::Magma.colour(0.0));
        assert!(error.to_rgb8().iter().any(|&c| c > 100));
        assert!(Heat::Density.of_pixels(&splats, &[look], &config, &[]).unwrap().is_none());
    }
}
