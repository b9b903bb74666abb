//! Time of whole frames, 1280 × 960: the default configuration over the Quest report's, in mono and stereo; as it is on a headset,
//! and with the expansion that is fastest on this device.
//!
//! On a driver that renders on the processor, the time that the process spent on all cores says more than the clock does
//! on a machine with other work; both are printed, as medians of ratios of neighbouring frames, with their quartiles.
//!
//! `cargo bench --bench frames [-- VIEW… NAME=VALUE,NAME=VALUE…]`; every argument with `=` adds a configuration that
//! differs so from the default one.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench may")]

use cpu_time::ProcessTime;
use glam::DVec3;
use motes_renderer::Choice;
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

/// A configuration with some choices made otherwise: `NAME=VALUE,NAME=VALUE`.
fn changed(config: &RenderConfig, text: &str) -> RenderConfig {
    let mut config = config.clone();
    for change in text.split(',') {
        let (name, value) = change.split_once('=').unwrap();
        Choice::named(name)
            .unwrap_or_else(|| panic!("no choice is called {name}"))
            .set(&mut config, value)
            .unwrap();
    }
    config
}

fn main() {
    let (others, wanted): (Vec<_>, Vec<_>) =
        std::env::args().skip(1).filter(|a| !a.starts_with('-')).partition(|a| a.contains('='));
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    for name in
        NAMES.into_iter().filter(|n| wanted.is_empty() || wanted.iter().any(|w| n.contains(w.as_str())))
    {
        let golden = golden_view(name);
        let view = golden.scaled(2);
        let scene = SceneOnDevice::new(&gpu, &golden.splats, packing).unwrap();
        for views in [&[view][..], &eyes(view)[..]] {
            let tangent = RenderConfig::default();
            let affine = RenderConfig { projection: Projection::Affine, ..tangent.clone() };
            let mut configs = vec![
                ("report".to_owned(), RenderConfig::quest_report()),
                ("default".to_owned(), tangent.clone()),
                ("default, affine".to_owned(), affine),
                ("on this device".to_owned(), tangent.clone().on(&gpu.capabilities, scene.splats, views)),
            ];
            configs.extend(others.iter().map(|text| (text.clone(), changed(&tangent, text))));
            offscreen.sort(&scene, views, &tangent);
            let visible = offscreen.draw(&scene, views, &tangent).unwrap().visible;
            println!("{name:18} {} view(s): {visible} of {} splats in sight", views.len(), scene.splats);
            // Seconds by the clock, of processor time, and on the device for order, preparation and drawing.
            let mut time = |config: &RenderConfig| -> [f64; 5] {
                offscreen.sort(&scene, views, config);
                let (wall, process) = (Instant::now(), ProcessTime::now());
                // The geometry stage draws one view: the report's viewer drew its eyes one by one.
                let parts = if config.expansion == Expansion::Geometry { 1 } else { views.len() };
                let mut device = [0.0; 3];
                for part in views.chunks(parts) {
                    let report = offscreen.draw(&scene, part, config).unwrap();
                    for (sum, ns) in
                        device.iter_mut().zip([report.upload_ns, report.prepare_ns, report.draw_ns])
                    {
                        *sum += 1e-9 * ns;
                    }
                }
                let [order, prepare, draw] = device;
                [wall.elapsed().as_secs_f64(), process.elapsed().as_secs_f64(), order, prepare, draw]
            };
            // Every configuration in turn, so that what else the machine does meets all alike.
            let frames: Vec<Vec<[f64; 5]>> = (0..=FRAMES)
                .map(|_| configs.iter().map(|(_, config)| time(config)).collect())
                .skip(1)
                .collect();
            for (i, (label, _)) in configs.iter().enumerate() {
                let ratio = |j: usize| quartiles(frames.iter().map(|f| f[i][j] / f[0][j]).collect());
                let ms = |j: usize| 1e3 * quartiles(frames.iter().map(|f| f[i][j]).collect())[1];
                let ([w1, w2, w3], [p1, p2, p3]) = (ratio(0), ratio(1));
                println!(
                    "{name:18} {} view(s) {label:16} processor time {p2:.3} ({p1:.3} to {p3:.3}), clock {w2:.3} \
                     ({w1:.3} to {w3:.3}) of the report's; {:.0} ms of processor time; on the device: order {:.1}, \
                     preparation {:.1}, drawing {:.1} ms",
                    views.len(),
                    ms(1),
                    ms(2),
                    ms(3),
                    ms(4)
                );
            }
        }
    }
}
