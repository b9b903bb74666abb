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
