//! `motes label`, `optimize` and `lod` from the command line, on a scene of a few hundred splats.
#![allow(clippy::unwrap_used, reason = "a test may")]

mod common;

use motes_scenes::labels::Labels;
use motes_scenes::levels::LevelFile;
use motes_scenes::synthetic::Recipe;
use motes_scenes::{LoadOptions, load, save};

fn run(arguments: &[&str]) -> Result<String, String> {
    let output = common::motes().args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    if output.status.success() { Ok(text(output.stdout)) } else { Err(text(output.stderr)) }
}

/// Twelve cameras in a circle around the scene.
fn cameras() -> String {
    let camera = |k: usize| {
        let (s, c) = (k as f64 * std::f64::consts::FRAC_PI_6).sin_cos();
        format!(
            r#"{{"name":"c{k}","R_w2c":[[{c},0,{s}],[0,1,0],[{},0,{c}]],"t_w2c":[0,0,4],
                "fx":60,"fy":60,"cx":32,"cy":24,"width":64,"height":48}}"#,
            -s
        )
    };
    format!("[{}]", (0..12).map(camera).collect::<Vec<_>>().join(","))
}

#[test]
fn scenes_are_labelled_optimised_and_levelled() {
    let folder = common::folder("detail");
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(at("cameras.json"), cameras()).unwrap();
    let scene = Recipe { count: 400, log_scales: [-3.0, -2.0], ..Default::default() }.still();
    save(&folder.join("scene.ply"), &scene).unwrap();
    let ids: Vec<u16> = scene.means.iter().map(|m| if m[0] > 0.0 { 2 } else { 1 }).collect();
    Labels::of_ids(ids.clone()).save(&folder.join("ids.json")).unwrap();

    // Ids become labels beside the scene, masks are made from them, and from the masks the labels come back.
    let ply = at("scene.ply");
    let label = |more: &[&str]| run(&[&["label", &ply][..], more].concat());
    label(&["--ids", &at("ids.json"), "--class", "2=right#ff8000", "--write-masks", &at("masks")]).unwrap();
    let beside = Labels::beside(&folder.join("scene.ply")).unwrap().unwrap();
    assert_eq!((beside.ids == ids, beside.class(2).unwrap().colour), (true, [255, 128, 0]));
    let truth = at("ids.json");
    let again = ["--masks", &at("masks"), "--truth", &truth, "--json", "-o", &at("again.json")];
    let report: serde_json::Value = serde_json::from_str(&label(&again).unwrap()).unwrap();
    assert_eq!(report["masks"], 12);
    assert!(report["agreement"][2]["share"].as_f64().unwrap() > 0.9, "{report}");
    assert!(label(&["--masks", &at("nowhere")]).unwrap_err().contains("no mask of a camera"));

    // Half of the splats, and what that costs.
    let out = at("half.ply");
    let optimize =
        |more: &[&str]| run(&[&["optimize", &ply, "-o", &out, "--scale", "0.6"][..], more].concat());
    let report =
        optimize(&["--keep", "0.5", "--steps", "2", "--pictures", &at("pictures"), "--json"]).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let figure = |of: &str, what: &str| report[of][what].as_f64().unwrap();
    assert_eq!(load(&folder.join("half.ply"), &LoadOptions::default()).unwrap().splats.len(), 200);
    assert_eq!((figure("ours", "splats"), figure("original", "flip")), (200.0, 0.0));
    assert!(figure("ours", "flip") < 0.8 * figure("opacity_cut", "flip"), "{report}");
    assert!(figure("ours", "layers") < figure("original", "layers"));
    assert_eq!(Labels::beside(&folder.join("half.ply")).unwrap().unwrap().ids.len(), 200);
    assert!(std::fs::read_dir(folder.join("pictures")).unwrap().count() > 0);
    let refused = optimize(&["--layers", "0.2", "--steps", "0", "--at-most", "0.001"]).unwrap_err();
    assert!(refused.contains("0.2 layers per pixel cannot be had"), "{refused}");

    // Three levels, a fit against the finest, and a test of it.
    let levels = at("scene.mlod");
    let built = run(&["lod", "build", &ply, "-o", &levels, "--levels", "3", "--scale", "0.6"]).unwrap();
    assert!(built.contains("level 2") && built.contains("right"), "{built}");
    let file = LevelFile::open(&folder.join("scene.mlod")).unwrap();
    assert_eq!(file.levels().iter().map(|l| l.splats).collect::<Vec<_>>(), [400, 200, 100]);
    let eval = ["lod", "eval", &levels, "--against", "finest", "--targets", "0.2,0.99"];
    assert!(run(&eval).unwrap_err().contains("run motes lod fit"));
    let fit = ["lod", "fit", &levels, "--against", "finest", "-o", &at("fit"), "--least-views", "4"];
    let fitted = run(&fit).unwrap();
    assert!(fitted.contains("10 views, 3 levels"), "{fitted}");
    assert!(folder.join("fit/right-distance.svg").is_file() && folder.join("fit/report.json").is_file());
    let tested = run(&[&eval[..], &["-o", &at("fit")]].concat()).unwrap();
    assert!(tested.contains("2 views that were not fitted to"), "{tested}");
    // Who judges can be said: nothing is fitted to those views.
    let judges = format!("{}:c1,c2,c3", at("cameras.json"));
    let copy = at("judged.mlod");
    std::fs::copy(&levels, &copy).unwrap();
    let judged = |what: &str| {
        run(&["lod", what, &copy, "--against", "finest", "--judge", &judges, "-o", &at("judged")]).unwrap()
    };
    let (fitted, tested) = (judged("fit"), judged("eval"));
    assert!(fitted.contains("7 views, 3 levels"), "{fitted}");
    assert!(tested.contains("3 views that were named"), "{tested}");
    // What would have no effect is refused.
    assert!(run(&[&fit[..], &["--views", "3"]].concat()).unwrap_err().contains("--views"));
    let trials: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.join("fit/trials.json")).unwrap()).unwrap();
    let share = |k: usize| trials["summaries"][k]["splats"].as_f64().unwrap();
    assert!(share(0) < share(1), "a higher target takes more splats: {trials}");
    assert!(run(&["lod", "info", &ply]).unwrap_err().contains("begins with MOTESLOD"));

    // Pictures at the levels that a target allows: the lower it is, the fewer splats; the levels in use as colours.
    let splats = |target: &str, file: &str| {
        let out = at(file);
        let render = ["render", &levels, "--json", "--lod-target", target, "-o", &out, "--heat", "level"];
        run(&render).unwrap();
        let line = run(&render[..7]).unwrap();
        serde_json::from_str::<serde_json::Value>(&line).unwrap()["report"]["visible"].as_u64().unwrap()
    };
    let (few, many) = (splats("0.3", "few.png"), splats("1", "many.png"));
    assert!(few < many, "{few} {many}");
    assert!(std::fs::read(at("few.png")).unwrap() != std::fs::read(at("many.png")).unwrap());
    let refused = run(&["render", &ply, "--lod-target", "0.9", "-o", &at("none.png")]).unwrap_err();
    assert!(refused.contains("begins with MOTESLOD"), "{refused}");

    // A walk round the scene. Changes of level are seen where they come at once, and not where they fade.
    let walk = |fade: &str| {
        run(&[
            "lod",
            "walk",
            &levels,
            "--scale",
            "1",
            "--seconds",
            "1",
            "--lod-target",
            "0.9",
            "--fade",
            fade,
            "-o",
            &at("walk.json"),
        ])
    };
    let walked = walk("0.5");
    println!("{walked:?}");
    let figures: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.join("walk.json")).unwrap()).unwrap();
    let (step, at_once) = (figures["step"].as_f64().unwrap(), figures["hard_step"].as_f64().unwrap());
    assert!(walked.is_ok() && step <= 2.0 && at_once > 3.0 * step && at_once > 2.0, "{figures}");
    assert!(walk("0").unwrap_err().contains("exceeds the bound"));
}
