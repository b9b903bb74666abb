//! What is observed of each level: SSIM of each class in each view, and how near the class is.

use std::path::PathBuf;

use glam::DVec3;
use motes_renderer::View;
use motes_renderer::detail::vote::mask_of;
use motes_renderer::reference::{self, ReferenceOptions};
use motes_scenes::levels::LevelFile;
use motes_scenes::{Scene, Splats};

use crate::error::CommandError;
use crate::measure::{ClassMask, Matching, Picture, SsimMap};
use crate::vantage::Seat;

/// A class in a mask with fewer pixels than this is not observed: its windows reach into its neighbours.
const LEAST_PIXELS: usize = 100;
/// Share of a class's splats in view that may be nearer than its “minimum distance”: floaters do not count.
const NEAREST: f64 = 0.01;
/// Splats less opaque than this do not count for distances.
const OPAQUE: f32 = 0.1;

/// One class of one level in one view.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Observation {
    /// The class.
    pub class: u16,
    /// The view, as an index.
    pub view: usize,
    /// The level's step ([`motes_scenes::levels::Level::step`]).
    pub step: f64,
    /// Smallest distance of the class from the eye, scene units.
    pub distance: f64,
    /// Mean SSIM over the class's mask.
    pub ssim: f64,
    /// Pixels of the mask.
    pub pixels: usize,
}

/// A view, what it should look like, and which pixel is of which class.
pub struct Target {
    /// The view.
    pub view: View,
    /// Its name.
    pub name: String,
    /// A photograph, or the finest level's picture.
    pub truth: Picture,
    /// The classes.
    pub mask: ClassMask,
    /// Smallest distances of the classes, by class; ∞ for those not in view.
    pub distances: Vec<f64>,
}

/// What SSIM is against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Against {
    /// The photographs, as the thesis does it
    Photographs,
    /// The finest level's pictures: what a viewer can lose by a coarser one
    Finest,
}

/// A level of a file as one scene.
///
/// # Errors
/// A range is damaged.
pub fn level(file: &LevelFile, level: usize) -> Result<Splats, CommandError> {
    combined(file, |_| Some(level))
}

/// A scene of groups at levels of their own; `None` leaves a group out.
///
/// # Errors
/// A range is damaged.
pub fn combined(file: &LevelFile, level: impl Fn(usize) -> Option<usize>) -> Result<Splats, CommandError> {
    let mut parts = Vec::new();
    for group in 0..file.groups().len() {
        if let Some(level) = level(group) {
            parts.push(file.read(group, level)?);
        }
    }
    Ok(Scene::joined(parts))
}

/// The views that can be observed: those with a truth (and a mask, where a folder of masks is given; else masks are made
/// from the finest level's labels).
///
/// # Errors
/// A picture cannot be read, or there is no such view.
pub fn targets(
    finest: &Splats,
    seats: &[Seat],
    masks: Option<&PathBuf>,
    against: Against,
    options: &ReferenceOptions,
) -> Result<Vec<Target>, CommandError> {
    let labels = finest.labels.as_deref().unwrap_or_default();
    let highest = usize::from(labels.iter().copied().max().unwrap_or(0));
    let mut targets = Vec::new();
    for seat in seats {
        let truth = match (against, &seat.photograph) {
            (Against::Finest, _) => {
                let image = reference::render(finest, &seat.view, options)?;
                Picture::new(image.size, image.to_rgb_f32())?
            }
            (Against::Photographs, Some(file)) => {
                let picture = Picture::load(file)?;
                if picture.size() == seat.view.size { picture } else { picture.resized(seat.view.size)? }
            }
            (Against::Photographs, None) => continue,
        };
        let mask = match masks {
            Some(folder) => {
                let file = folder.join(format!("{}.png", seat.name));
                if !file.is_file() {
                    continue;
                }
                ClassMask::load(&file)?.resized(seat.view.size)?
            }
            None => ClassMask::new(seat.view.size, mask_of(finest, labels, &seat.view, 0.5, options)?)?,
        };
        let distances = distances(finest, &seat.view, highest);
        targets.push(Target { view: seat.view, name: seat.name.clone(), truth, mask, distances });
    }
    if targets.is_empty() {
        return Err(CommandError::Usage(
            "no view can be judged: it takes photographs beside the cameras (or --against finest), and masks named \
             like them"
                .into(),
        ));
    }
    Ok(targets)
}

/// For each class up to the highest, the distance from the eye that only a hundredth of its opaque splats in view fall
/// short of; ∞ where it is not in view.
pub fn distances(splats: &Splats, view: &View, highest: usize) -> Vec<f64> {
    let mut of_class = vec![Vec::new(); highest + 1];
    for (i, &label) in splats.labels.iter().flatten().enumerate() {
        let at = view.to_eye(DVec3::from_array(splats.mean_of(i)));
        let (x, y) = (at.x / at.z, at.y / at.z);
        let f = view.fov;
        let inside = at.z > 0.0 && (f.left..f.right).contains(&x) && (f.up..f.down).contains(&y);
        if inside && splats.opacities[i] >= OPAQUE && usize::from(label) <= highest {
            of_class[usize::from(label)].push(at.length());
        }
    }
    let nearest = |mut list: Vec<f64>| {
        let at = (list.len() as f64 * NEAREST) as usize;
        if list.is_empty() { f64::INFINITY } else { *list.select_nth_unstable_by(at, f64::total_cmp).1 }
    };
    of_class.into_iter().map(nearest).collect()
}

/// SSIM and pixels of each class, by class; none where it is not observed.
pub type OfClasses = Vec<Option<(f64, usize)>>;

/// SSIM per class (all but 0) of a scene in a view, and over the whole picture; `None` where a class is not observed.
///
/// # Errors
/// The reference's.
pub fn ssim(
    splats: &Splats,
    target: &Target,
    matching: Option<Matching>,
    options: &ReferenceOptions,
) -> Result<(OfClasses, f64), CommandError> {
    let image = reference::render(splats, &target.view, options)?;
    let mut test = Picture::new(image.size, image.to_rgb_f32())?;
    if let Some(matching) = matching {
        test = matching.apply(&target.truth, &test);
    }
    let small = || CommandError::Usage("pictures are too small for SSIM: raise --judge-scale".into());
    let map = SsimMap::new(&target.truth, &test).ok_or_else(small)?;
    let of_class = (0..target.distances.len().max(1)).map(|class| {
        let class = u8::try_from(class).ok().filter(|&c| c > 0)?;
        let pixels = target.mask.classes().iter().filter(|&&c| c == class).count();
        let ssim = map.mean(|x, y| target.mask.class(x, y) == class)?;
        (pixels >= LEAST_PIXELS).then_some((ssim, pixels))
    });
    Ok((of_class.collect(), map.mean(|_, _| true).unwrap_or(1.0)))
}

/// Observes every level from every target.
///
/// # Errors
/// A range is damaged, or the reference's.
pub fn observe(
    file: &LevelFile,
    targets: &[Target],
    matching: Option<Matching>,
    options: &ReferenceOptions,
    mut told: impl FnMut(usize),
) -> Result<Vec<Observation>, CommandError> {
    let mut observations = Vec::new();
    for (k, l) in file.levels().iter().enumerate() {
        told(k);
        let splats = level(file, k)?;
        for (view, target) in targets.iter().enumerate() {
            let (of_class, _) = ssim(&splats, target, matching, options)?;
            for (class, found) in of_class.into_iter().enumerate() {
                let distance = target.distances.get(class).copied().unwrap_or(f64::INFINITY);
                if let Some((ssim, pixels)) = found
                    && distance.is_finite()
                {
                    let class = class as u16;
                    observations.push(Observation { class, view, step: l.step, distance, ssim, pixels });
                }
            }
        }
    }
    Ok(observations)
}
