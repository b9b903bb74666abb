//! How fast compressed scenes load: `cargo bench -p motes-scenes --bench compressed`.
//!
//! Every file is read from the page cache, once to warm up and seven times to measure.

use std::path::{Path, PathBuf};
use std::time::Instant;

use motes_scenes::{LoadOptions, load};

fn main() {
    let folder = std::env::var_os("MOTES_SCENES")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes"), PathBuf::from);
    println!(
        "{:28} {:>10} {:>3} {:>10} {:>8} {:>14}",
        "scene", "splats", "SH", "median ms", "spread", "M splats/s"
    );
    for name in [
        "static/skull.sog",
        "static/statues/st-peter.sog",
        "static/playcanvas-logo",
        "static/playbot",
        "static/flowers_lod0",
        "static/hq_garden_lod2",
        "static/hq_garden_lod1",
        "static/skull_sh3_v3.spz",
        "static/biker.spz",
        "photos_snowmiku/snapshots/iteration_03500.spz",
    ] {
        let path = folder.join(name);
        let mut times = Vec::new();
        let mut splats = 0;
        let mut degree = 0;
        for run in 0..8 {
            let start = Instant::now();
            match load(&path, &LoadOptions::default()) {
                Ok(scene) => (splats, degree) = (scene.splats.len(), scene.splats.sh_degree),
                Err(error) => {
                    eprintln!("{error}");
                    std::process::exit(1);
                }
            }
            if run > 0 {
                times.push(start.elapsed().as_secs_f64());
            }
        }
        times.sort_by(f64::total_cmp);
        let median = times[times.len() / 2];
        let spread = (times[times.len() - 1] - times[0]) / median;
        println!(
            "{:28} {splats:>10} {degree:>3} {:>10.1} {:>7.0}% {:>14.2}",
            path.file_name().unwrap_or_default().to_string_lossy(),
            median * 1e3,
            spread * 100.0,
            splats as f64 / median / 1e6
        );
    }
}
