//! The command line: what it writes, and how it refuses.
#![allow(clippy::unwrap_used, reason = "a test may")]

mod common;

use std::path::Path;
use std::process::Output;

use motes_desktop::measure::Picture;

fn run(arguments: &[&str]) -> Output {
    common::motes().args(arguments).output().unwrap()
}

fn succeeds(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn fails(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(!output.status.success(), "{arguments:?} must fail");
    String::from_utf8(output.stderr).unwrap()
}

/// PSNR of two pictures, dB.
fn psnr(a: &Path, b: &Path) -> f64 {
    let load = |p: &Path| Picture::load(p).unwrap();
    motes_desktop::commands::golden::decibels(&load(a), &load(b)).unwrap()
}

#[test]
fn pictures_from_every_kind_of_camera() {
    let folder = common::folder("cli");
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    // The same camera three times: a list of reference pictures, NeRF's axes, an eye and its target.
    std::fs::write(
        at("list.json"),
        r#"[{"name":"near","R_w2c":[[1,0,0],[0,1,0],[0,0,1]],"t_w2c":[0,0,1.5],
            "fx":100,"fy":100,"cx":48,"cy":32,"width":96,"height":64},
           {"name":"far","R_w2c":[[1,0,0],[0,1,0],[0,0,1]],"t_w2c":[0,0,3],
            "fx":100,"fy":100,"cx":48,"cy":32,"width":96,"height":64}]"#,
    )
    .unwrap();
    std::fs::write(
        at("transforms.json"),
        r#"{"fl_x":100,"fl_y":100,"cx":48,"cy":32,"w":96,"h":64,"frames":[{"file_path":"near",
            "transform_matrix":[[1,0,0,0],[0,-1,0,0],[0,0,-1,-1.5],[0,0,0,1]]}]}"#,
    )
    .unwrap();
    let list = at("list.json");
    succeeds(&["render", "--cameras", &list, "--name", "near", "-o", &at("list.png"), "--validation"]);
    succeeds(&["render", "--cameras", &at("transforms.json"), "-o", &at("nerf.png")]);
    let fov = (2.0f64 * 0.32f64.atan()).to_degrees().to_string();
    let eye = ["--eye", "0,0,-1.5", "--target", "0,0,0", "--up", "-y", "--fov", &fov, "--size", "96x64"];
    succeeds(&[&["render", "-o", &at("eye.png")], &eye[..]].concat());
    succeeds(&["render", "--cameras", &list, "--name", "near", "--reference", "-o", &at("reference.png")]);
    let [a, nerf, eye, reference] =
        ["list.png", "nerf.png", "eye.png", "reference.png"].map(|name| folder.join(name));
    assert!(psnr(&a, &nerf) > 60.0 && psnr(&a, &eye) > 60.0, "one camera in three forms");
    assert!(psnr(&a, &reference) > 40.0, "{}", psnr(&a, &reference));

    let said = succeeds(&["render", "--cameras", &list, "--all-cameras", "--json", "-o", &at("all")]);
    assert_eq!(said.lines().count(), 2);
    assert!(said.lines().all(|line| line.contains("\"fragments\"")), "{said}");
    assert!(psnr(&folder.join("all/near.png"), &a) > 90.0);
    assert!(psnr(&folder.join("all/far.png"), &a) < 30.0, "another camera, another picture");

    succeeds(&["render", "--turntable", "3", "--size", "64x48", "-o", &at("round")]);
    assert_eq!(std::fs::read_dir(at("round")).unwrap().count(), 3);
    succeeds(&["render", "--stereo", "--size", "64x48", "-o", &at("stereo.png")]);
    assert_eq!(Picture::load(&folder.join("stereo.png")).unwrap().size(), [128, 48]);
}

#[test]
fn a_scene_is_stated() {
    let json: serde_json::Value = serde_json::from_str(&succeeds(&["info", "--json"])).unwrap();
    assert_eq!(json["statement"]["splats"], 113_648);
    assert_eq!(json["settings"]["up"], "-y");
    let device = json["on_device"].as_array().unwrap();
    assert_eq!(device[0]["bytes"], 113_648 * 56);
    let text = succeeds(&["info"]);
    assert!(text.contains("113,648") && text.contains("on the device"), "{text}");
}

#[test]
fn mistakes_are_named() {
    for (arguments, words) in [
        (&["info", "/nowhere/garden.ply"][..], &["/nowhere/garden.ply"][..]),
        (&["render", "-o", "x.png", "--projection", "cubist"], &["cubist", "tangent"]),
        (&["render", "-o", "x.png", "--name", "near"], &["--cameras"]),
        (&["render", "-o", "x.png", "--eye", "1,2"], &["1,2"]),
        (&["render"], &["--output"]),
        (&["/nowhere/garden.ply"], &["/nowhere/garden.ply"]),
        (
            &["render", "-o", "x.png", "--size", "64x48", "--radius", "tiles", "--projection", "tangent"],
            &["tiles", "affine"],
        ),
    ] {
        let said = fails(arguments);
        assert!(words.iter().all(|word| said.contains(word)), "{arguments:?}: {said}");
    }
    assert!(!Path::new("x.png").exists());
}
