//! What drawing by plan saves: `cargo xtask run-on-driver -- cargo bench -p motes-tests --bench plan [-- VIEW… --times N]`.
//!
//! Each scene by its plan, with everything that it has switched on, and with every buffer that a viewer without plans makes
//! for any scene (three degrees of harmonics that are zero, motion that stands still): bytes, counts, and the time of a
//! frame, 1280 × 960, order included, with the expansion that is fastest on this device. Times are medians of ratios of
//! neighbouring frames, the processor's time on all cores first, with their quartiles.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench may")]

use cpu_time::ProcessTime;
use motes_app::framing::Framing;
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::plan::{Overrides, Plan};
use motes_renderer::{Offscreen, RenderConfig, SceneOnDevice, View};
use motes_scenes::settings::Settings;
use motes_scenes::statement::Statement;
use motes_scenes::{LoadOptions, Motion, Scene, Splats, load, sh_coefficients};
use motes_tests::golden::{NAMES, golden_view};
use motes_tests::{psnr, sample};
use std::sync::Arc;
use std::time::Instant;

/// A moving sample.
const MOVING: &str = "4d/spinach_stg_lite.ply";

/// The same scene with buffers for what it does not have.
fn with_every_buffer(splats: &Splats) -> Splats {
    let (few, all) = (sh_coefficients(splats.sh_degree), sh_coefficients(3));
    let mut sh = vec![[0.0; 3]; splats.len() * all];
    for (to, from) in sh.chunks_exact_mut(all).zip(splats.sh.chunks_exact(few)) {
        to[..few].copy_from_slice(from);
    }
    let still = || Motion {
        centers: vec![0.5; splats.len()],
        widths: vec![f32::MAX; splats.len()],
        polynomials: vec![[[0.0; 3]; 3]; splats.len()],
        omegas: vec![[0.0; 4]; splats.len()],
    };
    Splats { sh_degree: 3, sh, motion: Some(splats.motion.clone().unwrap_or_else(still)), ..splats.clone() }
}

fn quartiles(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let [low, middle, high] =
        [0.25, 0.5, 0.75].map(|q| values[(q * (values.len() - 1) as f64).round() as usize]);
    format!("{middle:.3} ({low:.3} to {high:.3})")
}

fn compare(gpu: &Arc<Gpu>, name: &str, splats: Splats, view: View, times: usize) {
    let full = with_every_buffer(&splats);
    let scene = Scene { splats, ..Default::default() };
    let statement = Statement::of(&scene);
    let everything = Plan::of(&statement, &Overrides::EVERYTHING);
    let plans = [
        ("by plan", Plan::of(&statement, &Overrides::default()), &scene.splats),
        ("everything it has", everything, &scene.splats),
        (
            "every buffer",
            Plan::of(
                &Statement::of(&Scene { splats: full.clone(), ..Default::default() }),
                &Overrides::EVERYTHING,
            ),
            &full,
        ),
    ];
    let mut offscreen = Offscreen::new(gpu).unwrap();
    let on_device =
        plans.each_ref().map(|(_, plan, splats)| SceneOnDevice::new(gpu, splats, plan.packing).unwrap());
    let config = RenderConfig { time: 0.4, ..RenderConfig::default() }.on(
        &gpu.capabilities,
        on_device[0].splats,
        &[view],
    );
    let configs = plans.each_ref().map(|(_, plan, _)| plan.apply(&config));
    // Seconds of processor time, and by the clock.
    let mut time = |i: usize| {
        offscreen.renderer().expire_order();
        let (wall, process) = (Instant::now(), ProcessTime::now());
        offscreen.sort(&on_device[i], &[view], &configs[i]);
        offscreen.draw(&on_device[i], &[view], &configs[i]).unwrap();
        [process.elapsed().as_secs_f64(), wall.elapsed().as_secs_f64()]
    };
    let mut frames = vec![[[0.0; 2]; 3]; times + 1];
    for (round, frame) in frames.iter_mut().enumerate() {
        for step in 0..3 {
            let i = if round % 2 == 0 { step } else { 2 - step };
            frame[i] = time(i);
        }
    }
    let pictures: Vec<_> = (0..3)
        .map(|i| {
            let (picture, report) = offscreen.render(&on_device[i], &[view], &configs[i]).unwrap();
            (picture[0].pixels.iter().map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>(), report)
        })
        .collect();
    for (i, (label, plan, _)) in plans.iter().enumerate() {
        let ratio = |j: usize| quartiles(frames[1..].iter().map(|f| f[i][j] / f[2][j]).collect());
        let bytes = on_device[i].bytes();
        println!(
            "{name:23} {label:17} {:6.1} bytes a splat, {:7.2} MB; {:9} blended pixels of {:7} splats; {:5.1} dB to every buffer; \
             processor time {}, clock {}; {}",
            bytes as f64 / f64::from(on_device[i].splats),
            bytes as f64 / 1e6,
            pictures[i].1.fragments,
            pictures[i].1.visible,
            psnr(&pictures[i].0, &pictures[2].0),
            ratio(0),
            ratio(1),
            plan.apply(&config).projection,
        );
    }
}

fn main() {
    let (mut wanted, mut times) = (Vec::new(), 9);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--times" => times = arguments.next().unwrap().parse().unwrap(),
            "--bench" => {}
            other if other.starts_with('-') => panic!("no option is called {other}"),
            _ => wanted.push(argument),
        }
    }
    let wanted = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    println!("{}", gpu.capabilities.device);
    for name in NAMES.into_iter().filter(|n| wanted(n)) {
        let golden = golden_view(name);
        let view = golden.scaled(2);
        compare(&gpu, name, golden.splats, view, times);
    }
    if wanted(MOVING) {
        let splats = load(&sample(MOVING), &LoadOptions::default()).unwrap().splats;
        let view = Framing::of(&splats, &Settings::default()).view(0.4, 0.1, 1.0, [1280, 960]);
        compare(&gpu, MOVING, splats, view, times);
    }
}
