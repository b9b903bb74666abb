//! Measures the hard cases, sweeps and layers, and writes the stability report: `cargo xtask stability`.

#![allow(clippy::print_stdout, reason = "a command says how far it is")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use motes_renderer::{Composite, LowPass, OrderKey, Precision, Projection, RenderConfig, TargetFormat};
use motes_tests::hard::cases;
use motes_tests::hard::colour::layer_error;
use motes_tests::hard::precision;
use motes_tests::hard::rig::{Rig, every_layer};
use motes_tests::hard::sweeps::{self, Rung, Sample, Sweep, VALID};
use motes_tests::hard::temporal::{Movement, shimmer, stale};
use plotters::prelude::*;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Colours by rung, told apart by people who see fewer (Okabe & Ito 2008).
const COLOURS: [RGBColor; 6] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "docs".into()));
    let plots = folder.join("stability");
    std::fs::create_dir_all(&plots)?;
    let mut rig = Rig::new();
    let mut page = String::from(HEAD);
    table_of_cases(&mut rig, &mut page)?;
    page.push_str(ELSEWHERE);
    sweep_pages(&mut rig, &mut page, &plots)?;
    layers(&mut rig, &mut page, &plots)?;
    halves(&mut page)?;
    over_time(&mut rig, &mut page, &plots)?;
    page.push_str(include_str!("../hard/mutants.md"));
    std::fs::write(folder.join("stability.md"), page)?;
    println!("wrote {}", folder.join("stability.md").display());
    Ok(())
}

const HEAD: &str = "\
# Stability

Made by `cargo xtask stability`; do not edit. Every figure is measured on lavapipe, against the reference renderer in
64-bit floating point (`renderer/src/reference`). Distances between pictures are in steps of an 8-bit image (1/255) and,
unless it says *mean*, those of the worst pixel and channel, before anything is rounded to 8 bits.

## Hard cases

Each is drawn in every projection and expansion, mono and stereo where there are two eyes. *Control* is the same figure on
input that is wrong on purpose: it must be above the bound, or the test tests nothing. They run as `hard_cases` in
`tests/tests`; the functions are in `tests/src/hard`.

| what breaks viewers | test | what holds | bound | worst | control |
|---|---|---|---:|---:|---:|
";

fn table_of_cases(rig: &mut Rig, page: &mut String) -> Result<()> {
    for case in cases::all() {
        let found = (case.measure)(rig);
        println!("{}: {:.3} of {} {}", case.name, found.worst, case.bound, case.unit);
        writeln!(
            page,
            "| {} | `{}` | {} | {} {} | {:.2} ({}) | {:.1} |",
            case.row,
            case.name,
            case.property,
            case.bound,
            case.unit,
            found.worst,
            found.place,
            found.control
        )?;
    }
    Ok(())
}

/// Rows whose tests do not draw, or live elsewhere, and rows without a test, with the reason.
const ELSEWHERE: &str = "
Rows that are held elsewhere:

| what breaks viewers | where |
|---|---|
| missing, extra, reordered, list properties; wrong count; truncated; big-endian; ascii; 0 splats; 4 GB and more | `scenes/tests`: `robustness` (cut at every percent, 1000 seeds of damage a format, memory counted), `damaged_compressed`, `loading` (`rows_beyond_four_gigabytes`, `scenes_without_splats_load_and_say_so`), `conventions` |
| an enormous splat is reported at load | `scenes/tests/loading.rs`: `splats_larger_than_the_scene_are_reported` |
| scenes that would take seconds a frame | `hard_faults`: `a_flood_is_predicted_before_it_is_drawn` |
| storage-buffer limit of 128 MiB per binding | `hard_faults`: `streams_are_split_at_the_limit`, `scenes_beyond_every_binding_are_refused` |
| det overflow and underflow | sweeps `scale`, `scale-magnified`; `scales_whose_exponential_overflows` |
| halves: overflow, flushed subnormals; the halo | `hard_precision` (model in software), `precision` |
| radix sort: n = 0 … block ± 1, sorted, reversed, equal, maximal | `renderer/src/order/radix.rs`: `radix_sort_equals_the_stable_sort`; `hard_poison`: `radix_sort_is_the_stable_sort` |
| stale order | `hard_temporal`: `stale_orders_stay_bounded`, `turning_the_head_changes_no_radial_order` |
| needles and sub-pixel splats under a moving camera | `hard_temporal`: `thin_and_distant_splats_do_not_shimmer` |
| out of memory, no Vulkan, missing features, window of zero size, file that vanishes | `hard_faults` |
| a file that shrinks while it is read | `scenes/tests/loading.rs`: `a_file_that_shrinks_while_it_is_read_is_an_error` |
| published GPU sorts broken on Adreno and lavapipe | `order`: `both_sorts_agree_with_the_stable_sort`, `a_million_keys_agree_and_repeat`, with several sizes of workgroups; nothing of an Adreno |
| swapchain out of date, no display | no test here: a window's affair, not the renderer's |
| device lost in earnest | no test: no software driver can lose its device; `hard_faults` checks the message |
";

/// Values per sweep.
const VALUES: usize = 33;

fn sweep_pages(rig: &mut Rig, page: &mut String, plots: &Path) -> Result<()> {
    page.push_str(
        "\n## Sweeps\n\nLeft: the distance of each rung from the same projection in f64, with its bound (dashed). Right: the distance \
         from the exact projection in f64, where the approximation and the stored precision show; dashed: what is called valid.\n\n",
    );
    let mut table = format!(
        "### Where a rung stops being valid\n\nValues at which the worst pixel is within {VALID} steps of the truth; \
         for the forms of storage, within their bound of the tangent projection in f64. A splat that covers a large \
         angle differs from the truth whatever is swept: the projections are approximations, which only *exact* is not.\n\n\
         | sweep | quantity | {} |\n|---|---|{}\n",
        Rung::ALL.map(Rung::name).join(" | "),
        "---|".repeat(Rung::ALL.len())
    );
    for sweep in sweeps::all() {
        let count = if sweep.name == "resolution" { 13 } else { VALUES };
        let values = sweep.values(count);
        let samples: Vec<Vec<Sample>> = values.iter().map(|v| sweep.measure(rig, *v)).collect();
        let file = format!("sweep-{}.svg", sweep.name);
        plot_sweep(&sweep, &samples, &plots.join(&file))?;
        let worst = |i: usize| samples.iter().map(|s| s[i].own.worst).fold(0.0, f64::max);
        println!("{}: {:.2?}", sweep.name, [0, 1, 2, 3, 4].map(worst));
        writeln!(
            page,
            "### {}\n\n{} Worst over the range: affine {:.2}, tangent {:.2}, exact {:.2} of {}; f16 {:.2}; naive halves {:.2}.\n\n\
             ![{}](stability/{file})\n",
            sweep.name,
            sweep.about,
            worst(0),
            worst(1),
            worst(2),
            sweep.bound,
            worst(3),
            worst(4),
            sweep.quantity
        )?;
        write!(table, "| {} | {} |", sweep.name, sweep.quantity)?;
        for (i, rung) in Rung::ALL.into_iter().enumerate() {
            let valid: Vec<bool> = samples
                .iter()
                .map(|s| match rung.precision {
                    Precision::F32 => s[i].truth.worst <= VALID,
                    _ => s[i].own.worst <= sweep.bound_f16,
                })
                .collect();
            write!(table, " {} |", ranges(&values, &valid))?;
        }
        table.push('\n');
    }
    page.push_str(&table);
    Ok(())
}

/// The stretches of values that are valid.
fn ranges(values: &[f64], valid: &[bool]) -> String {
    if valid.iter().all(|v| *v) {
        return "all".into();
    }
    let mut found = Vec::new();
    let mut start = None;
    for (i, ok) in valid.iter().enumerate() {
        match (ok, start) {
            (true, None) => start = Some(i),
            (false, Some(s)) => {
                found.push((s, i - 1));
                start = None;
            }
            _ => {}
        }
    }
    found.extend(start.map(|s| (s, values.len() - 1)));
    if found.is_empty() {
        return "nowhere".into();
    }
    let text: Vec<String> =
        found.iter().map(|(a, b)| format!("{} … {}", short(values[*a]), short(values[*b]))).collect();
    text.join(", ")
}

fn short(v: f64) -> String {
    if v != 0.0 && (v.abs() < 1e-2 || v.abs() >= 1e4) {
        format!("{v:.0e}")
    } else {
        format!("{v:.3}").trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

/// Errors are shown from a hundredth of a step to the whole range.
const ERRORS: [f64; 2] = [0.01, 300.0];

struct Curve {
    name: String,
    points: Vec<(f64, f64)>,
}

fn plot_sweep(sweep: &Sweep, samples: &[Vec<Sample>], file: &Path) -> Result<()> {
    let root = SVGBackend::new(file, (1000, 380)).into_drawing_area();
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(500);
    let curves = |figure: &dyn Fn(&Sample) -> f64| -> Vec<Curve> {
        Rung::ALL
            .into_iter()
            .enumerate()
            .map(|(i, rung)| Curve {
                name: rung.name(),
                points: samples.iter().map(|s| (s[i].value, figure(&s[i]))).collect(),
            })
            .collect()
    };
    let axis = Axis { label: sweep.quantity, range: sweep.range, logarithmic: sweep.logarithmic };
    panel(
        &left,
        "distance from its own f64 twin (1/255)",
        &axis,
        &curves(&|s| s.own.worst),
        Some(sweep.bound),
    )?;
    panel(&right, "distance from the truth (1/255)", &axis, &curves(&|s| s.truth.worst), Some(VALID))?;
    root.present()?;
    Ok(())
}

struct Axis<'a> {
    label: &'a str,
    range: [f64; 2],
    logarithmic: bool,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn panel(area: &Area<'_>, title: &str, axis: &Axis<'_>, curves: &[Curve], bound: Option<f64>) -> Result<()> {
    let [low, high] = axis.range;
    let mut builder = ChartBuilder::on(area);
    builder.caption(title, ("sans-serif", 15)).margin(8).x_label_area_size(36).y_label_area_size(48);
    let errors = (ERRORS[0]..ERRORS[1]).log_scale();
    // The two kinds of axes are two types: the same steps for each.
    macro_rules! draw {
        ($chart:expr) => {{
            let mut chart = $chart;
            chart
                .configure_mesh()
                .x_desc(axis.label)
                .x_labels(7)
                .x_label_formatter(&|v| short(*v))
                .y_label_formatter(&|v| short(*v))
                .light_line_style(WHITE)
                .draw()?;
            for (i, curve) in curves.iter().enumerate() {
                let colour = COLOURS[i % COLOURS.len()];
                let points = curve.points.iter().map(|(x, y)| (*x, y.clamp(ERRORS[0], ERRORS[1])));
                chart
                    .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
                    .label(curve.name.clone())
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], colour.stroke_width(2)));
            }
            if let Some(bound) = bound {
                chart.draw_series(DashedLineSeries::new(
                    [(low, bound), (high, bound)],
                    6,
                    4,
                    BLACK.stroke_width(1),
                ))?;
            }
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperLeft)
                .background_style(WHITE.mix(0.8))
                .border_style(BLACK.mix(0.3))
                .label_font(("sans-serif", 11))
                .draw()?;
        }};
    }
    if axis.logarithmic {
        draw!(builder.build_cartesian_2d((low..high).log_scale(), errors)?);
    } else {
        draw!(builder.build_cartesian_2d(low..high, errors)?);
    }
    Ok(())
}

fn layers(rig: &mut Rig, page: &mut String, plots: &Path) -> Result<()> {
    let config = |composite| RenderConfig { composite, ..every_layer(Projection::Tangent) };
    let ways = [
        (TargetFormat::Rgba16F, Composite::EarlyStop),
        (TargetFormat::Rgba16F, Composite::BackToFront),
        (TargetFormat::Rgba16F, Composite::FrontToBack),
        (TargetFormat::Rgba8, Composite::BackToFront),
        (TargetFormat::Rgba8, Composite::EarlyStop),
        (TargetFormat::Rgb10A2, Composite::BackToFront),
    ];
    let counts = [1usize, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000];
    let file = plots.join("layers.svg");
    let root = SVGBackend::new(&file, (1000, 380)).into_drawing_area();
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(500);
    page.push_str("\n## Layers in one pixel\n\nThe error of 1 to 10 000 layers, by target format and direction of blending; left: layers as opaque as together \
                   take 95 % of the light (at least 0.0045), right: of opacity 0.2.\n\n![layers](stability/layers.svg)\n\n| target, direction | worst, thin layers | worst, opacity 0.2 |\n|---|---:|---:|\n");
    let axis = Axis { label: "layers", range: [1.0, 1e4], logarithmic: true };
    let mut sets = Vec::new();
    for opacity in [None, Some(0.2f32)] {
        let curves: Result<Vec<Curve>> = ways
            .iter()
            .map(|(target, composite)| {
                let points = counts
                    .iter()
                    .map(|&n| {
                        let opacity = opacity
                            .unwrap_or_else(|| (1.0 - 0.05f32.powf(1.0 / n as f32)).clamp(0.0045, 0.9));
                        (n as f64, layer_error(rig, n, opacity, *target, &config(*composite)))
                    })
                    .collect();
                Ok(Curve { name: format!("{target}, {composite}"), points })
            })
            .collect();
        sets.push(curves?);
    }
    panel(&left, "thin layers (1/255)", &axis, &sets[0], None)?;
    panel(&right, "layers of opacity 0.2 (1/255)", &axis, &sets[1], None)?;
    root.present()?;
    for i in 0..ways.len() {
        let worst = |curves: &[Curve]| curves[i].points.iter().map(|p| p.1).fold(0.0, f64::max);
        writeln!(page, "| {} | {:.2} | {:.2} |", sets[0][i].name, worst(&sets[0]), worst(&sets[1]))?;
    }
    page.push_str(
        "\nWhy early stop is the default: front to back, half floats keep adding what no longer can be subtracted from the light once the opacity \
         has rounded to its last step; stopping there ends the drift. `rgb10a2` has two bits of opacity: it cannot show a background behind splats.\n",
    );
    println!("layers");
    Ok(())
}

fn halves(page: &mut String) -> Result<()> {
    page.push_str(
        "\n## Half precision\n\nEvery quantity that is kept in half floats, with subnormals flushed to zero (a model in software, `hard_precision`).\n\n\
         | quantity | stated bound | worst |\n|---|---:|---:|\n",
    );
    for q in precision::quantities() {
        writeln!(page, "| {} | {:.2e} {} | {:.2e} |", q.name, q.bound, q.unit, q.worst)?;
    }
    page.push_str("\nAnd what is not, because it would lose this much (the controls of that test):\n\n| quantity | needed | found |\n|---|---:|---:|\n");
    for q in precision::naive() {
        writeln!(page, "| {} | {:.1e} {} | {:.1e} |", q.name, q.bound, q.unit, q.worst)?;
    }
    Ok(())
}

fn over_time(rig: &mut Rig, page: &mut String, plots: &Path) -> Result<()> {
    page.push_str("\n## From frame to frame\n\nWires of 0.1 mm and specks of a tenth of a pixel, on a path of an eighth of a pixel a frame:\n\n\
                   | projection, filter | energy varies by | a pixel changes by more than in f64 | a pixel changes by |\n|---|---:|---:|---:|\n");
    for (projection, low_pass) in [
        (Projection::Affine, LowPass::Planar),
        (Projection::Tangent, LowPass::Planar),
        (Projection::Exact, LowPass::Planar),
        (Projection::Tangent, LowPass::Volumetric),
        (Projection::Tangent, LowPass::Off),
    ] {
        let s = shimmer(rig, projection, low_pass, 17);
        writeln!(
            page,
            "| {projection}, {low_pass} | {:.2} % | {:.2} | {:.1} |",
            100.0 * s.energy,
            s.pixel,
            s.change
        )?;
    }
    let ages: Vec<u32> = (0..=8).collect();
    let mut curves = Vec::new();
    let mut worst = Vec::new();
    for (movement, key) in [
        (Movement::Walk, OrderKey::Radial),
        (Movement::Turn, OrderKey::Radial),
        (Movement::Both, OrderKey::Radial),
        (Movement::Walk, OrderKey::Depth),
        (Movement::Turn, OrderKey::Depth),
        (Movement::Both, OrderKey::Depth),
    ] {
        let found = stale(rig, movement, key, &ages);
        let points = |f: &dyn Fn(&motes_tests::hard::rig::Deviation) -> f64| {
            found.iter().zip(&ages).map(|(d, a)| (f64::from(*a), f(d))).collect()
        };
        let name = format!("{movement:?}, {key}").to_lowercase();
        curves.push(Curve { name: name.clone(), points: points(&|d| d.mean) });
        worst.push(Curve { name, points: points(&|d| d.worst) });
    }
    let file = plots.join("stale-order.svg");
    let root = SVGBackend::new(&file, (1000, 380)).into_drawing_area();
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(500);
    let axis = Axis { label: "age of the order (frames of 1/72 s)", range: [0.0, 8.0], logarithmic: false };
    panel(&left, "mean of all pixels (1/255)", &axis, &curves, None)?;
    panel(&right, "worst pixel (1/255)", &axis, &worst, None)?;
    root.present()?;
    page.push_str("\nAn order that is some frames old, walking at 1.4 m/s, turning by 180° a second, and both, through a crowd of 540 overlapping splats: with the radial key turning changes nothing.\n\n\
                   ![stale order](stability/stale-order.svg)\n");
    Ok(())
}
