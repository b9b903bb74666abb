//! Time of whole frames, 1280 × 960: the default configuration over the Quest report's, in mono and stereo; as it is on a headset,
//! and with the expansion that is fastest on this device.
//!
//! On a driver that renders on the processor, the time that the process spent on all cores says more than the clock does
//! on a machine with other work; both are printed, as medians of ratios of neighbouring frames, with their quartiles.
//! What the tangent projection takes over the affine one is said for both ways to draw.
//!
//! `cargo bench --bench frames [-- VIEW… --times N --projections NAME=VALUE,NAME=VALUE…]`; every argument with `=` adds a
//! configuration that differs so from the default one, and `--projections` leaves the report's out.

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

struct Options {
    /// Parts of names of the views; none: all.
    views: Vec<String>,
    /// Frames that are measured of each configuration, after one that is not.
    times: usize,
    /// The projections alone, without the report's way.
    projections: bool,
    /// What other configurations do otherwise than the default one.
    others: Vec<String>,
}

fn options() -> Options {
    let mut o = Options { views: Vec::new(), times: 5, projections: false, others: Vec::new() };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--times" => o.times = arguments.next().unwrap().parse().unwrap(),
            "--projections" => o.projections = true,
            "--bench" => {}
            other if other.starts_with('-') => panic!("no option is called {other}"),
            other if other.contains('=') => o.others.push(argument),
            _ => o.views.push(argument),
        }
    }
    o
}

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
    let options = options();
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    for name in
        NAMES.into_iter().filter(|n| options.views.is_empty() || options.views.iter().any(|w| n.contains(w)))
    {
        let golden = golden_view(name);
        let view = golden.scaled(2);
        let scene = SceneOnDevice::new(&gpu, &golden.splats, packing).unwrap();
        for views in [&[view][..], &eyes(view)[..]] {
            let tangent = RenderConfig::default();
            let fastest = tangent.clone().on(&gpu.capabilities, scene.splats, views);
            let affine =
                |config: &RenderConfig| RenderConfig { projection: Projection::Affine, ..config.clone() };
            let mut configs = vec![
                ("default".to_owned(), tangent.clone()),
                ("default, affine".to_owned(), affine(&tangent)),
                ("on this device".to_owned(), fastest.clone()),
                ("on this device, affine".to_owned(), affine(&fastest)),
            ];
            if !options.projections {
                configs.insert(0, ("report".to_owned(), RenderConfig::quest_report()));
            }
            configs.extend(options.others.iter().map(|text| (text.clone(), changed(&tangent, text))));
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
            // Every configuration in turn, and back, so that what else the machine does meets all alike.
            let mut frames = vec![vec![[0.0; 5]; configs.len()]; options.times + 1];
            for (round, frame) in frames.iter_mut().enumerate() {
                for step in 0..configs.len() {
                    let i = if round % 2 == 0 { step } else { configs.len() - 1 - step };
                    frame[i] = time(&configs[i].1);
                }
            }
            let frames = &frames[1..];
            // Of one configuration over another: processor time (1) or the clock (0).
            let ratio = |i: usize, over: usize, j: usize| {
                let [low, middle, high] = quartiles(frames.iter().map(|f| f[i][j] / f[over][j]).collect());
                format!("{middle:.3} ({low:.3} to {high:.3})")
            };
            for (i, (label, _)) in configs.iter().enumerate() {
                let ms = |j: usize| 1e3 * quartiles(frames.iter().map(|f| f[i][j]).collect())[1];
                println!(
                    "{name:18} {} view(s) {label:22} processor time {}, clock {} of the {}'s; {:.0} ms of processor time; on \
                     the device: order {:.1}, preparation {:.1}, drawing {:.1} ms",
                    views.len(),
                    ratio(i, 0, 1),
                    ratio(i, 0, 0),
                    configs[0].0,
                    ms(1),
                    ms(2),
                    ms(3),
                    ms(4)
                );
                if let Some(affine) =
                    configs.iter().position(|(other, _)| *other == format!("{label}, affine"))
                {
                    println!(
                        "{name:18} {} view(s) {label:22} tangent over affine: processor time {}, clock {}",
                        views.len(),
                        ratio(i, affine, 1),
                        ratio(i, affine, 0)
                    );
                }
            }
        }
    }
}
