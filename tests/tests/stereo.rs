//! Stereo, formats and large scenes: the same picture by another way.
#![allow(clippy::unwrap_used, reason = "a test may")]

use std::path::Path;

use glam::DVec3;
use motes_app::framing::Framing;
use motes_app::viewer::eyes;
use motes_renderer::{
    Composite, Fov, Offscreen, Packing, Picture, Precision, RenderConfig, SceneOnDevice, ShPrecision,
    TargetFormat, View,
};
use motes_scenes::settings::Settings;
use motes_scenes::{LoadOptions, Splats, load, sample as plant};
use motes_tests::{TestGpu, psnr, sample};

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
const SIZE: [u32; 2] = [160, 120];

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

/// Values of one picture of a pair.
fn values(pair: &[View]) -> usize {
    pair[0].size.iter().map(|&s| s as usize).product::<usize>() * 4
}

/// Values that differ by more than so many steps of 255.
fn differing(a: &Picture, b: &Picture, steps: u8) -> usize {
    a.pixels.iter().flatten().zip(b.pixels.iter().flatten()).filter(|(a, b)| a.abs_diff(**b) > steps).count()
}

/// Largest difference in a channel, steps of 255.
fn steps(a: &Picture, b: &Picture) -> u8 {
    let pairs = a.pixels.iter().flatten().zip(b.pixels.iter().flatten());
    pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

fn read(path: &str) -> Splats {
    load(&sample(path), &LoadOptions::default()).unwrap().splats
}

fn front(splats: &Splats) -> View {
    Framing::of(splats, &Settings::default()).view(0.5, 0.3, 1.0, SIZE)
}

#[test]
fn an_eye_sees_what_it_sees_alone() {
    let gpu = TestGpu::new();
    let splats = plant::sample(&LoadOptions::default()).unwrap().splats;
    let scene = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let pair = eyes(&front(&splats), 0.063);
    let most = values(&pair) / 10_000;
    // With every layer, an eye in a pair is the eye alone. Early stop looks for finished pixels at other places in the
    // order then; what that leaves is less than a step, of which half-float sums that are cut towards zero make two in a
    // value or so of 50 000.
    for (target, composite, most) in [
        (TargetFormat::Rgba16F, Composite::FrontToBack, 0),
        (TargetFormat::Rgba32F, Composite::EarlyStop, 0),
        (TargetFormat::Rgba16F, Composite::EarlyStop, most),
    ] {
        let config = RenderConfig { target, composite, ..RenderConfig::default() };
        let (both, _) = offscreen.render(&scene, &pair, &config).unwrap();
        for eye in 0..2 {
            // The order is the pair's: alone, an eye would sort from its own place.
            offscreen.sort(&scene, &pair, &config);
            let (alone, _) = offscreen.picture(&scene, &pair[eye..=eye], &config).unwrap();
            let apart = |step| differing(&both[eye], &alone[0], step);
            println!(
                "{target}, {composite}, eye {eye}: {} values by one step of 255, {} by two",
                apart(0),
                apart(1)
            );
            assert!(
                apart(1) <= most && apart(2) == 0,
                "{target}, {composite}, eye {eye}: {} values",
                apart(1)
            );
            assert!(composite == Composite::EarlyStop || apart(0) == 0, "{target}, {composite}, eye {eye}");
            assert!(differing(&both[1 - eye], &alone[0], 50) > 100, "the other eye must not pass");
        }
    }
}

/// One scene in three formats. What differs is the formats' own steps: SPZ rounds harmonics to 4 and 5 bits and colours
/// to 8, compressed PLY scales to 11 bits and positions to 11 bits of their chunk, SOG has codebooks of 256.
#[test]
fn formats_of_one_scene_give_one_picture() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let config = RenderConfig::default();
    let first = read("static/skull.sog");
    let view = front(&first);
    let mut take = |splats: &Splats, view: &View| {
        let scene = SceneOnDevice::new(&gpu, splats, PLAIN).unwrap();
        colours(&offscreen.render(&scene, &[*view], &config).unwrap().0[0])
    };
    let sog = take(&first, &view);
    for file in ["static/skull_sh3_v3.spz", "static/skull_sh3.compressed.ply"] {
        let splats = read(file);
        let db = psnr(&sog, &take(&splats, &view));
        println!("{file}: {db:.1} dB");
        assert!(db >= 38.0, "{file}: {db:.1} dB");
        // A degree less of one band is seen.
        let mut plain = splats.clone();
        plain.set_sh_degree(0);
        let control = psnr(&sog, &take(&plain, &view));
        assert!(control < db - 3.0, "{file} without harmonics: {control:.1} dB");
    }
}

/// The garden in f32 takes 48 MB a binding of 2²⁰ splats or more; repeated four times it needs two bindings.
#[test]
fn a_scene_of_several_bindings_is_drawn_whole() {
    let gpu = TestGpu::new();
    let once = plant::sample(&LoadOptions::default()).unwrap().splats;
    let view = front(&once);
    let limit = gpu.capabilities.max_storage_range;
    // Copies far behind the eye fill the bindings; the plant itself lies in the last one.
    let copies = (limit / (once.len() as u64 * 56) + 1) as usize;
    let mut splats = Splats::zeroed(0, 0, false);
    let behind = view.eye - view.rotation.row(2) * 100.0;
    for copy in 0..=copies {
        let offset = if copy == copies { DVec3::ZERO } else { behind };
        let shift = |m: &[f32; 3]| std::array::from_fn(|k| m[k] + offset[k] as f32);
        splats.means.extend(once.means.iter().map(shift));
        splats.rotations.extend(&once.rotations);
        splats.log_scales.extend(&once.log_scales);
        splats.opacities.extend(&once.opacities);
        splats.sh.extend(&once.sh);
    }
    assert_eq!(once.sh_degree, 0);
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let config = RenderConfig::default();
    let alone = SceneOnDevice::new(&gpu, &once, PLAIN).unwrap();
    let (expected, _) = offscreen.render(&alone, &[view], &config).unwrap();
    let scene = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    println!("{} splats, {} bindings", splats.len(), scene.geometry.buffers.len());
    assert!(scene.geometry.buffers.len() >= 2, "the scene must not fit one binding");
    let (whole, _) = offscreen.render(&scene, &[view], &config).unwrap();
    let off = steps(&whole[0], &expected[0]);
    assert!(off <= 1, "{off} steps of 255");
    // Negative control: without the last binding there is nothing to see.
    let mut cut = splats;
    let kept = cut.len() - once.len();
    cut.retain(|i| i < kept);
    let nothing = SceneOnDevice::new(&gpu, &cut, PLAIN).unwrap();
    let (empty, _) = offscreen.render(&nothing, &[view], &config).unwrap();
    assert!(steps(&empty[0], &expected[0]) > 50);
}

#[test]
fn every_sample_file_is_drawn() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let size = [96, 72];
    for path in [
        "static/biker.spz",
        "static/guitar.compressed.ply",
        "static/lucy_100k.splat",
        "static/plant_l1.ksplat",
        "static/playcanvas-logo",
        "4d/spinach_4.splatv",
        "photos_snowmiku/snowmiku_sh3.ply",
    ] {
        let file = sample(path);
        let splats = load(&file, &LoadOptions::default()).unwrap().splats;
        let scene = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
        let view = View { fov: Fov::vertical(1.0, size), size, ..front(&splats) };
        let config = RenderConfig { time: 0.5, ..Default::default() };
        let (picture, report) = offscreen.render(&scene, &[view], &config).unwrap();
        let bright = colours(&picture[0]).iter().filter(|p| p.iter().any(|c| *c > 16)).count();
        let share = bright as f64 / picture[0].pixels.len() as f64;
        println!("{}: {} splats, {share:.2} of the picture", Path::new(path).display(), report.visible);
        assert!(share > 0.02 && report.visible > 100, "{path}: nothing to see");
    }
}
