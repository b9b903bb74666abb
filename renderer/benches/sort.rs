//! How fast a million splats are ordered: `cargo xtask run-on-driver -- cargo bench -p motes-renderer --bench sort [-- COUNT]
//! [PART OF A VARIANT'S NAME…]`.
//!
//! Pairs of a 32-bit key and an index, random keys, one thread, beside the standard library and the fastest crates for
//! the task; then the device's sort in several shapes. All within one run, each variant in turn,
//! median of 41. Times are the clock's, and the processor's of all threads, among which nothing is that the machine does
//! besides; the device's are from submission to its end.

use std::hint::black_box;
use std::time::{Duration, Instant};

use cpu_time::ProcessTime;

use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_renderer::order::device::{KeySorter, SortShape};
use motes_renderer::order::{OrderRequest, Positions, SortBuffers, SplatOrder, radix_sort};
use motes_renderer::{Fov, RenderConfig, View};
use motes_scenes::synthetic::{Random, Recipe};

const ROUNDS: usize = 41;

/// The sort that everybody writes first: eight bits at a time, least significant first, one histogram a pass.
fn straightforward(pairs: &mut Vec<(u32, u32)>, scratch: &mut Vec<(u32, u32)>) {
    scratch.resize(pairs.len(), (0, 0));
    for shift in [0, 8, 16, 24] {
        let mut places = [0usize; 256];
        for p in pairs.iter() {
            places[(p.0 >> shift) as usize & 255] += 1;
        }
        let mut sum = 0;
        for place in &mut places {
            (*place, sum) = (sum, sum + *place);
        }
        for p in pairs.iter() {
            let place = &mut places[(p.0 >> shift) as usize & 255];
            scratch[*place] = *p;
            *place += 1;
        }
        std::mem::swap(pairs, scratch);
    }
}

/// By the clock, and of all threads.
type Taken = [Duration; 2];

struct Start(Instant, ProcessTime);

impl Start {
    fn now() -> Self {
        Self(Instant::now(), ProcessTime::now())
    }

    fn elapsed(&self) -> Taken {
        [self.0.elapsed(), self.1.elapsed()]
    }
}

struct Variant<'a> {
    name: String,
    run: Box<dyn FnMut() -> Taken + 'a>,
    times: Vec<Taken>,
}

fn add<'a>(variants: &mut Vec<Variant<'a>>, name: &str, run: impl FnMut() -> Taken + 'a) {
    variants.push(Variant { name: name.to_owned(), run: Box::new(run), times: Vec::new() });
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let n = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(1_000_000);
    let mut random = Random::new(1);
    let keys: Vec<u32> = (0..n).map(|_| random.bits() as u32).collect();
    let pairs: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
    let words: Vec<u64> = pairs.iter().map(|p| u64::from(p.0) << 32 | u64::from(p.1)).collect();

    let gpu = Gpu::offscreen(&GpuOptions { validation: false })?;
    let mut variants: Vec<Variant<'_>> = Vec::new();
    {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let pairs = &pairs;
        add(&mut variants, "straightforward, 8 bits", move || {
            a.clone_from(pairs);
            let start = Start::now();
            straightforward(&mut a, &mut b);
            black_box(&a);
            start.elapsed()
        });
        let mut buffers = SortBuffers::default();
        add(&mut variants, "Motes, processor", move || {
            buffers.set(pairs.iter().copied());
            let start = Start::now();
            radix_sort(&mut buffers, 32);
            black_box(&buffers);
            start.elapsed()
        });
        let mut a = Vec::new();
        add(&mut variants, "radsort", move || {
            a.clone_from(pairs);
            let start = Start::now();
            radsort::sort_by_key(&mut a, |p| p.0);
            black_box(&a);
            start.elapsed()
        });
        let words = &words;
        let mut a = Vec::new();
        add(&mut variants, "voracious_radix_sort", move || {
            use voracious_radix_sort::RadixSort;
            a.clone_from(words);
            let start = Start::now();
            a.voracious_sort();
            black_box(&a);
            start.elapsed()
        });
        let mut a = Vec::new();
        add(&mut variants, "std, stable", move || {
            a.clone_from(pairs);
            let start = Start::now();
            a.sort_by_key(|p| p.0);
            black_box(&a);
            start.elapsed()
        });
    }
    // Keys and sort of a scene, as a frame needs them.
    let positions = Positions::of(&Recipe { count: n, ..Default::default() }.still());
    let fov = Fov::vertical(1.0, [64, 64]);
    let view = View::look_at(glam::DVec3::NEG_Z, glam::DVec3::ZERO, glam::DVec3::NEG_Y, fov, [64, 64]);
    let request = OrderRequest::new(&[view], &RenderConfig::default());
    let (mut order, mut buffers) = (SplatOrder::default(), SortBuffers::default());
    add(&mut variants, "Motes, processor, keys too", move || {
        let start = Start::now();
        order.sort(&positions, &request, &mut buffers);
        start.elapsed()
    });
    let best = SortShape::of(&gpu.capabilities);
    let shape = |group, run, digit_bits, shuffled| SortShape { group, run, digit_bits, shuffled };
    for shape in [
        best,
        shape(8, 4096, 8, false),
        shape(8, 2048, 8, true),
        shape(8, 2048, 11, true),
        shape(8, 4096, 11, true),
        shape(8, 4096, 8, true),
        shape(32, 128, 8, false),
        shape(32, 1024, 8, false),
    ] {
        let mut sorter = KeySorter::new(&gpu, shape)?;
        let keys = &keys;
        add(
            &mut variants,
            &format!(
                "device, {} x {}, {} bits{}",
                shape.group,
                shape.run,
                shape.digit_bits,
                if shape.shuffled { ", shuffled" } else { "" }
            ),
            move || {
                let failed = |_| [Duration::MAX; 2];
                if let Err(e) = sorter.load(keys, 32) {
                    return failed(e);
                }
                let start = Start::now();
                sorter.run(keys.len(), 32).map_or_else(failed, |()| start.elapsed())
            },
        );
    }
    let wanted: Vec<String> =
        std::env::args().skip(1).filter(|a| !a.starts_with('-') && a.parse::<usize>().is_err()).collect();
    variants.retain(|v| wanted.is_empty() || wanted.iter().any(|w| v.name.contains(w.as_str())));
    for round in 0..=ROUNDS {
        for v in &mut variants {
            let took = (v.run)();
            if round > 0 {
                v.times.push(took);
            }
        }
    }
    println!(
        "{n} pairs on {}\n{:32} {:>9} {:>7} {:>7} {:>12} {:>7} {:>7}",
        gpu.capabilities.device, "", "median ms", "spread", "ratio", "of all cores", "spread", "ratio"
    );
    let mut first = [None; 2];
    for v in &variants {
        print!("{:32}", v.name);
        for (by, first) in first.iter_mut().enumerate() {
            let mut ms: Vec<f64> = v.times.iter().map(|t| t[by].as_secs_f64() * 1e3).collect();
            ms.sort_by(f64::total_cmp);
            let median = ms[ROUNDS / 2];
            let base = *first.get_or_insert(median);
            let spread = (ms[ROUNDS - 1] - ms[0]) / median * 100.0;
            print!(" {median:>9.2} {spread:>6.0}% {:>7.2}   ", median / base);
        }
        println!();
    }
    Ok(())
}
