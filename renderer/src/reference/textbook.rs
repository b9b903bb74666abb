//! The definition, written down a second time, as plainly as it can be: what the reference itself is tested against.

use glam::{DMat3, DQuat, DVec2, DVec3};
use motes_scenes::Splats;

use crate::config::Projection;
use crate::projection::MAX_LEAN;
use crate::view::View;

/// Squared distance and depth of splat `i` at a pixel by covariances and their inverses. `None`: no contribution.
fn textbook_square(
    projection: Projection,
    splats: &Splats,
    i: usize,
    view: &View,
    pixel: DVec2,
) -> Option<(f64, f64)> {
    let [fx, fy] = view.focal();
    let mean = view.to_eye(DVec3::from_array(splats.means[i].map(f64::from)));
    let q = DQuat::from_array(splats.rotations[i].map(f64::from)).normalize();
    let s = DVec3::from_array(splats.log_scales[i].map(|s| f64::from(s).exp()));
    let m = view.rotation * DMat3::from_quat(q) * DMat3::from_diagonal(s);
    let z = mean.z.max(0.0);
    let filter = DMat3::from_diagonal(DVec3::new(0.3 * z * z / (fx * fx), 0.3 * z * z / (fy * fy), 0.0));
    let covariance = m * m.transpose() + filter;
    let [cx, cy] = view.principal_point();
    let ray = DVec3::new((pixel.x - cx) / fx, (pixel.y - cy) / fy, 1.0);
    match projection {
        Projection::Affine => {
            let x = (mean.x / mean.z).clamp(1.3 * view.fov.left, 1.3 * view.fov.right);
            let y = (mean.y / mean.z).clamp(1.3 * view.fov.up, 1.3 * view.fov.down);
            let j0 = DVec3::new(fx, 0.0, -fx * x) / mean.z;
            let j1 = DVec3::new(0.0, fy, -fy * y) / mean.z;
            let two = glam::DMat2::from_cols_array(&[
                j0.dot(covariance * j0),
                j0.dot(covariance * j1),
                j1.dot(covariance * j0),
                j1.dot(covariance * j1),
            ]);
            let d = pixel - DVec2::new(cx + fx * mean.x / mean.z, cy + fy * mean.y / mean.z);
            (mean.z > 0.0).then(|| (d.dot(two.inverse() * d), mean.z))
        }
        Projection::Tangent => {
            // The plane of the strongest points of all parallels to the mean's direction, where the density's gradient is at
            // a right angle to it: `(p - μ)·Σ⁻¹μ = 0`; brought upright as far as its lean has to be less.
            let inverse = covariance.inverse();
            let x_mu = mean.normalize();
            let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
            let across = DMat3::IDENTITY - outer(x_mu, x_mu);
            let flat = across * covariance * across;
            let normal = inverse * mean / (inverse * mean).dot(x_mu);
            let slope = x_mu - normal;
            let lean = slope.dot(flat * slope).sqrt() / mean.length();
            let normal = x_mu - slope * (MAX_LEAN / lean).min(1.0);
            let depth = normal.dot(mean) / normal.dot(ray);
            let d = across * (ray * depth - mean);
            // Adding the mean's own direction makes the matrix regular without touching the plane.
            (depth > 0.0).then(|| (d.dot((flat + outer(x_mu, x_mu)).inverse() * d), depth))
        }
        Projection::Exact => {
            let inverse = covariance.inverse();
            let depth = ray.dot(inverse * mean) / ray.dot(inverse * ray);
            let d = ray * depth - mean;
            (depth > 0.0).then(|| (d.dot(inverse * d), depth))
        }
    }
}

/// Colours by rows, in radial order, planar filter, black background, no near plane.
pub(super) fn textbook(projection: Projection, splats: &Splats, view: &View) -> Vec<[f64; 3]> {
    let mut order: Vec<usize> = (0..splats.len()).collect();
    let distance = |i: usize| (DVec3::from_array(splats.means[i].map(f64::from)) - view.eye).length();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
    let mut pixels = Vec::new();
    for y in 0..view.size[1] {
        for x in 0..view.size[0] {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (mut colour, mut left) = (DVec3::ZERO, 1.0);
            for &i in &order {
                let Some((square, _)) = textbook_square(projection, splats, i, view, pixel) else { continue };
                let alpha = (f64::from(splats.opacities[i]) * (-0.5 * square).exp()).min(0.99);
                if alpha >= 1.0 / 255.0 {
                    let dc = DVec3::from_array(splats.sh[i].map(f64::from));
                    colour += left * alpha * (dc * 0.282_094_791_773_878_14 + 0.5).max(DVec3::ZERO);
                    left *= 1.0 - alpha;
                }
            }
            pixels.push(colour.to_array());
        }
    }
    pixels
}
