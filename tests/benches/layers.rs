//! Layers per pixel of five views, 640 × 480: what the Quest report's way shades, every layer of opacity-aware
//! octagons, what early stop leaves of them, and the least that a stop per pixel could leave.
//!
//! `cargo bench --bench layers [-- VIEW… [stop-below=T…]]`: transmittances at which pixels stop, instead of the default.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench may")]

use motes_desktop::measure::{Picture as Measured, Settings, compare};
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::reference::{self, ReferenceOptions};
use motes_renderer::{
    Composite, Expansion, Marks, Offscreen, Packing, Picture, Precision, Projection, RenderConfig,
    SceneOnDevice, ShPrecision, TargetFormat,
};
use motes_tests::golden::{NAMES, golden_view};

/// Area of the octagon over that of the ellipse in it: the reference counts ellipses, the rasteriser octagons.
const OCTAGON: f64 = 3.31 / std::f64::consts::PI;

fn measured(picture: &Picture) -> Measured {
    let bytes: Vec<u8> = picture.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    Measured::from_rgb8(picture.size, &bytes).unwrap()
}

fn main() {
    let (stops, wanted): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).filter(|a| !a.starts_with('-')).partition(|a| a.starts_with("stop-below="));
    let mut stops: Vec<f32> = stops.iter().map(|s| s["stop-below=".len()..].parse().unwrap()).collect();
    if stops.is_empty() {
        stops.push(RenderConfig::default().stop_below);
    }
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
    for name in
        NAMES.into_iter().filter(|n| wanted.is_empty() || wanted.iter().any(|w| n.contains(w.as_str())))
    {
        let golden = golden_view(name);
        let views = [golden.view];
        let scene = SceneOnDevice::new(&gpu, &golden.splats, packing).unwrap();
        let count = |offscreen: &mut Offscreen, label: &str, config: &RenderConfig| {
            let (maps, _) = offscreen.layers(&scene, &views, config).unwrap();
            let (picture, report) = offscreen.render(&scene, &views, config).unwrap();
            println!(
                "{name:18} {label:34} shaded {:6.2}  blended {:6.2}  statistic {:6.2}  marks {:5.2}  predicted {:6.2} unhidden {:6.2}",
                maps[0].mean_shaded(),
                maps[0].mean_blended(),
                report.fragments as f64 / report.pixels as f64,
                report.full_screen_fragments as f64 / report.pixels as f64,
                f64::from(report.predicted_fragments) / report.pixels as f64,
                f64::from(report.predicted_unhidden) / report.pixels as f64
            );
            picture.into_iter().next().unwrap()
        };
        let projection = Projection::Tangent;
        let report = RenderConfig { projection, ..RenderConfig::quest_report() };
        count(&mut offscreen, &format!("report {projection}"), &report);
        for &stop_below in &stops {
            let base = RenderConfig {
                projection,
                composite: Composite::FrontToBack,
                stop_below,
                ..Default::default()
            };
            let all =
                measured(&count(&mut offscreen, &format!("every layer, opaque at {stop_below:.4}"), &base));
            let exact = RenderConfig { target: TargetFormat::Rgba32F, ..base.clone() };
            let all_exact = measured(&offscreen.render(&scene, &views, &exact).unwrap().0[0]);
            println!(
                "{:53} FLIP of rgba16f to rgba32f {:.5}",
                "",
                compare(&all_exact, &all, &Settings::default()).unwrap().flip.mean
            );
            for (marks, batches) in [
                (Marks::Everywhere, 16),
                (Marks::Due, 16),
                (Marks::Due, 32),
                (Marks::Due, 64),
                (Marks::Due, 128),
            ] {
                let config = RenderConfig { composite: Composite::EarlyStop, batches, marks, ..base.clone() };
                let picture = measured(&count(
                    &mut offscreen,
                    &format!("stop at {stop_below:.4} {batches} {marks}"),
                    &config,
                ));
                let flip = compare(&all, &picture, &Settings::default()).unwrap().flip.mean;
                // Half floats lose the last layers of many, here by truncation: without a stop more than with it.
                let exact = RenderConfig { target: TargetFormat::Rgba32F, ..config };
                let exact = measured(&offscreen.render(&scene, &views, &exact).unwrap().0[0]);
                let apart = compare(&all_exact, &exact, &Settings::default()).unwrap().flip.mean;
                println!("{:53} FLIP to every layer {flip:.5}; in rgba32f {apart:.5}", "");
            }
        }
        // By tiles, blended in full precision whatever the target; against themselves without a stop.
        for &stop_below in &stops {
            let [every, stopped] = [Composite::FrontToBack, Composite::EarlyStop].map(|composite| {
                let config = RenderConfig {
                    projection,
                    composite,
                    stop_below,
                    expansion: Expansion::Tiles,
                    ..Default::default()
                };
                measured(&count(&mut offscreen, &format!("tiles, {composite} at {stop_below:.4}"), &config))
            });
            let flip = compare(&every, &stopped, &Settings::default()).unwrap().flip.mean;
            println!("{:53} FLIP to every layer {flip:.5}", "");
        }
        let options = ReferenceOptions {
            projection: Projection::Affine,
            ..ReferenceOptions::of_config(&RenderConfig::default())
        };
        let image = reference::render(&golden.splats, &golden.view, &options).unwrap();
        let layers: f64 = image.pixels.iter().map(|p| f64::from(p.layers_until)).sum();
        println!("{name:18} ideal {:34.2}", OCTAGON * layers / image.pixels.len() as f64);
    }
}
