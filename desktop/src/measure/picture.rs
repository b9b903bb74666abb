//! A picture in memory, and PNG files.

use std::fs::File;
use std::io::{BufReader, BufWriter, Write as _};
use std::path::Path;

use super::MeasureError;

/// Pixels of the largest picture that is read: 2²⁸.
pub const MAX_PIXELS: u64 = 1 << 28;

/// A picture as it is shown: sRGB-encoded colours from 0 to 1, by rows from the upper left.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    size: [u32; 2],
    pixels: Vec<[f32; 3]>,
}

impl Picture {
    /// From colours by rows. Values are clamped to `0 ..= 1`, as a screen clamps them.
    ///
    /// # Errors
    /// Where a side is 0, the number of pixels is not width × height, or a value is not finite.
    pub fn new(size: [u32; 2], mut pixels: Vec<[f32; 3]>) -> Result<Self, MeasureError> {
        check_size(size, pixels.len())?;
        for (i, pixel) in pixels.iter_mut().enumerate() {
            if !pixel.iter().all(|c| c.is_finite()) {
                let (x, y) = (i % size[0] as usize, i / size[0] as usize);
                return Err(MeasureError::Pixels(format!(
                    "pixel ({x}, {y}) is {pixel:?}, not a finite colour"
                )));
            }
            *pixel = pixel.map(|c| c.clamp(0.0, 1.0));
        }
        Ok(Self { size, pixels })
    }

    /// From 8-bit colours by rows, three bytes a pixel.
    ///
    /// # Errors
    /// Where a side is 0 or the number of bytes is not 3 × width × height.
    pub fn from_rgb8(size: [u32; 2], bytes: &[u8]) -> Result<Self, MeasureError> {
        let (pixels, rest) = bytes.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(MeasureError::Pixels(format!("{} bytes are no whole number of pixels", bytes.len())));
        }
        check_size(size, pixels.len())?;
        Ok(Self { size, pixels: pixels.iter().map(|p| p.map(|c| f32::from(c) / 255.0)).collect() })
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Colours by rows.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// The picture with a function applied to every pixel, whose results are finite and `0 ..= 1`.
    pub(super) fn mapped(&self, function: impl Fn(&[f32; 3]) -> [f32; 3]) -> Self {
        Self { size: self.size, pixels: self.pixels.iter().map(function).collect() }
    }

    /// The picture at another size: each pixel is the mean of the area that it covers.
    ///
    /// # Errors
    /// An empty size.
    pub fn resized(&self, size: [u32; 2]) -> Result<Self, MeasureError> {
        let scale = [0, 1].map(|k| f64::from(self.size[k]) / f64::from(size[k].max(1)));
        // What a destination pixel covers of each source pixel along one axis.
        let covers = |i: u32, k: usize| {
            let (low, high) = (f64::from(i) * scale[k], f64::from(i + 1) * scale[k]);
            let last = (high.ceil() as u32).min(self.size[k]);
            (low as u32..last).map(move |s| (s, high.min(f64::from(s) + 1.0) - low.max(f64::from(s))))
        };
        let mut pixels = Vec::new();
        for y in 0..size[1] {
            for x in 0..size[0] {
                let (mut sum, mut area) = ([0.0; 3], 0.0);
                for (sy, wy) in covers(y, 1) {
                    for (sx, wx) in covers(x, 0) {
                        let pixel = self.pixels[sy as usize * self.size[0] as usize + sx as usize];
                        for c in 0..3 {
                            sum[c] += f64::from(pixel[c]) * wx * wy;
                        }
                        area += wx * wy;
                    }
                }
                pixels.push(sum.map(|v| (v / area) as f32));
            }
        }
        Self::new(size, pixels)
    }

    /// 8-bit colours by rows, rounded to nearest.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.pixels.iter().flat_map(|p| p.map(|c| (c * 255.0).round() as u8)).collect()
    }

    /// Reads a PNG: grey, palette or colour, of any depth (16 bits are cut to 8).
    ///
    /// # Errors
    /// Where the file cannot be read, is no PNG, is larger than [`MAX_PIXELS`], or has transparent pixels, whose
    /// colour would depend on what lies behind.
    pub fn load(path: &Path) -> Result<Self, MeasureError> {
        let Decoded { size, samples, channels, .. } =
            decode(path, png::Transformations::normalize_to_color8())?;
        let problem = |problem: String, remedy| MeasureError::File { path: path.to_owned(), problem, remedy };
        let mut rgb = Vec::with_capacity(size[0] as usize * size[1] as usize * 3);
        for (i, pixel) in samples.chunks_exact(channels).enumerate() {
            let (colour, alpha) = match *pixel {
                [grey] => ([grey; 3], 255),
                [grey, alpha] => ([grey; 3], alpha),
                [r, g, b] => ([r, g, b], 255),
                [r, g, b, alpha] => ([r, g, b], alpha),
                _ => return Err(problem(format!("{channels} channels"), "Save it as an RGB PNG")),
            };
            if alpha != 255 {
                let (x, y) = (i % size[0] as usize, i / size[0] as usize);
                return Err(problem(
                    format!("pixel ({x}, {y}) is transparent"),
                    "Flatten it onto a background first",
                ));
            }
            rgb.extend(colour);
        }
        Self::from_rgb8(size, &rgb)
    }

    /// Writes an 8-bit RGB PNG, marked as sRGB.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), MeasureError> {
        let io = |source| MeasureError::Io { path: path.to_owned(), source };
        let encoding = |e: png::EncodingError| match e {
            png::EncodingError::IoError(source) => MeasureError::Io { path: path.to_owned(), source },
            other => io(std::io::Error::other(other.to_string())),
        };
        let mut file = BufWriter::new(File::create(path).map_err(io)?);
        let mut encoder = png::Encoder::new(&mut file, self.size[0], self.size[1]);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header().map_err(encoding)?;
        writer.write_image_data(&self.to_rgb8()).map_err(encoding)?;
        writer.finish().map_err(encoding)?;
        file.flush().map_err(io)
    }
}

fn check_size(size: [u32; 2], pixels: usize) -> Result<(), MeasureError> {
    let [w, h] = size;
    if w == 0 || h == 0 || u64::from(w) * u64::from(h) != pixels as u64 {
        return Err(MeasureError::Pixels(format!("{pixels} pixels do not fill {w} × {h}")));
    }
    Ok(())
}

/// What a PNG holds.
pub(super) struct Decoded {
    pub size: [u32; 2],
    /// Packed samples, every row filled up to whole bytes.
    pub samples: Vec<u8>,
    /// Bits of a sample.
    pub bits: usize,
    /// Samples of a pixel.
    pub channels: usize,
}

/// Reads a PNG.
pub(super) fn decode(path: &Path, transformations: png::Transformations) -> Result<Decoded, MeasureError> {
    let remedy = "Give a PNG file that a picture viewer opens";
    let problem = |problem: String| MeasureError::File { path: path.to_owned(), problem, remedy };
    let decoding = |e: png::DecodingError| match e {
        png::DecodingError::IoError(source) if source.kind() != std::io::ErrorKind::UnexpectedEof => {
            MeasureError::Io { path: path.to_owned(), source }
        }
        other => problem(other.to_string()),
    };
    let file = File::open(path).map_err(|source| MeasureError::Io { path: path.to_owned(), source })?;
    // Eight bytes a pixel at most; the size is checked before anything of that order is allocated.
    let limits = png::Limits { bytes: usize::try_from(MAX_PIXELS * 8).unwrap_or(usize::MAX) };
    let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), limits);
    decoder.set_transformations(transformations);
    let mut reader = decoder.read_info().map_err(decoding)?;
    let info = reader.info();
    let size = [info.width, info.height];
    if u64::from(size[0]) * u64::from(size[1]) > MAX_PIXELS {
        return Err(problem(format!("{} × {} pixels are more than {MAX_PIXELS}", size[0], size[1])));
    }
    let bytes = reader.output_buffer_size().ok_or_else(|| problem("its size overflows".to_owned()))?;
    let mut samples = Vec::new();
    samples
        .try_reserve_exact(bytes)
        .map_err(|_| problem(format!("no memory for {bytes} bytes of pixels")))?;
    samples.resize(bytes, 0);
    let frame = reader.next_frame(&mut samples).map_err(decoding)?;
    samples.truncate(frame.buffer_size());
    Ok(Decoded { size, samples, bits: frame.bit_depth as usize, channels: frame.color_type.samples() })
}

#[cfg(test)]
mod tests {
    use super::super::tests::pair;
    use super::*;

    fn file(name: &str) -> std::path::PathBuf {
        let folder = std::env::temp_dir().join(format!("motes-measure-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder.join(name)
    }

    #[test]
    fn what_is_written_is_read_back() {
        let (picture, other) = pair(33, 21);
        let path = file("round.png");
        picture.save(&path).unwrap();
        let back = Picture::load(&path).unwrap();
        assert_eq!(back, picture);
        assert_ne!(back, other);
    }

    #[test]
    fn greys_and_palettes_become_colours_and_transparency_is_refused() {
        let write = |name: &str, colour, depth, palette: Option<Vec<u8>>, data: &[u8]| {
            let path = file(name);
            let mut encoder = png::Encoder::new(File::create(&path).unwrap(), 2, 1);
            encoder.set_color(colour);
            encoder.set_depth(depth);
            if let Some(p) = palette {
                encoder.set_palette(p);
            }
            encoder.write_header().unwrap().write_image_data(data).unwrap();
            path
        };
        use png::{BitDepth, ColorType};
        let grey = write("grey.png", ColorType::Grayscale, BitDepth::Sixteen, None, &[0x80, 0xff, 0, 0]);
        assert_eq!(Picture::load(&grey).unwrap().to_rgb8(), [128, 128, 128, 0, 0, 0]);
        let palette = Some(vec![1, 2, 3, 250, 251, 252]);
        let indexed = write("indexed.png", ColorType::Indexed, BitDepth::One, palette, &[0b0100_0000]);
        assert_eq!(Picture::load(&indexed).unwrap().to_rgb8(), [1, 2, 3, 250, 251, 252]);
        let opaque =
            write("opaque.png", ColorType::Rgba, BitDepth::Eight, None, &[9, 8, 7, 255, 6, 5, 4, 255]);
        assert_eq!(Picture::load(&opaque).unwrap().to_rgb8(), [9, 8, 7, 6, 5, 4]);
        let clear = write("clear.png", ColorType::Rgba, BitDepth::Eight, None, &[9, 8, 7, 255, 6, 5, 4, 254]);
        let error = Picture::load(&clear).unwrap_err().to_string();
        assert!(error.contains("pixel (1, 0) is transparent. Flatten"), "{error}");
    }

    #[test]
    fn bad_files_and_pixels_are_named() {
        let missing = Picture::load(&file("missing.png")).unwrap_err();
        assert!(matches!(missing, MeasureError::Io { .. }) && missing.to_string().contains("missing.png"));
        let path = file("cut.png");
        pair(40, 40).0.save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in [0, 4, 20, 60, whole.len() / 2, whole.len() - 30] {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = Picture::load(&path).unwrap_err();
            assert!(matches!(error, MeasureError::File { .. }), "{length}: {error}");
            assert!(error.to_string().contains("cut.png"));
        }
        // A header that promises 100 000 × 100 000 pixels is refused before they are allocated.
        let mut huge = whole.clone();
        huge[16..24].copy_from_slice(&[0, 1, 0x86, 0xa0, 0, 1, 0x86, 0xa0]);
        let crc = crc32(&huge[12..29]);
        huge[29..33].copy_from_slice(&crc.to_be_bytes());
        std::fs::write(&path, &huge).unwrap();
        let error = Picture::load(&path).unwrap_err().to_string();
        assert!(error.contains("100000 × 100000 pixels are more than"), "{error}");

        assert!(Picture::new([2, 2], vec![[0.0; 3]; 3]).is_err());
        assert!(Picture::new([0, 0], vec![]).is_err());
        assert!(Picture::from_rgb8([1, 1], &[0; 4]).is_err());
        let error = Picture::new([2, 1], vec![[0.0; 3], [0.0, f32::NAN, 0.0]]).unwrap_err().to_string();
        assert!(error.contains("pixel (1, 0)"), "{error}");
        assert_eq!(Picture::new([1, 1], vec![[-1.0, 0.5, 7.0]]).unwrap().pixels(), [[0.0, 0.5, 1.0]]);
        assert!(pair(2, 2).0.save(Path::new("/no/such/folder/a.png")).is_err());
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0, |crc, &b| {
            (0..8).fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
        })
    }

    #[test]
    fn smaller_pictures_are_means_of_areas() {
        let picture = Picture::new([4, 2], (0..8).map(|i| [i as f32 / 10.0, 0.5, 1.0]).collect()).unwrap();
        let half = picture.resized([2, 1]).unwrap();
        assert_eq!(half.size(), [2, 1]);
        assert!((half.pixels()[0][0] - 0.25).abs() < 1e-6 && (half.pixels()[1][0] - 0.45).abs() < 1e-6);
        assert!((half.pixels()[0][1] - 0.5).abs() < 1e-6 && (half.pixels()[0][2] - 1.0).abs() < 1e-6);
        let third = picture.resized([3, 2]).unwrap();
        assert!((third.pixels()[1][0] - 0.15).abs() < 1e-6, "half of two pixels");
        assert_eq!(picture.resized([4, 2]).unwrap(), picture);
        assert!(picture.resized([0, 2]).is_err());
    }
}
