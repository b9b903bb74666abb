//! `motes compare`: figures for a pair of pictures, or for two folders of pictures of the same names.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Serialize;

use crate::measure::plots::{self, Line};
use crate::measure::{
    self, ClassMask, ColourMap, Comparison, DEFAULT_PIXELS_PER_DEGREE, Flip, Matching, MeasureError, Picture,
    Region, Settings, Worst, coloured,
};

/// Why LPIPS is not among the figures.
const NO_LPIPS: &str =
    "LPIPS is left out: it needs a trained network and a runtime for it, and this build contains neither";

/// Compare pictures: PSNR, SSIM, FLIP, worst pixel.
#[derive(Clone, Debug, clap::Args)]
pub struct CompareArgs {
    /// The reference: a PNG, or a folder of PNGs
    pub reference: PathBuf,
    /// The picture to judge, or a folder with pictures of the same names
    pub test: PathBuf,
    /// Pixels per degree of the visual field, for FLIP (67: a 4K screen at 0.7 m; headsets have 18 to 25)
    #[arg(long, value_name = "N", default_value_t = DEFAULT_PIXELS_PER_DEGREE)]
    pub ppd: f32,
    /// Bring the colours of the test near the reference's first
    #[arg(long = "match", value_name = "HOW")]
    pub matching: Option<Matching>,
    /// Write the FLIP error map here, in magma colours (a folder, for folders)
    #[arg(long, value_name = "OUT.png")]
    pub map: Option<PathBuf>,
    /// A PNG whose palette indices or grey values are classes: figures for each (a folder, for folders)
    #[arg(long, value_name = "MASK.png")]
    pub mask: Option<PathBuf>,
    /// Figures for each block of a grid
    #[arg(long, value_name = "COLUMNSxROWS")]
    pub blocks: Option<Grid>,
    /// Write plots (SVG) of every figure over the pictures, with a line for each class, and by blocks
    #[arg(long, value_name = "FOLDER")]
    pub plots: Option<PathBuf>,
    /// A file with an LPIPS network
    #[arg(long, value_name = "MODEL")]
    pub lpips: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Columns and rows of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid(pub u32, pub u32);

impl FromStr for Grid {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let parse = |n: &str| n.trim().parse().ok().filter(|&n: &u32| n > 0);
        s.split_once(['x', '×'])
            .and_then(|(c, r)| Some(Self(parse(c)?, parse(r)?)))
            .ok_or_else(|| format!("'{s}' is no grid; write columns and rows, like 4x3"))
    }
}

/// Why pictures could not be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// A picture or a setting.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// One of a pair of files.
    #[error("{name}: {source}")]
    Pair {
        /// The pictures' common name.
        name: String,
        /// What is wrong with them.
        source: MeasureError,
    },
    /// A file where a folder is needed, or the other way round, or nothing in common.
    #[error("{0}")]
    Paths(String),
    /// The figures could not be printed.
    #[error("cannot print: {0}")]
    Print(#[from] std::io::Error),
}

/// The report of one pair.
#[derive(Debug, Serialize)]
struct PairReport {
    reference: PathBuf,
    test: PathBuf,
    size: [u32; 2],
    #[serde(flatten)]
    whole: Region,
    flip_pool: Flip,
    worst: Worst,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    classes: Vec<ClassReport>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    blocks: Vec<Region>,
}

#[derive(Debug, Serialize)]
struct ClassReport {
    class: u8,
    #[serde(flatten)]
    region: Region,
}

/// Everything that is printed.
#[derive(Debug, Serialize)]
struct Report {
    pixels_per_degree: f32,
    matching: Option<Matching>,
    pairs: Vec<PairReport>,
    /// Means over the pairs, where there is more than one.
    #[serde(skip_serializing_if = "Option::is_none")]
    mean: Option<Means>,
    /// Names that only one of two folders has.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    unpaired: Vec<PathBuf>,
    /// Figures that were left out, and why.
    left_out: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Means {
    psnr: f64,
    ssim: Option<f64>,
    flip: f64,
}

/// Compares, and prints to the standard output.
///
/// # Errors
/// Where a file cannot be read or written, sizes differ, or folders have no name in common.
pub fn run(args: &CompareArgs) -> Result<(), CompareError> {
    run_to(args, &mut std::io::stdout().lock())
}

/// [`run`] with another place to print to.
///
/// # Errors
/// As [`run`].
pub fn run_to(args: &CompareArgs, out: &mut dyn Write) -> Result<(), CompareError> {
    let report = report(args)?;
    if let Some(folder) = &args.plots {
        plot(&report, folder, args.blocks).map_err(CompareError::Measure)?;
    }
    if args.json {
        serde_json::to_writer_pretty(&mut *out, &report).map_err(std::io::Error::from)?;
        writeln!(out)?;
    } else {
        print(&report, out)?;
    }
    Ok(())
}

fn report(args: &CompareArgs) -> Result<Report, CompareError> {
    let settings = Settings { pixels_per_degree: args.ppd, matching: args.matching };
    let (mut pairs, mut unpaired) = (Vec::new(), Vec::new());
    match (args.reference.is_dir(), args.test.is_dir()) {
        (false, false) => pairs.push(pair(args, &settings, None)?),
        (true, true) => {
            let (a, b) = (pictures(&args.reference)?, pictures(&args.test)?);
            for name in a.intersection(&b) {
                let compared = pair(args, &settings, Some(name));
                pairs.push(compared.map_err(|source| CompareError::Pair { name: name.clone(), source })?);
            }
            unpaired.extend(a.difference(&b).map(|n| args.reference.join(n)));
            unpaired.extend(b.difference(&a).map(|n| args.test.join(n)));
            if pairs.is_empty() {
                return Err(CompareError::Paths(format!(
                    "{} and {} have no PNG of the same name; name the pictures alike",
                    args.reference.display(),
                    args.test.display()
                )));
            }
        }
        (first, _) => {
            let (folder, file) =
                if first { (&args.reference, &args.test) } else { (&args.test, &args.reference) };
            return Err(CompareError::Paths(format!(
                "{} is a folder and {} is not; give two pictures or two folders",
                folder.display(),
                file.display()
            )));
        }
    }
    let mut left_out = vec![match &args.lpips {
        None => NO_LPIPS.to_owned(),
        Some(model) => format!("{NO_LPIPS}; {} was not read", model.display()),
    }];
    if pairs.iter().any(|p| p.whole.ssim.is_none()) {
        let window = measure::SSIM_WINDOW;
        left_out
            .push(format!("SSIM is left out where a picture is smaller than its {window} × {window} window"));
    }
    let mean = (pairs.len() > 1).then(|| means(&pairs));
    Ok(Report { pixels_per_degree: args.ppd, matching: args.matching, pairs, mean, unpaired, left_out })
}

fn means(pairs: &[PairReport]) -> Means {
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let ssim: Option<Vec<f64>> = pairs.iter().map(|p| p.whole.ssim).collect();
    Means {
        psnr: mean(pairs.iter().map(|p| p.whole.psnr).collect()),
        ssim: ssim.map(mean),
        flip: mean(pairs.iter().map(|p| p.whole.flip).collect()),
    }
}

/// Plots every figure.
fn plot(report: &Report, folder: &Path, blocks: Option<Grid>) -> Result<(), MeasureError> {
    std::fs::create_dir_all(folder).map_err(|source| MeasureError::Io { path: folder.to_owned(), source })?;
    let classes: BTreeSet<u8> = report.pairs.iter().flat_map(|p| &p.classes).map(|c| c.class).collect();
    type Figure = fn(&Region) -> Option<f64>;
    let psnr: Figure = |r| Some(r.psnr);
    let ssim: Figure = |r| r.ssim;
    let flip: Figure = |r| Some(r.flip);
    for (name, figure) in [("PSNR", psnr), ("SSIM", ssim), ("FLIP", flip)] {
        let line = |name: String, of: &dyn Fn(&PairReport) -> Option<f64>| Line {
            name,
            values: report.pairs.iter().map(of).collect(),
        };
        let mut lines = vec![line("whole".into(), &|p| figure(&p.whole))];
        for &class in &classes {
            let of =
                |p: &PairReport| p.classes.iter().find(|c| c.class == class).and_then(|c| figure(&c.region));
            lines.push(line(format!("class {class}"), &of));
        }
        let lower = name.to_ascii_lowercase();
        plots::over_pictures(&folder.join(format!("{lower}.svg")), name, &lines)?;
        if let Some(Grid(columns, rows)) = blocks {
            let mean = |block: usize| {
                let of = |p: &PairReport| p.blocks.get(block).and_then(figure).filter(|v| v.is_finite());
                let values: Vec<f64> = report.pairs.iter().filter_map(of).collect();
                (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
            };
            let means: Vec<Option<f64>> = (0..columns as usize * rows as usize).map(mean).collect();
            plots::over_blocks(&folder.join(format!("{lower}-blocks.svg")), name, columns, &means)?;
        }
    }
    Ok(())
}

/// Compares two files, or the files of one name in two folders.
fn pair(args: &CompareArgs, settings: &Settings, name: Option<&str>) -> Result<PairReport, MeasureError> {
    let file = |path: &Path| name.map_or_else(|| path.to_owned(), |n| path.join(n));
    let (reference, test) = (file(&args.reference), file(&args.test));
    let (a, b) = (Picture::load(&reference)?, Picture::load(&test)?);
    let Comparison { whole, flip, worst, maps } = measure::compare(&a, &b, settings)?;
    let mut classes = Vec::new();
    if let Some(mask) = &args.mask {
        let found = maps.by_class(&ClassMask::load(&file(mask))?)?;
        classes.extend(found.into_iter().map(|(class, region)| ClassReport { class, region }));
    }
    let blocks = match args.blocks {
        Some(Grid(columns, rows)) => maps.by_block(columns, rows)?,
        None => Vec::new(),
    };
    if let Some(map) = &args.map {
        if name.is_some() {
            std::fs::create_dir_all(map).map_err(|source| MeasureError::Io { path: map.clone(), source })?;
        }
        let errors = maps.flip.iter().map(|&e| f64::from(e));
        coloured(maps.size, errors, [0.0, 1.0], ColourMap::Magma)?.save(&file(map))?;
    }
    Ok(PairReport { reference, test, size: maps.size, whole, flip_pool: flip, worst, classes, blocks })
}

/// Names of the PNG files of a folder.
fn pictures(folder: &Path) -> Result<BTreeSet<String>, MeasureError> {
    let io = |source| MeasureError::Io { path: folder.to_owned(), source };
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
        if let Some(name) = path.file_name().and_then(|n| n.to_str()).filter(|_| png && path.is_file()) {
            names.insert(name.to_owned());
        }
    }
    Ok(names)
}

fn print(report: &Report, out: &mut dyn Write) -> std::io::Result<()> {
    match report.matching {
        Some(Matching::Mean) => {
            writeln!(out, "The test's mean and deviation were matched to the reference's.")?
        }
        Some(Matching::Histogram) => writeln!(out, "The test's histograms were matched to the reference's.")?,
        None => (),
    }
    for pair in &report.pairs {
        let [w, h] = pair.size;
        writeln!(out, "{} (reference) and {}, {w} × {h}", pair.reference.display(), pair.test.display())?;
        writeln!(out, "  PSNR   {}", decibels(pair.whole.psnr))?;
        writeln!(out, "  SSIM   {}", similarity(pair.whole.ssim))?;
        let flip = &pair.flip_pool;
        let [first, third] = flip.weighted_quartiles;
        writeln!(
            out,
            "  FLIP   {:.6} mean, {:.6} weighted median, {first:.6} and {third:.6} weighted quartiles, {:.6} min, {:.6} max \
             ({:.1} pixels per degree)",
            flip.mean, flip.weighted_median, flip.min, flip.max, report.pixels_per_degree
        )?;
        let worst = &pair.worst;
        writeln!(
            out,
            "  worst  pixel ({}, {}): {} is {:.4} instead of {:.4}",
            worst.x,
            worst.y,
            ["red", "green", "blue"][worst.channel.min(2)],
            worst.test,
            worst.reference
        )?;
        for ClassReport { class, region } in &pair.classes {
            writeln!(out, "  class {class:3}   {}", line(region))?;
        }
        for (i, region) in pair.blocks.iter().enumerate() {
            writeln!(out, "  block {i:3}   {}", line(region))?;
        }
    }
    if let Some(Means { psnr, ssim, flip }) = report.mean {
        let n = report.pairs.len();
        writeln!(out, "mean of {n}: PSNR {}, SSIM {}, FLIP {flip:.6}", decibels(psnr), similarity(ssim))?;
    }
    for path in &report.unpaired {
        writeln!(out, "{} has no counterpart and was left out", path.display())?;
    }
    for reason in &report.left_out {
        writeln!(out, "{reason}")?;
    }
    Ok(())
}

fn line(region: &Region) -> String {
    format!(
        "PSNR {}, SSIM {}, FLIP {:.6} ({} pixels)",
        decibels(region.psnr),
        similarity(region.ssim),
        region.flip,
        region.pixels
    )
}

fn decibels(psnr: f64) -> String {
    if psnr == f64::INFINITY { "∞ (identical)".to_owned() } else { format!("{psnr:.3} dB") }
}

fn similarity(ssim: Option<f64>) -> String {
    ssim.map_or_else(|| "–".to_owned(), |s| format!("{s:.6}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::tests::pair as pictures_of;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: CompareArgs,
    }

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("motes-compare-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        path
    }

    fn compare(words: &[&str]) -> Result<String, String> {
        let cli = Cli::try_parse_from(std::iter::once("compare").chain(words.iter().copied()))
            .map_err(|e| e.to_string())?;
        let mut out = Vec::new();
        run_to(&cli.args, &mut out).map_err(|e| e.to_string())?;
        Ok(String::from_utf8(out).unwrap())
    }

    #[test]
    fn two_files() {
        let folder = folder("files");
        let (a, b) = pictures_of(48, 36);
        let path = |n: &str| folder.join(n).to_str().unwrap().to_owned();
        let (pa, pb, map) = (path("a.png"), path("b.png"), path("map.png"));
        a.save(Path::new(&pa)).unwrap();
        b.save(Path::new(&pb)).unwrap();
        let text = compare(&[&pa, &pb, "--map", &map]).unwrap();
        let expected = measure::compare(&a, &b, &Settings::default()).unwrap();
        for needle in [
            format!("PSNR   {:.3} dB", expected.whole.psnr),
            format!("SSIM   {:.6}", expected.whole.ssim.unwrap()),
            format!("FLIP   {:.6} mean", expected.flip.mean),
            "LPIPS is left out".to_owned(),
        ] {
            assert!(text.contains(&needle), "{needle} is not in {text}");
        }
        let coloured = Picture::load(Path::new(&map)).unwrap();
        assert_eq!(coloured.size(), [48, 36]);
        let pixel = expected.worst.y as usize * 48 + expected.worst.x as usize;
        assert_eq!(
            coloured.to_rgb8()[pixel * 3..pixel * 3 + 3],
            ColourMap::Magma.colour(expected.maps.flip[pixel].into())
        );
        // JSON has the same figures; nothing differs is null, for JSON has no infinity.
        let json: serde_json::Value = serde_json::from_str(&compare(&[&pa, &pb, "--json"]).unwrap()).unwrap();
        let first = &json["pairs"][0];
        assert!((first["psnr"].as_f64().unwrap() - expected.whole.psnr).abs() < 1e-9);
        assert!(
            (first["flip_pool"]["weighted_median"].as_f64().unwrap() - expected.flip.weighted_median).abs()
                < 1e-9
        );
        let same: serde_json::Value = serde_json::from_str(&compare(&[&pa, &pa, "--json"]).unwrap()).unwrap();
        assert!(same["pairs"][0]["psnr"].is_null() && same["pairs"][0]["flip"].as_f64() == Some(0.0));
        assert!(compare(&[&pa, &pa]).unwrap().contains("∞ (identical)"));
        // Matching and pixels per degree change the figures.
        assert_ne!(compare(&[&pa, &pb, "--match", "mean", "--json"]), compare(&[&pa, &pb, "--json"]));
        let near: serde_json::Value =
            serde_json::from_str(&compare(&[&pa, &pb, "--ppd", "20", "--json"]).unwrap()).unwrap();
        assert!(near["pairs"][0]["flip"] != first["flip"]);
    }

    #[test]
    fn folders_masks_and_blocks() {
        let (a, b) = pictures_of(40, 30);
        let (fa, fb, masks, maps) = (folder("a"), folder("b"), folder("masks"), folder("maps").join("new"));
        for name in ["one.png", "two.png"] {
            a.save(&fa.join(name)).unwrap();
            (if name == "one.png" { &a } else { &b }).save(&fb.join(name)).unwrap();
            let mut encoder = png::Encoder::new(std::fs::File::create(masks.join(name)).unwrap(), 40, 30);
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_depth(png::BitDepth::Two);
            encoder.set_palette(vec![0; 12]);
            // 0b00_01_10_11: classes 0, 1, 2, 3 side by side.
            encoder.write_header().unwrap().write_image_data(&[0b0001_1011; 300]).unwrap();
        }
        a.save(&fa.join("alone.png")).unwrap();
        let words = [&fa, &fb, &masks, &maps].map(|p| p.to_str().unwrap());
        let plots = folder("plots");
        let (blocks, into) = (["--blocks", "2x2"], ["--plots", plots.to_str().unwrap()]);
        let masked = [words[0], words[1], "--mask", words[2], "--map", words[3]];
        let text = compare(&[&masked[..], &blocks, &into].concat()).unwrap();
        let plot = |name: &str| std::fs::read_to_string(plots.join(name)).unwrap();
        // Two pictures, the whole and four classes; the first pair is equal, and its PSNR nowhere finite.
        assert_eq!(plot("ssim.svg").matches("<circle").count(), 2 * 5);
        assert_eq!(plot("psnr.svg").matches("<circle").count(), 5);
        assert!(plot("flip-blocks.svg").matches("<rect").count() >= 4);
        assert!(text.contains("mean of 2:") && text.contains("alone.png has no counterpart"), "{text}");
        for class in 0..4 {
            assert_eq!(text.matches(&format!("class   {class}")).count(), 2, "{text}");
        }
        assert_eq!(text.matches("(300 pixels)").count(), 2 * (4 + 4), "{text}");
        assert!(maps.join("one.png").is_file() && maps.join("two.png").is_file());
    }

    #[test]
    fn what_cannot_be_compared_is_said() {
        let folder = folder("errors");
        let (a, _) = pictures_of(20, 20);
        let path = folder.join("a.png");
        a.save(&path).unwrap();
        let (file, dir) = (path.to_str().unwrap(), folder.to_str().unwrap());
        assert!(compare(&[file, dir]).unwrap_err().contains("is a folder and"));
        assert!(compare(&[file, "missing.png"]).unwrap_err().contains("missing.png"));
        assert!(compare(&[file, file, "--ppd", "0"]).unwrap_err().contains("pixels per degree"));
        assert!(compare(&[file, file, "--match", "wrong"]).unwrap_err().contains("histogram"));
        assert!(compare(&[file, file, "--blocks", "3"]).unwrap_err().contains("like 4x3"));
        assert!(compare(&[file, file, "--mask", file]).unwrap_err().contains("no class per pixel"));
        let empty = folder.join("empty");
        std::fs::create_dir_all(&empty).unwrap();
        assert!(compare(&[dir, empty.to_str().unwrap()]).unwrap_err().contains("no PNG of the same name"));
        assert!(compare(&[file, file, "--lpips", "alex.onnx"]).unwrap().contains("alex.onnx was not read"));
    }
}
