//! Some of the golden views and one photograph: the rest, at the same bounds, by `motes golden`.
#![allow(clippy::unwrap_used, reason = "a test may")]

use motes_desktop::commands::golden::{
    DEVICE_BOUND, PHOTOGRAPH_BOUND, REFERENCE_BOUND, figures, inputs, photograph_figures, photographs,
};
use motes_desktop::measure::Picture;
use motes_scenes::cameras;
use motes_scenes::{LoadOptions, load, load_many};
use motes_tests::{TestGpu, sample};

#[test]
fn golden_views_are_matched() {
    let gpu = TestGpu::new();
    let list = cameras::load(&sample("golden/golden.json")).unwrap();
    // Spherical harmonics of degree 3; an eye in the midst of a scene; motion.
    for (name, file) in [
        ("fruit_drops_sh3", None),
        ("parking_lot", None),
        ("spinach_t050", Some(sample("4d/spinach_stg_lite.ply"))),
    ] {
        let camera = cameras::find(&list, name).unwrap();
        let files = file.map_or_else(|| inputs(&sample(""), camera), |f| vec![f]);
        let scene = load_many(&files, &LoadOptions::default()).unwrap();
        let golden = Picture::load(&sample(format!("golden/{name}.png"))).unwrap();
        let f = figures(&gpu, &scene, camera, &golden).unwrap();
        println!("{f:?}");
        assert!(f.reference >= REFERENCE_BOUND, "{f:?}");
        assert!(f.device >= DEVICE_BOUND, "{f:?}");
        assert!(f.control < 25.0, "the y axis of the camera flipped must not pass: {f:?}");
        assert!(f.default < f.device, "other semantics must be told apart: {f:?}");
    }
}

#[test]
fn a_photograph_is_matched_as_the_data_set_says() {
    let gpu = TestGpu::new();
    let folder = sample("photos_snowmiku");
    let scene = load(&folder.join("snowmiku_sh3.ply"), &LoadOptions::default()).unwrap();
    let list = photographs(&folder).unwrap();
    assert_eq!(list.len(), 13, "held-out photographs");
    let photograph = &list[5];
    let [reference, wide, half] = photograph_figures(&gpu, &scene, photograph).unwrap();
    println!(
        "{}: {} stated, {reference:.2} {wide:.2} {half:.2} dB",
        photograph.camera.name, photograph.stated
    );
    assert!((reference - photograph.stated).abs() <= PHOTOGRAPH_BOUND);
    assert!((wide - photograph.stated).abs() <= PHOTOGRAPH_BOUND);
    // Another photograph's figure must not pass.
    assert!((reference - list[6].stated).abs() > PHOTOGRAPH_BOUND);
}
