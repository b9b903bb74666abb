//! SOG and SPZ beyond the ordinary: what is refused and with which words, extensions, levels, early exporters.

#![allow(clippy::panic, clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::path::Path;
use std::sync::{Arc, Mutex};

use common::{difference, pack, read};
use motes_scenes::levels::LevelFile;
use motes_scenes::synthetic::Recipe;
use motes_scenes::{
    CancelToken, DropReason, Limits, LoadOptions, Scene, Splats, load, load_bytes, sh_coefficients,
    streamed_levels,
};
use serde_json::{Value, json};

fn splats(count: usize, sh_degree: u8) -> Splats {
    let mut splats = Recipe { count, sh_degree, ..Default::default() }.still();
    let coarse = |v: &mut f32| *v = (*v * 8.0).round() / 8.0;
    splats.log_scales.as_flattened_mut().iter_mut().for_each(coarse);
    splats.sh.as_flattened_mut().iter_mut().for_each(coarse);
    splats
}

/// A zipped SOG scene with its description changed.
fn sog_with(splats: &Splats, change: impl FnOnce(&mut Value, &mut pack::Files)) -> Vec<u8> {
    let mut files = pack::sog(splats, 2);
    let mut meta: Value = serde_json::from_slice(&files.pop().unwrap().1).unwrap();
    change(&mut meta, &mut files);
    files.push(("meta.json".to_owned(), serde_json::to_vec(&meta).unwrap()));
    pack::zip(&files, "", false)
}

fn error_of(name: &str, bytes: &[u8]) -> String {
    match read(name, bytes) {
        Err(error) => error.to_string(),
        Ok(scene) => panic!("{name}: {} splats where an error is expected", scene.splats.len()),
    }
}

fn assert_says(error: &str, words: &[&str]) {
    for word in words {
        assert!(error.contains(word), "“{word}” is not in: {error}");
    }
}

#[test]
fn wrong_descriptions_are_refused_with_file_property_and_remedy() {
    let scene = splats(100, 1);
    type Change = Box<dyn FnOnce(&mut Value, &mut pack::Files)>;
    let set = |pointer: &'static str, value: Value| -> Change {
        Box::new(move |meta, _| *meta.pointer_mut(pointer).unwrap() = value)
    };
    let remove = |object: &'static str, key: &'static str| -> Change {
        Box::new(move |meta, _| {
            meta.pointer_mut(object).unwrap().as_object_mut().unwrap().remove(key);
        })
    };
    let cases: Vec<(Change, &[&str])> = vec![
        (set("/version", json!(3)), &["SOG version 3", "look for a newer Motes"]),
        (set("/version", json!("2")), &["meta.json, line 1, column", "invalid type"]),
        (remove("", "version"), &["meta.json, means: has no shape"]),
        (remove("", "count"), &["meta.json, count: is missing"]),
        (set("/count", json!(-1)), &["meta.json, line 1"]),
        (set("/count", json!(101)), &["means_l.webp, the image's size", "10 × 10 pixels for 101 splats"]),
        (set("/means/mins", json!([0, 1])), &["meta.json, line 1", "invalid length 2"]),
        (remove("/means", "maxs"), &["means: has no maxs"]),
        (set("/means/files", json!(["means_l.webp"])), &["means: names 1 files, expected 2"]),
        (set("/means/files", json!(["a", "b", "c"])), &["one or two file names"]),
        (set("/quats/files", json!(["other.webp"])), &["other.webp, in the zip: is missing"]),
        (remove("/scales", "codebook"), &["scales: has no codebook"]),
        (set("/scales/codebook", json!([0.0])), &["invalid length 1, expected a codebook of 256 numbers"]),
        (set("/sh0/codebook", json!(vec![0.0; 257])), &["invalid length 257"]),
        (set("/sh0/codebook/5", json!(null)), &["value 5 of a codebook is null"]),
        (set("/shN/bands", json!(4)), &["shN: has 4 bands"]),
        (set("/shN/bands", json!(2)), &["shN_centroids.webp", "192 × 2 pixels, expected a width of 512"]),
        (set("/shN/count", json!(0)), &["shN: has a count outside of 1 to 65536"]),
        (set("/shN/count", json!(65_537)), &["shN: has a count outside"]),
        (set("/shN/count", json!(50)), &["shN_labels.webp", "of a palette of 50"]),
        (
            Box::new(|_, files| files[2].1 = b"RIFF\x04\0\0\0WEBP".to_vec()),
            &["quats.webp, the image: cannot be decoded"],
        ),
        (
            Box::new(|_, files| files[2].1 = pack::webp(9, 11, &[1; 396])),
            &["quats.webp", "9 × 11 pixels for 100"],
        ),
    ];
    for (change, words) in cases {
        let error = error_of("a.sog", &sog_with(&scene, change));
        assert_says(&error, words);
        assert_says(&error, &["a.sog"]);
    }
    assert_says(&error_of("a.sog", &pack::zip(&Vec::new(), "", false)), &["a.sog"]);
    let none = pack::zip(&vec![("x".to_owned(), vec![1])], "", false);
    assert_says(&error_of("a.sog", &none), &["no meta.json"]);
    let streamed = pack::zip(&vec![("lod-meta.json".to_owned(), vec![1])], "", false);
    assert_says(&error_of("a.sog", &streamed), &["streamed scene in a zip", "Unpack it"]);
}

/// A 1 × 1 lossy WebP, as libwebp writes it (VP8 key frame).
const LOSSY: &[u8] = b"RIFF\x22\0\0\0WEBPVP8 \x16\0\0\0\x30\x01\0\x9d\x01\x2a\x01\0\x01\0\x0e\xc0\xfe\x25\xa4\0\x03\x70\0\0\0\0";

#[test]
fn lossy_images_are_refused() {
    let bytes = sog_with(&splats(1, 0), |_, files| files[4].1 = LOSSY.to_vec());
    assert_says(&error_of("a.sog", &bytes), &["sh0.webp", "compressed with loss", "lossless"]);
}

#[test]
fn a_scene_reads_no_file_outside_of_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let files = pack::sog(&splats(10, 0), 2);
    pack::unzip(&files, &folder.path().join("scene"));
    pack::unzip(&files, folder.path());
    let meta = folder.path().join("scene/meta.json");
    let text = std::fs::read_to_string(&meta).unwrap();
    let absolute = folder.path().join("quats.webp").to_string_lossy().replace('\\', "/");
    for name in ["../quats.webp", "x/../../quats.webp", absolute.as_str()] {
        std::fs::write(&meta, text.replace("quats.webp", name)).unwrap();
        let error = load(&folder.path().join("scene"), &LoadOptions::default()).unwrap_err().to_string();
        assert_says(&error, &["leads out of the scene's folder", "meta.json"]);
    }
    std::fs::remove_file(folder.path().join("scales.webp")).unwrap();
    let error = load(folder.path(), &LoadOptions::default()).unwrap_err().to_string();
    assert_says(&error, &["scales.webp"]);
}

#[test]
fn a_codebook_that_begins_with_null_is_extrapolated_and_told() {
    let scene = splats(50, 0);
    let values: Vec<f64> = (0..256).map(|i| -5.0 + f64::from(i) * 0.02).collect();
    let mut with_null: Vec<Value> = values.iter().map(|v| json!(v)).collect();
    with_null[0] = Value::Null;
    let bytes = sog_with(&scene, |meta, files| {
        meta["scales"]["codebook"] = json!(with_null);
        files[3].1 = pack::webp(8, 7, &[0; 224]);
    });
    let found = read("a.sog", &bytes).unwrap();
    let first = values[1] + (values[1] - values[255]) / 255.0;
    assert!((f64::from(found.splats.log_scales[0][0]) - first).abs() < 1e-6);
    assert_says(&found.report.warnings.join(" "), &["codebook of scales", "a.sog"]);
}

#[test]
fn splats_without_a_rotation_are_dropped_and_counted() {
    let bytes = sog_with(&splats(100, 0), |_, files| {
        let mut rgba = [128, 128, 128, 252].repeat(100);
        rgba[4 * 7 + 3] = 251;
        rgba[4 * 9 + 3] = 0;
        files[2].1 = pack::webp(10, 10, &rgba);
    });
    let found = read("a.sog", &bytes).unwrap();
    assert_eq!((found.report.read, found.report.kept), (100, 98));
    assert_eq!(found.report.dropped.get(&DropReason::ZeroRotation), Some(&2));
}

#[test]
fn antialiased_scenes_say_so() {
    let scene = splats(10, 0);
    let of = |bytes: &[u8]| read("a", bytes).unwrap().sources[0].antialiased;
    assert!(of(&sog_with(&scene, |meta, _| meta["antialias"] = json!(true))));
    assert!(!of(&sog_with(&scene, |meta, _| meta["antialias"] = json!(false))));
    let attributes = pack::spz_attributes(&scene, 3, 0, 12).concat();
    for flag in [0, 1] {
        let header = pack::spz_header(3, 10, 0, 12, flag, 0);
        assert_eq!(of(&pack::gzip(&[header, attributes.clone()].concat())), flag == 1);
    }
}

/// An SPZ of version 3 (gzip) with flags and what follows the splats.
fn spz_3(splats: &Splats, degree: u8, flags: u8, trailer: &[u8]) -> Vec<u8> {
    let header = pack::spz_header(3, splats.len() as u32, degree, 12, flags, 0);
    let attributes = pack::spz_attributes(splats, 3, degree, 12).concat();
    pack::gzip(&[header, attributes, trailer.to_vec()].concat())
}

#[test]
fn spz_refusals_say_what_and_where() {
    let scene = splats(20, 1);
    let with = |version, degree, bits, flags| {
        let attributes = pack::spz_attributes(&scene, 3, 1, 12).concat();
        pack::gzip(&[pack::spz_header(version, 20, degree, bits, flags, 0), attributes].concat())
    };
    for (bytes, words) in [
        (with(0, 1, 12, 0), &["SPZ version 0 in a gzip stream"][..]),
        (with(4, 1, 12, 0), &["SPZ version 4 in a gzip stream"]),
        (with(3, 5, 12, 0), &["the header", "degree 5"]),
        (with(3, 1, 25, 0), &["25 fractional bits"]),
        (with(3, 1, 12, 0x80), &["tree of levels of detail"]),
        (
            with(3, 2, 12, 0),
            &["the gzip stream: ends after 580 of the 880 bytes that 20 splats of degree 2 take"],
        ),
        (pack::gzip(b"NGSP"), &["ends after 4 of 16 bytes"]),
        (pack::gzip(b"something else altogether"), &["begins with “some”"]),
        (spz_3(&scene, 1, 2, &[1, 0, 0, 0, 200, 0, 0, 0, 5]), &["the extension records", "200 bytes"]),
        (pack::spz_header(5, 20, 1, 12, 0, 6), &["SPZ version 5"]),
        (pack::spz_header(4, 20, 1, 12, 0, 6), &["ends after 16 of 32 bytes"]),
    ] {
        let error = error_of("a.spz", &bytes);
        assert_says(&error, words);
        assert_says(&error, &["a.spz"]);
    }
    let streams: Vec<Vec<u8>> = pack::spz_attributes(&scene, 4, 1, 12).into();
    let header = pack::spz_header(4, 20, 1, 12, 0, 6);
    let good = pack::spz_4(&header, &[], &streams);
    assert_eq!(read("a.spz", &good).unwrap().splats.len(), 20);
    let mut fewer = streams.clone();
    fewer.pop();
    let fewer = pack::spz_4(&pack::spz_header(4, 20, 1, 12, 0, 5), &[], &fewer);
    assert_says(&error_of("a.spz", &fewer), &["lists 5 streams of splats, expected 6"]);
    let mut shorter = streams;
    shorter[4].truncate(79);
    let shorter = pack::spz_4(&header, &[], &shorter);
    assert_says(&error_of("a.spz", &shorter), &["stream 4 of 6", "unpacks to 79 bytes, expected 80"]);
    let mut beyond = good.clone();
    beyond[32 + 5] = 1;
    assert_says(&error_of("a.spz", &beyond), &["stream 0 of 6", "reach beyond the file's"]);
}

/// Places whose bytes are those of an extension record are places, unless the header speaks of such records.
#[test]
fn places_that_look_like_an_extension_are_places() {
    let mut scene = splats(20, 1);
    // 01 00 be ad: the whole of x, and the lowest byte of y.
    scene.means[0] = [(0x00be_0001 - 0x0100_0000) as f32 / 4096.0, f32::from(0xad_u8) / 4096.0, 0.5];
    let loaded = common::read("a.spz", &spz_3(&scene, 1, 0, &[])).unwrap();
    assert_eq!(loaded.splats.mean_of(0), scene.mean_of(0));
    assert_says(&error_of("a.spz", &spz_3(&scene, 1, 2, &[])), &["extension records before its splats"]);
}

#[test]
fn degree_4_is_cut_to_3_and_told() {
    let scene = splats(30, 3);
    let cut = read("a.spz", &spz_3(&scene, 4, 0, &[])).unwrap();
    let plain = read("a.spz", &spz_3(&scene, 3, 0, &[])).unwrap();
    assert_eq!(cut.splats, plain.splats);
    assert_says(&cut.report.warnings.join(" "), &["degree 4", "a.spz"]);
    assert!(plain.report.warnings.is_empty());
}

#[test]
fn extension_records_give_the_range_of_harmonics_and_unknown_ones_are_skipped() {
    let scene = splats(30, 1);
    let record = |kind: u32, payload: &[u8]| {
        [&kind.to_le_bytes()[..], &(payload.len() as u32).to_le_bytes()[..], payload].concat()
    };
    let range = [&[5, 4][..], &(-3.0_f32).to_le_bytes(), &2.0_f32.to_le_bytes()].concat();
    let records = [record(0x1234_0001, &[9; 24]), record(0xadbe_0001, &range)].concat();
    let streams: Vec<Vec<u8>> = pack::spz_attributes(&scene, 4, 1, 12).into();
    let plain = read("a.spz", &pack::spz_4(&pack::spz_header(4, 30, 1, 12, 0, 6), &[], &streams)).unwrap();
    let header = pack::spz_header(4, 30, 1, 12, 2, 6);
    for bytes in [pack::spz_4(&header, &records, &streams), spz_3(&scene, 1, 2, &records)] {
        let found = read("a.spz", &bytes).unwrap().splats;
        for (k, (a, b)) in found.sh.iter().zip(&plain.splats.sh).enumerate() {
            for c in 0..3 {
                let byte = b[c] * 128.0 + 128.0;
                let expected = if k % 4 == 0 { b[c] } else { -3.0 + 5.0 * byte / 255.0 };
                assert!((a[c] - expected).abs() < 1e-5, "{} where {expected} is meant", a[c]);
            }
        }
    }
}

/// Writes a streamed scene of two levels and an environment: level 0 in two files, of which the second is shared with
/// level 1.
fn streamed(folder: &Path) -> [Splats; 3] {
    let parts = [splats(60, 1), splats(80, 0), splats(40, 2)];
    for (name, part) in ["0_0", "shared", "sky"].iter().zip(&parts) {
        pack::unzip(&pack::sog(part, 2), &folder.join(name));
    }
    let lod = |file: u32, offset: u32, count: u32| json!({"file": file, "offset": offset, "count": count});
    let index = json!({"version": 1, "lodLevels": 2, "environment": "sky/meta.json",
        "filenames": ["0_0/meta.json", "shared/meta.json"],
        "tree": {"bound": {"min": [-1, -1, -1], "max": [1, 1, 1]}, "children": [
            {"lods": {"0": lod(0, 0, 25), "1": lod(1, 70, 10)}},
            {"children": [{"lods": {"0": lod(0, 25, 35)}}, {"lods": {"0": lod(1, 5, 15), "1": lod(1, 30, 20)}}]}]}});
    std::fs::write(folder.join("lod-meta.json"), serde_json::to_vec(&index).unwrap()).unwrap();
    parts
}

#[test]
fn ranges_of_shared_files_and_the_environment_make_a_level() {
    let folder = tempfile::tempdir().unwrap();
    streamed(folder.path());
    let levels = streamed_levels(folder.path()).unwrap();
    let listed: Vec<_> = levels.iter().map(|l| (l.level, l.splats, l.files)).collect();
    assert_eq!(listed, [(0, 75, 2), (1, 30, 1)]);
    let [first, shared, sky] = ["0_0", "shared", "sky"]
        .map(|name| load(&folder.path().join(name), &LoadOptions::default()).unwrap().splats);
    for (level, pieces) in [
        (0, vec![(&first, 0..60), (&shared, 5..20), (&sky, 0..40)]),
        (1, vec![(&shared, 30..50), (&shared, 70..80), (&sky, 0..40)]),
    ] {
        let options = LoadOptions { level, ..Default::default() };
        let scene = load(folder.path(), &options).unwrap();
        // The environment's degree is the highest.
        assert_eq!(scene.splats.sh_degree, 2);
        let mut at = 0;
        for (from, range) in pieces {
            let n = sh_coefficients(from.sh_degree);
            for i in range {
                assert_eq!(scene.splats.means[at], from.means[i], "level {level}, splat {at}");
                assert_eq!(scene.splats.rotations[at], from.rotations[i]);
                assert_eq!(scene.splats.log_scales[at], from.log_scales[i]);
                assert_eq!(scene.splats.opacities[at], from.opacities[i]);
                assert_eq!(scene.splats.sh_of(at)[..n], *from.sh_of(i));
                assert!(scene.splats.sh_of(at)[n..].iter().all(|v| *v == [0.0; 3]));
                at += 1;
            }
        }
        assert_eq!(scene.splats.len(), at);
    }
}

/// The same scene region by region, as a file of levels is read.
#[test]
fn leaves_of_streamed_scenes_are_groups_of_levels() {
    let folder = tempfile::tempdir().unwrap();
    streamed(folder.path());
    let file = LevelFile::open(folder.path()).unwrap();
    let listed: Vec<Vec<u64>> =
        file.groups().iter().map(|g| g.ranges.iter().map(|r| r.splats).collect()).collect();
    // Three leaves, and the environment, which belongs to every level.
    assert_eq!(listed, [[25, 10], [35, 0], [15, 20], [40, 40]]);
    assert_eq!(file.levels().iter().map(|l| l.splats).collect::<Vec<_>>(), [115, 70]);
    assert_eq!(file.sh_degree(), Some(2));
    for level in 0..2 {
        let whole = load(folder.path(), &LoadOptions { level: level as u32, ..Default::default() }).unwrap();
        let mut means = whole.splats.means;
        let mut found = Vec::new();
        for (group, about) in file.groups().iter().enumerate() {
            let splats = file.read(group, level).unwrap();
            assert_eq!(splats.len() as u64, about.ranges[level].splats);
            // What a group may cover lies within its reach.
            let [low, high] = about.reach.unwrap();
            for i in 0..splats.len() {
                let radius = 3.3 * splats.log_scales[i].iter().fold(f32::MIN, |a, b| a.max(*b)).exp();
                for k in 0..3 {
                    let at = splats.mean_of(i)[k];
                    assert!(
                        at - f64::from(radius) >= low[k] - 1e-3 && at + f64::from(radius) <= high[k] + 1e-3
                    );
                }
            }
            found.extend(splats.means);
        }
        let order = |a: &[f32; 3], b: &[f32; 3]| a.partial_cmp(b).unwrap();
        means.sort_by(order);
        found.sort_by(order);
        assert_eq!(found, means);
    }
    assert!(file.read(4, 0).is_err() && file.read(0, 2).is_err());
    assert!(file.save_with(&folder.path().join("x.mlod"), json!({})).is_err());
    // A leaf that reaches beyond its file is refused by name.
    let path = folder.path().join("lod-meta.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"count\":35", "\"count\":36")).unwrap();
    let error = LevelFile::open(&path).unwrap_err().to_string();
    assert!(error.contains("level 0 of file 0 (0_0/meta.json)") && error.contains("splat 61"), "{error}");
}

#[test]
fn wrong_indices_of_streamed_scenes_are_refused_with_the_place() {
    let folder = tempfile::tempdir().unwrap();
    streamed(folder.path());
    let path = folder.path().join("lod-meta.json");
    let text = std::fs::read_to_string(&path).unwrap();
    for (from, to, words) in [
        ("\"lodLevels\":2", "\"lodLevels\":0", &["lodLevels: is 0"][..]),
        ("\"lodLevels\":2", "\"lodLevels\":1", &["the tree", "level 1, and there are 1"]),
        ("\"version\":1", "\"version\":2", &["version 2 of streamed SOG"]),
        ("\"tree\"", "\"three\"", &["missing field `tree`", "line 1"]),
        ("\"file\":1", "\"file\":2", &["the tree", "names file 2, and 2 are listed"]),
        ("\"offset\":25", "\"offset\":24", &["file 0 (0_0/meta.json)", "two nodes claim splat 24"]),
        ("\"offset\":25", "\"offset\":26", &["a node reaches splat 61, and the file has 60"]),
        ("\"count\":35", "\"count\":18446744073709551615", &["a node reaches splat"]),
        ("\"count\":35", "\"count\":-1", &["line 1"]),
        ("\"0\":", "\"zero\":", &["“zero” is no level"]),
        ("0_0/meta.json", "../0_0/meta.json", &["filenames", "leads out of the scene's folder"]),
        ("sky/meta.json", "/etc/meta.json", &["leads out of the scene's folder"]),
        ("sky/meta.json", "heaven/meta.json", &["heaven"]),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let error = load(folder.path(), &LoadOptions::default()).unwrap_err().to_string();
        assert_says(&error, words);
    }
    // Depth is bounded, not the program's stack.
    std::fs::write(
        &path,
        text.replace(
            "\"bound\"",
            &format!("\"children\":{}{},\"bound\"", "[".repeat(100_000), "]".repeat(100_000)),
        ),
    )
    .unwrap();
    assert_says(&load(folder.path(), &LoadOptions::default()).unwrap_err().to_string(), &["recursion limit"]);
}

#[test]
fn loading_reports_progress_can_be_stopped_and_keeps_limits() {
    let scene = splats(5000, 0);
    for (name, bytes) in [
        ("a.sog", pack::zip(&pack::sog(&scene, 2), "", false)),
        ("a.spz", pack::spz(&scene, 3)),
        ("b.spz", pack::spz(&scene, 4)),
    ] {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let cancel = CancelToken::default();
        let options = LoadOptions {
            progress: Some({
                let seen = seen.clone();
                Arc::new(move |progress| seen.lock().unwrap().push(progress.fraction))
            }),
            ..Default::default()
        };
        let bytes: Arc<[u8]> = Arc::from(bytes);
        let load = |options: &LoadOptions| -> Result<Scene, String> {
            load_bytes(Path::new(name), bytes.clone(), options).map_err(|error| error.to_string())
        };
        load(&options).unwrap();
        let last = seen.lock().unwrap().iter().copied().fold(0.0, f32::max);
        assert!(last > 0.99, "{name}: progress ends at {last}");

        let stop = cancel.clone();
        let stopped =
            LoadOptions { progress: Some(Arc::new(move |_| stop.cancel())), cancel, ..Default::default() };
        let error = load(&stopped).unwrap_err();
        assert_says(&error, &[name, "cancelled"]);

        let few = LoadOptions { limits: Limits { splats: 4999, ..Default::default() }, ..Default::default() };
        assert_says(&load(&few).unwrap_err(), &[name, "5000 splats", "4999"]);
        let little =
            LoadOptions { limits: Limits { memory: 1000, ..Default::default() }, ..Default::default() };
        assert_says(&load(&little).unwrap_err(), &[name, "5000 splats need"]);
    }
}

/// Means of SOG are stored as logarithms: near zero and far out, on both sides.
#[test]
fn sog_means_keep_their_sign_and_magnitude() {
    let mut scene = splats(9, 0);
    for (i, v) in [-1000.0_f32, -1.0, -1e-3, 0.0, 1e-3, 0.5, 1.0, 30.0, 1000.0].into_iter().enumerate() {
        scene.means[i] = [v, -v, 2.0 * v];
    }
    let found = read("a.sog", &pack::zip(&pack::sog(&scene, 2), "", false)).unwrap().splats;
    // A step of the logarithm is 2 ln(2001) / 65535 at most.
    for (a, b) in found.means.iter().zip(&scene.means) {
        let allowed: Vec<f32> = b.iter().map(|v| 1.2e-4 * (1.0 + v.abs())).collect();
        assert!(a.iter().zip(b).zip(&allowed).all(|((a, b), d)| (a - b).abs() <= *d), "{a:?}, not {b:?}");
    }
    assert!(difference(found.means[3].iter(), &[0.0; 3]) <= 1.2e-4);
}
