//! Generated scenes: repeatable, valid, and moving along the paths that they are meant to move on.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail them")]

mod common;

use common::{angle, defect};
use glam::{DQuat, DVec3};
use motes_scenes::Splats;
use motes_scenes::synthetic::{Animation, Recipe};

#[test]
fn equal_recipes_give_equal_scenes_and_seeds_give_others() {
    let recipe = Recipe { count: 2000, sh_degree: 2, seed: 9, bounds: 3.0, log_scales: [-5.0, -1.0] };
    let splats = recipe.still();
    assert_eq!(splats, recipe.still());
    assert_eq!(recipe.moving(&Animation::default()), recipe.moving(&Animation::default()));
    assert_ne!(splats.means, Recipe { seed: 10, ..recipe }.still().means);
    // A shorter scene is the beginning of a longer one.
    assert_eq!(splats.means[..5], Recipe { count: 5, ..recipe }.still().means);
    // Pinned, so that a change of the generator is a decision.
    assert_eq!(splats.means[1999].map(f32::to_bits), PINNED);
}

/// The last mean of the test above.
const PINNED: [u32; 3] = [1_072_418_824, 1_061_017_384, 1_064_774_812];

#[test]
fn scenes_are_valid_and_within_their_recipe() {
    for sh_degree in 0..=3 {
        let recipe =
            Recipe { count: 3000, sh_degree, bounds: 2.0, log_scales: [-6.0, -2.0], ..Recipe::default() };
        for splats in [recipe.still(), recipe.moving(&Animation::default())] {
            assert_eq!((splats.len(), splats.sh_degree), (3000, sh_degree));
            assert_eq!(defect(&splats), None);
            assert!(splats.log_scales.as_flattened().iter().all(|v| (-6.0..=-2.0).contains(v)));
            assert!(splats.opacities.iter().all(|v| (0.05..=1.0).contains(v)));
        }
        let splats = recipe.still();
        let reach = splats.means.as_flattened().iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(reach <= 2.0 && reach > 1.99);
    }
    assert!(Recipe { count: 0, ..Recipe::default() }.moving(&Animation::default()).is_empty());
}

/// Position and rotation of splat `i` at `t`, from the scene's coefficients.
fn evaluate(splats: &Splats, i: usize, t: f64) -> (DVec3, [f32; 4]) {
    let motion = splats.motion.as_ref().unwrap();
    let dt = t - f64::from(motion.centers[i]);
    let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
    let [a, b, c] = motion.polynomials[i].map(vector);
    let position = vector(splats.means[i]) + a * dt + b * dt * dt + c * dt * dt * dt;
    let q: [f64; 4] =
        std::array::from_fn(|k| f64::from(splats.rotations[i][k]) + dt * f64::from(motion.omegas[i][k]));
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    (position, q.map(|v| (v / length) as f32))
}

/// Largest distance and angle between a moving scene and the motion it was made from, `dt` away from the centres.
fn errors(animation: &Animation, dt: f64, turn: f64) -> (f64, f64) {
    let recipe = Recipe { count: 400, seed: 3, ..Recipe::default() };
    let (still, moving) = (recipe.still(), recipe.moving(animation));
    let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
    let middle = still.means.iter().map(|m| vector(*m)).sum::<DVec3>() / 400.0;
    let (axis, travel) = (vector(animation.axis).normalize(), vector(animation.travel));
    let tau = std::f64::consts::TAU;
    let wave_number = tau / f64::from(animation.wave_length);
    let (mut distance, mut rotation) = (0.0_f64, 0.0_f64);
    for i in 0..400 {
        let t = f64::from(moving.motion.as_ref().unwrap().centers[i]) + dt;
        let turned = DQuat::from_axis_angle(axis, turn * t);
        let mean = vector(still.means[i]);
        let phase = wave_number * mean.dot(travel.normalize()) + tau * t;
        let path =
            middle + turned * (mean - middle) + travel * t + axis * f64::from(animation.wave) * phase.sin();
        let q = turned * DQuat::from_array(still.rotations[i].map(f64::from));
        let (position, found) = evaluate(&moving, i, t);
        distance = distance.max(position.distance(path));
        rotation = rotation.max(angle(found, q.to_array().map(|v| v as f32)));
    }
    (distance, rotation)
}

#[test]
fn moving_scenes_follow_the_turn_the_travel_and_the_wave() {
    let animation = Animation::default();
    let turn = f64::from(animation.turn);
    let (distance, rotation) = errors(&animation, 0.0, turn);
    assert!(distance < 1e-6 && rotation < 1e-6, "{distance} {rotation}");
    // Positions are cubic: halving the distance in time leaves a sixteenth. Rotations are exact to the second order:
    // it leaves an eighth.
    let (far, near) = (errors(&animation, 0.2, turn), errors(&animation, 0.1, turn));
    assert!(far.0 < 0.01 && (13.0..19.0).contains(&(far.0 / near.0)), "{far:?} {near:?}");
    assert!(far.1 < 0.01 && (7.0..9.0).contains(&(far.1 / near.1)), "{far:?} {near:?}");
    // Negative control: the other way round it is elsewhere.
    assert!(errors(&animation, 0.1, -turn).0 > 0.1);
}
