//! What moving scenes cost: `cargo xtask run-on-driver -- cargo bench -p motes-tests --bench moving`.
//!
//! A moving scene beside the same splats frozen, and a scene of which little is alive beside evaluating all of it; each
//! frame sorted and drawn at 640 × 480, variants in turn within one run, medians of the processor's time (of all
//! threads: the driver runs on the processor too), so that what else the machine does counts little.

#![allow(clippy::unwrap_used, reason = "a bench may")]

use cpu_time::ProcessTime;
use motes_app::framing::Framing;
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::motion::frozen;
use motes_renderer::{
    Offscreen, Packing, Precision, RenderConfig, SceneOnDevice, ShPrecision, Sorter, TimeCull, View,
};
use motes_scenes::settings::Settings;
use motes_scenes::synthetic::{Animation, Recipe};
use motes_scenes::{LoadOptions, Splats, load};
use motes_tests::sample;

const ROUNDS: usize = 11;
const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };

/// Median milliseconds of each variant, sorting and drawing, and of sorting and preparing alone.
fn medians(
    offscreen: &mut Offscreen,
    variants: &[(&SceneOnDevice, RenderConfig)],
    view: View,
) -> Vec<[f64; 2]> {
    let mut times = vec![(Vec::new(), Vec::new()); variants.len()];
    for round in 0..=ROUNDS {
        for (times, (scene, config)) in times.iter_mut().zip(variants) {
            // Another eye each time, so that no order serves twice.
            let eye = view.eye + glam::DVec3::splat(1e-4 * round as f64);
            let view = View { eye, ..view };
            offscreen.renderer().expire_order();
            let start = ProcessTime::now();
            offscreen.sort(scene, &[view], config);
            let sorted = start.elapsed().as_secs_f64() * 1e3;
            let report = offscreen.draw(scene, &[view], config).unwrap();
            if round > 0 {
                let whole = start.elapsed().as_secs_f64() * 1e3;
                times.0.push(whole);
                // Device times are of the wall; of the drawing's share the processor's time is taken off.
                let share = report.draw_ns / report.device_ns();
                times.1.push(sorted + (whole - sorted) * (1.0 - share));
            }
        }
    }
    let median = |t: &mut Vec<f64>| {
        t.sort_by(f64::total_cmp);
        t[t.len() / 2]
    };
    times.iter_mut().map(|(a, b)| [median(a), median(b)]).collect()
}

fn compare(
    gpu: &std::sync::Arc<Gpu>,
    name: &str,
    a: (&Splats, RenderConfig),
    b: (&Splats, RenderConfig),
    view: View,
) {
    let mut offscreen = Offscreen::new(gpu).unwrap();
    let (on_a, on_b) =
        (SceneOnDevice::new(gpu, a.0, PACKING).unwrap(), SceneOnDevice::new(gpu, b.0, PACKING).unwrap());
    for sorter in [Sorter::Cpu, Sorter::Gpu] {
        let config = |c: &RenderConfig| RenderConfig { sorter, ..c.clone() };
        let [x, y] = medians(&mut offscreen, &[(&on_a, config(&a.1)), (&on_b, config(&b.1))], view)[..]
        else {
            return;
        };
        println!(
            "{name:44} {sorter:>4}: {:8.2} ms against {:8.2} ms: {:.3}; before drawing {:8.2} against {:8.2}: {:.3}",
            x[0],
            y[0],
            x[0] / y[0],
            x[1],
            y[1],
            x[1] / y[1]
        );
    }
}

fn main() {
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    println!("{}", gpu.capabilities.device);
    let at = |time| RenderConfig { time, ..RenderConfig::default() };
    for file in ["4d/yellow_clip3.splatv", "4d/spinach_stg_lite.ply"] {
        let splats = load(&sample(file), &LoadOptions::default()).unwrap().splats;
        let view = Framing::of(&splats, &Settings::default()).view(0.4, 0.1, 1.0, [640, 480]);
        for time in [0.25, 0.75] {
            let still = frozen(&splats, f64::from(time));
            let name = format!("{file} ({} moving, {} frozen) {time}", splats.len(), still.len());
            compare(&gpu, &name, (&splats, at(time)), (&still, at(time)), view);
        }
    }
    // 4.4 widths of support: 5 % of the time.
    let animation = Animation { fleeting: 1.0, width: 0.05 / 4.4, ..Animation::default() };
    let recipe = Recipe { count: 1_000_000, log_scales: [-6.5, -5.0], ..Recipe::default() };
    let splats = recipe.moving(&animation);
    let view = Framing::of(&splats, &Settings::default()).view(0.4, 0.1, 1.0, [640, 480]);
    for time in [0.3, 0.62] {
        let alive = frozen(&splats, f64::from(time)).len();
        let name = format!("1 M, {alive} alive, index against all, {time}");
        let all = RenderConfig { time_cull: TimeCull::Off, ..at(time) };
        compare(&gpu, &name, (&splats, at(time)), (&splats, all), view);
    }
}
