//! Every sample scene in every storage: bytes a splat on the device, and likeness to f32.
//!
//! `cargo bench --bench precision [-- SCENE… --pictures FOLDER]`

#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench may")]

use motes_app::framing::Framing;
use motes_desktop::measure::{Picture as Measured, Settings as Compared, compare};
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::{
    Offscreen, Packing, Picture, Precision, Projection, RenderConfig, SceneOnDevice, ShPrecision, View,
};
use motes_scenes::settings::Settings;
use motes_scenes::{LoadOptions, Splats, load_many};
use motes_tests::golden::golden_view;
use motes_tests::sample;

/// Scenes seen from their golden view, and those seen as the viewer frames them.
const GOLDEN: &[&str] = &[
    "skull_sh3",
    "biker",
    "fruit_drops_sh3",
    "plant",
    "parking_lot",
    "playbot_lod0_sh2",
    "lacadiere_a",
    "hq_garden_lod2_a",
];
const FRAMED: &[&str] = &[
    "static/skull_sh3_v3.spz",
    "static/skull_sh3.compressed.ply",
    "static/biker.spz",
    "static/guitar.compressed.ply",
    "static/flowers_lod0",
    "static/lucy_100k.splat",
    "static/plant_l1.ksplat",
    "static/playcanvas-logo",
    "static/statues",
    "4d/spinach_4.splatv",
    "4d/spinach_stg_lite.ply",
    "4d/yellow_clip3.splatv",
    "4d/coffee10.splatv",
    "4d/flipbook_monkey/monkey_0001.sog",
    "photos_snowmiku/snowmiku_sh3.ply",
];

const STORED: [(Precision, ShPrecision); 5] = [
    (Precision::F32, ShPrecision::F32),
    (Precision::F16, ShPrecision::F32),
    (Precision::F16, ShPrecision::F16),
    (Precision::F16, ShPrecision::U8),
    (Precision::F16Naive, ShPrecision::F16),
];

fn measured(picture: &Picture) -> Measured {
    let bytes: Vec<u8> = picture.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    Measured::from_rgb8(picture.size, &bytes).unwrap()
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    let (mut wanted, mut folder) = (Vec::new(), None);
    while let Some(a) = arguments.next() {
        if a == "--pictures" { folder = arguments.next() } else { wanted.push(a) }
    }
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    println!(
        "bytes a splat (geometry + harmonics + motion), and PSNR to f32 in the tangent and the affine projection"
    );
    let mut show = |name: &str, splats: &Splats, view: View| {
        let mut truth: [Option<Measured>; 2] = [None, None];
        for (precision, sh_precision) in STORED {
            if splats.sh_degree == 0 && precision == Precision::F16 && sh_precision != ShPrecision::U8 {
                continue;
            }
            let packing = Packing { precision, sh_precision, sh_degree: 3 };
            let scene = SceneOnDevice::new(&gpu, splats, packing).unwrap();
            let each = |bytes: u64| bytes as f64 / f64::from(scene.splats);
            let db = [Projection::Tangent, Projection::Affine].map(|projection| {
                let config = RenderConfig { projection, time: 0.4, ..Default::default() };
                let (pictures, _) = offscreen.render(&scene, &[view], &config).unwrap();
                let picture = measured(&pictures[0]);
                if let Some(folder) = &folder {
                    let file = format!("{folder}/{}-{precision}-{projection}.png", name.replace('/', "-"));
                    picture.save(file.as_ref()).unwrap();
                }
                let truth = &mut truth[usize::from(projection == Projection::Affine)];
                match truth {
                    Some(t) => compare(t, &picture, &Compared::default()).unwrap().whole.psnr,
                    None => {
                        *truth = Some(picture);
                        f64::INFINITY
                    }
                }
            });
            println!(
                "{name:34} {:9} {precision:9} {sh_precision:4} {:5.1} + {:5.1} + {:4.1} = {:5.1}   {:6.2} {:6.2} dB",
                scene.splats,
                each(scene.geometry.bytes()),
                each(scene.harmonics.bytes()),
                each(scene.motion.bytes()),
                each(scene.bytes()),
                db[0],
                db[1],
            );
        }
    };
    let wants = |n: &str| wanted.is_empty() || wanted.iter().any(|w| n.contains(w.as_str()));
    for &name in GOLDEN.iter().filter(|n| wants(n)) {
        let golden = golden_view(name);
        show(name, &golden.splats, golden.view);
    }
    for &name in FRAMED.iter().filter(|n| wants(n)) {
        let splats = load_many(&[sample(name)], &LoadOptions::default()).unwrap().splats;
        let view = Framing::of(&splats, &Settings::default()).view(0.3, 0.1, 0.9, [640, 480]);
        show(name, &splats, view);
    }
}
