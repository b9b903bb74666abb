//! A scripted walk through a scene whose levels are chosen on the way: what it saves, what that costs in quality, and whether
//! a change of levels is seen.
//!
//! Every frame's own view is drawn with the levels of the frame before and with its own: what differs is the change's doing
//! alone, and not the walk's. Beside it, what the same change would do at once, without a cross-fade.

use glam::DQuat;
use motes_app::lod::{Levels, Tuning};
use motes_renderer::parts::Parts;
use motes_renderer::{Offscreen, RenderConfig, SceneOnDevice, View};

use crate::error::CommandError;
use crate::measure::{Picture, SsimMap};
use crate::studio::picture_of;

/// Side of the blocks over which a change is averaged, pixels.
const BLOCK: usize = 16;

/// How a walk is measured.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Frames a second.
    pub rate: f64,
    /// Of so many frames, one is compared with the finest level.
    pub every: usize,
}

/// A frame that was compared with the finest level.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Compared {
    /// Its number.
    pub frame: usize,
    /// Layers drawn per pixel, as chosen and at the finest level.
    pub layers: [f64; 2],
    /// Splats sorted and projected, as chosen and at the finest level of the regions in view.
    pub splats: [u32; 2],
    /// SSIM to the finest level.
    pub ssim: f64,
}

/// What a walk came to.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Walked {
    /// The frames that were compared.
    pub compared: Vec<Compared>,
    /// Changes of a region's level in view.
    pub changes: usize,
    /// Largest difference of two successive frames by a change of levels: mean over a block, steps of 1/255.
    pub step: f64,
    /// What it would have been without a cross-fade.
    pub hard_step: f64,
}

impl Walked {
    /// Mean of a figure over the compared frames.
    pub fn mean(&self, figure: impl Fn(&Compared) -> f64) -> f64 {
        self.compared.iter().map(figure).sum::<f64>() / self.compared.len().max(1) as f64
    }
}

/// Views from the first of some to the last, at a constant speed on straight lines between them.
pub fn path(stations: &[View], frames: usize) -> Vec<View> {
    let Some(first) = stations.first() else { return Vec::new() };
    let mut reached = vec![0.0];
    for pair in stations.windows(2) {
        reached.push(reached[reached.len() - 1] + pair[0].eye.distance(pair[1].eye));
    }
    let length = reached[reached.len() - 1];
    let view = |k: usize| {
        let at = length * k as f64 / (frames.max(2) - 1) as f64;
        let next = reached.partition_point(|&r| r <= at).clamp(1, stations.len().max(2) - 1);
        let (Some(a), Some(b)) = (stations.get(next - 1), stations.get(next)) else { return *first };
        let t = ((at - reached[next - 1]) / (reached[next] - reached[next - 1]).max(1e-12)).clamp(0.0, 1.0);
        let turn = |v: &View| DQuat::from_mat3(&v.rotation);
        let rotation = glam::DMat3::from_quat(turn(a).slerp(turn(b), t));
        // Of one lens all the way: a change of angle is no walk.
        View { rotation, eye: a.eye.lerp(b.eye, t), fov: first.fov, size: first.size }
    };
    (0..frames).map(view).collect()
}

/// What takes the pictures of a walk.
pub struct Tripod<'a> {
    /// All levels, on the device.
    pub scene: &'a SceneOnDevice,
    /// Draws them.
    pub offscreen: &'a mut Offscreen,
    /// How.
    pub config: &'a RenderConfig,
}

impl Tripod<'_> {
    fn picture(&mut self, parts: &Parts, view: &View) -> Result<Picture, CommandError> {
        self.scene.positions.choose(Some(parts.clone()));
        let (pictures, _) = self.offscreen.render(self.scene, &[*view], self.config)?;
        pictures
            .first()
            .map(picture_of)
            .unwrap_or_else(|| Err(CommandError::Usage("there is no picture".into())))
    }

    fn layers(&mut self, parts: &Parts, view: &View) -> Result<f64, CommandError> {
        self.scene.positions.choose(Some(parts.clone()));
        let (maps, _) = self.offscreen.layers(self.scene, &[*view], self.config)?;
        Ok(maps.first().map_or(0.0, |m| m.mean_shaded()))
    }
}

/// Walks along views, one a frame.
///
/// # Errors
/// The driver's; pictures too small to compare.
pub fn walk(
    levels: &Levels,
    tripod: &mut Tripod<'_>,
    views: &[View],
    tuning: Tuning,
    pace: Pace,
    mut told: impl FnMut(usize),
) -> Result<Walked, CommandError> {
    let mut choice = levels.choice(tuning);
    let mut walked = Walked::default();
    for (frame, view) in views.iter().enumerate() {
        told(frame);
        let before = levels.parts(choice.shares());
        let old: Vec<_> = choice.levels().collect();
        let goes_on = choice.advance(&[*view], 1.0 / pace.rate, 0.0) && frame > 0;
        let now = levels.parts(choice.shares());
        let new: Vec<_> = choice.levels().collect();
        if goes_on && before != now {
            let step = largest_block(&tripod.picture(&before, view)?, &tripod.picture(&now, view)?);
            walked.step = walked.step.max(step);
        }
        let changes =
            old.iter().zip(&new).filter(|(old, new)| old.is_some() && new.is_some() && old != new).count();
        if frame > 0 && changes > 0 {
            walked.changes += changes;
            let step = largest_block(
                &tripod.picture(&at_once(levels, &old), view)?,
                &tripod.picture(&at_once(levels, &new), view)?,
            );
            walked.hard_step = walked.hard_step.max(step);
        }
        if frame.is_multiple_of(pace.every.max(1)) {
            let finest = at_once(levels, &new.iter().map(|l| l.map(|_| 0)).collect::<Vec<_>>());
            let (test, truth) = (tripod.picture(&now, view)?, tripod.picture(&finest, view)?);
            let small = || CommandError::Usage("pictures are too small for SSIM: raise --scale".into());
            let ssim = SsimMap::new(&truth, &test).and_then(|m| m.mean(|_, _| true)).ok_or_else(small)?;
            let layers = [tripod.layers(&now, view)?, tripod.layers(&finest, view)?];
            let splats = [now.splats(), finest.splats()];
            walked.compared.push(Compared { frame, layers, splats, ssim });
        }
    }
    Ok(walked)
}

/// Regions at levels without cross-fades; those without a level are left out.
fn at_once(levels: &Levels, of_regions: &[Option<usize>]) -> Parts {
    levels.parts(of_regions.iter().enumerate().filter_map(|(region, level)| Some((region, (*level)?, 1.0))))
}

/// The largest mean difference of a block, steps of 1/255.
fn largest_block(a: &Picture, b: &Picture) -> f64 {
    let [width, height] = a.size().map(|s| s as usize);
    let off =
        |i: usize| (0..3).map(|c| f64::from((a.pixels()[i][c] - b.pixels()[i][c]).abs())).sum::<f64>() / 3.0;
    let block = |x: usize, y: usize| {
        let (right, bottom) = ((x + BLOCK).min(width), (y + BLOCK).min(height));
        let sum: f64 = (y..bottom).flat_map(|y| (x..right).map(move |x| y * width + x)).map(off).sum();
        255.0 * sum / ((right - x) * (bottom - y)) as f64
    };
    let corners = (0..height).step_by(BLOCK).flat_map(|y| (0..width).step_by(BLOCK).map(move |x| (x, y)));
    corners.map(|(x, y)| block(x, y)).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use motes_renderer::Fov;

    #[test]
    fn a_walk_goes_at_one_speed_from_end_to_end() {
        let at = |x: f64| {
            View::look_at(
                DVec3::X * x,
                DVec3::X * x + DVec3::Z,
                DVec3::NEG_Y,
                Fov::vertical(1.0, [64, 48]),
                [64, 48],
            )
        };
        let walk = path(&[at(0.0), at(1.0), at(4.0)], 9);
        let places: Vec<f64> = walk.iter().map(|v| v.eye.x).collect();
        assert!(places.iter().zip(0..).all(|(x, k)| (x - 0.5 * f64::from(k)).abs() < 1e-9), "{places:?}");
        assert!(walk.iter().all(|v| v.check().is_ok()));
        assert!(path(&[], 5).is_empty());
        assert_eq!(path(&[at(2.0)], 3), [at(2.0); 3]);
    }

    #[test]
    fn a_change_is_measured_where_it_is_largest() {
        let black = Picture::new([40, 40], vec![[0.0; 3]; 1600]).unwrap();
        let mut pixels = vec![[0.0; 3]; 1600];
        // A corner block of 8 × 8 pixels, half of them one step brighter.
        (32..40).for_each(|y| (32..36).for_each(|x| pixels[y * 40 + x] = [1.0 / 255.0; 3]));
        let spot = Picture::new([40, 40], pixels).unwrap();
        assert!((largest_block(&black, &spot) - 0.5).abs() < 1e-5);
        assert_eq!(largest_block(&spot, &spot), 0.0);
    }
}
