//! A class per pixel.

use std::path::Path;

use super::MeasureError;
use super::picture::{Decoded, decode};

/// A class index per pixel, by rows from the upper left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClassMask {
    size: [u32; 2],
    classes: Vec<u8>,
}

impl ClassMask {
    /// From class indices by rows.
    ///
    /// # Errors
    /// Where the number of pixels is not width × height.
    pub fn new(size: [u32; 2], classes: Vec<u8>) -> Result<Self, MeasureError> {
        if u64::from(size[0]) * u64::from(size[1]) != classes.len() as u64 {
            return Err(MeasureError::Pixels(format!(
                "{} classes do not fill a mask of {} × {}",
                classes.len(),
                size[0],
                size[1]
            )));
        }
        Ok(Self { size, classes })
    }

    /// Reads a PNG whose pixel *values* are the classes: palette (the index counts, not the colour) or grey, up to 8 bits.
    ///
    /// # Errors
    /// Where the file cannot be read, is no PNG, or has several channels or 16 bits.
    pub fn load(path: &Path) -> Result<Self, MeasureError> {
        let Decoded { size, samples, bits, channels } = decode(path, png::Transformations::IDENTITY)?;
        if channels != 1 || bits > 8 {
            return Err(MeasureError::File {
                path: path.to_owned(),
                problem: format!("{channels} channels of {bits} bits are no class per pixel"),
                remedy: "Give a palette or grey PNG of at most 8 bits, whose pixel values are the classes",
            });
        }
        let width = size[0] as usize;
        let (per_byte, low) = (8 / bits, (0xff_u16 >> (8 - bits)) as u8);
        let classes = samples
            .chunks_exact(width.div_ceil(per_byte))
            .flat_map(|row| {
                (0..width).map(move |x| row[x / per_byte] >> (8 - bits * (x % per_byte + 1)) & low)
            })
            .collect();
        Self::new(size, classes)
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Class indices by rows.
    pub fn classes(&self) -> &[u8] {
        &self.classes
    }

    /// The mask at another size: each pixel takes the class at its middle.
    ///
    /// # Errors
    /// An empty size.
    pub fn resized(&self, size: [u32; 2]) -> Result<Self, MeasureError> {
        let at = |i: u32, to: u32, from: u32| ((f64::from(i) + 0.5) * f64::from(from) / f64::from(to)) as u32;
        let [w, h] = size;
        let rows = (0..h).map(|y| at(y, h, self.size[1]).min(self.size[1] - 1));
        let classes = rows
            .flat_map(|y| (0..w).map(move |x| self.class(at(x, w, self.size[0]).min(self.size[0] - 1), y)));
        Self::new(size, classes.collect())
    }

    /// Writes a palette PNG: the index is the class, and `colour` says what it looks like.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn save(&self, path: &Path, colour: impl Fn(u8) -> [u8; 3]) -> Result<(), MeasureError> {
        let io = |source| MeasureError::Io { path: path.to_owned(), source };
        let encoding = |e: png::EncodingError| io(std::io::Error::other(e));
        let file = std::io::BufWriter::new(std::fs::File::create(path).map_err(io)?);
        let mut encoder = png::Encoder::new(file, self.size[0], self.size[1]);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette((0..=u8::MAX).flat_map(colour).collect::<Vec<u8>>());
        let mut writer = encoder.write_header().map_err(encoding)?;
        writer.write_image_data(&self.classes).map_err(encoding)?;
        writer.finish().map_err(encoding)
    }

    /// The class in column `x` and row `y`.
    pub fn class(&self, x: u32, y: u32) -> u8 {
        self.classes[y as usize * self.size[0] as usize + x as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(name: &str, width: u32, depth: png::BitDepth, data: &[u8]) -> std::path::PathBuf {
        let path = std::env::temp_dir().join(format!("motes-mask-{}-{name}", std::process::id()));
        let mut encoder = png::Encoder::new(std::fs::File::create(&path).unwrap(), width, 2);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(depth);
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        path
    }

    #[test]
    fn values_are_classes_at_every_depth() {
        use png::BitDepth::{Eight, Four, One, Sixteen, Two};
        let load = |path: std::path::PathBuf| ClassMask::load(&path).unwrap().classes;
        assert_eq!(load(write("1", 3, One, &[0b1010_0000, 0b0110_0000])), [1, 0, 1, 0, 1, 1]);
        assert_eq!(load(write("2", 3, Two, &[0b1101_1000, 0])), [3, 1, 2, 0, 0, 0]);
        assert_eq!(load(write("4", 1, Four, &[0x70, 0xf0])), [7, 15]);
        assert_eq!(load(write("8", 1, Eight, &[200, 9])), [200, 9]);
        let path = std::env::temp_dir().join(format!("motes-mask-{}-palette", std::process::id()));
        let mask = ClassMask::new([3, 2], vec![0, 1, 255, 7, 7, 2]).unwrap();
        mask.save(&path, |class| [class, 0, 255 - class]).unwrap();
        assert_eq!(ClassMask::load(&path).unwrap(), mask);
        let error = ClassMask::load(&write("16", 1, Sixteen, &[0; 4])).unwrap_err().to_string();
        assert!(error.contains("1 channels of 16 bits"), "{error}");
        assert!(ClassMask::new([2, 2], vec![0; 3]).is_err());
    }
}
