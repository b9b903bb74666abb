//! What depth for a headset's compositor costs: drawing both eyes with it over drawing them without, by the device's clock
//! and in processor time (medians of ratios of neighbouring frames, with their quartiles).
//!
//! `cargo bench --bench depth [-- VIEW…]`

#![allow(clippy::unwrap_used, reason = "a bench may")]

use cpu_time::ProcessTime;
use glam::DVec3;
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::{Offscreen, Packing, Precision, RenderConfig, SceneOnDevice, ShPrecision, View};
use motes_tests::golden::{NAMES, golden_view};

/// Pairs of frames that are measured, after one that is not.
const FRAMES: usize = 5;

fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.25, 0.5, 0.75].map(|q| values[(q * (values.len() - 1) as f64).round() as usize])
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    let config = RenderConfig::default();
    for name in NAMES.into_iter().filter(|n| wanted.is_empty() || wanted.iter().any(|w| n.contains(&**w))) {
        let golden = golden_view(name);
        let view = golden.scaled(2);
        let right: DVec3 = view.rotation.row(0);
        let views = [-0.032, 0.032].map(|x| View { eye: view.eye + right * x, ..view });
        let scene = SceneOnDevice::new(&gpu, &golden.splats, packing).unwrap();
        let mut frame = |depth: bool| {
            let begun = ProcessTime::now();
            let report = if depth {
                offscreen.depths(&scene, &views, &config).unwrap().1
            } else {
                offscreen.render(&scene, &views, &config).unwrap().1
            };
            (report.draw_ns / 1e6, begun.elapsed().as_secs_f64() * 1e3, report)
        };
        let pairs: Vec<_> = (0..=FRAMES).map(|_| (frame(false), frame(true))).skip(1).collect();
        let [device, process] = [
            quartiles(pairs.iter().map(|(plain, depth)| depth.0 / plain.0).collect()),
            quartiles(pairs.iter().map(|(plain, depth)| depth.1 / plain.1).collect()),
        ];
        let (plain, depth) = (&pairs[0].0.2, &pairs[0].1.2);
        println!(
            "{name:18} {} × {}: with depth {:.3} ({:.3} to {:.3}) of drawing's time, {:.3} ({:.3} to {:.3}) of the processor's; \
             {} draws over {}, {:.1} layers a pixel",
            view.size[0],
            view.size[1],
            device[1],
            device[0],
            device[2],
            process[1],
            process[0],
            process[2],
            depth.draws,
            plain.draws,
            plain.layers(),
        );
    }
}
