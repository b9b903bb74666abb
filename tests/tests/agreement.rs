//! Every way of drawing agrees with the reference: expansion × projection × shape × mono and stereo.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_renderer::reference::{self, ReferenceOptions, ReferenceOrder};
use motes_renderer::{
    Axis, Composite, Expansion, Fov, LowPass, Offscreen, Packing, Picture, Precision, Projection, QuadShape,
    RadiusRule, RenderConfig, SceneOnDevice, ShPrecision, Stereo, View, midpoint,
};
use motes_scenes::Splats;
use motes_scenes::synthetic::Recipe;
use motes_tests::{TestGpu, psnr};

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };

fn scene() -> Splats {
    Recipe { count: 600, sh_degree: 3, seed: 11, ..Default::default() }.still()
}

/// Two eyes 64 mm apart with mirrored asymmetric fields of view, as a headset has them.
fn eyes() -> [View; 2] {
    let look = |x: f64, fov| View {
        fov,
        ..View::look_at(DVec3::new(x, 0.2, -2.2), DVec3::new(x, 0.0, 0.0), DVec3::NEG_Y, fov, [96, 80])
    };
    let left = Fov { left: -1.3, right: 0.9, up: -0.9, down: 1.1 };
    let right = Fov { left: -0.9, right: 1.3, up: -0.9, down: 1.1 };
    [look(-0.032, left), look(0.032, right)]
}

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

fn truth(splats: &Splats, view: &View, views: &[View], config: &RenderConfig) -> Vec<[u8; 3]> {
    let options = ReferenceOptions {
        order: ReferenceOrder::Radial(Some(midpoint(views))),
        ..ReferenceOptions::of_config(config)
    };
    let image = reference::render(splats, view, &options).unwrap();
    image.to_rgb8().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

/// What is drawn when every layer counts, so that only projection and coverage can differ from the reference.
fn every_layer(projection: Projection, low_pass: LowPass) -> RenderConfig {
    let (radius, composite) = (RadiusRule::Full, Composite::FrontToBack);
    RenderConfig { projection, low_pass, radius, composite, ..Default::default() }
}

/// Every shape and expansion of a projection, in mono and stereo.
fn agrees(projection: Projection) {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let eyes = eyes();
    let mut config = every_layer(projection, LowPass::Planar);
    let alone = truth(&splats, &eyes[0], &eyes[..1], &config);
    let expected = [0, 1].map(|e| truth(&splats, &eyes[e], &eyes, &config));
    for &shape in QuadShape::ALL {
        config.shape = shape;
        for &expansion in Expansion::ALL {
            config.expansion = expansion;
            let name = format!("{projection} {shape} {expansion}");
            // A diamond cuts the rims of its splats: its bound is another.
            let least = if shape == QuadShape::Diamond { 38.0 } else { 55.0 };
            let (mono, _) = offscreen.render(&on_device, &eyes[..1], &config).unwrap();
            let db = psnr(&colours(&mono[0]), &alone);
            println!("{name}: {db:.1} dB mono");
            assert!(db >= least, "{name}: {db:.1} dB mono");
            if expansion == Expansion::Geometry {
                continue; // one view only
            }
            let (stereo, _) = offscreen.render(&on_device, &eyes, &config).unwrap();
            for eye in 0..2 {
                let db = psnr(&colours(&stereo[eye]), &expected[eye]);
                assert!(db >= least, "{name}: {db:.1} dB, eye {eye}");
                let wrong = psnr(&colours(&stereo[eye]), &expected[1 - eye]);
                assert!(wrong < 30.0, "the other eye's picture must not pass: {wrong:.1} dB");
            }
        }
    }
}

#[test]
fn affine_agrees_in_every_shape_and_expansion() {
    agrees(Projection::Affine);
}

#[test]
fn tangent_agrees_in_every_shape_and_expansion() {
    agrees(Projection::Tangent);
}

#[test]
fn exact_agrees_in_every_shape_and_expansion() {
    agrees(Projection::Exact);
}

#[test]
fn every_filter_agrees_in_every_projection() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let view = &eyes()[..1];
    for &projection in Projection::ALL {
        let unfiltered = truth(&splats, &view[0], view, &every_layer(projection, LowPass::Off));
        for &low_pass in LowPass::ALL {
            let config = every_layer(projection, low_pass);
            let (picture, _) = offscreen.render(&on_device, view, &config).unwrap();
            let db = psnr(&colours(&picture[0]), &truth(&splats, &view[0], view, &config));
            println!("{projection} {low_pass}: {db:.1} dB");
            assert!(db >= 55.0, "{projection} {low_pass}: {db:.1} dB");
            if low_pass != LowPass::Off {
                let wrong = psnr(&colours(&picture[0]), &unfiltered);
                assert!(wrong < 50.0, "{projection} {low_pass}: no filter must not pass: {wrong:.1} dB");
            }
        }
    }
}

/// Splats whose middles lie beside the image, on all sides, and which reach into it: no early test may leave them out.
#[test]
fn what_lies_beside_the_image_shows_where_it_reaches_in() {
    const DEVIATION: f64 = 0.3;
    let gpu = TestGpu::new();
    let view = &eyes()[..1];
    let fov = view[0].fov;
    let mut splats = Recipe { count: 80, seed: 5, ..Default::default() }.still();
    for i in 0..splats.means.len() {
        let along = i as f64 / splats.means.len() as f64 * 1.6 - 0.8;
        let z = 1.5 + (i % 7) as f64 * 0.2;
        // Up to 2.5 deviations beyond the side's plane: there a twentieth of the opacity is left.
        let beyond =
            |slope: f64| slope.signum() * DEVIATION * (0.5 + 0.25 * (i % 9) as f64) * slope.hypot(1.0);
        let [x, y] = match i % 4 {
            0 => [fov.left * z + beyond(fov.left), along * z],
            1 => [fov.right * z + beyond(fov.right), along * z],
            2 => [along * z, fov.up * z + beyond(fov.up)],
            _ => [along * z, fov.down * z + beyond(fov.down)],
        };
        let mean = view[0].eye + view[0].rotation.transpose() * DVec3::new(x, y, z);
        splats.means[i] = mean.as_vec3().to_array();
        splats.log_scales[i] = [DEVIATION.ln() as f32; 3];
        splats.opacities[i] = 0.9;
    }
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for &projection in Projection::ALL {
        for &expansion in Expansion::ALL {
            let config = RenderConfig { expansion, ..every_layer(projection, LowPass::Planar) };
            let expected = truth(&splats, &view[0], view, &config);
            let (picture, _) = offscreen.render(&on_device, view, &config).unwrap();
            let db = psnr(&colours(&picture[0]), &expected);
            println!("{projection} {expansion}: {db:.1} dB");
            assert!(db >= 55.0, "{projection} {expansion}: {db:.1} dB");
            // Control: without them the picture is another.
            let wrong = psnr(&vec![[0; 3]; expected.len()], &expected);
            assert!(wrong < 35.0, "{projection}: nothing must not pass: {wrong:.1} dB");
        }
    }
}

#[test]
fn multiview_equals_two_passes_bit_for_bit() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let eyes = eyes();
    for composite in [Composite::BackToFront, Composite::EarlyStop] {
        for expansion in [Expansion::Instanced, Expansion::Precomputed] {
            let config = RenderConfig { composite, expansion, ..Default::default() };
            offscreen.set_stereo(Stereo::Multiview);
            let (one, _) = offscreen.render(&on_device, &eyes, &config).unwrap();
            offscreen.set_stereo(Stereo::TwoPass);
            let (two, _) = offscreen.render(&on_device, &eyes, &config).unwrap();
            assert_eq!(one, two, "{composite} {expansion}");
            assert_ne!(one[0], one[1], "both eyes must not see the same");
        }
    }
}
