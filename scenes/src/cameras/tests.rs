use std::path::{Path, PathBuf};

use super::*;

/// The folder of sample scenes, which these tests cannot do without.
fn scenes() -> PathBuf {
    let folder = std::env::var_os("MOTES_SCENES")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes"), PathBuf::from);
    if folder.is_dir() {
        return folder;
    }
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes");
    assert!(
        above.is_dir(),
        "the sample scenes are missing: set MOTES_SCENES to their folder (looked at {} and {})",
        folder.display(),
        above.display()
    );
    above
}

fn folder_with(files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }
    folder
}

fn error_of(files: &[(&str, &[u8])], open: &str) -> String {
    let folder = folder_with(files);
    load(&folder.path().join(open)).unwrap_err().to_string()
}

/// The largest difference between two cameras' numbers; infinite where anything else differs.
fn difference(a: &Camera, b: &Camera) -> f64 {
    if (a.width, a.height, &a.name) != (b.width, b.height, &b.name) {
        return f64::INFINITY;
    }
    let numbers = |c: &Camera| {
        let mut all = vec![c.fx, c.fy, c.cx, c.cy];
        all.extend(c.rotation.iter().flatten());
        all.extend(c.translation);
        all
    };
    numbers(a).iter().zip(numbers(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn three_files_of_one_data_set_give_the_same_cameras() {
    let root = scenes().join("photos_snowmiku");
    let trainer = load(&root.join("cameras.json")).unwrap();
    let nerf = load(&root.join("transforms.json")).unwrap();
    let colmap = load(&root.join("sparse/0")).unwrap();
    assert_eq!((trainer.len(), nerf.len(), colmap.len()), (97, 97, 97));
    for camera in &trainer {
        for others in [&nerf, &colmap] {
            let other = find(others, &camera.name).unwrap();
            let off = difference(camera, other);
            assert!(off < 1e-9, "{}: off by {off:e}", camera.name);
        }
    }
    // Negative control: the same comparison sees a flipped axis, and a neighbour's pose.
    let mut flipped = trainer[3].clone();
    flipped.rotation[1] = flipped.rotation[1].map(|v| -v);
    assert!(difference(&trainer[3], &flipped) > 0.1);
    let mut neighbour = trainer[4].clone();
    neighbour.name = trainer[3].name.clone();
    assert!(difference(&trainer[3], &neighbour) > 1e-3);
}

#[test]
fn the_trainer_s_file_keeps_split_photograph_and_position() {
    let cameras = load(&scenes().join("photos_snowmiku/cameras.json")).unwrap();
    let test = cameras.iter().filter(|c| c.split == Some(Split::Test));
    assert_eq!(test.count(), 13);
    let first = find(&cameras, "20240212_003919").unwrap();
    let p = first.position();
    let stated = [-2.0239410600999292, 1.5094239986550113, -3.171810618383385];
    assert!(p.iter().zip(stated).all(|(p, s)| (p - s).abs() < 1e-9), "{p:?}");
    let image = first.image.as_ref().unwrap();
    assert!(image.ends_with("images/20240212_003919.png") && image.is_file());
    // 25 of the 97 photographs are there.
    assert_eq!(cameras.iter().filter(|c| c.image.is_some()).count(), 25);
    let [h, v] = first.field_of_view();
    assert!((h - 2.0 * (240.0f64 / first.fx).atan()).abs() < 1e-12);
    assert!((v - 2.0 * (180.0f64 / first.fy).atan()).abs() < 1e-12);
}

#[test]
fn reference_pictures_have_cameras() {
    let cameras = load(&scenes().join("golden/golden.json")).unwrap();
    assert_eq!(cameras.len(), 11);
    let skull = find(&cameras, "skull_sh3").unwrap();
    assert_eq!(skull.inputs, ["static/skull.sog"]);
    assert_eq!((skull.width, skull.height), (640, 480));
    let p = skull.position();
    assert!(p.iter().zip([-1.2, -0.6, 1.2]).all(|(p, s)| (p - s).abs() < 1e-12), "{p:?}");
    assert_eq!(find(&cameras, "spinach_t095").unwrap().time, Some(0.95));
    let error = find(&cameras, "skul").unwrap_err();
    assert!(error.contains("skull_sh3") && error.contains("and 3 more"), "{error}");
}

#[test]
fn a_data_set_s_cameras_are_found_beside_its_scene() {
    let root = scenes().join("photos_snowmiku");
    assert_eq!(beside(&root.join("snapshots/iteration_00100.spz")), Some(root.join("cameras.json")));
    let folder = folder_with(&[("a/b/c/scene.ply", b""), ("a/sparse/0/cameras.txt", b"")]);
    let scene = folder.path().join("a/b/c/scene.ply");
    assert_eq!(beside(&scene), Some(folder.path().join("a/sparse/0/cameras.txt")));
    assert_eq!(beside(&folder.path().join("a/b/c/d/e/scene.ply")), None);
}

const CAMERAS_TXT: &[u8] = b"# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE 480 360 400.5 401.5 239 181\n7 SIMPLE_RADIAL 100 50 80 50 25 0\n";
const IMAGES_TXT: &[u8] = b"# Image list with two lines of data per image:\n2 0.5 0.5 -0.5 0.5 1 2 3 7 b second.jpg\n1 2 3 4 5 -1\n1 1 0 0 0 0 0 0 1 a.jpg\n\n";

/// The same model in COLMAP's binary form.
fn binary_model() -> (Vec<u8>, Vec<u8>) {
    let mut cameras = 2u64.to_le_bytes().to_vec();
    for (id, model, w, h, parameters) in
        [(1u32, 1u32, 480u64, 360u64, [400.5, 401.5, 239.0, 181.0]), (7, 2, 100, 50, [80.0, 50.0, 25.0, 0.0])]
    {
        cameras.extend(id.to_le_bytes());
        cameras.extend(model.to_le_bytes());
        cameras.extend(w.to_le_bytes());
        cameras.extend(h.to_le_bytes());
        parameters.iter().for_each(|p: &f64| cameras.extend(p.to_le_bytes()));
    }
    let mut images = 2u64.to_le_bytes().to_vec();
    for (id, pose, camera, name, points) in [
        (2u32, [0.5, 0.5, -0.5, 0.5, 1.0, 2.0, 3.0], 7u32, "b second.jpg", 2u64),
        (1, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1, "a.jpg", 0),
    ] {
        images.extend(id.to_le_bytes());
        pose.iter().for_each(|p: &f64| images.extend(p.to_le_bytes()));
        images.extend(camera.to_le_bytes());
        images.extend(name.as_bytes());
        images.push(0);
        images.extend(points.to_le_bytes());
        images.extend(std::iter::repeat_n(0xab, points as usize * 24));
    }
    (cameras, images)
}

#[test]
fn colmap_text_and_binary_agree() {
    let (cameras_bin, images_bin) = binary_model();
    let text = folder_with(&[("cameras.txt", CAMERAS_TXT), ("images.txt", IMAGES_TXT)]);
    let binary = folder_with(&[
        ("sparse/0/cameras.bin", &cameras_bin),
        ("sparse/0/images.bin", &images_bin),
        ("images/a.jpg", b""),
    ]);
    let from_text = load(text.path()).unwrap();
    let mut from_binary = load(binary.path()).unwrap();
    assert!(from_binary[0].image.as_ref().unwrap().is_file());
    from_binary[0].image = None;
    assert_eq!(from_text, from_binary);
    assert_eq!(load(&text.path().join("images.txt")).unwrap(), from_text);

    assert_eq!(from_text[0].name, "a");
    assert_eq!(from_text[1].name, "b second");
    assert_eq!((from_text[0].fx, from_text[0].fy, from_text[0].cx), (400.5, 401.5, 239.0));
    assert_eq!((from_text[1].fx, from_text[1].fy, from_text[1].width), (80.0, 80.0, 100));
    // q = (½, ½, −½, ½): x → −y, y → −z, z → x, by the quaternion's own formula v' = q v q*.
    assert_eq!(from_text[1].rotation, [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]);
    assert_eq!(from_text[1].translation, [1.0, 2.0, 3.0]);
}

#[test]
fn colmap_s_distorted_and_damaged_models_are_refused_with_the_reason() {
    let with = |cameras: &str| {
        error_of(&[("cameras.txt", cameras.as_bytes()), ("images.txt", IMAGES_TXT)], "cameras.txt")
    };
    let distorted = with("1 SIMPLE_RADIAL 480 360 400 240 180 0.01\n");
    for part in ["cameras.txt", "line 1", "SIMPLE_RADIAL", "0.01", "image_undistorter"] {
        assert!(distorted.contains(part), "{distorted}");
    }
    let fisheye = with("1 OPENCV_FISHEYE 480 360 400 400 240 180 0 0 0 0\n");
    assert!(fisheye.contains("OPENCV_FISHEYE") && fisheye.contains("pinhole"), "{fisheye}");
    let short = with("1 PINHOLE 480 360 400 240 180\n");
    assert!(short.contains("4 parameters, found 3"), "{short}");
    let word = with("1 PINHOLE 480 abc 400 400 240 180\n");
    assert!(word.contains("height is “abc”"), "{word}");
    let missing = with("1 PINHOLE 480 360 400 400 240 180\n");
    assert!(missing.contains("refers to camera 7"), "{missing}");
    let nan = with("1 PINHOLE 480 360 NaN 400 240 180\n7 PINHOLE 4 4 2 2 2 2\n");
    assert!(nan.contains("focal length fx is NaN"), "{nan}");

    let (cameras, images) = binary_model();
    for cut in 0..images.len() {
        let error = error_of(&[("cameras.bin", &cameras), ("images.bin", &images[..cut])], "cameras.bin");
        assert!(error.contains("images.bin"), "cut at {cut}: {error}");
    }
    for cut in 1..cameras.len() {
        let error = error_of(&[("cameras.bin", &cameras[..cut]), ("images.bin", &images)], "images.bin");
        assert!(error.contains("the file ends within"), "cut at {cut}: {error}");
    }
    let mut many = cameras.clone();
    many[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    let error = error_of(&[("cameras.bin", &many), ("images.bin", &images)], "images.bin");
    assert!(error.contains("ends within"), "{error}");
}

/// A camera at (1, 2, 3) that looks along the scene's +x, with the scene's +z up in the picture.
const NERF: &str = r#"{"w": 640, "h": 480, "fl_x": 500, "cx": 321, "k1": 0.0, "camera_model": "OPENCV",
 "frames": [
  {"file_path": "images/a/0.png", "transform_matrix": [[0,0,-1,1],[-1,0,0,2],[0,1,0,3],[0,0,0,1]]},
  {"file_path": "images/b/0.png", "fl_x": 250, "fl_y": 260, "w": 320, "h": 240, "cx": 100, "cy": 110, "time": 0.25,
   "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}],
 "test_filenames": ["images/b/0.png"], "train_filenames": ["images/a/0.png"]}"#;

#[test]
fn nerf_axes_and_lenses() {
    let folder = folder_with(&[("transforms.json", NERF.as_bytes())]);
    let cameras = load(folder.path()).unwrap();
    let a = &cameras[0];
    assert_eq!(a.name, "images/a/0");
    assert_eq!(a.split, Some(Split::Train));
    assert_eq!((a.fx, a.fy, a.cx, a.cy), (500.0, 500.0, 321.0, 240.0));
    assert_eq!(a.position(), [1.0, 2.0, 3.0]);
    // Forward is the third row, down the second, right the first.
    assert_eq!(a.rotation, [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]);
    let b = &cameras[1];
    assert_eq!((b.fx, b.fy, b.cx, b.cy, b.width, b.height), (250.0, 260.0, 100.0, 110.0, 320, 240));
    assert_eq!((b.split, b.time), (Some(Split::Test), Some(0.25)));
    assert_eq!(b.rotation, [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]);
    assert!(find(&cameras, "0").unwrap_err().contains("fits 2 cameras"));
    assert_eq!(find(&cameras, "images/b/0.png").unwrap(), b);
}

#[test]
fn nerf_takes_an_angle_and_the_photograph_s_size() {
    // A PNG's signature and header are all that its size needs.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    png.extend(800u32.to_be_bytes());
    png.extend(600u32.to_be_bytes());
    png.extend([8, 2, 0, 0, 0, 0, 0, 0, 0]);
    let text = r#"{"camera_angle_x": 1.5707963267948966, "frames": [{"file_path": "./train/r_0",
      "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    let folder = folder_with(&[("transforms_test.json", text.as_bytes()), ("train/r_0.png", &png)]);
    let path = folder.path().join("transforms_test.json");
    let cameras = load(&path).unwrap();
    let camera = &cameras[0];
    assert_eq!((camera.width, camera.height), (800, 600));
    assert!((camera.fx - 400.0).abs() < 1e-9 && (camera.fy - 400.0).abs() < 1e-9);
    assert_eq!((camera.name.as_str(), camera.split), ("r_0", Some(Split::Test)));
    assert!(camera.image.as_ref().unwrap().ends_with("train/r_0.png"));

    let error = error_of(&[("transforms.json", text.as_bytes())], "transforms.json");
    for part in ["frame 0 (./train/r_0)", "w is missing", "Add w and h"] {
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn nerf_s_wrong_files_are_refused_with_the_reason() {
    let with = |from: &str, to: &str| {
        assert!(NERF.contains(from));
        error_of(&[("transforms.json", NERF.replacen(from, to, 1).as_bytes())], "transforms.json")
    };
    for (from, to, parts) in [
        ("\"k1\": 0.0", "\"k1\": 0.02", &["k1 = 0.02", "Undistort"][..]),
        ("OPENCV", "OPENCV_FISHEYE", &["OPENCV_FISHEYE", "Undistort"]),
        ("\"fl_x\": 500", "\"focal\": 500", &["frame 0", "neither fl_x"]),
        ("[0,0,-1,1]", "[0,0,-2,1]", &["frame 0", "not a rotation"]),
        ("[0,0,-1,1]", "[0,0,1,1]", &["not a rotation"]),
        ("[0,0,0,1]]},", "[0,0,0,2]]},", &["transform_matrix has 4 rows"]),
        (",[0,1,0,3],[0,0,0,1]]", "]", &["transform_matrix has 2 rows"]),
        ("\"w\": 640", "\"w\": 640.5", &["w is 640.5"]),
        ("\"time\": 0.25", "\"time\": 25", &["time is 25"]),
        ("\"frames\"", "\"shots\"", &["no “frames”"]),
        ("[0,0,-1,1]", "[0,0,NaN,1]", &["line 3", "column"]),
    ] {
        let error = with(from, to);
        for part in parts {
            assert!(error.contains(part), "{from} → {to}: {error}");
        }
    }
    let empty = error_of(&[("t.json", br#"{"frames": []}"#)], "t.json");
    assert!(empty.contains("lists no camera"), "{empty}");
}

#[test]
fn lists_are_refused_with_the_entry_and_the_property() {
    let good = r#"{"img_name": "a", "width": 4, "height": 3, "fx": 5, "fy": 5, "position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]]}"#;
    let with = |second: String| error_of(&[("c", format!("[{good}, {second}]").as_bytes())], "c");
    for (from, to, parts) in [
        ("\"fx\"", "\"f\"", &["camera 1 of the list", "“fx” is missing"][..]),
        ("\"position\"", "\"p\"", &["“position” is missing"]),
        ("\"rotation\"", "\"r\"", &["“rotation” is missing"]),
        ("\"rotation\"", "\"R_w2c\"", &["“t_w2c” is missing"]),
        ("\"width\": 4", "\"width\": 0", &["width is 0 pixels"]),
        ("\"width\": 4", "\"width\": -4", &["line 1"]),
        ("\"fx\": 5", "\"fx\": -5", &["fx is -5"]),
        ("[1,0,0]", "[1e200,0,0]", &["not a rotation"]),
        ("\"img_name\"", "\"split\"", &["split “a” is none of"]),
    ] {
        let error = with(good.replacen(from, to, 1));
        for part in parts {
            assert!(error.contains(part), "{from} → {to}: {error}");
        }
    }
    assert!(error_of(&[("c", b"[]")], "c").contains("lists no camera"));
    assert!(error_of(&[("c", b"[{}")], "c").contains("“width” is missing"));
    assert!(error_of(&[("c", b"ply\nformat")], "c").contains("neither JSON nor"));
    assert!(error_of(&[("c", b"")], "c").contains("neither JSON nor"));
    assert!(error_of(&[("x", b"")], "").contains("holds none of cameras.json"));
    assert!(error_of(&[], "nothing.json").contains("nothing.json"));

    let mut list = format!("\u{feff}[{good}]");
    let folder = folder_with(&[("c", list.as_bytes())]);
    let cameras = load(&folder.path().join("c")).unwrap();
    assert_eq!((cameras[0].cx, cameras[0].cy), (2.0, 1.5));
    // Cut anywhere, it is an error and nothing else.
    while list.pop().is_some() {
        let folder = folder_with(&[("c", list.as_bytes())]);
        assert!(load(&folder.path().join("c")).is_err(), "{list}");
    }
}
