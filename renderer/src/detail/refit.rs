//! Colours and opacities that bring a thinned scene's pictures back to those of the whole scene.
//!
//! A pixel is linear in the spherical-harmonics coefficients of its layers, `C = Σ w c(d)` with `w = T α`, and to first order
//! in the logarithms of their opacities, with derivatives `T α (c − B)`, `B` the colour behind. So the sum of squares over all
//! pixels of all views is brought down by Gauss–Newton steps. Each solves `(AᵀA + D) δ = Aᵀr` by conjugate gradients with
//! `AᵀA`'s diagonal as preconditioner (Nocedal and Wright 2006, algorithms 5.3 and 10.2); the product `AᵀA p` is one pass over
//! the recorded layers ([`Recording`]), the matrix is never there. `D` holds back what hardly shows, and bands that few
//! directions tell apart. A step that makes the sum larger is shortened until it does not. Shapes and places stay.

use glam::Vec3;
use motes_scenes::{Splats, sh_coefficients};
use rayon::prelude::*;

use super::recording::{Lit, Recorded, Recording};
use crate::View;
use crate::reference::{self, ReferenceError, ReferenceOptions};

/// Share of the diagonal that is added to it.
const DAMPING: f32 = 1e-3;
/// What is added to the diagonal besides, in pixels of full weight: for base colours, for each further band as many times more
/// as it has coefficients, and for opacities.
const FLOOR: f32 = 1e-2;
/// Largest change of an opacity's logarithm in one step, where the first order does not reach.
const LARGEST_STEP: f32 = 0.5;
/// Opacities stay between the least that shows and what a pixel takes from one splat.
const OPACITIES: [f32; 2] = [1.0 / 255.0, 0.99];
/// A step is halved so often before it is given up.
const HALVINGS: u32 = 4;
/// Sums are made over so many groups of views at once, and then in order: equal on every machine.
const GROUPS: usize = 4;

/// What a view is to look like.
#[derive(Clone)]
pub struct Goal {
    /// From where.
    pub view: View,
    /// sRGB-encoded colours by rows, background included.
    pub pixels: Vec<[f32; 3]>,
}

impl Goal {
    /// The view's picture of a scene.
    ///
    /// # Errors
    /// The reference's.
    pub fn of(splats: &Splats, view: &View, options: &ReferenceOptions) -> Result<Self, ReferenceError> {
        Ok(Self { view: *view, pixels: reference::render(splats, view, options)?.to_rgb_f32() })
    }

    /// What a recording from these views shows.
    pub fn of_recording(splats: &Splats, views: &[View], recording: &Recording) -> Vec<Self> {
        let goal = |(&view, pixels)| Self { view, pixels };
        views.iter().zip(recording.pictures(splats)).map(goal).collect()
    }
}

/// How far a fit goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Gauss–Newton steps.
    pub steps: usize,
    /// Conjugate gradients in each: passes over all layers.
    pub passes: usize,
}

/// Fits colours and opacities to goals, whose views the recording was made from, in their order. Returns the mean square
/// residual, over pixels and channels, before and after.
///
/// # Errors
/// Goals that are not of the recording's pictures.
pub fn refit(
    splats: &mut Splats,
    recording: &Recording,
    goals: &[Goal],
    effort: Effort,
) -> Result<[f64; 2], ReferenceError> {
    let fit = Fit::new(recording, goals, splats)?;
    let pixels: usize = goals.iter().map(|g| g.pixels.len()).sum();
    let mean = |squares: f64| squares / (3 * pixels.max(1)) as f64;
    let first = fit.squares(splats);
    let mut last = first;
    for _ in 0..effort.steps {
        let (gradient, diagonal) = fit.linearised(splats);
        let step = fit.solved(splats, gradient, &diagonal, effort.passes);
        let before = (splats.sh.clone(), splats.opacities.clone());
        let mut share = 1.0;
        for _ in 0..HALVINGS {
            fit.apply(splats, &step, share);
            let squares = fit.squares(splats);
            if squares < last {
                last = squares;
                share = 0.0;
                break;
            }
            splats.sh.clone_from(&before.0);
            splats.opacities.clone_from(&before.1);
            share *= 0.5;
        }
        if share != 0.0 {
            break;
        }
    }
    Ok([mean(first), mean(last)])
}

/// The least-squares problem. A vector holds for each splat its coefficients, three channels each, and its opacity's logarithm.
struct Fit<'a> {
    recording: &'a Recording,
    goals: &'a [Goal],
    coefficients: usize,
    length: usize,
}

impl<'a> Fit<'a> {
    fn new(recording: &'a Recording, goals: &'a [Goal], splats: &Splats) -> Result<Self, ReferenceError> {
        let views = recording.views();
        if views.len() != goals.len() || views.iter().zip(goals).any(|(v, g)| v.pixels() != g.pixels.len()) {
            let what =
                format!("{} goals are not what {} pictures were recorded for", goals.len(), views.len());
            return Err(ReferenceError::View { what });
        }
        let coefficients = sh_coefficients(recording.degree());
        Ok(Self { recording, goals, coefficients, length: splats.len() * (3 * coefficients + 1) })
    }

    fn stride(&self) -> usize {
        3 * self.coefficients + 1
    }

    /// Sums over the views of what `work` adds to a vector of some length.
    fn sum(
        &self,
        length: usize,
        work: impl Fn(&Recorded, &Goal, &mut [f32]) -> f64 + Sync,
    ) -> (Vec<f32>, f64) {
        let groups: Vec<(Vec<f32>, f64)> = (0..GROUPS)
            .into_par_iter()
            .map(|group| {
                let mut sum = vec![0.0; length];
                let views = self.recording.views().iter().zip(self.goals).skip(group).step_by(GROUPS);
                let squares = views.map(|(view, goal)| work(view, goal, &mut sum)).sum();
                (sum, squares)
            })
            .collect();
        let mut all = (vec![0.0; length], 0.0);
        for (sum, squares) in groups {
            all.0.iter_mut().zip(sum).for_each(|(a, b)| *a += b);
            all.1 += squares;
        }
        all
    }

    /// The sum of squares.
    fn squares(&self, splats: &Splats) -> f64 {
        let squares = |view: &Recorded, goal: &Goal, _: &mut [f32]| {
            let mut squares = 0.0;
            let colours = view.colours(splats, self.recording.degree());
            self.recording.each_pixel(view, splats, &colours, |pixel, colour, _| {
                squares += f64::from((Vec3::from(goal.pixels[pixel]) - colour).length_squared());
            });
            squares
        };
        self.sum(0, squares).1
    }

    /// `Aᵀr` and the diagonal of `AᵀA`.
    fn linearised(&self, splats: &Splats) -> (Vec<f32>, Vec<f32>) {
        let (stride, opacity) = (self.stride(), self.stride() - 1);
        let work = |view: &Recorded, goal: &Goal, sum: &mut [f32]| {
            let colours = view.colours(splats, self.recording.degree());
            let mut found = vec![Found::default(); colours.len()];
            self.recording.each_pixel(view, splats, &colours, |pixel, colour, layers| {
                let residual = Vec3::from(goal.pixels[pixel]) - colour;
                for layer in layers {
                    let found = &mut found[layer.at];
                    found.along += residual * layer.weight;
                    found.square += layer.weight * layer.weight;
                    if layer.free() {
                        found.opacity += layer.change.dot(residual);
                        found.opacity_square += layer.change.length_squared();
                    }
                }
            });
            let (gradient, diagonal) = sum.split_at_mut(self.length);
            for ((&i, found), colour) in view.splats().iter().zip(&found).zip(&colours) {
                let basis = view.basis(splats, i as usize);
                let (shown, at) = (shown(*colour), i as usize * stride);
                let along = found.along * shown;
                for (k, y) in basis.into_iter().take(self.coefficients).enumerate() {
                    for c in 0..3 {
                        gradient[at + 3 * k + c] += y * along[c];
                        diagonal[at + 3 * k + c] += y * y * found.square * shown[c];
                    }
                }
                gradient[at + opacity] += found.opacity;
                diagonal[at + opacity] += found.opacity_square;
            }
            0.0
        };
        let (mut gradient, _) = self.sum(2 * self.length, work);
        let diagonal = gradient.split_off(self.length);
        (gradient, diagonal)
    }

    /// `AᵀA p`.
    fn product(&self, splats: &Splats, p: &[f32]) -> Vec<f32> {
        let (stride, opacity) = (self.stride(), self.stride() - 1);
        let work = |view: &Recorded, _: &Goal, sum: &mut [f32]| {
            let colours = view.colours(splats, self.recording.degree());
            // What `p` changes about each splat's colour from here, and its opacity.
            let change_of = |(&i, colour): (&u32, &Vec3)| {
                let basis = view.basis(splats, i as usize);
                let p = &p[i as usize * stride..][..stride];
                let coefficients = p[..opacity].chunks_exact(3).zip(basis);
                let sum = coefficients.fold(Vec3::ZERO, |sum, (p, y)| sum + Vec3::from_slice(p) * y);
                (sum * shown(*colour), p[opacity])
            };
            let changes: Vec<(Vec3, f32)> = view.splats().iter().zip(&colours).map(change_of).collect();
            let mut found = vec![Found::default(); colours.len()];
            self.recording.each_pixel(view, splats, &colours, |_, _, layers| {
                let of = |layer: &Lit| {
                    let (colour, opacity) = changes[layer.at];
                    let opacity = if layer.free() { opacity } else { 0.0 };
                    colour * layer.weight + layer.change * opacity
                };
                let pixel: Vec3 = layers.iter().map(of).sum();
                for layer in layers {
                    let found = &mut found[layer.at];
                    found.along += pixel * layer.weight;
                    if layer.free() {
                        found.opacity += layer.change.dot(pixel);
                    }
                }
            });
            for ((&i, found), colour) in view.splats().iter().zip(&found).zip(&colours) {
                let basis = view.basis(splats, i as usize);
                let sum = &mut sum[i as usize * stride..][..stride];
                let along = found.along * shown(*colour);
                for (sum, y) in sum.chunks_exact_mut(3).zip(&basis[..self.coefficients]) {
                    for c in 0..3 {
                        sum[c] += y * along[c];
                    }
                }
                sum[opacity] += found.opacity;
            }
            0.0
        };
        self.sum(self.length, work).0
    }

    /// What is added to the diagonal.
    fn damping(&self, diagonal: &[f32]) -> Vec<f32> {
        let stride = self.stride();
        let floor = |at: usize| match at % stride {
            k if k == stride - 1 => FLOOR,
            k => FLOOR * [1.0, 3.0, 5.0, 7.0][((k / 3) as f32).sqrt() as usize],
        };
        diagonal.iter().enumerate().map(|(at, d)| d * DAMPING + floor(at)).collect()
    }

    /// The step, by so many conjugate gradients.
    fn solved(&self, splats: &Splats, mut residual: Vec<f32>, diagonal: &[f32], passes: usize) -> Vec<f32> {
        let damping = self.damping(diagonal);
        let conditioned = |r: &[f32]| -> Vec<f32> {
            r.iter().zip(diagonal.iter().zip(&damping)).map(|(r, (d, e))| r / (d + e)).collect()
        };
        let mut step = vec![0.0; self.length];
        let mut z = conditioned(&residual);
        let mut p = z.clone();
        let mut rz = dot(&residual, &z);
        for _ in 0..passes {
            if !(rz > 0.0) {
                break;
            }
            let mut q = self.product(splats, &p);
            q.iter_mut().zip(p.iter().zip(&damping)).for_each(|(q, (p, d))| *q += p * d);
            let curvature = dot(&p, &q);
            if !(curvature > 0.0) {
                break;
            }
            let along = (rz / curvature) as f32;
            step.iter_mut().zip(&p).for_each(|(s, p)| *s += p * along);
            residual.iter_mut().zip(&q).for_each(|(r, q)| *r -= q * along);
            z = conditioned(&residual);
            let next = dot(&residual, &z);
            let turn = (next / rz) as f32;
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + *p * turn);
            rz = next;
        }
        step
    }

    /// Adds a share of a step.
    fn apply(&self, splats: &mut Splats, step: &[f32], share: f32) {
        let stored = sh_coefficients(splats.sh_degree);
        for (i, step) in step.chunks_exact(self.stride()).enumerate() {
            let (colours, opacity) = step.split_at(self.stride() - 1);
            for (k, add) in colours.chunks_exact(3).enumerate() {
                let sum = &mut splats.sh[i * stored + k];
                *sum = std::array::from_fn(|c| sum[c] + add[c] * share);
            }
            let before = splats.opacities[i];
            // A splat outside of the bounds keeps its own opacity as its bound.
            let [low, high] = [OPACITIES[0].min(before), OPACITIES[1].max(before)];
            let change = (opacity[0] * share).clamp(-LARGEST_STEP, LARGEST_STEP).exp();
            splats.opacities[i] = (before * change).clamp(low, high);
        }
    }
}

/// What a picture says about one of its splats.
#[derive(Clone, Copy, Default)]
struct Found {
    along: Vec3,
    square: f32,
    opacity: f32,
    opacity_square: f32,
}

/// Which channels of a colour follow its coefficients: a negative sum is black, whatever is added.
fn shown(colour: Vec3) -> Vec3 {
    Vec3::select(colour.cmpgt(Vec3::ZERO), Vec3::ONE, Vec3::ZERO)
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// The mean square residual, over pixels and channels, of the reference's own pictures.
///
/// # Errors
/// The reference's.
pub fn residual(splats: &Splats, goals: &[Goal], options: &ReferenceOptions) -> Result<f64, ReferenceError> {
    let (mut squares, mut pixels) = (0.0, 0usize);
    for Goal { view, pixels: goal } in goals {
        let image = reference::render(splats, view, options)?;
        for (p, q) in image.pixels.iter().zip(goal) {
            let colour = glam::DVec3::from(p.colour);
            squares += colour.distance_squared(Vec3::from(*q).as_dvec3());
        }
        pixels += goal.len();
    }
    Ok(squares / (3 * pixels.max(1)) as f64)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ahead, balls};
    use super::*;

    fn scene() -> Splats {
        balls(&[
            ([0.0, 0.0, 3.0], 0.5, 0.6, [0.8, 0.2, 0.1]),
            ([0.4, 0.1, 3.5], 0.6, 0.7, [0.2, 0.7, 0.3]),
            ([-0.3, 0.3, 4.0], 0.9, 0.9, [0.3, 0.3, 0.9]),
        ])
    }

    fn fitted(wrong: &mut Splats, goals: &[Goal], effort: Effort) -> [f64; 2] {
        let views = goals.iter().map(|g| &g.view);
        let recording = Recording::of(wrong, views, &ReferenceOptions::default()).unwrap();
        refit(wrong, &recording, goals, effort).unwrap()
    }

    #[test]
    fn colours_and_opacities_come_back() {
        let options = ReferenceOptions::default();
        let truth = scene();
        let goals = [Goal::of(&truth, &ahead(), &options).unwrap()];
        let mut wrong = truth.clone();
        wrong.sh[0][0] -= 0.5;
        wrong.sh[2][1] += 0.4;
        let [before, after] = fitted(&mut wrong, &goals, Effort { steps: 2, passes: 6 });
        // What is left is what the damping holds back in two steps.
        assert!(after < 1e-3 * before, "{before} {after}");
        // Colours and opacities are fitted together: from one side, a little of one stands for a little of the other.
        assert!((wrong.sh[0][0] - truth.sh[0][0]).abs() < 0.1, "{:?}", wrong.sh);

        let mut wrong = truth.clone();
        wrong.opacities = vec![0.5, 0.8, 0.85];
        let [before, after] = fitted(&mut wrong, &goals, Effort { steps: 8, passes: 6 });
        assert!(after < 0.01 * before, "{before} {after}");
        assert!((wrong.opacities[0] - 0.6).abs() < 0.03, "{:?}", wrong.opacities);
    }

    /// What a splat shows to the left and to the right needs its second band, and takes it from pictures of both sides.
    #[test]
    fn directional_colours_come_back() {
        let options = ReferenceOptions::default();
        let mut truth = balls(&[([0.0, 0.0, 3.0], 0.5, 0.8, [0.5; 3])]);
        truth.set_sh_degree(1);
        let mut wrong = truth.clone();
        truth.sh[3] = [0.4, -0.2, 0.0];
        let views = [-2.0, 0.0, 2.0].map(|x| {
            let eye = glam::DVec3::new(x, 0.0, 0.0);
            View::look_at(eye, glam::DVec3::Z * 3.0, glam::DVec3::NEG_Y, ahead().fov, [32, 32])
        });
        let goals = views.map(|v| Goal::of(&truth, &v, &options).unwrap());
        let [before, after] = fitted(&mut wrong, &goals, Effort { steps: 2, passes: 8 });
        assert!(after < 1e-4 * before, "{before} {after}");
        assert!((wrong.sh[3][0] - 0.4).abs() < 0.02, "{:?}", wrong.sh);
    }

    #[test]
    fn what_fits_already_is_left_alone_and_a_wrong_goal_is_refused() {
        let options = ReferenceOptions::default();
        let mut splats = scene();
        let goals = [Goal::of(&splats, &ahead(), &options).unwrap()];
        let [first, last] = fitted(&mut splats, &goals, Effort { steps: 1, passes: 2 });
        assert!(first < 1e-10 && last <= first, "{first} {last}");
        let recording = Recording::of(&splats, [&ahead()], &options).unwrap();
        let bad = [Goal { view: ahead(), pixels: vec![[0.0; 3]; 7] }];
        assert!(refit(&mut splats, &recording, &bad, Effort { steps: 1, passes: 1 }).is_err());
        assert!(refit(&mut splats, &recording, &[], Effort { steps: 1, passes: 1 }).is_err());
    }
}
