//! Plots of figures over pictures: one line for the whole, one for each class; and means over the blocks of a grid.

use std::ops::Range;
use std::path::Path;

use plotters::prelude::*;

use super::{ColourMap, MeasureError};

const SIZE: (u32, u32) = (760, 420);
/// Side of a block's cell, pixels.
const CELL: u32 = 84;

/// A line of a plot: a figure for each picture, where it has one.
pub struct Line {
    /// What it is of.
    pub name: String,
    /// By picture. Infinite figures (the PSNR of equal pictures) are left out.
    pub values: Vec<Option<f64>>,
}

fn failed(file: &Path, error: impl ToString) -> MeasureError {
    MeasureError::Io { path: file.to_owned(), source: std::io::Error::other(error.to_string()) }
}

fn finite(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let ends = |range: Option<(f64, f64)>, v: f64| {
        Some(range.map_or((v, v), |(low, high)| (low.min(v), high.max(v))))
    };
    let (low, high) = values.filter(|v| v.is_finite()).fold(None, ends)?;
    let margin = (0.05 * (high - low)).max(1e-6 * high.abs().max(1e-3));
    Some(low - margin..high + margin)
}

/// A figure over pictures, as an SVG. Without any finite figure nothing is written; returns whether something was.
///
/// # Errors
/// The file cannot be written.
pub fn over_pictures(file: &Path, figure: &str, lines: &[Line]) -> Result<bool, MeasureError> {
    let pictures = lines.iter().map(|l| l.values.len()).max().unwrap_or(0);
    let Some(heights) = finite(lines.iter().flat_map(|l| l.values.iter().flatten().copied())) else {
        return Ok(false);
    };
    // Names stand beside the lines, where no point can be.
    let last = pictures as f64;
    let legend = if lines.len() > 1 { 0.18 * last } else { 0.0 };
    let root = SVGBackend::new(file, SIZE).into_drawing_area();
    let paint = || -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .caption(format!("{figure} over {pictures} pictures"), ("sans-serif", 16))
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(56)
            .build_cartesian_2d(0.5..last + legend + 0.5, heights)?;
        let number = |x: &f64| if x.fract() == 0.0 && *x <= last { format!("{x:.0}") } else { String::new() };
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("picture, by name").x_label_formatter(&number).y_desc(figure);
        mesh.light_line_style(WHITE).draw()?;
        for (k, line) in lines.iter().enumerate() {
            // The whole is black; classes along a colour map.
            let share = k.saturating_sub(1) as f64 / (lines.len().max(3) - 2) as f64;
            let [r, g, b] = if k == 0 { [0; 3] } else { ColourMap::Viridis.colour(share) };
            let colour = RGBColor(r, g, b);
            let shown = |(i, v): (usize, &Option<f64>)| Some((i as f64 + 1.0, v.filter(|v| v.is_finite())?));
            let points: Vec<(f64, f64)> = line.values.iter().enumerate().filter_map(shown).collect();
            let width = if k == 0 { 2 } else { 1 };
            chart
                .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(width)))?
                .label(&line.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
            chart.draw_series(points.iter().map(|&at| Circle::new(at, 2, colour.filled())))?;
        }
        if lines.len() > 1 {
            let mut names = chart.configure_series_labels();
            names
                .position(SeriesLabelPosition::UpperRight)
                .background_style(WHITE)
                .border_style(BLACK)
                .draw()?;
        }
        root.present()
    };
    paint().map_err(|e| failed(file, e))?;
    Ok(true)
}

/// A figure by blocks, rows from above, as an SVG: the least in the darkest colour. Blocks without one are white. Returns
/// whether there was any.
///
/// # Errors
/// The file cannot be written.
pub fn over_blocks(
    file: &Path,
    figure: &str,
    columns: u32,
    values: &[Option<f64>],
) -> Result<bool, MeasureError> {
    let Some(range) = finite(values.iter().flatten().copied()) else { return Ok(false) };
    let columns = columns.max(1);
    let rows = (values.len() as u32).div_ceil(columns);
    let size = (columns * CELL + 20, rows * CELL + 50);
    let root = SVGBackend::new(file, size).into_drawing_area();
    let paint = || -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        root.fill(&WHITE)?;
        let title = format!("{figure} by blocks, mean over the pictures");
        root.draw(&Text::new(title, (10, 10), ("sans-serif", 14)))?;
        for (i, value) in values.iter().enumerate() {
            let Some(value) = value.filter(|v| v.is_finite()) else { continue };
            let share = (value - range.start) / (range.end - range.start);
            let [r, g, b] = ColourMap::Viridis.colour(share);
            let (x, y) = ((i as u32 % columns * CELL) as i32 + 10, (i as u32 / columns * CELL) as i32 + 40);
            let (right, bottom) = (x + CELL as i32, y + CELL as i32);
            root.draw(&Rectangle::new([(x, y), (right, bottom)], RGBColor(r, g, b).filled()))?;
            let ink = if share > 0.6 { BLACK } else { WHITE };
            let style = ("sans-serif", 13).into_font().color(&ink);
            root.draw(&Text::new(format!("{value:.4}"), (x + 12, y + CELL as i32 / 2), style))?;
        }
        root.present()
    };
    paint().map_err(|e| failed(file, e))?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_blocks_are_drawn_and_nothing_is_drawn_of_nothing() {
        let folder = std::env::temp_dir().join(format!("motes-measure-plots-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = |name: &str| folder.join(name);
        let line = |name: &str, values: &[Option<f64>]| Line { name: name.into(), values: values.to_vec() };
        let lines = [
            line("whole", &[Some(1.0), Some(2.0), Some(f64::INFINITY)]),
            line("class 4", &[None, Some(3.0), Some(0.5)]),
        ];
        assert!(over_pictures(&file("a.svg"), "PSNR", &lines).unwrap());
        let text = std::fs::read_to_string(file("a.svg")).unwrap();
        assert_eq!(text.matches("<circle").count(), 4, "what is infinite or absent has no dot");
        assert!(text.contains("class 4") && text.contains("PSNR over 3 pictures"));
        let nothing = [line("whole", &[None, Some(f64::INFINITY)])];
        assert!(!over_pictures(&file("none.svg"), "PSNR", &nothing).unwrap() && !file("none.svg").exists());
        let blocks = [Some(0.25), None, Some(0.5), Some(0.75)];
        assert!(over_blocks(&file("b.svg"), "SSIM", 2, &blocks).unwrap());
        let text = std::fs::read_to_string(file("b.svg")).unwrap();
        assert_eq!(["0.2500", "0.5000", "0.7500"].map(|v| text.matches(v).count()), [1; 3]);
        assert!(!over_blocks(&file("none.svg"), "SSIM", 2, &[None]).unwrap());
        assert!(over_pictures(Path::new("/nowhere/a.svg"), "PSNR", &lines).is_err());
    }
}
