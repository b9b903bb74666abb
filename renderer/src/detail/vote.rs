//! From classes of pixels to classes of splats, by majority over the views.
//!
//! Two ways to vote:
//! * **By centres**, as the thesis does (`000`, §5.1.2): a splat has one vote a view, that of the pixel that its mean lies
//!   on. Splats behind a wall vote as the wall.
//! * **By visible weight**: each pixel hands its class to its layers, by the share that they have in it, to a power. What is
//!   hidden has no say, and a splat with its mean hidden votes where it shows. A mask knows one class a pixel, that of the
//!   layers with the largest shares: the higher the power, the less a splat listens where it is not among them.
//!
//! Pixels of class 0 are unlabelled and hand out nothing; splats that got no vote stay 0.

use glam::DVec3;
use motes_scenes::Splats;
use rayon::prelude::*;

use super::merge::{SHIFTS, along_curve};
use super::sums::Sums;
use crate::View;
use crate::motion::moment;
use crate::reference::{self, ReferenceError, ReferenceOptions};

/// Neighbours on either side along each of two space-filling curves that have a say.
const NEIGHBOURS: usize = 12;
/// Weight of all neighbours' shares together against a splat's own, if all lay at its place.
const NEIGHBOURS_SAY: f64 = 1.5;

/// Votes of every splat for every class.
pub struct Votes {
    classes: usize,
    sums: Sums,
    splats: usize,
}

/// What an election found.
#[derive(Clone, Debug, PartialEq)]
pub struct Elected {
    /// A class per splat, 0 where nobody voted; of classes with equal votes the first.
    pub labels: Vec<u16>,
    /// Votes for all classes together: pixels of visible weight, or views.
    pub votes: Vec<f64>,
    /// Share of them that the elected class got, `0 ..= 1`.
    pub agreement: Vec<f64>,
}

/// A class per pixel, by rows; as many as the view has pixels.
pub type Classes<'a> = &'a [u8];

impl Votes {
    /// For so many splats, and classes up to (and with) `highest`. Takes 8 bytes a splat and class.
    pub fn new(splats: usize, highest: u8) -> Self {
        let classes = usize::from(highest) + 1;
        Self { classes, sums: Sums::new(splats * classes), splats }
    }

    /// Adds a view's votes by centres: of every splat in front of the eye whose mean lies on the picture and that can
    /// change a pixel at all.
    ///
    /// # Errors
    /// A mask or a scene of the wrong size.
    pub fn by_centres(
        &mut self,
        splats: &Splats,
        view: &View,
        mask: Classes<'_>,
        options: &ReferenceOptions,
    ) -> Result<(), ReferenceError> {
        self.check(splats, view, mask)?;
        let origin = DVec3::from_array(splats.origin);
        let ([fx, fy], [cx, cy], [width, height]) = (view.focal(), view.principal_point(), view.size);
        (0..splats.len()).into_par_iter().for_each(|i| {
            let Some(moment) = moment(splats, i, options.time) else { return };
            let at = view.to_eye(moment.mean + origin);
            if !(moment.opacity >= crate::projection::MIN_ALPHA && at.z > 0.0) {
                return;
            }
            let (x, y) = (cx + fx * at.x / at.z, cy + fy * at.y / at.z);
            if (0.0..f64::from(width)).contains(&x) && (0.0..f64::from(height)).contains(&y) {
                self.add(i, mask[y as usize * width as usize + x as usize], 1.0);
            }
        });
        Ok(())
    }

    /// Adds a view's votes by visible weight to the power of `sharpness` (1 and up).
    ///
    /// # Errors
    /// A mask or a scene of the wrong size, or the reference's.
    pub fn by_weight(
        &mut self,
        splats: &Splats,
        view: &View,
        mask: Classes<'_>,
        sharpness: i32,
        options: &ReferenceOptions,
    ) -> Result<(), ReferenceError> {
        self.check(splats, view, mask)?;
        reference::trace(splats, view, options, |[x, y], pixel| {
            let class = mask[y as usize * view.size[0] as usize + x as usize];
            for layer in pixel {
                self.add(layer.splat as usize, class, layer.weight().powi(sharpness));
            }
        })
    }

    fn add(&self, splat: usize, class: u8, vote: f64) {
        let class = usize::from(class);
        if class > 0 && class < self.classes {
            self.sums.add(splat * self.classes + class, vote);
        }
    }

    fn check(&self, splats: &Splats, view: &View, mask: Classes<'_>) -> Result<(), ReferenceError> {
        if splats.len() != self.splats {
            return Err(ReferenceError::Scene {
                splats: splats.len(),
                array: "sums of an election",
                found: self.splats,
                expected: splats.len(),
            });
        }
        let [width, height] = view.size;
        if mask.len() as u64 != u64::from(width) * u64::from(height) {
            let what = format!("{width} × {height} pixels do not fit a mask of {}", mask.len());
            return Err(ReferenceError::View { what });
        }
        Ok(())
    }

    /// Counts the votes.
    pub fn elect(&self) -> Elected {
        self.count(&self.sums.values().collect::<Vec<f64>>())
    }

    /// Counts the votes after neighbours have had a say: to each splat's own shares of the classes those of its neighbours are
    /// added, less the farther off they are. Classes are things, and things hang together; a splat that only shows together
    /// with others of another class has no other way to its own.
    pub fn elect_among_neighbours(&self, splats: &Splats) -> Elected {
        let own: Vec<f64> = self.sums.values().collect();
        let shares: Vec<f64> = (own.par_chunks_exact(self.classes))
            .flat_map_iter(|votes| {
                let all: f64 = votes.iter().sum();
                votes.iter().map(move |v| if all > 0.0 { v / all } else { 0.0 })
            })
            .collect();
        let mut sums = shares.clone();
        let mean = |i: u32| DVec3::from_array(splats.means[i as usize].map(f64::from));
        for shift in SHIFTS {
            let curve = along_curve(splats, shift);
            let said: Vec<(u32, Vec<f64>)> = (0..curve.len())
                .into_par_iter()
                .map(|at| {
                    let i = curve[at];
                    let near = at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(curve.len());
                    let others = near.filter(|&k| k != at).map(|k| curve[k]);
                    let mut distances: Vec<(f64, u32)> =
                        others.map(|j| (mean(i).distance_squared(mean(j)), j)).collect();
                    distances.sort_by(|a, b| a.0.total_cmp(&b.0));
                    distances.truncate(NEIGHBOURS);
                    let middle = distances.get(distances.len() / 2).map_or(1.0, |d| d.0).max(1e-30);
                    let mut sum = vec![0.0; self.classes];
                    for (square, j) in distances {
                        let weight = (-square / middle).exp() / NEIGHBOURS as f64;
                        let theirs = &shares[j as usize * self.classes..][..self.classes];
                        sum.iter_mut().zip(theirs).for_each(|(s, t)| *s += weight * t);
                    }
                    (i, sum)
                })
                .collect();
            for (i, sum) in said {
                let mine = &mut sums[i as usize * self.classes..][..self.classes];
                mine.iter_mut().zip(sum).for_each(|(m, s)| *m += NEIGHBOURS_SAY * s);
            }
        }
        let mut elected = self.count(&sums);
        elected.votes = own.chunks_exact(self.classes).map(|votes| votes.iter().sum()).collect();
        elected
    }

    fn count(&self, sums: &[f64]) -> Elected {
        let mut elected = Elected {
            labels: Vec::with_capacity(self.splats),
            votes: Vec::with_capacity(self.splats),
            agreement: Vec::with_capacity(self.splats),
        };
        for votes in sums.chunks_exact(self.classes) {
            let mut best = 0;
            for class in 1..votes.len() {
                if votes[class] > votes[best] {
                    best = class;
                }
            }
            let all: f64 = votes.iter().sum();
            elected.labels.push(best as u16);
            elected.votes.push(all);
            elected.agreement.push(if all > 0.0 { votes[best] / all } else { 0.0 });
        }
        elected
    }
}

/// The class with the largest blended weight at every pixel, by rows; 0 where less than `least` of the pixel is covered
/// by labelled splats. Labels above 255 do not fit a mask and count as unlabelled.
///
/// # Errors
/// The reference's, or labels of another scene.
pub fn mask_of(
    splats: &Splats,
    labels: &[u16],
    view: &View,
    least: f64,
    options: &ReferenceOptions,
) -> Result<Vec<u8>, ReferenceError> {
    if labels.len() != splats.len() {
        return Err(ReferenceError::Scene {
            splats: splats.len(),
            array: "labels",
            found: labels.len(),
            expected: splats.len(),
        });
    }
    let width = view.size[0] as usize;
    let mask: Vec<_> =
        (0..width * view.size[1] as usize).map(|_| std::sync::atomic::AtomicU8::new(0)).collect();
    reference::trace(splats, view, options, |[x, y], pixel| {
        let mut sums = [0.0; 256];
        for layer in pixel {
            if let Some(sum) = sums.get_mut(usize::from(labels[layer.splat as usize])) {
                *sum += layer.weight();
            }
        }
        sums[0] = 0.0;
        let mut best = 0;
        for class in 1..sums.len() {
            if sums[class] > sums[best] {
                best = class;
            }
        }
        if sums.iter().sum::<f64>() >= least {
            mask[y as usize * width + x as usize].store(best as u8, std::sync::atomic::Ordering::Relaxed);
        }
    })?;
    Ok(mask.into_iter().map(std::sync::atomic::AtomicU8::into_inner).collect())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ahead, balls};
    use super::*;

    /// A wall of class 1 hides a ball of class 2 from one side; from the other it is seen.
    #[test]
    fn visible_weight_respects_occlusion_and_centres_do_not() {
        let mut list = vec![([0.0, 0.0, 6.0], 0.4, 0.95, [0.0, 0.0, 1.0])];
        for k in 0..400 {
            let (x, y) = ((k % 20) as f32 - 9.5, (k / 20) as f32 - 9.5);
            list.push(([0.2 * x, 0.2 * y, 4.0], 0.2, 0.99, [1.0, 1.0, 0.0]));
        }
        let splats = balls(&list);
        let truth: Vec<u16> = (0..list.len()).map(|i| if i == 0 { 2 } else { 1 }).collect();
        let options = ReferenceOptions::default();
        let front = ahead();
        let back = View::look_at(DVec3::Z * 10.0, DVec3::ZERO, DVec3::NEG_Y, front.fov, front.size);
        // Three views from the front, one from behind.
        let votes = || Votes::new(splats.len(), 2);
        let (mut centres, mut weights, mut blunt) = (votes(), votes(), votes());
        for view in [front, front, front, back] {
            let mask = mask_of(&splats, &truth, &view, 0.5, &options).unwrap();
            centres.by_centres(&splats, &view, &mask, &options).unwrap();
            weights.by_weight(&splats, &view, &mask, 3, &options).unwrap();
            blunt.by_weight(&splats, &view, &mask, 1, &options).unwrap();
        }
        let (centres, weights) = (centres.elect(), weights.elect());
        assert!(weights.labels == truth);
        assert!(weights.agreement[0] > 0.6 && weights.votes[0] > 1.0);
        // Control: by centres the ball is outvoted by the wall in front of it.
        assert_eq!((centres.labels[0], centres.votes[0]), (1, 4.0));
        // And plain weights listen to its faint rim, where the mask is the wall's.
        assert!(blunt.elect().agreement[0] < weights.agreement[0] - 0.1);
    }

    #[test]
    fn what_nobody_sees_and_what_is_unlabelled_stays_0() {
        let splats = balls(&[([0.0, 0.0, 3.0], 0.3, 0.8, [1.0; 3]), ([0.0, 0.0, -3.0], 0.3, 0.8, [1.0; 3])]);
        let (view, options) = (ahead(), ReferenceOptions::default());
        let mut votes = Votes::new(2, 3);
        let mask = |class: u8| vec![class; 32 * 32];
        votes.by_weight(&splats, &view, &mask(0), 2, &options).unwrap();
        votes.by_weight(&splats, &view, &mask(200), 2, &options).unwrap();
        assert_eq!(votes.elect().labels, [0, 0]);
        votes.by_weight(&splats, &view, &mask(3), 2, &options).unwrap();
        let elected = votes.elect();
        assert_eq!((elected.labels, elected.agreement), (vec![3, 0], vec![1.0, 0.0]));
        assert!(votes.by_weight(&splats, &view, &[1; 5], 1, &options).is_err());
        assert!(Votes::new(3, 3).by_centres(&splats, &view, &mask(1), &options).is_err());
        assert!(mask_of(&splats, &[1], &view, 0.5, &options).is_err());
    }
}
