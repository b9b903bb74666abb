//! Moving scenes: every way of drawing against the reference at many times, what is left out because it is gone, and
//! the times and scenes that are no good.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_app::framing::Framing;
use motes_renderer::reference::{self, ReferenceOptions, ReferenceOrder};
use motes_renderer::{
    Axis, Composite, Expansion, Fov, Offscreen, Packing, Picture, Precision, Projection, RadiusRule,
    RenderConfig, SceneOnDevice, ShPrecision, Sorter, TimeCull, View,
};
use motes_scenes::settings::Settings;
use motes_scenes::synthetic::{Animation, Recipe};
use motes_scenes::{LoadOptions, Splats, load};
use motes_tests::{TestGpu, psnr, sample};

fn packed(precision: Precision) -> Packing {
    Packing { precision, sh_precision: ShPrecision::F32, sh_degree: 1 }
}

fn view() -> View {
    let fov = Fov { left: -0.9, right: 1.1, up: -0.8, down: 0.8 };
    View::look_at(DVec3::new(0.3, 0.2, -2.6), DVec3::ZERO, DVec3::NEG_Y, fov, [64, 48])
}

fn scene(fleeting: f32, width: f32) -> Splats {
    let animation = Animation { fleeting, width, ..Default::default() };
    Recipe { count: 500, sh_degree: 1, seed: 21, ..Default::default() }.moving(&animation)
}

fn every_layer(time: f32) -> RenderConfig {
    RenderConfig { radius: RadiusRule::Full, composite: Composite::FrontToBack, time, ..Default::default() }
}

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

fn truth(splats: &Splats, view: &View, config: &RenderConfig) -> Vec<[u8; 3]> {
    let options = ReferenceOptions {
        order: ReferenceOrder::Radial(Some(view.eye)),
        ..ReferenceOptions::of_config(config)
    };
    let image = reference::render(splats, view, &options).unwrap();
    image.to_rgb8().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

#[test]
fn every_expansion_and_projection_moves_as_the_reference_does() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let splats = scene(0.5, 0.15);
    let view = view();
    for (precision, least) in [(Precision::F32, 55.0), (Precision::F16, 50.0)] {
        let on_device = SceneOnDevice::new(&gpu, &splats, packed(precision)).unwrap();
        for &projection in Projection::ALL {
            for time in [0.37, 1.0] {
                let mut config = RenderConfig { projection, ..every_layer(time) };
                let expected = truth(&splats, &view, &config);
                let later = truth(&splats, &view, &RenderConfig { time: time + 0.02, ..config.clone() });
                for &expansion in Expansion::ALL {
                    config.expansion = expansion;
                    let (picture, _) = offscreen.render(&on_device, &[view], &config).unwrap();
                    let db = psnr(&colours(&picture[0]), &expected);
                    let name = format!("{precision} {projection} {expansion} at {time}");
                    println!("{name}: {db:.1} dB");
                    assert!(db >= least, "{name}: {db:.1} dB");
                    // Control: another time, a 50th of the scene later.
                    let wrong = psnr(&colours(&picture[0]), &later);
                    assert!(wrong < least - 5.0, "{name}: a later time must not pass: {wrong:.1} dB");
                }
            }
        }
    }
}

#[test]
fn leaving_out_what_is_gone_changes_nothing() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let splats = scene(1.0, 0.02);
    let view = view();
    for precision in [Precision::F32, Precision::F16] {
        let on_device = SceneOnDevice::new(&gpu, &splats, packed(precision)).unwrap();
        let index = on_device.positions.alive().unwrap();
        for sorter in [Sorter::Cpu, Sorter::Gpu] {
            for step in 0..6 {
                let time = -0.05 + 0.2 * step as f32;
                assert!(index.at(time).len() < splats.len() / 3);
                let config = RenderConfig { sorter, ..every_layer(time) };
                let (few, report) = offscreen.render(&on_device, &[view], &config).unwrap();
                let all = RenderConfig { time_cull: TimeCull::Off, ..config };
                let (every, of_all) = offscreen.render(&on_device, &[view], &all).unwrap();
                assert!(few == every, "{precision} {sorter} at {time}");
                assert_eq!(report.visible, of_all.visible);
            }
        }
        // Control: the lists of another time leave out what is to be seen.
        let config = every_layer(0.5);
        offscreen.sort(&on_device, &[view], &every_layer(0.3));
        let (early, _) = offscreen.picture(&on_device, &[view], &config).unwrap();
        let (right, _) = offscreen.render(&on_device, &[view], &config).unwrap();
        assert!(early != right);
    }
}

#[test]
fn times_outside_show_what_reaches_there_and_no_time_is_refused() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut splats = scene(0.8, 0.05);
    if let Some(motion) = &mut splats.motion {
        // The widest and the narrowest that there are.
        for i in 0..100 {
            motion.widths[i] = f32::MAX;
            motion.widths[100 + i] = motes_scenes::MIN_WIDTH;
        }
    }
    let on_device = SceneOnDevice::new(&gpu, &splats, packed(Precision::F32)).unwrap();
    let view = view();
    for time in [-1.0, -0.01, 0.0, 1.0, 1.01, 3.0] {
        let config = every_layer(time);
        let (picture, _) = offscreen.render(&on_device, &[view], &config).unwrap();
        let db = psnr(&colours(&picture[0]), &truth(&splats, &view, &config));
        assert!(db >= 50.0, "{time}: {db:.1} dB");
    }
    // Both ends of a loop are moments of their own: 1 is not drawn as 0.
    let at = |offscreen: &mut Offscreen, t| offscreen.render(&on_device, &[view], &every_layer(t)).unwrap().0;
    assert!(at(&mut offscreen, 0.0) != at(&mut offscreen, 1.0));
    for time in [f32::NAN, f32::INFINITY] {
        let refusal = offscreen.render(&on_device, &[view], &every_layer(time)).unwrap_err().to_string();
        assert!(refusal.contains("time"), "{refusal}");
    }
}

#[test]
fn dirty_scenes_play_from_end_to_end() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    // Values that are none, and splats that are never visible.
    for (file, dropped) in [("4d/yellow_clip3.splatv", 146 + 20_314), ("4d/coffee10.splatv", 24 + 11_307)] {
        let scene = load(&sample(file), &LoadOptions::default()).unwrap();
        assert_eq!(scene.report.dropped.values().sum::<usize>(), dropped, "{file}");
        let view = Framing::of(&scene.splats, &Settings::default()).view(0.4, 0.1, 1.0, [96, 72]);
        let on_device = SceneOnDevice::new(&gpu, &scene.splats, packed(Precision::F32)).unwrap();
        for time in [-0.5, 0.5, 1.5] {
            let config = every_layer(time);
            let (picture, _) = offscreen.render(&on_device, &[view], &config).unwrap();
            let db = psnr(&colours(&picture[0]), &truth(&scene.splats, &view, &config));
            println!("{file} at {time}: {db:.1} dB");
            assert!(db >= 45.0, "{file} at {time}: {db:.1} dB");
        }
    }
}
