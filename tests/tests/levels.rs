//! Scenes that are drawn in parts: what the device sorts, projects and blends of them, and a viewer that walks through levels.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::path::Path;
use std::time::Duration;

use glam::DVec3;
use motes_app::lod::{LevelChoice, Resident, Tuning};
use motes_renderer::order::{OrderRequest, SortBuffers, SplatOrder};
use motes_renderer::parts::{Part, Parts, shared_opacity};
use motes_renderer::{
    Axis, Composite, Expansion, Fov, Offscreen, Packing, Picture, Precision, RenderConfig, SceneOnDevice,
    ShPrecision, Sorter, View,
};
use motes_scenes::levels::{self, LevelFile, NewLevel, Storage};
use motes_scenes::synthetic::Recipe;
use motes_scenes::{Scene, Splats};
use motes_tests::TestGpu;

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 1 };

fn scene() -> Splats {
    Recipe { count: 600, sh_degree: 1, seed: 8, log_scales: [-3.0, -1.5], ..Default::default() }.still()
}

fn view() -> View {
    let fov = Fov { left: -0.6, right: 0.6, up: -0.5, down: 0.5 };
    View::look_at(DVec3::new(0.2, 0.1, -2.6), DVec3::ZERO, DVec3::NEG_Y, fov, [64, 48])
}

fn parts(share: f32) -> Parts {
    let part = |first, splats, share| Part { first, splats, share };
    Parts::new([part(500, 100, 1.0), part(0, 90, 1.0), part(250, 150, share)])
}

/// The splats of some parts as a scene of its own.
fn alone(splats: &Splats, parts: &Parts) -> Splats {
    let mut alone = splats.selected(&parts.indices().collect::<Vec<_>>());
    let shares = parts.list().iter().flat_map(|p| std::iter::repeat_n(p.share, p.splats as usize));
    alone.opacities.iter_mut().zip(shares).for_each(|(o, share)| *o = shared_opacity(*o, share));
    alone
}

fn largest_difference(a: &Picture, b: &Picture) -> u8 {
    let values = a.pixels.iter().flatten().zip(b.pixels.iter().flatten());
    values.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

#[test]
fn parts_are_drawn_as_if_they_were_all_there_is() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let splats = scene();
    let whole = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    for share in [1.0, 0.4] {
        let alone = SceneOnDevice::new(&gpu, &alone(&splats, &parts(share)), PLAIN).unwrap();
        for sorter in [Sorter::Cpu, Sorter::Gpu] {
            for &expansion in Expansion::ALL {
                let config = RenderConfig { sorter, expansion, ..Default::default() };
                let name = format!("{sorter} {expansion} {share}");
                whole.positions.choose(Some(parts(share)));
                let (ours, report) = offscreen.render(&whole, &[view()], &config).unwrap();
                let (theirs, of_theirs) = offscreen.render(&alone, &[view()], &config).unwrap();
                let off = largest_difference(&ours[0], &theirs[0]);
                println!("{name}: {off} of 255");
                // With whole shares the very same picture; else two roundings of one power.
                assert!(off <= if share == 1.0 { 0 } else { 1 }, "{name}: {off}");
                assert_eq!(report.visible, of_theirs.visible, "{name}");
                // Control: the share is seen, and so is what is left out.
                whole.positions.choose(Some(parts(1.4 - share)));
                let (other, _) = offscreen.render(&whole, &[view()], &config).unwrap();
                assert!(largest_difference(&other[0], &theirs[0]) > 10, "{name}");
                whole.positions.choose(None);
                let (all, of_all) = offscreen.render(&whole, &[view()], &config).unwrap();
                assert!(largest_difference(&all[0], &theirs[0]) > 10, "{name}");
                assert!(expansion != Expansion::Precomputed || of_all.visible > report.visible, "{name}");
            }
        }
    }
}

#[test]
fn what_is_in_no_part_is_neither_sorted_nor_drawn() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let scene = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let config = RenderConfig::default();
    let sorted = |scene: &SceneOnDevice| {
        let mut order = SplatOrder::default();
        let request = OrderRequest::new(&[view()], &config).of_parts(&scene.positions);
        order.sort(&scene.positions, &request, &mut SortBuffers::default());
        order.indices.len()
    };
    assert_eq!(sorted(&scene), 600);
    scene.positions.choose(Some(parts(0.5)));
    assert_eq!(sorted(&scene), 340);
    // What reaches beyond the scene is left out; where nothing is left, nothing is drawn.
    scene.positions.choose(Some(Parts::new([Part { first: 590, splats: 11, share: 1.0 }])));
    for sorter in [Sorter::Cpu, Sorter::Gpu, Sorter::Stochastic] {
        let config = RenderConfig { sorter, composite: Composite::FrontToBack, ..Default::default() };
        let (pictures, report) = offscreen.render(&scene, &[view()], &config).unwrap();
        assert_eq!(report.visible, 0, "{sorter}");
        assert!(pictures[0].pixels.iter().all(|p| p[..3] == [0; 3]), "{sorter}");
    }
}

/// Samples are hashed by the splat, so that a part of a scene is not the same picture as the part alone: but nearly.
#[test]
fn stochastic_transparency_shows_parts() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let splats = scene();
    let whole = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let alone = SceneOnDevice::new(&gpu, &alone(&splats, &parts(0.4)), PLAIN).unwrap();
    let config = RenderConfig {
        sorter: Sorter::Stochastic,
        composite: Composite::FrontToBack,
        samples: 256,
        ..Default::default()
    };
    whole.positions.choose(Some(parts(0.4)));
    let mut mean_off = |scene: &SceneOnDevice| {
        let (ours, _) = offscreen.render(scene, &[view()], &config).unwrap();
        let sorted = RenderConfig { sorter: Sorter::Cpu, ..config.clone() };
        let (theirs, _) = offscreen.render(&alone, &[view()], &sorted).unwrap();
        let values = ours[0].pixels.iter().flatten().zip(theirs[0].pixels.iter().flatten());
        values.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (4 * ours[0].pixels.len()) as f64
    };
    let of_parts = mean_off(&whole);
    let of_alone = mean_off(&alone);
    whole.positions.choose(Some(parts(1.0)));
    let of_others = mean_off(&whole);
    println!("{of_parts:.2}, alone {of_alone:.2}, other shares {of_others:.2}");
    assert!(of_parts < 1.2 * of_alone && of_others > 1.5 * of_alone, "{of_parts} {of_alone} {of_others}");
}

/// A fine level of 12000 splats in cells, and a coarse one of every sixth of them.
fn save_levels(path: &Path) {
    let fine = Recipe { count: 12_000, seed: 5, log_scales: [-4.0, -3.0], ..Default::default() }.still();
    let coarse = fine.selected(&(0..2000).map(|i| 6 * i).collect::<Vec<_>>());
    let level = |name: &str, step, splats| NewLevel { name: name.into(), step, splats };
    let list = [level("fine", 1000.0, fine), level("coarse", 150.0, coarse)];
    levels::save(path, &list, &[], Some(0.5), Storage::Ply).unwrap();
}

#[test]
fn a_scene_larger_than_memory_is_read_on_the_way_and_nothing_is_missing_in_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.mlod");
    save_levels(&path);
    let gpu = TestGpu::new();
    let packing = Packing { sh_degree: 0, ..PLAIN };
    let splat_bytes = 4 * packing.geometry_words() as u64 + 12;
    // Half of the fine level would not fit.
    let budget = 400 << 10;
    assert!(budget < 6_100 * splat_bytes);
    let least = Resident::open(&gpu, &path, packing, 1 << 10, Tuning::default());
    assert!(least.err().unwrap().to_string().contains("--cell"));
    let eyes = [0.0f64, 1.5, 3.0].map(|turn| DVec3::new(1.6 * turn.sin(), 0.1, 1.6 * turn.cos()));
    walk_within(&gpu, &path, budget, DVec3::ZERO, &eyes);
}

/// The same with a streamed SOG scene of 500 000 splats at its finest level, of which a quarter would fit at the most.
#[test]
fn streamed_scenes_are_read_on_the_way_too() {
    let gpu = TestGpu::new();
    let path = motes_tests::sample("static/playbot");
    let middle = DVec3::new(0.0, -0.5, 0.0);
    // One half of it is nearer, then the other.
    let eyes = [-2.0, 2.0].map(|z| middle + DVec3::new(0.1, -0.2, z));
    walk_within(&gpu, &path, 8 << 20, middle, &eyes);
}

/// Looks at the middle from one eye after another until nothing is missing, and compares with the same levels read whole.
fn walk_within(gpu: &TestGpu, path: &Path, budget: u64, middle: DVec3, eyes: &[DVec3]) {
    let packing = Packing { sh_degree: 0, ..PLAIN };
    let file = LevelFile::open(path).unwrap();
    let (resident, mut choice) = Resident::open(gpu, path, packing, budget, Tuning::default()).unwrap();
    let mut offscreen = Offscreen::new(gpu).unwrap();
    let config = RenderConfig { sh_degree: 0, ..Default::default() };
    let settle = |choice: &mut LevelChoice, view: View| {
        for _ in 0..5000 {
            resident.advance(choice, &[view], 0.02, 0.0);
            if choice.missing() == (0, 0) && choice.at_rest() {
                return;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("it does not settle: {:?}, {:?}", choice.missing(), resident.memory());
    };
    let mut read = 0;
    for &eye in eyes {
        let view = View::look_at(eye, middle, DVec3::NEG_Y, Fov::vertical(1.0, [64, 48]), [64, 48]);
        settle(&mut choice, view);
        let shown: Vec<Option<usize>> = choice.levels().collect();
        let levels: std::collections::BTreeSet<usize> = shown.iter().flatten().copied().collect();
        assert!(levels.len() > 1, "near regions are finer than far ones: {shown:?}");
        let memory = resident.memory();
        assert!(memory.peak <= memory.budget && memory.budget <= budget && memory.failed == 0, "{memory:?}");
        assert!(memory.read > read, "another side needs other regions");
        read = memory.read;
        let (ours, _) = offscreen.render(resident.scene(), &[view], &config).unwrap();
        let mut whole = |without: Option<usize>| {
            let drawn = shown.iter().enumerate().filter(|(group, _)| Some(*group) != without);
            let parts = drawn.filter_map(|(group, level)| Some(file.read(group, (*level)?).unwrap()));
            let scene = SceneOnDevice::new(gpu, &Scene::joined(parts.collect()), packing).unwrap();
            offscreen.render(&scene, &[view], &config).unwrap().0
        };
        // Splats at one distance may come in another order.
        let off = largest_difference(&ours[0], &whole(None)[0]);
        let nearest = choice.wishes().next().unwrap().0;
        let control = largest_difference(&ours[0], &whole(Some(nearest))[0]);
        println!("from {eye}: off by {off}, without one region {control}; {memory:?}");
        assert!(off <= 1 && control > 5, "{off} {control}");
    }
    drop((resident, offscreen));
}
