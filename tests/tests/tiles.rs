//! Splats by tiles: what only they have to keep. (Agreement with the reference, motion and levels: as every expansion.)
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::{DQuat, DVec3};
use motes_renderer::gpu::Capabilities;
use motes_renderer::reference::{self, ReferenceOptions};
use motes_renderer::{
    Composite, Expansion, Fov, Lens, Offscreen, Packing, Picture, Precision, Projection, RadiusRule,
    RenderConfig, SceneOnDevice, ShPrecision, Stereo, TILES_STOP, TargetFormat, Upscale, View,
};
use motes_scenes::Splats;
use motes_scenes::synthetic::{Random, Recipe};
use motes_tests::TestGpu;

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 3 };
const SIZE: [u32; 2] = [200, 120];

fn look(x: f64, size: [u32; 2]) -> View {
    let fov = Fov::vertical(1.0, size);
    View::look_at(DVec3::new(x, 0.2, -2.2), DVec3::new(x, 0.0, 0.0), DVec3::NEG_Y, fov, size)
}

fn scene() -> Splats {
    Recipe { count: 600, sh_degree: 3, seed: 11, ..Default::default() }.still()
}

/// In 32-bit sums, so that only who is blended where can differ.
fn every_layer(expansion: Expansion) -> RenderConfig {
    RenderConfig {
        expansion,
        radius: RadiusRule::Full,
        composite: Composite::FrontToBack,
        stop_below: 0.0,
        target: TargetFormat::Rgba32F,
        ..Default::default()
    }
}

/// Largest difference, steps of 255.
fn worst(a: &Picture, b: &Picture) -> u8 {
    assert_eq!(a.pixels.len(), b.pixels.len());
    a.pixels.iter().flatten().zip(b.pixels.iter().flatten()).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// The device goes last, and sees whether everything was freed.
struct Bench {
    offscreen: Offscreen,
    gpu: TestGpu,
}

impl Bench {
    fn new() -> Self {
        let gpu = TestGpu::new();
        let offscreen = Offscreen::new(&gpu).unwrap();
        Self { offscreen, gpu }
    }

    /// By polygons and by tiles.
    fn both(
        &mut self,
        splats: &Splats,
        views: &[View],
        change: impl Fn(&mut RenderConfig),
    ) -> [Vec<Picture>; 2] {
        let scene = SceneOnDevice::new(&self.gpu, splats, PLAIN).unwrap();
        [Expansion::Precomputed, Expansion::Tiles].map(|expansion| {
            let mut config = every_layer(expansion);
            change(&mut config);
            self.offscreen.render(&scene, views, &config).unwrap().0
        })
    }
}

#[test]
fn needles_reach_every_tile_that_they_cross() {
    // 1000 : 1 in all directions, some through many tiles, some within one: a tile that is missed leaves a gap.
    let mut random = Random::new(5);
    let mut splats = Recipe { count: 200, seed: 3, ..Default::default() }.still();
    for i in 0..splats.len() {
        let axis = DVec3::from_array([0, 1, 2].map(|_| f64::from(random.uniform(-0.5, 0.5)))).normalize();
        splats.rotations[i] = DQuat::from_rotation_arc(DVec3::X, axis).as_quat().to_array();
        let length = (0.05f32 * 20f32.powf(random.uniform(0.0, 1.0))).ln();
        splats.log_scales[i] = [length, length - 1000f32.ln(), length - 1000f32.ln()];
        splats.opacities[i] = 0.9;
    }
    let mut bench = Bench::new();
    let views = [look(0.0, SIZE)];
    for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
        let [polygons, tiles] = bench.both(&splats, &views, |c| c.projection = projection);
        let found = worst(&polygons[0], &tiles[0]);
        println!("{projection}: {found} of 255");
        assert!(found <= 1, "{projection}: {found} of 255");
    }
    // Control: one needle less is seen.
    let all = bench.both(&splats, &views, |_| {});
    splats.opacities[7] = 0.0;
    let fewer = bench.both(&splats, &views, |_| {});
    assert!(worst(&all[1][0], &fewer[1][0]) > 20);
}

#[test]
fn tiles_without_room_for_their_lists_are_blended_too() {
    // Each of them before every tile, of which there are 40 × 30: more entries than there is room for.
    let mut splats = Recipe { count: 150, seed: 9, ..Default::default() }.still();
    for i in 0..splats.len() {
        splats.log_scales[i] = [2.0; 3];
        splats.means[i][2] += 6.0;
        splats.opacities[i] = 0.02;
    }
    let size = [640, 480];
    assert!(splats.len() * (size[0] / 16 * size[1] / 16) as usize > 1 << 16);
    let mut bench = Bench::new();
    let [polygons, tiles] = bench.both(&splats, &[look(0.0, size)], |_| {});
    assert!(worst(&polygons[0], &tiles[0]) <= 1);
    let bright = tiles[0].pixels.iter().filter(|p| p[0].max(p[1]).max(p[2]) > 40).count();
    assert!(bright > tiles[0].pixels.len() / 2, "nothing to see: {bright}");
}

#[test]
fn pictures_are_the_same_every_time_and_in_one_pass_or_two() {
    let mut bench = Bench::new();
    let scene = SceneOnDevice::new(&bench.gpu, &scene(), PLAIN).unwrap();
    let views = [look(-0.032, SIZE), look(0.032, SIZE)];
    let config = RenderConfig { expansion: Expansion::Tiles, ..Default::default() };
    let mut draw = |stereo| {
        bench.offscreen.set_stereo(stereo);
        bench.offscreen.render(&scene, &views, &config).unwrap()
    };
    let (first, report) = draw(Stereo::Multiview);
    let (again, _) = draw(Stereo::Multiview);
    assert_eq!(first, again);
    let (two, parts) = draw(Stereo::TwoPass);
    assert_eq!(first, two);
    assert_ne!(first[0], first[1], "both eyes must not see the same");
    // Five dispatches prepare, four blend; the outcome is shown, and resolved.
    assert_eq!((report.draws, report.passes, report.dispatches), (2, 1, 9));
    assert_eq!((parts.draws, parts.passes, parts.dispatches), (4, 2, 13));
    assert_eq!(report.fragments, parts.fragments);
}

/// A small opaque thing before a hundred large faint ones: its pixels are finished, those beside it in the same tile are not.
#[test]
fn finished_pixels_are_left_alone_while_their_tile_goes_on() {
    const FAINT: usize = 100;
    let mut bench = Bench::new();
    let mut splats = Recipe { count: 20 + FAINT, seed: 4, ..Default::default() }.still();
    for i in 0..splats.means.len() {
        let near = i < 20;
        splats.means[i] = if near { [0.1, 0.0, -0.5] } else { [0.0, 0.0, 0.5 + 1e-3 * i as f32] };
        splats.log_scales[i] = [if near { -2.5 } else { 1.5 }; 3];
        splats.opacities[i] = if near { 0.95 } else { 0.02 };
    }
    let scene = SceneOnDevice::new(&bench.gpu, &splats, PLAIN).unwrap();
    let every = every_layer(Expansion::Tiles);
    let stop = RenderConfig { composite: Composite::EarlyStop, stop_below: 0.003, ..every.clone() };
    // Of each tile the least and the most layers of a pixel.
    let mut extremes = |config: &RenderConfig| {
        let (maps, _) = bench.offscreen.layers(&scene, &[look(0.0, SIZE)], config).unwrap();
        let columns = SIZE[0].div_ceil(16);
        let mut tiles = vec![[f32::MAX, 0.0f32]; (columns * SIZE[1].div_ceil(16)) as usize];
        for (place, layers) in (0..).zip(&maps[0].shaded) {
            let tile = &mut tiles[(place / SIZE[0] / 16 * columns + place % SIZE[0] / 16) as usize];
            *tile = [tile[0].min(*layers), tile[1].max(*layers)];
        }
        tiles
    };
    let goes_on_beside = |[least, most]: &[f32; 2]| *most >= FAINT as f32 && *least <= 0.5 * FAINT as f32;
    let tiles = extremes(&stop);
    assert!(tiles.iter().any(goes_on_beside), "{tiles:?}");
    // Control: without a stop nothing is left alone.
    let tiles = extremes(&every);
    assert!(!tiles.iter().any(goes_on_beside), "{tiles:?}");
}

#[test]
fn opaque_tiles_stop() {
    let mut bench = Bench::new();
    let mut splats = Recipe { count: 4000, seed: 4, ..Default::default() }.still();
    for s in &mut splats.log_scales {
        *s = [-1.5; 3];
    }
    splats.opacities.fill(0.5);
    let scene = SceneOnDevice::new(&bench.gpu, &splats, PLAIN).unwrap();
    let views = [look(0.0, SIZE)];
    let all = every_layer(Expansion::Tiles);
    let stop = RenderConfig { composite: Composite::EarlyStop, stop_below: 0.003, ..all.clone() };
    let (every, full) = bench.offscreen.render(&scene, &views, &all).unwrap();
    let (stopped, less) = bench.offscreen.render(&scene, &views, &stop).unwrap();
    println!("{:.1} of {:.1} layers", less.layers(), full.layers());
    assert!(less.fragments * 2 < full.fragments, "{} of {}", less.fragments, full.fragments);
    assert!(worst(&every[0], &stopped[0]) <= 1);
    // What is counted by pixel sums up to what the device counted itself.
    for (config, report) in [(&all, &full), (&stop, &less)] {
        let (maps, _) = bench.offscreen.layers(&scene, &views, config).unwrap();
        let mean = maps[0].mean_blended();
        assert!((mean / report.layers() - 1.0).abs() < 2e-3, "{mean} and {}", report.layers());
        assert!(maps[0].mean_shaded() >= maps[0].mean_blended());
    }
}

#[test]
fn every_pixel_blends_as_many_layers_as_a_stop_at_its_own_transmittance_leaves() {
    let mut bench = Bench::new();
    let mut splats = Recipe { count: 2000, seed: 6, ..Default::default() }.still();
    splats.log_scales.fill([-1.5; 3]);
    let scene = SceneOnDevice::new(&bench.gpu, &splats, PLAIN).unwrap();
    let view = look(0.0, SIZE);
    let stop = RenderConfig {
        composite: Composite::EarlyStop,
        stop_below: 0.01,
        projection: Projection::Affine,
        ..every_layer(Expansion::Tiles)
    };
    let (maps, _) = bench.offscreen.layers(&scene, &[view], &stop).unwrap();
    // Of pixels, those that are a layer or more beside what the reference counts until it is as dark.
    let beside = |count_until: f32| {
        let options =
            ReferenceOptions { count_until: count_until.into(), ..ReferenceOptions::of_config(&stop) };
        let image = reference::render(&splats, &view, &options).unwrap();
        let layers = image.pixels.iter().map(|p| p.layers_until as f32);
        maps[0].blended.iter().zip(layers).filter(|(a, b)| **a != *b).count() as f64
            / image.pixels.len() as f64
    };
    // Layers at the cut of 1/255 may fall to either side.
    let found = beside(TILES_STOP * stop.stop_below);
    assert!(found < 0.05, "{found}");
    // Control: another transmittance is another count.
    let control = beside(stop.stop_below);
    println!("{found:.4} of the pixels are beside, {control:.4} where the reference stops earlier");
    assert!(control > 0.5, "{control}");
}

#[test]
fn reduced_resolutions_sample_where_polygons_do() {
    let mut bench = Bench::new();
    let splats = scene();
    for scale in [0.5, 0.7072, 0.85] {
        for upscale in [Upscale::Bilinear, Upscale::Interleaved] {
            let [polygons, tiles] = bench.both(&splats, &[look(0.0, SIZE)], |c| {
                c.resolution_scale = scale;
                c.upscale = upscale;
            });
            let found = worst(&polygons[0], &tiles[0]);
            assert!(found <= 2, "{scale} {upscale}: {found} of 255");
        }
    }
    // Control: the two ways of sampling differ by more.
    let half = |upscale| move |c: &mut RenderConfig| (c.resolution_scale, c.upscale) = (0.5, upscale);
    let [_, bilinear] = bench.both(&splats, &[look(0.0, SIZE)], half(Upscale::Bilinear));
    let [_, interleaved] = bench.both(&splats, &[look(0.0, SIZE)], half(Upscale::Interleaved));
    assert!(worst(&bilinear[0], &interleaved[0]) > 10);
}

#[test]
fn what_tiles_cannot_draw_is_refused_with_a_reason() {
    let mut bench = Bench::new();
    let scene = SceneOnDevice::new(&bench.gpu, &scene(), PLAIN).unwrap();
    let good = RenderConfig { expansion: Expansion::Tiles, ..Default::default() };
    for (config, reason) in [
        (RenderConfig { lens: Lens::Fisheye, ..good.clone() }, "perspective"),
        (RenderConfig { composite: Composite::BackToFront, ..good.clone() }, "front to back"),
        (
            RenderConfig { radius: RadiusRule::Tiles, projection: Projection::Affine, ..good.clone() },
            "trainers",
        ),
    ] {
        let said = bench.offscreen.render(&scene, &[look(0.0, SIZE)], &config).unwrap_err().to_string();
        assert!(said.contains("expansion tiles") && said.contains(reason), "{said}");
    }
    let mut less = bench.gpu.capabilities.clone();
    less.subgroup_shuffle = false;
    assert!(good.check(1, &less).unwrap_err().to_string().contains("subgroups"));
    // What a device is given by itself: tiles where it renders on the processor and they can be had, else polygons.
    let default = RenderConfig::default();
    let chosen = |config: &RenderConfig, capabilities: &Capabilities, splats, size| {
        config.clone().on(capabilities, splats, &[look(0.0, size); 2]).expansion
    };
    let device = bench.gpu.capabilities.clone();
    assert_eq!(chosen(&default, &device, 600, SIZE), Expansion::Tiles);
    assert_eq!(chosen(&default, &less, 600, SIZE), Expansion::Precomputed);
    let fisheye = RenderConfig { lens: Lens::Fisheye, ..default.clone() };
    assert_eq!(chosen(&fisheye, &device, 600, SIZE), Expansion::Precomputed);
    // Nor where a buffer would be too large: 64 bytes a splat and eye, 16 a pixel, and as many for its layers.
    let most = (device.max_storage_range / 128) as u32;
    assert_eq!(chosen(&default, &device, most, SIZE), Expansion::Tiles);
    assert_eq!(chosen(&default, &device, most + 1, SIZE), Expansion::Precomputed);
    let high = (device.max_storage_range / (2 * 32 * 2048)) as u32;
    assert_eq!(chosen(&default, &device, 600, [2048, high]), Expansion::Tiles);
    assert_eq!(chosen(&default, &device, 600, [2048, high + 1]), Expansion::Precomputed);
    let hardware = Capabilities { software: false, ..device };
    assert_eq!(chosen(&default, &hardware, 600, SIZE), Expansion::Precomputed);
    bench.offscreen.render(&scene, &[look(0.0, SIZE)], &good).unwrap();
}
