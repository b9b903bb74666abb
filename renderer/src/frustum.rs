//! Which splats may enter the frustum at all, told before anything of them is projected.

use crate::config::Projection;
use crate::projection::{FRUSTUM_CLAMP, LOW_PASS_VARIANCE};
use crate::view::Fov;
use glam::Vec3;

/// Whether a ball around a splat enters the frustum; twin of `ball_in_frustum` in `projection.glsl`.
///
/// `mean` in eye axes, m; `longest`: the largest standard deviation without its filter, m; `focal`: pixels; `k`: the reach,
/// standard deviations. A splat whose ellipse enters the image is never left out, under any projection and filter: its support
/// function lies below the ball's.
pub fn ball_in_frustum_f32(
    projection: Projection,
    mean: Vec3,
    longest: f32,
    fov: &Fov,
    focal: [f32; 2],
    k: f32,
) -> bool {
    // Beyond what rounding can add.
    const SURE: f32 = 1.001;
    let affine = projection == Projection::Affine;
    let depth = if affine { mean.z } else { mean.length() };
    let pixel = focal.map(|f| depth / f);
    // Both low-pass filters at once: each is at most that.
    let filter = 2.0 * LOW_PASS_VARIANCE as f32 * (pixel[0] * pixel[0] + pixel[1] * pixel[1]);
    let ball = SURE * k * (longest * longest + filter).sqrt();
    let [left, right, up, down] = [fov.left, fov.right, fov.up, fov.down].map(|t| t as f32);
    let beyond = [
        (left * mean.z - mean.x, left),
        (mean.x - right * mean.z, right),
        (up * mean.z - mean.y, up),
        (mean.y - down * mean.z, down),
    ];
    let reaches = |(beyond, slope): (f32, f32)| {
        let slope = if affine { FRUSTUM_CLAMP as f32 * slope } else { slope };
        beyond <= ball * (1.0 + slope * slope).sqrt()
    };
    beyond.into_iter().all(reaches) && mean.z > -ball
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LowPass;
    use crate::projection::EyeSplat;
    use crate::view::View;
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    const K: f64 = 3.33;

    fn view() -> View {
        let fov = Fov { left: -1.2, right: 0.9, up: -0.8, down: 1.1 };
        View::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov, [160, 100])
    }

    /// Whether what is drawn of a splat enters the image: by the support functions of its ellipsoid, or of its affine ellipse.
    fn enters(projection: Projection, splat: &EyeSplat) -> bool {
        let fov = view().fov;
        let [x, y] = splat.mean.truncate().to_array();
        let z = splat.mean.z;
        if projection == Projection::Affine {
            let focal = view().focal();
            let columns = splat.affine_columns(&fov, focal);
            let [ex, ey] =
                [0, 1].map(|i| K * columns.iter().map(|c| c[i].powi(2)).sum::<f64>().sqrt() / focal[i]);
            return x / z + ex > fov.left
                && x / z - ex < fov.right
                && y / z + ey > fov.up
                && y / z - ey < fov.down;
        }
        let normals = [
            DVec3::new(1.0, 0.0, -fov.left),
            DVec3::new(-1.0, 0.0, fov.right),
            DVec3::new(0.0, 1.0, -fov.up),
            DVec3::new(0.0, -1.0, fov.down),
            DVec3::Z,
        ];
        normals.into_iter().all(|n| n.dot(splat.mean) + splat.support(n, K) > 0.0)
    }

    fn kept(projection: Projection, splat: &EyeSplat, longest: f64, k: f64) -> bool {
        let focal = view().focal().map(|f| f as f32);
        ball_in_frustum_f32(projection, splat.mean.as_vec3(), longest as f32, &view().fov, focal, k as f32)
    }

    /// A splat beside one of the frustum's sides, most of them just so beyond it.
    fn splats() -> impl Strategy<Value = (EyeSplat, f64)> {
        let low_pass = prop::sample::select(vec![LowPass::Off, LowPass::Planar, LowPass::Volumetric]);
        let scales = prop::array::uniform3(-7.0f64..1.0).prop_map(|e| DVec3::from(e.map(f64::exp)));
        let turn = prop::array::uniform4(-1.0f64..1.0)
            .prop_filter("no rotation", |q| q.iter().any(|c| c.abs() > 0.1));
        (low_pass, scales, turn, -2.0f64..3.0, -2.0f64..2.0, 0.0f64..1.3, any::<bool>()).prop_map(
            |(low_pass, scales, turn, z, across, beyond, sideways)| {
                let z = z.exp();
                let rotation = DQuat::from_array(turn).normalize();
                let fov = view().fov;
                let reach = beyond * K * scales.max_element();
                let mean = if sideways {
                    DVec3::new(fov.right * z + reach * fov.right.hypot(1.0), across * z, z)
                } else {
                    DVec3::new(across * z, fov.up * z - reach * fov.up.hypot(1.0), z)
                };
                (EyeSplat::new(&view(), low_pass, mean, rotation, scales), scales.max_element())
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn whatever_enters_the_image_is_kept((splat, longest) in splats()) {
            for projection in [Projection::Affine, Projection::Tangent] {
                prop_assert!(!enters(projection, &splat) || kept(projection, &splat, longest, K), "{projection}");
            }
        }
    }

    #[test]
    fn what_is_far_beside_is_left_out_and_a_smaller_ball_would_leave_out_too_much() {
        let round = |x: f64| {
            EyeSplat::new(
                &view(),
                LowPass::Planar,
                DVec3::new(x, 0.0, 2.0),
                DQuat::IDENTITY,
                DVec3::splat(0.1),
            )
        };
        for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
            assert!(!kept(projection, &round(2.9), 0.1, K), "{projection}");
            assert!(!kept(projection, &round(-3.5), 0.1, K), "{projection}");
            assert!(kept(projection, &round(0.0), 0.1, K));
            let behind = EyeSplat { mean: DVec3::new(0.0, 0.0, -1.0), ..round(0.0) };
            assert!(!kept(projection, &behind, 0.1, K));
        }
        // Control: the bound is one that a ball of nine tenths misses.
        let near = round(0.9 * 2.0 + 0.98 * K * 0.1 * 0.9f64.hypot(1.0));
        assert!(enters(Projection::Tangent, &near) && kept(Projection::Tangent, &near, 0.1, K));
        assert!(!kept(Projection::Tangent, &near, 0.09, 0.9 * K));
    }
}
