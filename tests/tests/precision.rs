//! Storage on the device: what half floats cost in bytes and in likeness, done right and done naively.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_app::framing::Framing;
use motes_renderer::{
    Composite, Fov, Offscreen, Packing, Picture, Precision, Projection, RenderConfig, SceneOnDevice,
    ShPrecision, TargetFormat, View,
};
use motes_scenes::settings::Settings;
use motes_scenes::synthetic::Recipe;
use motes_scenes::{LoadOptions, Splats, load};
use motes_tests::{TestGpu, psnr, sample};

const F32: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
const RIGHT: Packing = Packing { precision: Precision::F16, sh_precision: ShPrecision::U8, sh_degree: 3 };
const NAIVE: Packing =
    Packing { precision: Precision::F16Naive, sh_precision: ShPrecision::F16, sh_degree: 3 };

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

/// The widest a splat appears in an affine picture, and a picture of each packing.
fn pictures(gpu: &TestGpu, splats: &Splats, view: View, packings: &[Packing]) -> Vec<Vec<[u8; 3]>> {
    let mut offscreen = Offscreen::new(gpu).unwrap();
    let config = RenderConfig { projection: Projection::Affine, time: 0.4, ..Default::default() };
    packings
        .iter()
        .map(|&packing| {
            let scene = SceneOnDevice::new(gpu, splats, packing).unwrap();
            colours(&offscreen.render(&scene, &[view], &config).unwrap().0[0])
        })
        .collect()
}

#[test]
fn half_floats_done_right_show_the_samples_as_floats_do() {
    let gpu = TestGpu::new();
    for (file, geometry, harmonics) in [
        ("static/skull.sog", 32, 48),
        ("static/fruit_drops_minimal.ply", 32, 48),
        ("static/guitar.compressed.ply", 32, 0),
        ("4d/spinach_4.splatv", 32, 0),
    ] {
        let splats = load(&sample(file), &LoadOptions::default()).unwrap().splats;
        let view = Framing::of(&splats, &Settings::default()).view(0.3, 0.1, 0.9, [240, 180]);
        let scene = SceneOnDevice::new(&gpu, &splats, RIGHT).unwrap();
        let each = |bytes: u64| bytes.div_ceil(u64::from(scene.splats));
        assert_eq!(each(scene.geometry.bytes()), geometry, "{file}");
        assert_eq!(each(scene.harmonics.bytes()), harmonics, "{file}");
        drop(scene);
        let [truth, right] = pictures(&gpu, &splats, view, &[F32, RIGHT]).try_into().unwrap();
        let lit = truth.iter().filter(|p| p.iter().any(|&c| c > 20)).count();
        let db = psnr(&right, &truth);
        println!("{file}: {db:.1} dB, {lit} pixels lit");
        assert!(db >= 45.0, "{file}: {db:.1} dB");
        assert!(lit > 1000, "{file}: an empty picture proves nothing");
    }
}

/// Needles that are wide on the screen: their covariances in pixels are beyond what a half float holds when multiplied.
fn near_and_far() -> (Splats, View) {
    let mut splats = Recipe { count: 300, seed: 21, log_scales: [-3.6, -2.6], ..Default::default() }.still();
    for scales in &mut splats.log_scales {
        scales[0] += 2.0;
    }
    let size = [480, 360];
    let fov = Fov::vertical(0.9, size);
    (splats, View::look_at(DVec3::new(0.0, 0.1, -2.6), DVec3::ZERO, DVec3::NEG_Y, fov, size))
}

#[test]
fn naive_half_floats_make_a_halo_where_splats_are_wide_and_ours_do_not() {
    let gpu = TestGpu::new();
    let (splats, near) = near_and_far();
    let far = View { eye: near.eye * 12.0, ..near };
    let [truth, right, naive] = pictures(&gpu, &splats, near, &[F32, RIGHT, NAIVE]).try_into().unwrap();
    let (db, halo) = (psnr(&right, &truth), psnr(&naive, &truth));
    println!("near: {db:.1} dB done right, {halo:.1} dB naively");
    assert!(db >= 45.0, "{db:.1} dB done right");
    assert!(halo < 28.0, "the halo does not show: {halo:.1} dB");
    // Control: the same splats far away are narrow, and the naive way shows them nearly right.
    let [truth, naive] = pictures(&gpu, &splats, far, &[F32, NAIVE]).try_into().unwrap();
    let far = psnr(&naive, &truth);
    println!("far: {far:.1} dB naively");
    assert!(far > halo + 10.0, "far {far:.1} dB, near {halo:.1} dB");
}

#[test]
fn smaller_targets_lose_little_and_two_bits_of_opacity_are_refused() {
    let gpu = TestGpu::new();
    let (splats, view) = near_and_far();
    let scene = SceneOnDevice::new(&gpu, &splats, F32).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for composite in [Composite::EarlyStop, Composite::BackToFront] {
        let mut render = |target| {
            let config = RenderConfig { composite, target, ..Default::default() };
            offscreen.render(&scene, &[view], &config).map(|(p, _)| colours(&p[0]))
        };
        let truth = render(TargetFormat::Rgba16F).unwrap();
        let db = psnr(&render(TargetFormat::Rgba8).unwrap(), &truth);
        println!("{composite}: rgba8 {db:.1} dB");
        assert!(db > 38.0, "{composite}: rgba8 {db:.1} dB");
        match render(TargetFormat::Rgb10A2) {
            Ok(picture) => {
                let db = psnr(&picture, &truth);
                println!("{composite}: rgb10a2 {db:.1} dB");
                assert_eq!(composite, Composite::BackToFront);
                assert!(db > 45.0, "{composite}: rgb10a2 {db:.1} dB");
            }
            // Front to back, the opacity so far is read back: two bits cannot hold it.
            Err(e) => {
                assert_eq!(composite, Composite::EarlyStop);
                assert!(e.to_string().contains("back-to-front"), "{e}");
            }
        }
    }
}
