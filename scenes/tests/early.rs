//! Parts of a large scene, handed over before the whole is read.
#![allow(clippy::unwrap_used, reason = "a test may")]

use std::path::Path;
use std::sync::{Arc, Mutex};

use motes_scenes::early::{FIRST, RUN};
use motes_scenes::synthetic::Recipe;
use motes_scenes::{CancelToken, Format, LoadOptions, Scene, SceneError, load, load_many, save};

/// Loads, and keeps the parts that came on the way.
fn load_in_parts(paths: &[&Path]) -> (Scene, Vec<Scene>) {
    let parts = Arc::new(Mutex::new(Vec::new()));
    let kept = parts.clone();
    let early: motes_scenes::EarlyCallback = Arc::new(move |part| kept.lock().unwrap().push(part));
    let options = LoadOptions { early: Some(early), ..Default::default() };
    let scene = load_many(paths, &options).unwrap();
    drop(options);
    (scene, Arc::try_unwrap(parts).unwrap().into_inner().unwrap())
}

#[test]
fn a_part_is_spread_over_the_scene_and_the_whole_is_the_same_as_ever() {
    let folder = tempfile::tempdir().unwrap();
    let count = 4 * FIRST + 1000;
    let recipe = Recipe { count, ..Recipe::default() };
    let mut splats = recipe.still();
    // One that no picture can be made of, in the first run: it is in neither the part nor the whole.
    splats.means[3][0] = f32::NAN;
    for (name, format) in [("big.ply", Format::Ply), ("big.splat", Format::Splat)] {
        let path = folder.path().join(name);
        save(&path, &splats).unwrap();
        let (scene, parts) = load_in_parts(&[&path]);
        assert!(scene == load(&path, &LoadOptions::default()).unwrap(), "{name}: the whole differs");
        let [part] = &parts[..] else { panic!("{name}: {} parts", parts.len()) };
        assert_eq!((part.splats.len(), part.report.read), (FIRST - 1, FIRST), "{name}");
        assert_eq!((part.sources[0].format, scene.sources[0].format), (format, format));
        // Without the splat that was dropped: places in the file are one less in memory.
        let wider = ((count as f64 / FIRST as f64).sqrt()).ln() as f32;
        let runs = FIRST / RUN;
        let mut same = 0;
        for run in 1..runs {
            let first = run * count / runs;
            for i in 0..RUN {
                let (of_part, of_whole) = (run * RUN + i - 1, first + i - 1);
                let (a, b) = (&part.splats, &scene.splats);
                assert_eq!((a.means[of_part], a.sh[of_part]), (b.means[of_whole], b.sh[of_whole]), "{name}");
                for k in 0..3 {
                    let more = a.log_scales[of_part][k] - b.log_scales[of_whole][k];
                    assert!((more - wider).abs() < 1e-5, "{name}: {more} {wider}");
                }
                // Control: their neighbours in the file are others.
                same += usize::from(a.means[of_part] == b.means[of_whole + 1]);
            }
        }
        assert_eq!(same, 0);
    }
}

#[test]
fn small_and_merged_scenes_come_in_one_piece() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.splat");
    save(&path, &Recipe { count: 4 * FIRST - 1, ..Recipe::default() }.still()).unwrap();
    assert!(load_in_parts(&[&path]).1.is_empty());
    save(&path, &Recipe { count: 4 * FIRST, ..Recipe::default() }.still()).unwrap();
    assert_eq!(load_in_parts(&[&path]).1.len(), 1);
    assert!(load_in_parts(&[&path, &path]).1.is_empty());
}

#[test]
fn who_has_seen_enough_cancels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("big.splat");
    save(&path, &Recipe { count: 4 * FIRST, ..Recipe::default() }.still()).unwrap();
    let cancel = CancelToken::default();
    let stop = cancel.clone();
    let options = LoadOptions { early: Some(Arc::new(move |_| stop.cancel())), cancel, ..Default::default() };
    assert!(matches!(load(&path, &options), Err(SceneError::Cancelled { .. })));
}
