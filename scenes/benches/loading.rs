//! How fast scenes load from the page cache, and how much memory that takes at most.
//!
//! `cargo bench -p motes-scenes` writes files of a million splats to a temporary folder, loads each once to warm up
//! and nine times for the figures, and prints median, fastest and slowest run. `-- NAME` runs the cases whose names
//! contain NAME.

#[path = "../tests/common/allocation.rs"]
mod allocation;
#[allow(dead_code, reason = "the tests use all of it")]
#[path = "../tests/common/encode.rs"]
mod encode;

use std::path::Path;
use std::time::{Duration, Instant};

use allocation::{Counting, peak};
use encode::Encoding;
use motes_scenes::synthetic::{Animation, Recipe};
use motes_scenes::{LoadOptions, Splats, load, save};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const SPLATS: usize = 1_000_000;
const RUNS: usize = 9;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Cargo passes --bench.
    let wanted = std::env::args().skip(1).find(|a| !a.starts_with('-')).unwrap_or_default();
    let folder = tempfile::tempdir()?;
    let still = |sh_degree, count| Recipe { count, sh_degree, ..Recipe::default() }.still();
    let moving = |count| Recipe { count, ..Recipe::default() }.moving(&Animation::default());
    let bytes = |make: &dyn Fn() -> Vec<u8>, path: &Path| std::fs::write(path, make());
    let saved = |splats: &Splats, path: &Path| save(path, splats);

    type Make<'a> = Box<dyn Fn(&Path) -> Result<(), Box<dyn std::error::Error>> + 'a>;
    let cases: [(&str, Make<'_>); 14] = [
        ("sh3.ply", Box::new(|p| Ok(saved(&still(3, SPLATS), p)?))),
        ("sh0.ply", Box::new(|p| Ok(saved(&still(0, SPLATS), p)?))),
        (
            "sh3 big-endian.ply",
            Box::new(|p| {
                let columns = || encode::columns(&still(3, SPLATS / 4));
                Ok(bytes(&|| encode::ply(&columns(), Encoding::Big, false), p)?)
            }),
        ),
        (
            "sh3 with a list.ply",
            Box::new(|p| {
                let mut columns = encode::columns(&still(3, SPLATS / 4));
                encode::disorder(&mut columns, 1);
                Ok(bytes(&|| encode::ply(&columns, Encoding::Little, false), p)?)
            }),
        ),
        (
            "sh3 ascii.ply",
            Box::new(|p| {
                let columns = || encode::columns(&still(3, SPLATS / 4));
                Ok(bytes(&|| encode::ply(&columns(), Encoding::Ascii, false), p)?)
            }),
        ),
        ("moving.ply", Box::new(|p| Ok(saved(&moving(SPLATS), p)?))),
        ("sh0.compressed.ply", Box::new(|p| Ok(bytes(&|| encode::compressed_ply(&still(0, SPLATS)), p)?))),
        ("sh3.compressed.ply", Box::new(|p| Ok(bytes(&|| encode::compressed_ply(&still(3, SPLATS)), p)?))),
        ("a.splat", Box::new(|p| Ok(saved(&still(0, SPLATS), p)?))),
        ("a.splatv", Box::new(|p| Ok(bytes(&|| encode::splatv(&moving(SPLATS)), p)?))),
        ("sh2 level 0.ksplat", Box::new(|p| Ok(bytes(&|| encode::ksplat(&still(2, SPLATS), 0), p)?))),
        ("sh0 level 1.ksplat", Box::new(|p| Ok(bytes(&|| encode::ksplat(&still(0, SPLATS), 1), p)?))),
        ("sh2 level 1.ksplat", Box::new(|p| Ok(bytes(&|| encode::ksplat(&still(2, SPLATS), 1), p)?))),
        ("sh2 level 2.ksplat", Box::new(|p| Ok(bytes(&|| encode::ksplat(&still(2, SPLATS), 2), p)?))),
    ];
    println!(
        "{:<22} {:>9} {:>8} {:>17} {:>8} {:>9} {:>11}",
        "file", "splats", "MB", "median (range) ms", "MB/s", "M splat/s", "memory/file"
    );
    for (name, make) in cases.iter().filter(|(name, _)| name.contains(&wanted)) {
        let path = folder.path().join(name);
        make(&path)?;
        measure(name, &path)?;
        std::fs::remove_file(&path)?;
    }
    Ok(())
}

fn measure(name: &str, path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let len = std::fs::metadata(path)?.len();
    let mut times = Vec::with_capacity(RUNS);
    let (mut memory, mut splats) = (0, 0);
    for run in 0..=RUNS {
        let start = Instant::now();
        let (scene, most) = peak(|| load(path, &LoadOptions::default()));
        let scene = scene?;
        // The first run warms up.
        if run > 0 {
            times.push(start.elapsed());
        }
        memory = memory.max(most);
        splats = scene.splats.len();
    }
    times.sort();
    let median = times[RUNS / 2].as_secs_f64();
    let ms = |t: Duration| t.as_secs_f64() * 1e3;
    println!(
        "{name:<22} {splats:>9} {:>8.1} {:>5.0} ({:>4.0}-{:>4.0}) {:>8.0} {:>9.2} {:>11.2}",
        len as f64 / 1e6,
        median * 1e3,
        ms(times[0]),
        ms(times[RUNS - 1]),
        len as f64 / 1e6 / median,
        splats as f64 / 1e6 / median,
        memory as f64 / len as f64,
    );
    Ok(())
}
