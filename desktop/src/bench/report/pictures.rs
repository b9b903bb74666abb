//! Pictures in the page: thumbnails as data addresses, within a budget of bytes.

use std::collections::BTreeMap;
use std::path::Path;

use base64::Engine as _;

use super::super::BenchError;
use crate::measure::{ColourMap, Picture, flip_map};

/// Width of a thumbnail, pixels.
const WIDTH: u32 = 240;

/// FLIP error that a map's last colour stands for.
pub const ERROR_SHOWN: f64 = 0.5;

/// Pictures by name, as `data:` addresses.
pub struct Album {
    /// The addresses.
    pub pictures: BTreeMap<String, String>,
    left: usize,
}

impl Album {
    /// With room for so many bytes.
    pub fn new(bytes: usize) -> Self {
        Self { pictures: BTreeMap::new(), left: bytes }
    }

    /// Adds a picture from a file, whatever room is left.
    pub fn add(&mut self, name: &str, file: &Path) -> Result<(), BenchError> {
        let small = shrunk(&Picture::load(file)?);
        self.put(name, true_colour(&small)?);
        Ok(())
    }

    /// Adds a configuration's picture, its map of FLIP errors, and that of its layers where there is one. `false`: no room is left.
    pub fn add_pair(
        &mut self,
        name: &str,
        picture: &Path,
        truth: &Path,
        layers: &Path,
        pixels_per_degree: f32,
    ) -> Result<bool, BenchError> {
        let (picture, truth) = (Picture::load(picture)?, Picture::load(truth)?);
        let errors = flip_map(&truth, &picture, pixels_per_degree)?;
        let grey = Picture::new(picture.size(), errors.iter().map(|&e| [e; 3]).collect())?;
        let (small, map) = (shrunk(&picture), shrunk(&grey));
        let (small, map) = (true_colour(&small)?, palette(&map)?);
        let layers =
            if layers.exists() { Some(true_colour(&shrunk(&Picture::load(layers)?))?) } else { None };
        if small.len() + map.len() + layers.as_ref().map_or(0, Vec::len) > self.left {
            return Ok(false);
        }
        self.put(name, small);
        self.put(&format!("{name}|error"), map);
        if let Some(layers) = layers {
            self.put(&format!("{name}|layers"), layers);
        }
        Ok(true)
    }

    fn put(&mut self, name: &str, png: Vec<u8>) {
        let text = base64::engine::general_purpose::STANDARD.encode(&png);
        self.left = self.left.saturating_sub(text.len());
        self.pictures.insert(name.to_owned(), format!("data:image/png;base64,{text}"));
    }
}

/// Averaged down to at most [`WIDTH`] pixels a row.
fn shrunk(picture: &Picture) -> Picture {
    let [w, h] = picture.size();
    let width = WIDTH.min(w);
    let height = (u64::from(h) * u64::from(width) / u64::from(w)).max(1) as u32;
    let edge = |i: u32, n: u32, size: u32| (u64::from(i) * u64::from(size) / u64::from(n)) as usize;
    let mut pixels = Vec::with_capacity((width * height) as usize);
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut count) = ([0.0f32; 3], 0.0);
            for row in edge(y, height, h)..edge(y + 1, height, h) {
                for column in edge(x, width, w)..edge(x + 1, width, w) {
                    let p = picture.pixels()[row * w as usize + column];
                    sum = [sum[0] + p[0], sum[1] + p[1], sum[2] + p[2]];
                    count += 1.0;
                }
            }
            pixels.push(sum.map(|s| s / count));
        }
    }
    // As many pixels as the size says, all finite.
    Picture::new([width, height], pixels).unwrap_or_else(|_| picture.clone())
}

fn encoded(size: [u32; 2], data: &[u8], palette: Option<Vec<u8>>) -> Result<Vec<u8>, BenchError> {
    let mut bytes = Vec::new();
    let error = |e: png::EncodingError| BenchError::Setting(format!("thumbnail: {e}"));
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    match palette {
        None => encoder.set_color(png::ColorType::Rgb),
        Some(colours) => {
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_palette(colours);
        }
    }
    let mut writer = encoder.write_header().map_err(error)?;
    writer.write_image_data(data).map_err(error)?;
    writer.finish().map_err(error)?;
    Ok(bytes)
}

fn true_colour(picture: &Picture) -> Result<Vec<u8>, BenchError> {
    encoded(picture.size(), &picture.to_rgb8(), None)
}

/// A map of errors in magma; 64 colours are enough to see by, and small.
fn palette(map: &Picture) -> Result<Vec<u8>, BenchError> {
    const COLOURS: u32 = 64;
    let colours =
        (0..COLOURS).flat_map(|i| ColourMap::Magma.colour(f64::from(i) / f64::from(COLOURS - 1))).collect();
    let index = |p: &[f32; 3]| {
        let share = (f64::from(p[0]) / ERROR_SHOWN).clamp(0.0, 1.0);
        (share * f64::from(COLOURS - 1)).round() as u8
    };
    let data: Vec<u8> = map.pixels().iter().map(index).collect();
    encoded(map.size(), &data, Some(colours))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thumbnails_are_means_and_the_budget_holds() {
        let pixels =
            (0..480 * 4).map(|i| if i % 2 == 0 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] }).collect();
        let small = shrunk(&Picture::new([480, 4], pixels).unwrap());
        assert_eq!(small.size(), [240, 2]);
        assert!(small.pixels().iter().all(|p| *p == [0.5, 0.0, 0.5]));
        let folder = std::env::temp_dir().join(format!("motes-album-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (a, b) = (folder.join("a.png"), folder.join("b.png"));
        for (path, v) in [(&a, 0.2), (&b, 0.9)] {
            Picture::new([16, 16], vec![[v; 3]; 256]).unwrap().save(path).unwrap();
        }
        let mut album = Album::new(100_000);
        assert!(album.add_pair("x", &b, &a, &folder.join("none.png"), 67.0).unwrap());
        assert_eq!(album.pictures.keys().collect::<Vec<_>>(), ["x", "x|error"]);
        assert!(!Album::new(10).add_pair("x", &b, &a, &folder.join("none.png"), 67.0).unwrap());
        // What is shown is a PNG that decodes to the map's colour.
        let text = album.pictures["x|error"].strip_prefix("data:image/png;base64,").unwrap();
        let bytes = base64::engine::general_purpose::STANDARD.decode(text).unwrap();
        let file = folder.join("map.png");
        std::fs::write(&file, bytes).unwrap();
        let map = Picture::load(&file).unwrap();
        let error =
            f64::from(flip_map(&Picture::load(&a).unwrap(), &Picture::load(&b).unwrap(), 67.0).unwrap()[100]);
        let expected = ColourMap::Magma.colour(((error / ERROR_SHOWN).min(1.0) * 63.0).round() / 63.0);
        assert_eq!(map.to_rgb8()[300..303], expected);
    }
}
