//! Where a splat is, how it is turned, and how opaque it is at a time: Spacetime Gaussians, lite model (Li et al. 2023).

use glam::{DQuat, DVec3};
use motes_scenes::Splats;

/// A splat at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Mean relative to the scene's origin, metres, scene axes.
    pub mean: DVec3,
    /// Unit quaternion, splat to scene axes.
    pub rotation: DQuat,
    /// Opacity at the centre, `0 ..= 1`.
    pub opacity: f64,
}

/// Splat `i` of a scene at time `t` (`0 ..= 1` in a moving scene, of no effect in a still one): position
/// `mean + p0 dt + p1 dt² + p2 dt³`, rotation `normalize(q + dt ω)`, opacity times `exp(−(dt / width)²)`, `dt = t − center`.
/// `None` where that gives no rotation (a zero or non-finite quaternion).
pub fn moment(splats: &Splats, i: usize, t: f64) -> Option<Moment> {
    let mut mean = vector(splats.means[i]);
    let mut rotation = quaternion(splats.rotations[i]);
    let mut opacity = f64::from(splats.opacities[i]);
    if let Some(motion) = &splats.motion {
        let dt = t - f64::from(motion.centers[i]);
        let [p0, p1, p2] = motion.polynomials[i].map(vector);
        mean += dt * (p0 + dt * (p1 + dt * p2));
        rotation += quaternion(motion.omegas[i]) * dt;
        opacity *= (-(dt / f64::from(motion.widths[i])).powi(2)).exp();
    }
    let length = rotation.length();
    if !(length > 0.0 && length.is_finite()) {
        return None;
    }
    Some(Moment { mean, rotation: rotation * length.recip(), opacity })
}

/// A moving scene as it stands at a time: a still one, without the splats that are gone then (below 1/255 of opacity).
pub fn frozen(splats: &Splats, t: f64) -> Splats {
    let mut still = splats.clone();
    still.motion = None;
    let mut alive = vec![false; splats.len()];
    for (i, alive) in alive.iter_mut().enumerate() {
        if let Some(m) = moment(splats, i, t)
            && m.opacity >= 1.0 / 255.0
        {
            *alive = true;
            still.means[i] = m.mean.as_vec3().to_array();
            still.rotations[i] = m.rotation.as_quat().to_array();
            still.opacities[i] = m.opacity as f32;
        }
    }
    still.retain(|i| alive[i]);
    still
}

fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

fn quaternion(q: [f32; 4]) -> DQuat {
    DQuat::from_array(q.map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_scenes::Motion;

    fn moving() -> Splats {
        Splats {
            means: vec![[1.0, 2.0, 3.0]],
            rotations: vec![[0.0, 0.0, 0.0, 1.0]],
            log_scales: vec![[0.0; 3]],
            opacities: vec![0.5],
            sh: vec![[0.0; 3]],
            motion: Some(Motion {
                centers: vec![0.25],
                widths: vec![0.5],
                polynomials: vec![[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]]],
                omegas: vec![[2.0, 0.0, 0.0, 0.0]],
            }),
            ..Splats::default()
        }
    }

    #[test]
    fn follows_the_formulas() {
        let m = moment(&moving(), 0, 0.75).unwrap();
        assert_eq!(m.mean, DVec3::new(1.5, 2.5, 3.5));
        assert!((m.opacity - 0.5 * (-1f64).exp()).abs() < 1e-15);
        let half = 0.5f64.sqrt();
        assert!((m.rotation.x - half).abs() < 1e-15 && (m.rotation.w - half).abs() < 1e-15);
        // Control: at its own centre it is as stored.
        let m = moment(&moving(), 0, 0.25).unwrap();
        assert_eq!((m.mean, m.rotation, m.opacity), (DVec3::new(1.0, 2.0, 3.0), DQuat::IDENTITY, 0.5));
    }

    /// Against the same formulas written out anew, in another order of operations.
    #[test]
    fn a_thousand_splats_follow_the_formulas() {
        use motes_scenes::synthetic::{Animation, Random, Recipe};
        let animation = Animation { fleeting: 1.0, width: 0.3, ..Animation::default() };
        let scene = Recipe { count: 1000, ..Recipe::default() }.moving(&animation);
        let motion = scene.motion.as_ref().unwrap();
        let mut random = Random::new(9);
        let (mut worst, mut wrong) = (0.0f64, 0.0f64);
        for i in 0..scene.len() {
            let t = f64::from(random.uniform(-0.2, 1.2));
            let m = moment(&scene, i, t).unwrap();
            let dt = t - f64::from(motion.centers[i]);
            for k in 0..3 {
                let terms = [
                    f64::from(scene.means[i][k]),
                    f64::from(motion.polynomials[i][0][k]) * dt,
                    f64::from(motion.polynomials[i][1][k]) * dt.powi(2),
                    f64::from(motion.polynomials[i][2][k]) * dt.powi(3),
                ];
                let scale: f64 = terms.iter().map(|v| v.abs()).sum();
                worst = worst.max((m.mean[k] - terms.iter().sum::<f64>()).abs() / scale);
            }
            let q: Vec<f64> = (0..4)
                .map(|k| f64::from(scene.rotations[i][k]) + dt * f64::from(motion.omegas[i][k]))
                .collect();
            let length = q.iter().map(|v| v.powi(2)).sum::<f64>().sqrt();
            for ((moved, q), still) in m.rotation.to_array().into_iter().zip(&q).zip(scene.rotations[i]) {
                worst = worst.max((moved - q / length).abs());
                wrong = wrong.max((moved - f64::from(still)).abs());
            }
            let width = f64::from(motion.widths[i]);
            let opacity = f64::from(scene.opacities[i]) / (dt * dt / (width * width)).exp();
            worst = worst.max((m.opacity / opacity - 1.0).abs());
        }
        println!("worst relative error {worst:.1e}");
        assert!(worst < 1e-13, "{worst:e}");
        // Control: a rotation that does not change is another.
        assert!(wrong > 0.1);
    }

    #[test]
    fn a_frozen_scene_is_the_moving_one_at_its_time() {
        let scene = moving();
        let still = frozen(&scene, 0.75);
        let (a, b) = (moment(&still, 0, 0.0).unwrap(), moment(&scene, 0, 0.75).unwrap());
        assert!((a.mean - b.mean).length() < 1e-6 && (a.opacity - b.opacity).abs() < 1e-6);
        assert!(a.rotation.dot(b.rotation) > 1.0 - 1e-6);
        assert!(frozen(&scene, 2.0).is_empty(), "long gone");
    }

    #[test]
    fn still_scenes_ignore_time_and_zero_quaternions_are_refused() {
        let mut still = Splats { motion: None, ..moving() };
        assert_eq!(moment(&still, 0, 0.1), moment(&still, 0, 0.9));
        still.rotations[0] = [0.0; 4];
        assert_eq!(moment(&still, 0, 0.0), None);
        still.rotations[0] = [f32::NAN; 4];
        assert_eq!(moment(&still, 0, 0.0), None);
    }

    #[test]
    fn an_endless_width_never_fades() {
        let mut scene = moving();
        if let Some(motion) = &mut scene.motion {
            motion.widths[0] = f32::MAX;
        }
        assert_eq!(moment(&scene, 0, 1.0).unwrap().opacity, 0.5);
    }
}
