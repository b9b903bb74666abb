//! Lossless WebP images, decoded on all cores, interruptibly.

use std::io::{self, BufRead, Read, Seek, SeekFrom};

use image_webp::{DecodingError, WebPDecoder};

use super::container::Place;
use crate::SceneError;
use crate::load::LoadContext;
use crate::source::Source;

const LOSSLESS: &str = "Save the scene again, with lossless WebP images";

/// An 8-bit image.
pub(super) struct Image {
    /// Width, pixels.
    pub(super) width: u32,
    /// Height, pixels.
    pub(super) height: u32,
    /// 3 or 4 bytes a pixel, rows from the top.
    channels: usize,
    bytes: Vec<u8>,
}

impl Image {
    /// Red, green, blue and alpha of a pixel, row-major. An image without alpha has 255.
    #[inline]
    pub(super) fn pixel(&self, index: usize) -> [u8; 4] {
        let at = index * self.channels;
        match self.bytes[at..at + self.channels] {
            [r, g, b] => [r, g, b, 255],
            [r, g, b, a] => [r, g, b, a],
            _ => [0; 4],
        }
    }
}

/// Reports progress and stops decoding when loading is cancelled.
pub(super) struct Interrupt<'a> {
    pub(super) source: &'a Source,
    pub(super) ctx: &'a LoadContext<'a>,
    /// Bytes of compressed image in the whole work.
    pub(super) total: u64,
}

/// Width and height from an image's header, after checking that it is one that Motes reads.
pub(super) fn size(place: &Place, name: &str, bytes: &[u8]) -> Result<(u32, u32), SceneError> {
    let mut decoder = WebPDecoder::new(io::Cursor::new(bytes)).map_err(|error| wrong(place, name, &error))?;
    check(place, name, &mut decoder)?;
    Ok(decoder.dimensions())
}

/// Decodes the files of one scene; `names` are theirs.
pub(super) fn decode_all(
    place: &Place,
    names: &[&str],
    files: Vec<Vec<u8>>,
    interrupt: &Interrupt<'_>,
) -> Result<Vec<Image>, SceneError> {
    let mut results: Vec<Option<Result<Image, SceneError>>> = files.iter().map(|_| None).collect();
    let mut tasks: Vec<_> = results.iter_mut().zip(files).zip(names).collect();
    // The longest first, one image a task: the palette alone may take as long as all others together.
    tasks.sort_by_key(|((_, bytes), _)| std::cmp::Reverse(bytes.len()));
    rayon::scope_fifo(|scope| {
        for ((result, bytes), name) in tasks {
            scope.spawn_fifo(move |_| *result = Some(decode(place, name, &bytes, interrupt)));
        }
    });
    results.into_iter().flatten().collect()
}

fn decode(place: &Place, name: &str, bytes: &[u8], interrupt: &Interrupt<'_>) -> Result<Image, SceneError> {
    let (mut seen, mut cancelled) = (0, None);
    let reader = Windowed { bytes, at: 0, seen: &mut seen, interrupt, cancelled: &mut cancelled };
    let result = (|| {
        let mut decoder = WebPDecoder::new(reader)?;
        let (width, height) = decoder.dimensions();
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let size = decoder.output_buffer_size().ok_or(DecodingError::ImageTooLarge)?;
        let mut pixels = vec![0; size];
        decoder.read_image(&mut pixels)?;
        Ok(Image { width, height, channels, bytes: pixels })
    })();
    if let Some(cancelled) = cancelled {
        return Err(cancelled);
    }
    let image = result.map_err(|error| wrong(place, name, &error))?;
    let Interrupt { source, ctx, total } = interrupt;
    ctx.advance(source, (bytes.len() - seen) as u64, *total)?;
    Ok(image)
}

fn check<R: BufRead + Seek>(
    place: &Place,
    name: &str,
    decoder: &mut WebPDecoder<R>,
) -> Result<(), SceneError> {
    if decoder.is_animated() {
        return Err(place.wrong(name, "the image", "is an animation", LOSSLESS));
    }
    if decoder.is_lossy() {
        let problem = "is compressed with loss, which scatters splats at random";
        return Err(place.wrong(name, "the image", problem, LOSSLESS));
    }
    Ok(())
}

fn wrong(place: &Place, name: &str, error: &DecodingError) -> SceneError {
    let problem = format!("cannot be decoded: {error}");
    place.wrong(name, "the image", problem, "It is damaged: copy or export the scene again")
}

/// Bytes in memory, handed out in windows, so that the decoder comes by often enough to be told to stop.
struct Windowed<'a, 'b> {
    bytes: &'a [u8],
    at: usize,
    /// How far progress is reported: seeking back is no progress.
    seen: &'a mut usize,
    interrupt: &'a Interrupt<'b>,
    cancelled: &'a mut Option<SceneError>,
}

/// About a millisecond of decoding.
const WINDOW: usize = 1 << 14;

impl Read for Windowed<'_, '_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let window = self.fill_buf()?;
        let count = window.len().min(buffer.len());
        buffer[..count].copy_from_slice(&window[..count]);
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Windowed<'_, '_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        let start = self.at.min(self.bytes.len());
        let end = (start + WINDOW).min(self.bytes.len());
        if start >= *self.seen + WINDOW {
            let Interrupt { source, ctx, total } = self.interrupt;
            let work = (start - *self.seen) as u64;
            *self.seen = start;
            if let Err(error) = ctx.advance(source, work, *total) {
                *self.cancelled = Some(error);
                return Err(io::Error::other("stopped"));
            }
        }
        Ok(&self.bytes[start..end])
    }

    fn consume(&mut self, count: usize) {
        self.at += count;
    }
}

impl Seek for Windowed<'_, '_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => (self.at as u64).checked_add_signed(by),
            SeekFrom::End(by) => (self.bytes.len() as u64).checked_add_signed(by),
        };
        let at = at.and_then(|at| usize::try_from(at).ok());
        self.at = at.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.at as u64)
    }
}
