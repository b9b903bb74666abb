//! Plots of observations and curves, as SVG: SSIM over iterations and over the minimum distance, as the thesis's figures 6.8
//! and 6.9.

use std::path::Path;

use motes_app::lod::ClassQuality;
use plotters::prelude::*;

use super::fit::means;
use super::observe::Observation;
use crate::error::CommandError;

const SIZE: (u32, u32) = (640, 400);
/// Samples of a drawn curve.
const SAMPLES: usize = 200;

/// SSIM of a class over iterations (means over views, and every view faintly) and over the distance (one colour a level),
/// with its curve. Writes `CLASS-iterations.svg` and `CLASS-distance.svg` into a folder.
///
/// # Errors
/// A file cannot be written.
pub fn class(
    folder: &Path,
    quality: &ClassQuality,
    observations: &[Observation],
) -> Result<(), CommandError> {
    let mine: Vec<&Observation> = observations.iter().filter(|o| o.class == quality.class).collect();
    let name: String = quality
        .name
        .chars()
        .map(|c| if c.is_alphanumeric() { c.to_ascii_lowercase() } else { '-' })
        .collect();
    let range = |value: fn(&Observation) -> f64| {
        let values = mine.iter().map(|o| value(o));
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        (low, high)
    };
    let (steps, distances) = (range(|o| o.step), range(|o| o.distance));
    let (low, high) = range(|o| o.ssim);
    let heights = (low - 0.02)..(high + 0.02).min(1.0);
    let mut middle: Vec<f64> = mine.iter().map(|o| o.distance).collect();
    middle.sort_by(f64::total_cmp);
    let middle = middle.get(middle.len() / 2).copied().unwrap_or(1.0);

    let file = folder.join(format!("{name}-iterations.svg"));
    let points: Vec<_> = mine.iter().map(|o| (o.step, o.ssim, RED.mix(0.15))).collect();
    let dots: Vec<_> =
        means(observations, quality.class).iter().map(|p| (p[0], p[1], RED.mix(1.0))).collect();
    let curve: Vec<_> = samples(steps).map(|i| (i, quality.quality.ssim(i, middle))).collect();
    let title = format!("{}: SSIM over iterations (curve at the median distance)", quality.name);
    let dots = [&points[..], &dots].concat();
    draw(&file, &title, ["iteration", "SSIM"], steps, heights.clone(), &dots, &[curve])?;

    let file = folder.join(format!("{name}-distance.svg"));
    let mut levels: Vec<f64> = mine.iter().map(|o| o.step).collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    let colour = |step: f64| {
        let at = levels.iter().position(|&s| s == step).unwrap_or(0);
        let [r, g, b] = crate::measure::ColourMap::Viridis.colour(at as f64 / levels.len().max(2) as f64);
        RGBColor(r, g, b).mix(1.0)
    };
    let points: Vec<_> = mine.iter().map(|o| (o.distance, o.ssim, colour(o.step))).collect();
    let shown = [levels.first(), levels.get(levels.len() / 2), levels.last()];
    let curves: Vec<Vec<_>> = shown
        .into_iter()
        .flatten()
        .map(|&step| samples(distances).map(|d| (d, quality.quality.ssim(step, d))).collect())
        .collect();
    let title = format!("{}: SSIM over the minimum distance", quality.name);
    draw(&file, &title, ["minimum distance", "SSIM"], distances, heights, &points, &curves)
}

/// Bytes in memory over a walk, and the line that they must stay below.
///
/// # Errors
/// The file cannot be written.
pub fn memory(file: &Path, seconds: f64, resident: &[(f64, u64)], budget: u64) -> Result<(), CommandError> {
    let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let curve = resident.iter().map(|&(at, bytes)| (at, mebibytes(bytes))).collect();
    let line = vec![(0.0, mebibytes(budget)), (seconds, mebibytes(budget))];
    let heights = 0.0..1.1 * mebibytes(budget);
    let title = "Splats in memory over a walk, and the budget";
    draw(file, title, ["seconds of the walk", "MiB"], (0.0, seconds), heights, &[], &[curve, line])
}

fn samples((low, high): (f64, f64)) -> impl Iterator<Item = f64> {
    (0..=SAMPLES).map(move |k| low + (high - low) * k as f64 / SAMPLES as f64)
}

fn draw(
    file: &Path,
    title: &str,
    [across, upward]: [&str; 2],
    (low, high): (f64, f64),
    heights: std::ops::Range<f64>,
    points: &[(f64, f64, RGBAColor)],
    curves: &[Vec<(f64, f64)>],
) -> Result<(), CommandError> {
    let failed = |e: String| CommandError::io(file)(std::io::Error::other(e));
    let root = SVGBackend::new(file, SIZE).into_drawing_area();
    let paint = || -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        root.fill(&WHITE)?;
        let margin = 0.03 * (high - low).max(1e-9);
        let mut chart = ChartBuilder::on(&root)
            .caption(title, ("sans-serif", 16))
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d((low - margin)..(high + margin), heights)?;
        chart.configure_mesh().x_desc(across).y_desc(upward).light_line_style(WHITE).draw()?;
        chart.draw_series(points.iter().map(|&(x, y, colour)| Circle::new((x, y), 3, colour.filled())))?;
        for curve in curves {
            chart
                .draw_series(LineSeries::new(curve.iter().copied(), RGBColor(128, 0, 160).stroke_width(2)))?;
        }
        root.present()
    };
    paint().map_err(|e| failed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_app::lod::Quality;

    #[test]
    fn plots_hold_every_point_and_a_curve() {
        let folder = std::env::temp_dir().join(format!("motes-plots-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let observations: Vec<Observation> = (0..6)
            .map(|k| Observation {
                class: 2,
                view: k,
                step: [100.0, 1000.0][k % 2],
                distance: 1.0 + k as f64,
                ssim: 0.5 + 0.05 * k as f64,
                pixels: 500,
            })
            .collect();
        let quality = ClassQuality {
            class: 2,
            name: "Light cloth".into(),
            quality: Quality::Logarithm { a: 0.05, b: 0.3 },
            residual: 0.0,
            r2: 1.0,
            views: 6,
        };
        class(&folder, &quality, &observations).unwrap();
        let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        let (iterations, distance) = (text("light-cloth-iterations.svg"), text("light-cloth-distance.svg"));
        assert_eq!(iterations.matches("<circle").count(), 6 + 2);
        assert_eq!(
            (distance.matches("<circle").count(), distance.matches("<polyline").count() >= 3),
            (6, true)
        );
    }
}
