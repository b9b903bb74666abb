//! Only what a scene calls for: decisions, buffers, instructions, and pictures that do not change.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_desktop::commands::plan::PlanReport;
use motes_renderer::plan::{Overrides, Plan, Topic};
use motes_renderer::{Fov, Offscreen, Projection, RenderConfig, SceneOnDevice, View};
use motes_scenes::statement::Statement;
use motes_scenes::synthetic::{Animation, Recipe, animate};
use motes_scenes::{LoadOptions, Scene, Splats, load_many, save};
use motes_shaders::layout::Specialization;
use motes_shaders::modules;
use motes_tests::spirv::{Left, Specialized};
use motes_tests::{TestGpu, psnr, sample as sample_file};
use std::path::PathBuf;

fn scene(splats: Splats) -> Scene {
    Scene { splats, ..Default::default() }
}

fn planned(scene: &Scene) -> Plan {
    Plan::of(&Statement::of(scene), &Overrides::default())
}

fn animation() -> Animation {
    Animation { travel: [0.4, 0.0, 0.0], ..Default::default() }
}

fn view() -> View {
    let size = [128, 96];
    let fov = Fov::vertical(0.9, size);
    View::look_at(DVec3::new(0.1, 0.2, -3.0), DVec3::ZERO, DVec3::NEG_Y, fov, size)
}

/// The constants that a scene of this plan is drawn with.
fn constants(plan: &Plan) -> Vec<u32> {
    let s = Specialization {
        projection: plan.projection as u32,
        precision: plan.packing.precision as u32,
        sh_degree: plan.packing.sh_degree.into(),
        sh_stored: plan.packing.sh_degree.into(),
        sh_precision: plan.packing.sh_precision as u32,
        geometry_slots: 1,
        sh_slots: 1,
        motion: plan.motion.into(),
        views: 1,
        ..Default::default()
    };
    vec![
        s.projection,
        s.low_pass,
        s.shape,
        s.radius,
        s.precision,
        s.sh_degree,
        s.sh_stored,
        s.sh_precision,
        s.geometry_slots,
        s.sh_slots,
        s.motion,
        s.views,
        s.composite,
        s.geometry_shift,
        s.sh_shift,
        s.sampling,
        s.lens,
        s.parts,
    ]
}

fn left(words: &[u32], plan: &Plan) -> Left {
    Specialized::new(words, &constants(plan)).left()
}

#[test]
fn a_plain_scene_has_neither_buffers_nor_instructions_for_what_it_lacks() {
    let gpu = TestGpu::new();
    let plain = scene(Recipe { count: 500, ..Default::default() }.still());
    let rich = scene(Recipe { count: 500, sh_degree: 3, ..Default::default() }.moving(&animation()));
    let (plain_plan, rich_plan) = (planned(&plain), planned(&rich));
    let on_device = SceneOnDevice::new(&gpu, &plain.splats, plain_plan.packing).unwrap();
    assert!(on_device.harmonics.buffers.is_empty() && on_device.motion.buffers.is_empty());
    assert_eq!(on_device.bytes(), 500 * plain_plan.bytes_per_splat());
    let on_device = SceneOnDevice::new(&gpu, &rich.splats, rich_plan.packing).unwrap();
    assert!(!on_device.harmonics.buffers.is_empty() && !on_device.motion.buffers.is_empty());
    assert_eq!(on_device.bytes(), 500 * rich_plan.bytes_per_splat());

    for (name, words) in [
        ("project.comp", modules::PROJECT_COMP),
        ("splat_instanced.vert", modules::INSTANCED_VERT),
        ("splat.geom", modules::SPLAT_GEOM),
    ] {
        let (few, many) = (left(words, &plain_plan), left(words, &rich_plan));
        println!("{name}: {} instructions, {} with everything", few.instructions, many.instructions);
        for stream in ["sh_stream", "motion_stream"] {
            assert!(!few.variables.contains(stream), "{name} still reads {stream}");
            assert!(many.variables.contains(stream), "control: {name} must read {stream}");
        }
        assert!(few.variables.contains("geometry_stream"), "{name}: {:?}", few.variables);
        assert!(few.instructions * 10 < many.instructions * 9, "{name}");
    }
}

#[test]
fn plans_change_pictures_by_no_more_than_their_bound() {
    let gpu = TestGpu::new();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let recipe = Recipe { count: 1500, sh_degree: 3, seed: 3, ..Default::default() };
    // Bands that hardly show: what training leaves of directions that no photograph needed.
    let mut faint = recipe.still();
    for (i, c) in faint.sh.iter_mut().enumerate() {
        if i % 16 > 3 {
            *c = c.map(|v| v * 1e-3);
        }
    }
    for (name, splats, degree) in [
        ("still", recipe.still(), 3),
        ("faint", faint, 1),
        ("moving", recipe.moving(&animation()), 3),
        ("plain", Recipe { sh_degree: 0, ..recipe }.still(), 0),
    ] {
        let scene = scene(splats);
        let statement = Statement::of(&scene);
        let plan = planned(&scene);
        assert_eq!(plan.packing.sh_degree, degree, "{name}:\n{plan}");
        let all = Plan::of(&statement, &Overrides::EVERYTHING);
        let mut render = |plan: &Plan| {
            let on_device = SceneOnDevice::new(&gpu, &scene.splats, plan.packing).unwrap();
            let config = plan.apply(&RenderConfig { time: 0.3, ..Default::default() });
            let (pictures, report) = offscreen.render(&on_device, &[view()], &config).unwrap();
            let colours: Vec<_> = pictures[0].pixels.iter().map(|p| [p[0], p[1], p[2]]).collect();
            (colours, on_device.bytes(), report)
        };
        let (by_plan, bytes, report) = render(&plan);
        let (whole, all_bytes, all_report) = render(&all);
        let db = psnr(&by_plan, &whole);
        println!("{name}: {bytes} bytes of {all_bytes}, {db:.1} dB\n{plan}");
        assert!(db >= Plan::BOUND_DB, "{name}: {db:.1} dB");
        assert!(bytes < all_bytes);
        assert!(report.fragments.abs_diff(all_report.fragments) * 50 < all_report.fragments);
        if degree == 3 {
            // Control: what the plan keeps cannot be left out.
            let without = Plan::of(&statement, &Overrides { sh_degree: Some(0), ..Default::default() });
            let db = psnr(&render(&without).0, &whole);
            assert!(db < 35.0, "{name} without harmonics: {db:.1} dB");
        }
    }
}

#[test]
fn a_scene_that_gains_an_effect_gets_it_back() {
    let still = scene(Recipe { count: 300, sh_degree: 1, ..Default::default() }.still());
    let before = planned(&still);
    assert!(!before.motion && before.packing.sh_degree == 1);

    let mut moving = still.clone();
    animate(&mut moving.splats, &animation(), 1);
    assert!(planned(&moving).motion);

    let more = scene(Recipe { count: 300, sh_degree: 2, ..Default::default() }.still());
    assert_eq!(planned(&more).packing.sh_degree, 2);
    // A still file that one with motion is merged into has a motion buffer from then on.
    let folder = std::env::temp_dir().join(format!("motes-plan-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("still.ply");
    save(&file, &still.splats).unwrap();
    let load = |files: &[PathBuf]| load_many(files, &LoadOptions::default()).unwrap();
    let alone = load(std::slice::from_ref(&file));
    let merged = load(&[file, sample_file("4d/coffee10.splatv")]);
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(!planned(&alone).motion && planned(&merged).motion);
    assert_eq!(planned(&merged).packing.sh_degree, 1);
}

#[test]
fn what_somebody_asks_for_goes_before_what_the_scene_calls_for() {
    let scene = scene(Recipe { count: 300, sh_degree: 3, ..Default::default() }.still());
    let asked = Overrides { sh_degree: Some(1), projection: Some(Projection::Exact), ..Default::default() };
    let plan = Plan::of(&Statement::of(&scene), &asked);
    assert_eq!((plan.packing.sh_degree, plan.projection), (1, Projection::Exact));
    for d in &plan.decisions {
        let expected = matches!(d.topic, Topic::Harmonics | Topic::Projection);
        assert_eq!(d.overridden, expected, "{}", d.topic.name());
        assert!(!d.reason.is_empty());
    }
    assert!(plan.to_string().contains("(asked for)"));
}

/// `motes info --plan`, as text and as JSON: a plain scene's effects are off, and come back with what they need.
#[test]
fn the_plan_is_printed_with_what_it_saves() {
    let report = |scene: &Scene| PlanReport::of(scene, &Statement::of(scene), &Overrides::default());
    let on = |report: &PlanReport, topic| {
        report.effects.iter().find(|e| e.decision.topic == topic).map(|e| e.decision.on)
    };
    let plain = scene(Recipe { count: 400, ..Default::default() }.still());
    let plain = report(&plain);
    assert_eq!(on(&plain, Topic::Motion), Some(false));
    assert_eq!(on(&plain, Topic::Harmonics), Some(false));
    assert!(plain.bytes < plain.bytes_switched_on && plain.bytes_switched_on < plain.bytes_of_every_buffer);
    let text = plain.to_string();
    println!("{text}");
    for part in [
        "motion",
        "off",
        "by the scene (or --sh-degree)",
        "neither buffer nor instruction",
        "--precision f16",
    ] {
        assert!(text.contains(part), "{part}");
    }

    // Control: the same splats with a band of harmonics, and with motion, get both back, and their bytes.
    let coloured = Recipe { count: 400, sh_degree: 2, ..Default::default() }.still();
    let mut moving = Scene { splats: coloured.clone(), ..Default::default() };
    let coloured = report(&scene(coloured));
    assert_eq!((on(&coloured, Topic::Harmonics), on(&coloured, Topic::Motion)), (Some(true), Some(false)));
    animate(&mut moving.splats, &animation(), 1);
    let moving = report(&moving);
    assert_eq!((on(&moving, Topic::Harmonics), on(&moving, Topic::Motion)), (Some(true), Some(true)));
    assert!(plain.bytes < coloured.bytes && coloured.bytes < moving.bytes);
    let json = serde_json::to_value(&moving).unwrap();
    let motion = json["effects"].as_array().unwrap().iter().find(|e| e["topic"] == "motion").unwrap();
    assert!(
        motion["on"] == true && motion["option"].is_null() && motion["bytes_per_splat"].as_u64() > Some(0)
    );
    assert_eq!(json["bytes"].as_u64(), Some(moving.bytes));
}
