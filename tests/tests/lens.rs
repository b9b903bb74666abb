//! Pictures through a fisheye and all around: the device agrees with the reference, edges meet, early stop works.
#![allow(clippy::unwrap_used, reason = "a test may")]

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3};
use motes_renderer::gpu::GpuError;
use motes_renderer::reference::{self, ReferenceOptions};
use motes_renderer::{
    Composite, Expansion, Lens, LowPass, Offscreen, OrderKey, Packing, Picture, Precision, Projection,
    QuadShape, RadiusRule, RenderConfig, SceneOnDevice, ShPrecision, Sorter, View,
};
use motes_scenes::Splats;
use motes_scenes::synthetic::Recipe;
use motes_tests::{TestGpu, psnr};

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 1 };
const EYE: DVec3 = DVec3::new(0.05, -0.1, 0.02);

/// Splats all around the eye, thin and round, some so near that they cover a quarter of what there is to see.
fn scene() -> Splats {
    Recipe { count: 700, sh_degree: 1, seed: 5, log_scales: [-5.0, -1.8], ..Default::default() }.still()
}

fn view(lens: Lens, degrees: f64, size: [u32; 2]) -> View {
    let rotation = DMat3::from_rotation_x(0.2) * DMat3::from_rotation_y(0.4);
    View { rotation, eye: EYE, fov: lens.fov(degrees.to_radians(), size), size }
}

/// Every layer counts, so that only projection and coverage can differ from the reference.
fn every_layer(lens: Lens, projection: Projection) -> RenderConfig {
    let (radius, composite) = (RadiusRule::Full, Composite::FrontToBack);
    RenderConfig { lens, projection, radius, composite, sh_degree: 1, ..Default::default() }
}

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

fn truth(splats: &Splats, view: &View, options: &ReferenceOptions) -> Vec<[u8; 3]> {
    let image = reference::render(splats, view, options).unwrap();
    image.to_rgb8().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

fn square_error(a: &[[u8; 3]], b: &[[u8; 3]], at: impl Fn(usize) -> bool) -> f64 {
    let pixels = (0..a.len()).filter(|&i| at(i));
    let errors = pixels.flat_map(|i| (0..3).map(move |c| f64::from(a[i][c].abs_diff(b[i][c])).powi(2)));
    let (sum, count) = errors.fold((0.0, 0usize), |(s, n), e| (s + e, n + 1));
    sum / count.max(1) as f64
}

#[test]
fn every_lens_and_shape_agrees_with_the_reference() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for (lens, degrees, size) in [
        (Lens::Fisheye, 180.0, [96, 96]),
        (Lens::Fisheye, 356.0, [97, 80]),
        (Lens::Equirectangular, 360.0, [144, 72]),
        (Lens::Equirectangular, 120.0, [96, 64]),
    ] {
        let view = view(lens, degrees, size);
        for projection in [Projection::Tangent, Projection::Exact] {
            let mut config = every_layer(lens, projection);
            let expected = truth(&splats, &view, &ReferenceOptions::of_config(&config));
            let sideways = View { rotation: DMat3::from_rotation_z(0.2) * view.rotation, ..view };
            // Further shapes once a lens: each takes pipelines of its own.
            let further = degrees > 350.0 && projection == Projection::Tangent;
            let shapes = [QuadShape::Octagon, QuadShape::Square, QuadShape::Diamond];
            for shape in shapes.into_iter().take(if further { 3 } else { 1 }) {
                config.shape = shape;
                let name = format!("{lens} {degrees}° {projection} {shape}");
                let (pictures, report) = offscreen.render(&on_device, &[view], &config).unwrap();
                assert_eq!((pictures.len(), pictures[0].size), (1, size), "{name}");
                let db = psnr(&colours(&pictures[0]), &expected);
                println!("{name}: {db:.1} dB, {:.1} layers", report.layers());
                // A diamond cuts the rims of its splats: its bound is another.
                let least = if shape == QuadShape::Diamond { 36.0 } else { 50.0 };
                assert!(db >= least, "{name}: {db:.1} dB");
            }
            // Control: a head turned by 0.2 is another picture.
            config.shape = QuadShape::Octagon;
            let (turned, _) = offscreen.render(&on_device, &[sideways], &config).unwrap();
            let db = psnr(&colours(&turned[0]), &expected);
            assert!(db < 30.0, "{lens}: {db:.1} dB for another picture");
        }
    }
}

#[test]
fn filters_are_as_wide_as_the_lenss_pixels() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for (lens, degrees, size) in [(Lens::Fisheye, 300.0, [80, 80]), (Lens::Equirectangular, 360.0, [112, 56])]
    {
        let view = view(lens, degrees, size);
        let config = |low_pass| RenderConfig { low_pass, ..every_layer(lens, Projection::Tangent) };
        let unfiltered = truth(&splats, &view, &ReferenceOptions::of_config(&config(LowPass::Off)));
        for low_pass in [LowPass::PlanarCompensated, LowPass::Volumetric, LowPass::VolumetricCompensated] {
            let config = config(low_pass);
            let (pictures, _) = offscreen.render(&on_device, &[view], &config).unwrap();
            let drawn = colours(&pictures[0]);
            let db = psnr(&drawn, &truth(&splats, &view, &ReferenceOptions::of_config(&config)));
            println!("{lens} {low_pass}: {db:.1} dB");
            assert!(db >= 50.0, "{lens} {low_pass}: {db:.1} dB");
            let wrong = psnr(&drawn, &unfiltered);
            assert!(wrong < 45.0, "{lens} {low_pass}: no filter must not pass: {wrong:.1} dB");
        }
    }
}

/// The tangent plane serves wide images; linearising the lens at the mean does not (003, section 5.2).
#[test]
fn far_from_the_axis_tangent_is_much_nearer_to_the_truth_than_affine() {
    let gpu = TestGpu::new();
    let mut splats = scene();
    for mean in &mut splats.means {
        // None so near that its own depth makes the difference, which no plane knows.
        let distance = DVec3::from_array(mean.map(f64::from)).length() as f32;
        *mean = mean.map(|v| v * (distance + 1.0) / distance);
    }
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for (lens, degrees, size) in [(Lens::Fisheye, 300.0, [96, 96]), (Lens::Equirectangular, 360.0, [144, 72])]
    {
        let view = view(lens, degrees, size);
        let config = every_layer(lens, Projection::Tangent);
        let exact =
            ReferenceOptions { projection: Projection::Exact, ..ReferenceOptions::of_config(&config) };
        let exact_picture = truth(&splats, &view, &exact);
        let affine = truth(&splats, &view, &ReferenceOptions { projection: Projection::Affine, ..exact });
        let (pictures, _) = offscreen.render(&on_device, &[view], &config).unwrap();
        let tangent = colours(&pictures[0]);
        // More than 60° from the axis, or from the horizon.
        let far = |i: usize| {
            let (x, y) = (i % size[0] as usize, i / size[0] as usize);
            let [fx, fy] = view.focal();
            let (x, y) = (view.fov.left + (x as f64 + 0.5) / fx, view.fov.up + (y as f64 + 0.5) / fy);
            let angle = if lens == Lens::Fisheye { x.hypot(y) } else { y.abs() };
            angle > PI / 3.0
        };
        let (tangent, affine) =
            (square_error(&tangent, &exact_picture, far), square_error(&affine, &exact_picture, far));
        println!("{lens}, beyond 60°: mean square error {tangent:.2} (tangent), {affine:.2} (affine)");
        assert!(tangent * 4.0 <= affine, "{lens}: {tangent:.2} against {affine:.2}");
    }
}

/// Turning round by half a circle moves every column by half the width: what lies on the seam is whole.
#[test]
fn the_seam_is_like_any_other_column() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let size = [128, 64];
    let level = View { rotation: DMat3::IDENTITY, ..view(Lens::Equirectangular, 360.0, size) };
    let behind = View { rotation: DMat3::from_rotation_y(PI), ..level };
    for composite in [Composite::FrontToBack, Composite::EarlyStop] {
        let config = RenderConfig { composite, ..every_layer(Lens::Equirectangular, Projection::Tangent) };
        let mut take = |view: View| colours(&offscreen.render(&on_device, &[view], &config).unwrap().0[0]);
        let (ahead, behind) = (take(level), take(behind));
        let moved: Vec<_> = (0..ahead.len()).map(|i| ahead[i / 128 * 128 + (i % 128 + 64) % 128]).collect();
        let worst = moved.iter().zip(&behind).flat_map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c]))).max();
        let db = psnr(&moved, &behind);
        println!("{composite}: {db:.1} dB, worst {worst:?}");
        assert!(db >= 50.0 && worst <= Some(8), "{composite}: {db:.1} dB, worst {worst:?}");
        assert!(psnr(&ahead, &behind) < 30.0, "the control must differ");
    }
}

#[test]
fn pixels_stop_early_through_a_lens_too() {
    let gpu = TestGpu::new();
    let mut splats = Recipe { count: 24_000, log_scales: [-4.6, -3.2], ..Default::default() }.still();
    splats.opacities.fill(0.9);
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for (lens, degrees, size) in [(Lens::Fisheye, 200.0, [96, 96]), (Lens::Equirectangular, 360.0, [129, 64])]
    {
        let view = view(lens, degrees, size);
        let config = RenderConfig { lens, radius: RadiusRule::OpacityAware, ..Default::default() };
        let every = RenderConfig { composite: Composite::FrontToBack, ..config.clone() };
        let (stopped, report) = offscreen.render(&on_device, &[view], &config).unwrap();
        let (whole, _) = offscreen.render(&on_device, &[view], &every).unwrap();
        let db = psnr(&colours(&stopped[0]), &colours(&whole[0]));
        assert!(db >= 45.0, "{lens}: {db:.1} dB");
        let mut layers = |config| {
            let (maps, _) = offscreen.layers(&on_device, &[view], config).unwrap();
            assert_eq!((maps[0].size, maps[0].shaded.len()), (size, (size[0] * size[1]) as usize));
            (maps[0].mean_shaded(), maps[0].mean_blended())
        };
        let ((shaded, blended), (of_whole, blended_of_whole)) = (layers(&config), layers(&every));
        println!(
            "{lens}: {shaded:.1} layers of {of_whole:.1} ({blended:.1} of {blended_of_whole:.1} blended), {db:.1} dB"
        );
        assert!(shaded * 4.0 < of_whole * 3.0, "{lens}: nothing was saved");
        // Polygons do not cover much more than their splats.
        assert!(of_whole < 1.7 * blended_of_whole, "{lens}");
        // The prediction that governs overdraw knows the lens.
        let pixels = f64::from(size[0] * size[1]);
        let predicted = f64::from(report.predicted_fragments) / pixels;
        println!(
            "  predicted {predicted:.1}, {:.1} of it left",
            f64::from(report.predicted_unhidden) / pixels
        );
        assert!((0.5..2.0).contains(&(predicted / of_whole)), "{lens}: predicted {predicted:.1} layers");
    }
}

#[test]
fn what_makes_no_sense_through_a_lens_is_refused_with_a_reason() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let good = RenderConfig { lens: Lens::Equirectangular, ..Default::default() };
    let one = view(good.lens, 360.0, [32, 16]);
    let refused = |result: Result<_, GpuError>, part: &str| {
        let (pictures, _): (Vec<Picture>, _) = match result {
            Err(error) => return assert!(error.to_string().contains(part), "{part}: {error}"),
            Ok(drawn) => drawn,
        };
        assert!(pictures.is_empty(), "{part}: it was drawn");
    };
    for (config, part) in [
        (RenderConfig { projection: Projection::Affine, ..good.clone() }, "choose projection tangent"),
        (RenderConfig { expansion: Expansion::Instanced, ..good.clone() }, "precomputed"),
        (RenderConfig { shape: QuadShape::AxisAligned, ..good.clone() }, "choose another shape"),
        (RenderConfig { order: OrderKey::Depth, ..good.clone() }, "choose order radial"),
        (RenderConfig { resolution_scale: 0.7, ..good.clone() }, "resolution-scale 1"),
        (
            RenderConfig { sorter: Sorter::Stochastic, composite: Composite::FrontToBack, ..good.clone() },
            "choose sort cpu",
        ),
    ] {
        refused(offscreen.render(&on_device, &[one], &config), part);
    }
    refused(offscreen.render(&on_device, &[one, one], &good), "one view");
    let fov = good.lens.fov(TAU + 0.1, [32, 16]);
    refused(offscreen.render(&on_device, &[View { fov, ..one }], &good), "choose --fov 360 or less");
    offscreen.render(&on_device, &[one], &good).unwrap();
}
