//! Every way of drawing agrees with the reference: expansion × projection × shape × mono and stereo.

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

#[test]
fn all_combinations_agree_with_the_reference() {
    let gpu = TestGpu::new();
    let splats = scene();
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let eyes = eyes();
    for &projection in Projection::ALL {
        for &low_pass in LowPass::ALL {
            let mut base = RenderConfig {
                projection,
                low_pass,
                radius: RadiusRule::Full,
                composite: Composite::FrontToBack,
                ..Default::default()
            };
            let alone = truth(&splats, &eyes[0], &eyes[..1], &base);
            let expected = [0, 1].map(|e| truth(&splats, &eyes[e], &eyes, &base));
            for &shape in QuadShape::ALL {
                base.shape = shape;
                for &expansion in Expansion::ALL {
                    base.expansion = expansion;
                    let name = format!("{projection} {low_pass} {shape} {expansion}");
                    // A diamond cuts the rims of its splats: its bound is another.
                    let least = if shape == QuadShape::Diamond { 20.0 } else { 48.0 };
                    let (mono, _) = offscreen.render(&on_device, &eyes[..1], &base).unwrap();
                    let db = psnr(&colours(&mono[0]), &alone);
                    println!("{name}: {db:.1} dB mono");
                    assert!(db >= least, "{name}: {db:.1} dB mono");
                    if expansion == Expansion::Geometry {
                        continue; // one view only
                    }
                    let (stereo, _) = offscreen.render(&on_device, &eyes, &base).unwrap();
                    for eye in 0..2 {
                        let db = psnr(&colours(&stereo[eye]), &expected[eye]);
                        assert!(db >= least, "{name}: {db:.1} dB, eye {eye}");
                        let wrong = psnr(&colours(&stereo[eye]), &expected[1 - eye]);
                        assert!(wrong < 30.0, "the other eye's picture must not pass: {wrong:.1} dB");
                    }
                }
            }
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
