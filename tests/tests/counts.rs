//! What a frame costs, in counts that are the same on every device: draw calls, passes, dispatches, bytes, primitives,
//! fragments. A change that makes frames slower shows here without a clock.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_renderer::{
    Composite, Expansion, Fov, FrameReport, LowPass, Marks, Offscreen, Packing, Precision, Projection,
    QuadShape, RadiusRule, RenderConfig, SceneOnDevice, Stereo, Traffic, Upscale, View,
};
use motes_scenes::synthetic::Recipe;
use motes_tests::TestGpu;

const SPLATS: u32 = 600;
const SIZE: [u32; 2] = [96, 80];

fn view(x: f64) -> View {
    let fov = Fov { left: -1.0, right: 1.0, up: -0.9, down: 0.9 };
    View::look_at(DVec3::new(x, 0.2, -2.2), DVec3::new(x, 0.0, 0.0), DVec3::NEG_Y, fov, SIZE)
}

struct Bench {
    scene: SceneOnDevice,
    offscreen: Offscreen,
    gpu: TestGpu,
}

impl Bench {
    fn new(precision: Precision) -> Self {
        let gpu = TestGpu::new();
        let splats = Recipe { count: SPLATS as usize, sh_degree: 3, seed: 11, ..Default::default() }.still();
        let packing = Packing::of_config(&RenderConfig { precision, ..Default::default() });
        let scene = SceneOnDevice::new(&gpu, &splats, packing).unwrap();
        let offscreen = Offscreen::new(&gpu).unwrap();
        Self { scene, offscreen, gpu }
    }

    fn frame(&mut self, views: &[View], config: &RenderConfig) -> FrameReport {
        self.offscreen.render(&self.scene, views, config).unwrap().1
    }

    /// Fragments of splats, counted one by one: statistics of some drivers leave out those that end early.
    fn shaded(&mut self, config: &RenderConfig) -> f64 {
        let (maps, _) = self.offscreen.layers(&self.scene, &[view(0.0)], config).unwrap();
        maps[0].shaded.iter().map(|&l| f64::from(l)).sum()
    }
}

fn every_layer() -> RenderConfig {
    RenderConfig { composite: Composite::FrontToBack, ..Default::default() }
}

#[test]
fn calls_and_passes_of_a_frame() {
    let mut bench = Bench::new(Precision::F32);
    let (one, two) = ([view(0.0)], [view(-0.03), view(0.03)]);
    let mut calls = |views: &[View], config: &RenderConfig, stereo| {
        bench.offscreen.set_stereo(stereo);
        let r = bench.frame(views, config);
        (r.draws, r.passes, r.dispatches)
    };
    let all = every_layer();
    // All splats in one call, and the resolve. Five dispatches prepare: project, count, plan, emit, schedule.
    assert_eq!(calls(&one, &all, Stereo::Multiview), (2, 1, 5));
    let instanced = RenderConfig { expansion: Expansion::Instanced, ..all.clone() };
    assert_eq!(calls(&one, &instanced, Stereo::Multiview), (2, 1, 0));
    // Both eyes cost no further call in one pass, and all of it again in two.
    assert_eq!(calls(&two, &all, Stereo::Multiview), (2, 1, 5));
    assert_eq!(calls(&two, &all, Stereo::TwoPass), (4, 2, 5));
    // Early stop: a call a batch, a mark between two, the resolve.
    for batches in [2, 8] {
        let stop = RenderConfig { batches, ..Default::default() };
        assert_eq!(calls(&one, &stop, Stereo::Multiview), (2 * batches, 1, 5));
    }
    // A reduced resolution adds one pass with one call, which replaces the resolve.
    for upscale in [Upscale::Bilinear, Upscale::Interleaved] {
        let reduced = RenderConfig { resolution_scale: 0.5, upscale, ..all.clone() };
        assert_eq!(calls(&one, &reduced, Stereo::Multiview), (2, 2, 5), "{upscale}");
    }
}

#[test]
fn an_order_is_brought_to_the_device_once() {
    let mut bench = Bench::new(Precision::F32);
    let (views, config) = ([view(0.0)], every_layer());
    bench.offscreen.sort(&bench.scene, &views, &config);
    let first = bench.offscreen.draw(&bench.scene, &views, &config).unwrap();
    let second = bench.offscreen.draw(&bench.scene, &views, &config).unwrap();
    // What the shaders know of a frame is small, and comes with each.
    assert!(second.uploaded_bytes > 0 && second.uploaded_bytes <= 512, "{}", second.uploaded_bytes);
    assert_eq!(first.uploaded_bytes, second.uploaded_bytes + 4 * u64::from(SPLATS));
    bench.offscreen.sort(&bench.scene, &views, &config);
    let third = bench.offscreen.draw(&bench.scene, &views, &config).unwrap();
    assert_eq!(third.uploaded_bytes, first.uploaded_bytes);
}

#[test]
fn bytes_of_a_frame() {
    let mut full = Bench::new(Precision::F32);
    let config = every_layer();
    let report = full.frame(&[view(0.0)], &config);
    let traffic = Traffic::of(&full.scene, &config, &report);
    let pixels = u64::from(SIZE[0] * SIZE[1]);
    // 14 words of geometry, 45 of spherical harmonics, one of the order.
    assert_eq!(traffic.scene, u64::from(SPLATS) * 4 * (14 + 45 + 1));
    assert_eq!(traffic.records, 2 * 4 * 8 * u64::from(report.visible));
    let affine = RenderConfig { projection: Projection::Affine, ..config.clone() };
    let words =
        |config| Traffic::of(&full.scene, config, &report).records / (2 * 4 * u64::from(report.visible));
    assert_eq!([words(&affine), words(&config)], [7, 8]);
    assert_eq!(traffic.image, 4 * pixels);
    assert_eq!(traffic.blended, 8 * (2 * report.fragments + pixels));
    assert!(report.visible > SPLATS / 2 && report.visible <= SPLATS);
    // Without spherical harmonics they are not read.
    let plain = RenderConfig { sh_degree: 0, ..config.clone() };
    assert_eq!(Traffic::of(&full.scene, &plain, &report).scene, u64::from(SPLATS) * 4 * (14 + 1));
    let bytes = full.scene.bytes();
    drop(full);
    let half = Bench::new(Precision::F16);
    assert_eq!(bytes - half.scene.bytes(), u64::from(SPLATS) * 4 * (14 - 8));
    let Bench { scene, offscreen, gpu } = half;
    let used = gpu.allocated_bytes();
    let bytes = scene.bytes();
    drop(scene);
    assert!(used - gpu.allocated_bytes() >= bytes);
    drop(offscreen);
}

#[test]
fn primitives_of_a_frame() {
    let mut bench = Bench::new(Precision::F32);
    let views = [view(0.0)];
    for (shape, triangles) in [(QuadShape::Octagon, 6), (QuadShape::Square, 2), (QuadShape::Diamond, 2)] {
        let mut primitives = |expansion| {
            let config = RenderConfig { shape, expansion, ..every_layer() };
            let report = bench.frame(&views, &config);
            (report.primitives, u64::from(report.visible))
        };
        let (found, visible) = primitives(Expansion::Precomputed);
        // What is seen and no more, but for what clipping cuts in two; the last instance's unused quads collapse before
        // they are counted.
        assert!(found * 50 <= 51 * triangles * visible, "{shape}: {found} primitives for {visible} splats");
        assert!(found * 10 >= 9 * triangles * visible, "{shape}: {found} primitives for {visible} splats");
        // Control: the instanced stage sends every splat down.
        let (all, _) = primitives(Expansion::Instanced);
        let most = triangles * u64::from(SPLATS.next_multiple_of(256));
        assert!(all >= found && all * 50 <= 51 * most, "{shape}: {all}");
    }
}

#[test]
fn adaptive_polygons_are_squares_where_splats_are_small() {
    let mut bench = Bench::new(Precision::F32);
    let sized = |size| [View { size, ..view(0.0) }];
    for (size, [least, most]) in [([48, 40], [0.3, 0.37]), ([960, 800], [0.8, 1.0])] {
        let views = sized(size);
        for expansion in [Expansion::Precomputed, Expansion::Instanced, Expansion::Geometry] {
            let mut drawn = |shape| {
                let radius = RadiusRule::Full;
                let config = RenderConfig { shape, expansion, radius, ..every_layer() };
                let (maps, _) = bench.offscreen.layers(&bench.scene, &views, &config).unwrap();
                let (pictures, report) = bench.offscreen.render(&bench.scene, &views, &config).unwrap();
                (maps[0].mean_shaded(), maps[0].mean_blended(), pictures, report)
            };
            let (octagons, blended, expected, octagon) = drawn(QuadShape::Octagon);
            let (shaded, blended_too, found, adaptive) = drawn(QuadShape::Adaptive);
            let (squares, .., square) = drawn(QuadShape::Square);
            // A third of the triangles where all are small, hardly fewer where all are large.
            let share = adaptive.primitives as f64 / octagon.primitives as f64;
            println!(
                "{size:?} {expansion}: {share:.3} of the triangles, {octagons:.2} {shaded:.2} {squares:.2} layers"
            );
            // (The instanced stage's octagons fall together to squares: triangles without an area are counted still.)
            let least = if expansion == Expansion::Instanced { 0.99 } else { least };
            let most = if expansion == Expansion::Instanced { 1.01 } else { most };
            assert!((least..=most).contains(&share), "{size:?} {expansion}: {share}");
            if expansion == Expansion::Precomputed && size[0] < 100 {
                assert!(adaptive.vertices <= square.vertices, "{} vertices", adaptive.vertices);
                // Control: what is left of octagons that only fall together.
                assert!(adaptive.vertices < octagon.vertices * 6 / 10, "{} vertices", adaptive.vertices);
            }
            assert!(octagons <= shaded && shaded <= squares, "{octagons} {shaded} {squares}");
            // The picture is that of octagons: what a square covers besides is below the least that is blended.
            assert!((blended_too / blended - 1.0).abs() < 1e-3, "{blended_too} against {blended}");
            let worst = (expected[0].pixels.iter().flatten().zip(found[0].pixels.iter().flatten()))
                .map(|(a, b)| a.abs_diff(*b))
                .max();
            assert!(worst <= Some(1), "{size:?} {expansion}: {worst:?} of 255");
        }
    }
}

#[test]
fn fragments_of_a_frame() {
    let mut bench = Bench::new(Precision::F32);
    let square = bench.shaded(&RenderConfig { shape: QuadShape::Square, ..every_layer() });
    let octagon = bench.shaded(&every_layer());
    let diamond = bench.shaded(&RenderConfig { shape: QuadShape::Diamond, ..every_layer() });
    println!("square {square}, octagon {octagon}, diamond {diamond}");
    // By geometry: 8 (√2 − 1) / 4 and a half. Polygons that the image's rim cuts, and small ones, deviate.
    assert!((octagon / square - 0.828).abs() < 0.03, "{}", octagon / square);
    assert!((diamond / square - 0.5).abs() < 0.03, "{}", diamond / square);
    // The budget of this scene at the default: pixels whose centres its polygons cover, whoever rasterises them.
    assert!((octagon / BUDGET - 1.0).abs() < 0.01, "{octagon} fragments, the budget is {BUDGET}");
    // Controls: a longer reach, or none of the opacity's, breaks the budget.
    for radius in [RadiusRule::Full, RadiusRule::Sqrt8] {
        let more = bench.shaded(&RenderConfig { radius, ..every_layer() });
        assert!(more > 1.01 * BUDGET, "{radius}: {more}");
    }
    // Half the side, a quarter of the fragments; more with the low-pass filter, which is one of the rendered pixels.
    let sharp = RenderConfig { low_pass: LowPass::Off, ..every_layer() };
    let halved = |config: &RenderConfig| RenderConfig {
        resolution_scale: 0.5,
        upscale: Upscale::Bilinear,
        ..config.clone()
    };
    let quarter = bench.shaded(&halved(&sharp)) / bench.shaded(&sharp);
    assert!((quarter - 0.25).abs() < 0.03, "{quarter}");
    let filtered = bench.shaded(&halved(&every_layer())) / octagon;
    assert!(filtered > quarter + 0.05, "{filtered}");
}

/// Fragments of splats that the default draws of the scene above without early stop.
const BUDGET: f64 = 22_920.0;

#[test]
fn early_stop_shades_less_the_earlier_it_stops() {
    let mut bench = Bench::new(Precision::F32);
    let all = bench.shaded(&every_layer());
    let mut last = all;
    for stop_below in [1.0 / 255.0, 0.05, 0.3] {
        let fragments = bench.shaded(&RenderConfig { stop_below, ..Default::default() });
        println!("stop below {stop_below}: {fragments} of {all}");
        assert!(fragments < last, "{stop_below}: {fragments}, before {last}");
        last = fragments;
    }
    assert!(last < 0.9 * all, "{last} of {all}");
    // Control: a threshold of nothing stops nothing.
    let none = bench.shaded(&RenderConfig { stop_below: 0.0, ..Default::default() });
    assert_eq!(none, all);
}

#[test]
fn marks_go_where_pixels_fill_up() {
    let gpu = TestGpu::new();
    // A wall of nearly opaque splats in one half of the image, and hardly anything in the other.
    let mut splats = Recipe { count: 6000, seed: 5, ..Default::default() }.still();
    for i in 0..splats.len() {
        let [x, y, z] = splats.means[i];
        splats.means[i] = [0.5 * x.abs() + 0.1, y, 0.3 * z];
        splats.opacities[i] = 0.9;
        splats.log_scales[i] = [-2.5; 3];
    }
    let packing = Packing::of_config(&RenderConfig::default());
    let scene = SceneOnDevice::new(&gpu, &splats, packing).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let views = [view(0.0)];
    let mut drawn = |marks, batches, composite| {
        let config = RenderConfig { marks, batches, composite, ..Default::default() };
        let (maps, _) = offscreen.layers(&scene, &views, &config).unwrap();
        let (mut pictures, report) = offscreen.render(&scene, &views, &config).unwrap();
        (pictures.remove(0).pixels, maps[0].mean_shaded(), report)
    };
    let (_, every_layer, _) = drawn(Marks::Everywhere, 16, Composite::FrontToBack);
    let (truth, everywhere, all) = drawn(Marks::Everywhere, 16, Composite::EarlyStop);
    let (picture, due, some) = drawn(Marks::Due, 16, Composite::EarlyStop);
    let [all, some] = [all, some].map(|r| r.full_screen_fragments as f64 / r.pixels as f64);
    println!(
        "layers: every {every_layer:.2}, marks everywhere {everywhere:.2} ({all:.1} a pixel), due {due:.2} ({some:.1})"
    );
    assert!(due < 0.5 * every_layer && due < 1.1 * everywhere, "{due} of {every_layer}, {everywhere}");
    assert_eq!(all, 15.0);
    // The empty half is not looked at, and the full one not all the time.
    assert!(some > 0.0 && some < 0.5 * all, "{some} marks a pixel");
    let apart = |a: &[[u8; 4]], b: &[[u8; 4]]| {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a.abs_diff(*b)).max()
    };
    assert!(apart(&picture, &truth) <= Some(2), "{:?}", apart(&picture, &truth));
    // Controls: fewer batches find fewer pixels in time; and a threshold that hides what shows is seen.
    let (_, coarse, _) = drawn(Marks::Due, 2, Composite::EarlyStop);
    assert!(coarse > 1.2 * due, "{coarse}, {due}");
    let early = RenderConfig { stop_below: 0.3, ..Default::default() };
    let early = offscreen.render(&scene, &views, &early).unwrap().0.remove(0).pixels;
    assert!(apart(&early, &truth) > Some(4), "{:?}", apart(&early, &truth));
}

/// The ramp of `layers.frag`.
fn colour(share: f32) -> [f32; 3] {
    let stops = [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0], [1, 1, 0], [1, 0, 0], [1, 1, 1]];
    let at = share.clamp(0.0, 1.0) * 6.0;
    let i = (at as usize).min(5);
    std::array::from_fn(|k| {
        let [a, b] = [stops[i][k] as f32, stops[i + 1][k] as f32];
        a + (b - a) * (at - i as f32)
    })
}

#[test]
fn layers_are_seen_as_colours() {
    const MOST: f32 = 24.0;
    let mut bench = Bench::new(Precision::F32);
    let views = [view(-0.03), view(0.03)];
    let config = RenderConfig::default();
    let (plain, before) = bench.offscreen.render(&bench.scene, &views, &config).unwrap();
    let (maps, _) = bench.offscreen.layers(&bench.scene, &views, &config).unwrap();
    for stereo in [Stereo::Multiview, Stereo::TwoPass] {
        bench.offscreen.set_stereo(stereo);
        bench.offscreen.renderer().show_layers(Some(MOST)).unwrap();
        let (seen, _) = bench.offscreen.render(&bench.scene, &views, &config).unwrap();
        bench.offscreen.renderer().show_layers(None).unwrap();
        for (seen, map) in seen.iter().zip(&maps) {
            let expected = map.shaded.iter().map(|l| colour(l / MOST).map(|v| v * 255.0));
            let off = seen
                .pixels
                .iter()
                .zip(expected)
                .map(|(p, e)| (0..3).map(|k| (f32::from(p[k]) - e[k]).abs()).fold(0.0, f32::max));
            let off = off.fold(0.0, f32::max);
            assert!(off <= 1.0, "{stereo:?}: {off}");
        }
        assert_ne!(seen[0], seen[1], "each eye has its own");
        // Control: a few layers more would be seen.
        let other = maps[0].shaded.iter().map(|l| colour((l + 2.0) / MOST)[2]).sum::<f32>();
        let found = seen[0].pixels.iter().map(|p| f32::from(p[2]) / 255.0).sum::<f32>();
        assert!((other - found).abs() > 10.0, "{other} {found}");
    }
    bench.offscreen.set_stereo(Stereo::Multiview);
    let (again, after) = bench.offscreen.render(&bench.scene, &views, &config).unwrap();
    assert_eq!((again, after.draws, after.passes), (plain, before.draws, before.passes));
}
