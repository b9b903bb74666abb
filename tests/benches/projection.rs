//! What the projections err by in a headset's wide view, by angle from its middle: 110° × 96°, from where golden views stand and
//! from close to what they look at (the eye within 0.3 m of splats), in six directions all around. Mean absolute errors of
//! sRGB-encoded channels, in 1/255, against the f64 reference's exact projection: of the reference's own pictures under each
//! projection (the projection alone), and of the device's (f32 attributes, 32-bit sums, every layer), which are read as half
//! floats: their steps are up to an eighth of a 1/255 where channels are near 1, a sixteenth at ½.
//!
//! `cargo bench --bench projection [-- VIEW…]`: `lacadiere_a` and `hq_garden_lod2_a`, where none is named.

#![allow(clippy::unwrap_used, reason = "a bench may")]

use glam::{DMat3, DVec3};
use motes_renderer::reference::{self, ReferenceOptions};
use motes_renderer::{
    Composite, Fov, Packing, Precision, Projection, RadiusRule, RenderConfig, ShPrecision, TargetFormat, View,
};
use motes_scenes::Splats;
use motes_tests::golden::{NAMES, golden_view};
use motes_tests::hard::rig::{BACKGROUND, Rig};

const WIDE: Fov = Fov { left: -1.428, right: 1.428, up: -1.11, down: 1.11 };
const SIZE: [u32; 2] = [400, 312];
/// Width of a ring of angles, degrees.
const RING: f64 = 10.0;
const RINGS: usize = 7;
/// Directions, evenly around.
const HEADINGS: u32 = 6;
/// How far before a splat the eye stands, metres.
const CLOSE: f64 = 0.25;
const PROJECTIONS: [Projection; 3] = [Projection::Affine, Projection::Tangent, Projection::Exact];

/// Sums of absolute and squared errors and of pixels, by rings, and over everything (the last).
type Sums = [[f64; 3]; RINGS + 1];

/// Adds the errors of a picture, 1/255.
fn add(sums: &mut Sums, view: &View, truth: &[[f32; 3]], picture: &[[f32; 3]]) {
    for (i, (a, b)) in truth.iter().zip(picture).enumerate() {
        // As a screen shows them: what is brighter than white is white.
        let errors = [0, 1, 2].map(|c| 255.0 * f64::from(a[c].clamp(0.0, 1.0) - b[c].clamp(0.0, 1.0)));
        let (x, y) = (i as u32 % view.size[0], i as u32 / view.size[0]);
        let [x, y] = [
            WIDE.left + (WIDE.right - WIDE.left) * (f64::from(x) + 0.5) / f64::from(view.size[0]),
            WIDE.up + (WIDE.down - WIDE.up) * (f64::from(y) + 0.5) / f64::from(view.size[1]),
        ];
        let ring = (x.hypot(y).atan().to_degrees() / RING) as usize;
        for at in [ring.min(RINGS - 1), RINGS] {
            sums[at][0] += errors.iter().map(|e| e.abs()).sum::<f64>() / 3.0;
            sums[at][1] += errors.iter().map(|e| e * e).sum::<f64>() / 3.0;
            sums[at][2] += 1.0;
        }
    }
}

/// Distances of the splats that can be seen well, from a place.
fn distances(splats: &Splats, eye: DVec3) -> impl Iterator<Item = (f64, DVec3)> + '_ {
    let mean = move |i: usize| DVec3::from_array(splats.mean_of(i));
    let seen = (0..splats.len()).filter(|&i| splats.opacities[i] > 0.5);
    seen.map(move |i| (mean(i).distance(eye), mean(i)))
}

/// Before the splat in the middle of what a view sees, by distance.
fn close(splats: &Splats, view: &View) -> DVec3 {
    let ahead = |place: &DVec3| {
        let p = view.to_eye(*place);
        p.z > 0.0 && p.x.abs() < 0.5 * p.z && p.y.abs() < 0.5 * p.z
    };
    let mut seen: Vec<_> = distances(splats, view.eye).filter(|(_, place)| ahead(place)).collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (distance, place) = seen[seen.len() / 2];
    place + (view.eye - place) * (CLOSE / distance)
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let default = ["lacadiere_a", "hq_garden_lod2_a"];
    let named = |n: &&str| match wanted.as_slice() {
        [] => default.contains(n),
        some => some.iter().any(|w| n.contains(w.as_str())),
    };
    let mut rig = Rig::new();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    let base = RenderConfig {
        composite: Composite::FrontToBack,
        radius: RadiusRule::Full,
        max_radius: 1e6,
        target: TargetFormat::Rgba32F,
        background: BACKGROUND,
        ..Default::default()
    };
    let exact = ReferenceOptions { projection: Projection::Exact, ..ReferenceOptions::of_config(&base) };
    let rings: String = (0..RINGS).map(|r| format!("  {:2}-{:2}°", r * 10, r * 10 + 10)).collect();
    println!("{:43} {rings}   whole     RMS", "view               by");
    for name in NAMES.into_iter().filter(named) {
        let golden = golden_view(name);
        let scene = rig.upload(&golden.splats, packing);
        let eyes = [
            (name.to_owned(), golden.view.eye),
            (format!("{name}, close"), close(&golden.splats, &golden.view)),
        ];
        for (name, eye) in eyes {
            let near = distances(&golden.splats, eye).filter(|d| d.0 < 0.3).count();
            println!("{name}: {near} splats (opacity above ½) within 0.3 m");
            // By the reference and by the device.
            let mut sums = [[[[0.0; 3]; RINGS + 1]; 2]; 3];
            for heading in (0..HEADINGS).map(|i| f64::from(i) * 360.0 / f64::from(HEADINGS)) {
                let rotation = DMat3::from_axis_angle(golden.view.rotation.row(1), heading.to_radians());
                let rotation = golden.view.rotation * rotation.transpose();
                let view = View { rotation, fov: WIDE, size: SIZE, eye };
                let truth = reference::render(&golden.splats, &view, &exact).unwrap().to_rgb_f32();
                for (sums, projection) in sums.iter_mut().zip(PROJECTIONS) {
                    let options = ReferenceOptions { projection, ..exact.clone() };
                    let ours = reference::render(&golden.splats, &view, &options).unwrap().to_rgb_f32();
                    let config = RenderConfig { projection, ..base.clone() };
                    let (pictures, _) = rig.draw(&scene, &[view], &config).unwrap();
                    let device: Vec<_> = pictures[0].pixels.iter().map(|p| [p[0], p[1], p[2]]).collect();
                    add(&mut sums[0], &view, &truth, &ours);
                    add(&mut sums[1], &view, &truth, &device);
                }
            }
            for (i, by) in ["reference", "device"].iter().enumerate() {
                let means =
                    sums.map(|s| s[i].map(|[absolute, squared, n]| [absolute / n, (squared / n).sqrt()]));
                let row = |label: &str, of: &dyn Fn(usize) -> [f64; 2]| {
                    let cells: String = (0..=RINGS).map(|ring| format!("{:8.3}", of(ring)[0])).collect();
                    println!("{name:18} {by:9} {label:14} {cells} {:8.3}", of(RINGS)[1]);
                };
                let ratio =
                    |a: usize, b: usize, ring: usize| [0, 1].map(|k| means[a][ring][k] / means[b][ring][k]);
                row("affine", &|ring| means[0][ring]);
                row("tangent", &|ring| means[1][ring]);
                row("exact", &|ring| means[2][ring]);
                row("tangent/affine", &|ring| ratio(1, 0, ring));
                row("exact/tangent", &|ring| ratio(2, 1, ring));
            }
        }
    }
}
