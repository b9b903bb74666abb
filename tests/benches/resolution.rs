//! Reduced resolution against full: FLIP, PSNR, fragments and device time of the bilinear and the interleaved way, and
//! of the temporal one over eight frames of a still eye. Times as on a headset (polygons), and with the expansion that is
//! fastest on this device.
//!
//! `cargo bench --bench resolution [-- VIEW… --scales 0.5,0.7,0.9 --times N --large --pictures FOLDER]`

#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench may")]

use cpu_time::ProcessTime;
use motes_desktop::measure::{Picture as Measured, Settings, compare};
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::{
    Offscreen, Packing, Picture, Precision, RenderConfig, SceneOnDevice, ShPrecision, Upscale, View,
};
use motes_tests::golden::{NAMES, golden_view};
use std::path::PathBuf;

fn measured(picture: &Picture) -> Measured {
    let bytes: Vec<u8> = picture.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    Measured::from_rgb8(picture.size, &bytes).unwrap()
}

struct Options {
    views: Vec<String>,
    scales: Vec<f32>,
    times: usize,
    large: bool,
    pictures: Option<PathBuf>,
}

fn options() -> Options {
    let mut o = Options { views: Vec::new(), scales: vec![0.7], times: 0, large: false, pictures: None };
    let mut arguments = std::env::args().skip(1);
    while let Some(a) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{a} wants a value"));
        match a.as_str() {
            "--bench" => {}
            "--large" => o.large = true,
            "--scales" => o.scales = value().split(',').map(|s| s.parse().unwrap()).collect(),
            "--times" => o.times = value().parse().unwrap(),
            "--pictures" => o.pictures = Some(value().into()),
            _ => o.views.push(a),
        }
    }
    o
}

fn main() {
    let options = options();
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    println!("view               scale upscale              pixels  fragments     FLIP   PSNR  device ms");
    let wanted = |n: &&str| options.views.is_empty() || options.views.iter().any(|w| n.contains(w.as_str()));
    for name in NAMES.into_iter().filter(wanted) {
        let golden = golden_view(name);
        let views = [if options.large { golden.scaled(2) } else { golden.view }];
        let scene = SceneOnDevice::new(&gpu, &golden.splats, packing).unwrap();
        let row = |offscreen: &mut Offscreen,
                   scale: f32,
                   upscale: Upscale,
                   frames: usize,
                   full: Option<&Measured>| {
            let config = RenderConfig { resolution_scale: scale, upscale, ..Default::default() };
            let (pictures, report) =
                (0..frames).map(|_| offscreen.render(&scene, &views, &config).unwrap()).last().unwrap();
            let picture = measured(&pictures[0]);
            let (flip, psnr) = full.map_or((0.0, f64::INFINITY), |f| {
                let c = compare(f, &picture, &Settings::default()).unwrap();
                (c.flip.mean, c.whole.psnr)
            });
            let least = least_ns(offscreen, &scene, &views, &config, options.times);
            let label = if full.is_some() { upscale.to_string() } else { "full".into() };
            println!(
                "{name:18} {scale:5.3} {label:20} {:7} {:10} {flip:8.5} {psnr:6.2} {:10.2}",
                report.pixels,
                report.fragments,
                least / 1e6
            );
            if let Some(folder) = &options.pictures {
                picture.save(&folder.join(format!("{name}-{scale}-{label}.png"))).unwrap();
            }
            picture
        };
        let full = row(&mut offscreen, 1.0, Upscale::Bilinear, 1, None);
        for &scale in &options.scales {
            row(&mut offscreen, scale, Upscale::Bilinear, 1, Some(&full));
            row(&mut offscreen, scale, Upscale::Interleaved, 1, Some(&full));
            row(&mut offscreen, scale, Upscale::InterleavedTemporal, 8, Some(&full));
            if options.times > 0 {
                let polygons = RenderConfig { resolution_scale: scale, ..Default::default() };
                let here = polygons.clone().on(&gpu.capabilities, scene.splats, &views);
                for base in [polygons, here] {
                    let configs = [Upscale::Bilinear, Upscale::Interleaved]
                        .map(|upscale| RenderConfig { upscale, ..base.clone() });
                    let [fewer, more] = configs.each_ref().map(|config| {
                        let (maps, _) = offscreen.layers(&scene, &views, config).unwrap();
                        maps[0].mean_shaded()
                    });
                    println!(
                        "{name:18} {scale:5.3} {:12} layers shaded per rendered pixel: {fewer:.2} bilinear, {more:.2} interleaved",
                        base.expansion.to_string()
                    );
                    let [low, middle, high] = ratio(&mut offscreen, &scene, &views, &configs, options.times);
                    println!(
                        "{name:18} {scale:5.3} {:12} interleaved takes {middle:.3} ({low:.3} to {high:.3}) of bilinear's processor time",
                        base.expansion.to_string()
                    );
                }
            }
        }
    }
}

/// Processor time of the second configuration over the first one's: quartiles over pairs of neighbouring frames, of which
/// every other one is drawn the other way around.
fn ratio(
    offscreen: &mut Offscreen,
    scene: &SceneOnDevice,
    views: &[View],
    configs: &[RenderConfig; 2],
    pairs: usize,
) -> [f64; 3] {
    let mut time = |config: &RenderConfig| {
        let start = ProcessTime::now();
        offscreen.draw(scene, views, config).unwrap();
        start.elapsed().as_secs_f64()
    };
    let _warm = configs.each_ref().map(&mut time);
    let mut ratios: Vec<f64> = (0..pairs)
        .map(|i| {
            let [first, second] = if i % 2 == 0 { [0, 1] } else { [1, 0] };
            let (a, b) = (time(&configs[first]), time(&configs[second]));
            if first == 0 { b / a } else { a / b }
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    [0.25, 0.5, 0.75].map(|q| ratios[(q * (pairs - 1) as f64).round() as usize])
}

/// The shortest device time of so many frames.
fn least_ns(
    offscreen: &mut Offscreen,
    scene: &SceneOnDevice,
    views: &[View],
    config: &RenderConfig,
    times: usize,
) -> f64 {
    (0..times)
        .map(|_| offscreen.draw(scene, views, config).unwrap().device_ns())
        .fold(f64::INFINITY, f64::min)
}
