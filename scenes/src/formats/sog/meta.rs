//! `meta.json`: names of images, and the tables that their bytes index.

use serde::de::{Error as _, SeqAccess, Visitor};

use super::container::Place;
use super::image;
use crate::load::LoadContext;
use crate::{SceneError, sh_coefficients};

/// Values of a byte.
pub(super) type Table = [f32; 256];

const EXPORT_AGAIN: &str = "Export the scene again";

/// What both versions come down to.
pub(super) struct Layout {
    /// Number of splats.
    pub(super) count: u64,
    /// Degree of the spherical harmonics, `0 ..= 3`.
    pub(super) sh_degree: u8,
    /// Whether the scene was trained with the low-pass compensation of Mip-Splatting (Yu et al. 2024).
    pub(super) antialiased: bool,
    /// Range of `sign(x) ln(1 + |x|)` per axis.
    pub(super) mins: [f64; 3],
    pub(super) maxs: [f64; 3],
    /// Log-scale per axis.
    pub(super) scales: [Table; 3],
    /// Constant band per colour channel.
    pub(super) sh0: [Table; 3],
    /// Opacity.
    pub(super) opacity: Table,
    /// Higher bands.
    pub(super) palette: Option<Palette>,
    means: [String; 2],
    other: [String; 3],
}

/// The palette of higher bands.
pub(super) struct Palette {
    /// Number of entries.
    pub(super) count: usize,
    /// Coefficients per entry and channel: 3, 8 or 15.
    pub(super) coefficients: usize,
    /// Value of a byte, for all coefficients and channels.
    pub(super) table: Table,
    files: [String; 2],
}

/// Entries in a row of the palette's image.
pub(super) const PALETTE_ROW: usize = 64;

/// Indices into what [`Layout::files`] lists.
pub(super) const MEANS_LOW: usize = 0;
pub(super) const MEANS_HIGH: usize = 1;
pub(super) const SCALES: usize = 2;
pub(super) const QUATS: usize = 3;
pub(super) const SH0: usize = 4;
pub(super) const CENTROIDS: usize = 5;
pub(super) const LABELS: usize = 6;

#[derive(serde::Deserialize)]
struct Version {
    version: Option<u64>,
}

/// A property of either version.
#[derive(serde::Deserialize)]
struct Property<Range> {
    files: Files,
    mins: Option<Range>,
    maxs: Option<Range>,
    codebook: Option<Codebook>,
    shape: Option<Shape>,
    encoding: Option<String>,
    count: Option<u64>,
    bands: Option<u8>,
}

#[derive(serde::Deserialize)]
struct Meta {
    count: Option<u64>,
    #[serde(default)]
    antialias: bool,
    means: Property<[f64; 3]>,
    scales: Property<[f64; 3]>,
    quats: Property<serde::de::IgnoredAny>,
    sh0: Property<[f64; 4]>,
    #[serde(rename = "shN")]
    sh_n: Option<Property<f64>>,
}

/// One or two names.
struct Files(Vec<String>);

/// The first number of a shape: splats.
struct Shape(u64);

/// 256 values, of which the first may be `null`.
struct Codebook {
    table: Box<Table>,
    first_is_null: bool,
}

impl Layout {
    /// Reads the description.
    pub(super) fn parse(
        place: &Place,
        name: &str,
        text: &[u8],
        ctx: &LoadContext<'_>,
    ) -> Result<Self, SceneError> {
        let wrong_json = |error: serde_json::Error| {
            let at = format!("line {}, column {}", error.line(), error.column());
            place.wrong(name, &at, error.to_string(), EXPORT_AGAIN)
        };
        let Version { version } = serde_json::from_slice(text).map_err(wrong_json)?;
        if !matches!(version, None | Some(2)) {
            return Err(SceneError::unsupported(
                place.path(),
                format!("SOG version {} (Motes reads 1 and 2)", version.unwrap_or_default()),
                "Export it as version 2, or look for a newer Motes",
            ));
        }
        let meta: Meta = serde_json::from_slice(text).map_err(wrong_json)?;
        let wrong = |property: &str, problem: &str| place.wrong(name, property, problem, EXPORT_AGAIN);
        let layout = if version.is_none() { meta.version_1(&wrong) } else { meta.version_2(&wrong) };
        let (layout, patched) = layout?;
        for property in patched {
            ctx.warn(format!(
                "{}: the first value of the codebook of {property} is missing (an early exporter's mistake); it is \
                 extrapolated from the others",
                place.path().display()
            ));
        }
        Ok(layout)
    }

    /// The images' names, in a fixed order.
    pub(super) fn files(&self) -> Vec<&str> {
        let palette = self.palette.iter().flat_map(|palette| &palette.files);
        self.means.iter().chain(&self.other).chain(palette).map(String::as_str).collect()
    }

    /// Compares the images' sizes with the number of splats, before anything is decoded or allocated.
    /// Version 1 does not state the degree of the spherical harmonics: it follows from the palette's width.
    pub(super) fn check_images(&mut self, place: &Place, files: &[Vec<u8>]) -> Result<(), SceneError> {
        let names: Vec<String> = self.files().into_iter().map(str::to_owned).collect();
        for (index, (name, bytes)) in names.iter().zip(files).enumerate() {
            let (width, height) = image::size(place, name, bytes)?;
            let wrong = |problem: String| place.wrong(name, "the image's size", problem, EXPORT_AGAIN);
            let pixels = u64::from(width) * u64::from(height);
            if index == CENTROIDS {
                let Some(palette) = &mut self.palette else { continue };
                if palette.coefficients == 0 {
                    palette.coefficients = width as usize / PALETTE_ROW;
                    // Labels have 16 bits.
                    palette.count = (PALETTE_ROW * height as usize).min(1 << 16);
                }
                let degree = (1..=3).find(|&degree| sh_coefficients(degree) - 1 == palette.coefficients);
                let expected = palette.coefficients * PALETTE_ROW;
                let Some(degree) = degree.filter(|_| width as usize == expected) else {
                    return Err(wrong(format!(
                        "{width} × {height} pixels, expected a width of {} for {PALETTE_ROW} entries in a row",
                        if degree.is_some() { expected.to_string() } else { "192, 512 or 960".to_owned() }
                    )));
                };
                self.sh_degree = degree;
                let rows = palette.count.div_ceil(PALETTE_ROW);
                // Writers round heights up, some to a power of two.
                if (height as usize) < rows || height as usize > rows.saturating_mul(4) + 64 {
                    return Err(wrong(format!(
                        "{width} × {height} pixels, expected {rows} rows for a palette of {}",
                        palette.count
                    )));
                }
            } else if pixels < self.count || pixels > self.count.saturating_mul(4).saturating_add(1 << 16) {
                return Err(wrong(format!(
                    "{width} × {height} pixels for {} splats: there must be one for each, and not many more",
                    self.count
                )));
            }
        }
        Ok(())
    }
}

type Wrong<'a> = dyn Fn(&str, &str) -> SceneError + 'a;

impl Meta {
    fn version_2(self, wrong: &Wrong<'_>) -> Result<(Layout, Vec<&'static str>), SceneError> {
        let mut patched = Vec::new();
        let mut table = |codebook: Option<Codebook>, property: &'static str| {
            let mut codebook = codebook.ok_or_else(|| wrong(property, "has no codebook"))?;
            if codebook.first_is_null {
                let [first, second, .., last] = codebook.table.as_mut_slice() else {
                    return Err(wrong(property, "has no codebook"));
                };
                *first = *second + (*second - *last) / 255.0;
                patched.push(property);
            }
            Ok(*codebook.table)
        };
        let count = self.count.ok_or_else(|| wrong("count", "is missing"))?;
        let scales = table(self.scales.codebook, "scales")?;
        let sh0 = table(self.sh0.codebook, "sh0")?;
        let palette = match self.sh_n {
            // A palette of degree 0 has nothing to say.
            None | Some(Property { bands: Some(0), .. }) => None,
            Some(sh_n) => {
                let bands = sh_n.bands.ok_or_else(|| wrong("shN", "has no bands"))?;
                if !(1..=3).contains(&bands) {
                    return Err(wrong("shN", &format!("has {bands} bands, expected 1, 2 or 3")));
                }
                let count = sh_n.count.ok_or_else(|| wrong("shN", "has no count"))?;
                let count = usize::try_from(count).ok().filter(|count| (1..=1 << 16).contains(count));
                let count = count.ok_or_else(|| wrong("shN", "has a count outside of 1 to 65536"))?;
                Some(Palette {
                    count,
                    coefficients: sh_coefficients(bands) - 1,
                    table: table(sh_n.codebook, "shN")?,
                    files: sh_n.files.exactly("shN", wrong)?,
                })
            }
        };
        let layout = Layout {
            count,
            sh_degree: 0,
            antialiased: self.antialias,
            mins: self.means.mins.ok_or_else(|| wrong("means", "has no mins"))?,
            maxs: self.means.maxs.ok_or_else(|| wrong("means", "has no maxs"))?,
            scales: [scales; 3],
            sh0: [sh0; 3],
            opacity: std::array::from_fn(|byte| byte as f32 / 255.0),
            palette,
            means: self.means.files.exactly("means", wrong)?,
            other: others(self.scales.files, self.quats.files, self.sh0.files, wrong)?,
        };
        Ok((layout, patched))
    }

    fn version_1(self, wrong: &Wrong<'_>) -> Result<(Layout, Vec<&'static str>), SceneError> {
        if let Some(encoding) = &self.quats.encoding
            && encoding != "quaternion_packed"
        {
            return Err(wrong(
                "quats",
                &format!("has the encoding “{encoding}”, expected quaternion_packed"),
            ));
        }
        let Shape(count) = self.means.shape.ok_or_else(|| wrong("means", "has no shape"))?;
        let linear = |min: f64, max: f64| -> Table {
            std::array::from_fn(|byte| (min + (max - min) * (byte as f64 / 255.0)) as f32)
        };
        let scales = range(self.scales.mins, self.scales.maxs, "scales", wrong)?;
        let sh0 = range(self.sh0.mins, self.sh0.maxs, "sh0", wrong)?;
        let palette = match self.sh_n {
            None => None,
            Some(sh_n) => {
                let (min, max) = range(sh_n.mins, sh_n.maxs, "shN", wrong)?;
                // Count and degree follow from the image.
                let (count, coefficients) = (0, 0);
                let files = sh_n.files.exactly("shN", wrong)?;
                Some(Palette { count, coefficients, table: linear(min, max), files })
            }
        };
        let (mins, maxs) = range(self.means.mins, self.means.maxs, "means", wrong)?;
        let layout = Layout {
            count,
            sh_degree: 0,
            antialiased: false,
            mins,
            maxs,
            scales: std::array::from_fn(|axis| linear(scales.0[axis], scales.1[axis])),
            sh0: std::array::from_fn(|channel| linear(sh0.0[channel], sh0.1[channel])),
            opacity: linear(sh0.0[3], sh0.1[3]).map(|logit| 1.0 / (1.0 + (-logit).exp())),
            palette,
            means: self.means.files.exactly("means", wrong)?,
            other: others(self.scales.files, self.quats.files, self.sh0.files, wrong)?,
        };
        Ok((layout, Vec::new()))
    }
}

fn range<Range>(
    mins: Option<Range>,
    maxs: Option<Range>,
    property: &str,
    wrong: &Wrong<'_>,
) -> Result<(Range, Range), SceneError> {
    mins.zip(maxs).ok_or_else(|| wrong(property, "lacks mins or maxs"))
}

fn others(scales: Files, quats: Files, sh0: Files, wrong: &Wrong<'_>) -> Result<[String; 3], SceneError> {
    let [scales] = scales.exactly("scales", wrong)?;
    let [quats] = quats.exactly("quats", wrong)?;
    let [sh0] = sh0.exactly("sh0", wrong)?;
    Ok([scales, quats, sh0])
}

impl Files {
    fn exactly<const N: usize>(self, property: &str, wrong: &Wrong<'_>) -> Result<[String; N], SceneError> {
        self.0.try_into().map_err(|files: Vec<String>| {
            wrong(property, &format!("names {} files, expected {N}", files.len()))
        })
    }
}

// Lists are read element by element up to their greatest length, so that no damaged file fills memory.

impl<'de> serde::Deserialize<'de> for Files {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Names;
        impl<'de> Visitor<'de> for Names {
            type Value = Files;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("one or two file names")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Files, A::Error> {
                let mut names = Vec::new();
                while let Some(name) = seq.next_element()? {
                    if names.len() == 2 {
                        return Err(A::Error::invalid_length(3, &self));
                    }
                    names.push(name);
                }
                Ok(Files(names))
            }
        }
        deserializer.deserialize_seq(Names)
    }
}

impl<'de> serde::Deserialize<'de> for Shape {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct First;
        impl<'de> Visitor<'de> for First {
            type Value = Shape;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a shape, the number of splats first")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Shape, A::Error> {
                let first = seq.next_element()?.ok_or_else(|| A::Error::invalid_length(0, &self))?;
                while seq.next_element::<u64>()?.is_some() {}
                Ok(Shape(first))
            }
        }
        deserializer.deserialize_seq(First)
    }
}

impl<'de> serde::Deserialize<'de> for Codebook {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Values;
        impl<'de> Visitor<'de> for Values {
            type Value = Codebook;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a codebook of 256 numbers")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Codebook, A::Error> {
                let mut codebook = Codebook { table: Box::new([0.0; 256]), first_is_null: false };
                for (i, value) in codebook.table.iter_mut().enumerate() {
                    match seq.next_element::<Option<f32>>()? {
                        Some(Some(number)) => *value = number,
                        Some(None) if i == 0 => codebook.first_is_null = true,
                        Some(None) => {
                            return Err(A::Error::custom(format!("value {i} of a codebook is null")));
                        }
                        None => return Err(A::Error::invalid_length(i, &self)),
                    }
                }
                if seq.next_element::<f32>()?.is_some() {
                    return Err(A::Error::invalid_length(257, &self));
                }
                Ok(codebook)
            }
        }
        deserializer.deserialize_seq(Values)
    }
}
