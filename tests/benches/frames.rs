//! Time of whole frames, 1280 × 960: the default configuration over the Quest report's, in mono and stereo.
//!
//! On a driver that renders on the processor, the time that the process spent on all cores says more than the clock does
//! on a machine with other work; both are printed, as medians of ratios of neighbouring frames, with their quartiles.
//!
//! `cargo bench --bench frames [-- VIEW…]`

#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench may")]

use cpu_time::ProcessTime;
use glam::DVec3;
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::{
    Expansion, Offscreen, Packing, Precision, Projection, RenderConfig, SceneOnDevice, ShPrecision, View,
};
use motes_tests::golden::{NAMES, golden_view};
use std::time::Instant;

/// Frames that are measured of each configuration, after one that is not.
const FRAMES: usize = 5;

/// Two eyes 64 mm apart, seeing what one sees.
fn eyes(view: View) -> [View; 2] {
    let right: DVec3 = view.rotation.row(0);
    [-0.032, 0.032].map(|x| View { eye: view.eye + right * x, ..view })
}

fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.25, 0.5, 0.75].map(|q| values[(q * (values.len() - 1) as f64).round() as usize])
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    let tangent = RenderConfig::default();
    let affine = RenderConfig { projection: Projection::Affine, ..tangent.clone() };
    for name in
        NAMES.into_iter().filter(|n| wanted.is_empty() || wanted.iter().any(|w| n.contains(w.as_str())))
    {
        let golden = golden_view(name);
        let view = golden.scaled(2);
        let scene = SceneOnDevice::new(&gpu, &golden.splats, packing).unwrap();
        for views in [&[view][..], &eyes(view)[..]] {
            let mut baseline = RenderConfig::quest_report();
            if views.len() == 2 {
                // The geometry stage draws one view: the report's viewer drew its eyes one by one.
                baseline.expansion = Expansion::Geometry;
            }
            let mut configs = vec![("affine", affine.clone())];
            for batches in [8, 16, 32] {
                configs.push(("tangent", RenderConfig { batches, ..tangent.clone() }));
            }
            let mut time = |config: &RenderConfig| {
                offscreen.sort(&scene, views, config);
                let (wall, process) = (Instant::now(), ProcessTime::now());
                if config.expansion == Expansion::Geometry {
                    let reports: Vec<_> =
                        views.iter().map(|v| offscreen.draw(&scene, &[*v], config).unwrap()).collect();
                    (wall.elapsed().as_secs_f64(), process.elapsed().as_secs_f64(), reports[0].clone())
                } else {
                    let report = offscreen.draw(&scene, views, config).unwrap();
                    (wall.elapsed().as_secs_f64(), process.elapsed().as_secs_f64(), report)
                }
            };
            for (label, config) in &configs {
                let (mut wall, mut process, mut own) = (Vec::new(), Vec::new(), Vec::new());
                for frame in 0..=FRAMES {
                    let base = time(&baseline);
                    let ours = time(config);
                    if frame > 0 {
                        wall.push(ours.0 / base.0);
                        process.push(ours.1 / base.1);
                        own.push(ours.1);
                    }
                }
                let [w1, w2, w3] = quartiles(wall);
                let [p1, p2, p3] = quartiles(process);
                println!(
                    "{name:18} {} view(s) {label:8} {:2} batches: processor time {p2:.3} ({p1:.3} to {p3:.3}), \
                     clock {w2:.3} ({w1:.3} to {w3:.3}) of the report's; {:.0} ms of processor time",
                    views.len(),
                    config.batches,
                    1e3 * quartiles(own)[1]
                );
            }
        }
    }
}
