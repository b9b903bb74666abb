//! Niantic's SPZ, versions 1 to 4.
//!
//! Attributes one after the other, each for all splats: means (24-bit fixed point; version 1: half floats),
//! opacities, colours, log-scales, rotations (version 3 on: the three smaller components in 10 bits each; before:
//! x, y, z in a byte each, w ≥ 0), higher bands with the colour channel innermost. Versions 1 to 3 are one gzip stream
//! with a header of 16 bytes; version 4 has a plain header of 32 bytes and a zstd stream per attribute.
//!
//! Axes are left as the file has them. By the format's definition they are x right, y up, z back; some converters
//! write other axes all the same.
//!
//! Source: Niantic, "spz" (read-me, extensions' read-me, and the behaviour of its reader), and the sample files.

mod decode;
mod encode;

use std::io::Read;

use flate2::read::MultiGzDecoder;
use rayon::prelude::*;
use ruzstd::decoding::FrameDecoder;

use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats, sh_coefficients};

pub(crate) use encode::write;

const MAGIC: &[u8; 4] = b"NGSP";

/// Colour that a byte stands for: `(byte / 255 − ½) / COLOR_SCALE` is the constant band's coefficient.
const COLOR_SCALE: f32 = 0.15;

/// Flags of the header.
const ANTIALIASED: u8 = 0x01;
const HAS_EXTENSIONS: u8 = 0x02;
/// Spark's level-of-detail tree: the splats of all levels, one over the other.
const LEVEL_TREE: u8 = 0x80;

/// Extension records that say how the higher bands are quantised.
const SH_QUANTISATION: u32 = 0xadbe_0001;
const SAFE_ORBIT_CAMERA: u32 = 0xadbe_0002;

/// Largest degree that the format has; Motes shows three.
const MAX_DEGREE: u8 = 4;

const DAMAGED: &str = "It is damaged: copy or export it again";

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let bytes = source.read_all()?;
    if bytes.starts_with(MAGIC) { read_streams(source, &bytes, ctx) } else { read_gzip(source, &bytes, ctx) }
}

/// What the header says.
struct Header {
    version: u32,
    count: u64,
    /// Degree in the file, `0 ..= 4`.
    degree: u8,
    fractional_bits: u8,
    flags: u8,
}

impl Header {
    /// The part that all versions have in common.
    fn parse(source: &Source, bytes: &[u8]) -> Result<Self, SceneError> {
        let path = source.path();
        let &[m0, m1, m2, m3, v0, v1, v2, v3, c0, c1, c2, c3, degree, fractional_bits, flags, ..] = bytes
        else {
            return Err(SceneError::malformed(
                path,
                "the header",
                format!("ends after {} of 16 bytes", bytes.len()),
                DAMAGED,
            ));
        };
        if [m0, m1, m2, m3] != *MAGIC {
            let problem = format!("begins with “{}”, expected “NGSP”", [m0, m1, m2, m3].escape_ascii());
            return Err(SceneError::malformed(
                path,
                "the header",
                problem,
                "It is not an SPZ file, or damaged",
            ));
        }
        let version = u32::from_le_bytes([v0, v1, v2, v3]);
        let count = u64::from(u32::from_le_bytes([c0, c1, c2, c3]));
        if degree > MAX_DEGREE {
            let problem =
                format!("states spherical harmonics of degree {degree}, expected 0 to {MAX_DEGREE}");
            return Err(SceneError::malformed(path, "the header", problem, DAMAGED));
        }
        if flags & LEVEL_TREE != 0 {
            return Err(SceneError::unsupported(
                path,
                "it holds a tree of levels of detail (flag 0x80), whose splats lie one over the other",
                "Use the scene from which the levels were made",
            ));
        }
        Ok(Self { version, count, degree, fractional_bits, flags })
    }

    /// Bytes per splat of each attribute: means, opacities, colours, scales, rotations, higher bands.
    fn sizes(&self) -> [u64; 6] {
        let means = if self.version == 1 { 6 } else { 9 };
        let rotations = if self.version < 3 { 3 } else { 4 };
        [means, 1, 3, 3, rotations, 3 * (sh_coefficients(self.degree) as u64 - 1)]
    }

    /// Checks the version-independent rest and asks whether the splats may be had.
    fn admit(&self, source: &Source, ctx: &LoadContext<'_>) -> Result<usize, SceneError> {
        let path = source.path();
        if self.version > 1 && self.fractional_bits > 24 {
            let problem = format!("states {} fractional bits of 24-bit coordinates", self.fractional_bits);
            return Err(SceneError::malformed(path, "the header", problem, DAMAGED));
        }
        if self.flags & ANTIALIASED != 0 {
            ctx.set_antialiased();
        }
        if self.degree > 3 {
            ctx.warn(format!("{}: spherical harmonics of degree 4 are cut to degree 3", path.display()));
        }
        let degree = self.degree.min(3);
        let unpacked = self.sizes().iter().sum::<u64>() + Splats::bytes_per_splat(degree, false) as u64;
        let needed = self.count.saturating_mul(unpacked);
        super::expansion::check(path, "the header's count of splats", needed, source.len())?;
        ctx.admit(source, self.count, degree, false)
    }
}

/// Versions 1 to 3.
fn read_gzip(source: &Source, bytes: &[u8], ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let path = source.path();
    let failed =
        |error: std::io::Error| SceneError::malformed(path, "the gzip stream", error.to_string(), DAMAGED);
    let mut stream = MultiGzDecoder::new(bytes);
    let mut head = Vec::new();
    (&mut stream).take(16).read_to_end(&mut head).map_err(failed)?;
    let header = Header::parse(source, &head)?;
    if !(1..=3).contains(&header.version) {
        return Err(SceneError::unsupported(
            path,
            format!("SPZ version {} in a gzip stream (Motes reads 1, 2 and 3 there)", header.version),
            "Export it as version 3 or 4, or look for a newer Motes",
        ));
    }
    header.admit(source, ctx)?;
    let sizes = header.sizes();
    let total = header.count * sizes.iter().sum::<u64>();

    // The header's count does not size the buffer beyond what such a file may take: a count without contents behind
    // it fails at the stream's end.
    let mut body = Vec::new();
    let first = total.min(bytes.len() as u64 * 4 + (16 << 20)) as usize;
    body.reserve_exact(first);
    while (body.len() as u64) < total {
        if body.len() == body.capacity() {
            body.reserve_exact((total as usize - body.len()).min(body.len()));
        }
        const WINDOW: u64 = 1 << 20;
        let window = WINDOW.min((body.capacity() - body.len()) as u64).min(total - body.len() as u64);
        let read = (&mut stream).take(window).read_to_end(&mut body).map_err(failed)? as u64;
        if read < window {
            return Err(SceneError::malformed(
                path,
                "the gzip stream",
                format!(
                    "ends after {} of the {total} bytes that {} splats of degree {} take",
                    body.len(),
                    header.count,
                    header.degree
                ),
                DAMAGED,
            ));
        }
        // The rest of the work is a small part, and reported at its end.
        ctx.advance(source, read, total + total / 4)?;
    }
    // To the end, where the checksum is.
    let mut trailer = Vec::new();
    const MAX_TRAILER: u64 = 1 << 20;
    (&mut stream).take(MAX_TRAILER).read_to_end(&mut trailer).map_err(failed)?;
    let leading = body.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
    if header.flags & HAS_EXTENSIONS != 0 && matches!(leading, Some(SH_QUANTISATION | SAFE_ORBIT_CAMERA)) {
        return Err(SceneError::unsupported(
            path,
            "it has extension records before its splats, as only unreleased versions of the format's library wrote",
            "Save it again with a released version",
        ));
    }
    let range = sh_range(source, &header, &trailer)?;
    drop(stream);

    let mut rest = body.as_slice();
    let mut attributes = [rest; 6];
    for (attribute, size) in attributes.iter_mut().zip(sizes) {
        (*attribute, rest) = rest.split_at((header.count * size) as usize);
    }
    let splats = decode::decode(&header, &attributes, range);
    ctx.advance(source, total / 4, total + total / 4)?;
    Ok(splats)
}

/// Version 4.
fn read_streams(source: &Source, bytes: &[u8], ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let path = source.path();
    let header = Header::parse(source, bytes)?;
    if header.version != 4 {
        return Err(SceneError::unsupported(
            path,
            format!("SPZ version {} (Motes reads 1 to 4)", header.version),
            "Export it as version 4, or look for a newer Motes",
        ));
    }
    let wrong = |place: &str, problem: String| SceneError::malformed(path, place, problem, DAMAGED);
    let u64_at =
        |at: usize| -> u64 { bytes[at..].first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes)) };
    let Some(&[streams, t0, t1, t2, t3]) = bytes.get(15..20).and_then(|b| b.first_chunk::<5>()) else {
        return Err(wrong("the header", format!("ends after {} of 32 bytes", bytes.len())));
    };
    header.admit(source, ctx)?;

    let contents = u32::from_le_bytes([t0, t1, t2, t3]) as usize;
    let entries = usize::from(streams);
    if contents < 32 || contents + entries * 16 > bytes.len() {
        return Err(wrong(
            "byte 16",
            format!(
                "the table of contents lies at {contents} … {}, outside of the file",
                contents + entries * 16
            ),
        ));
    }
    let extensions = if header.flags & HAS_EXTENSIONS != 0 { &bytes[32..contents] } else { &[] };
    let range = sh_range(source, &header, extensions)?;

    // A stream per attribute that has bytes.
    let expected: Vec<u64> =
        header.sizes().iter().map(|size| size * header.count).filter(|&size| size > 0).collect();
    let first = contents + entries * 16;
    let mut slices = Vec::new();
    let mut at = first as u64;
    for entry in 0..entries {
        let (packed, unpacked) = (u64_at(contents + entry * 16), u64_at(contents + entry * 16 + 8));
        let end = at.checked_add(packed).filter(|&end| end <= bytes.len() as u64);
        let Some(end) = end else {
            return Err(wrong(
                &format!("stream {entry} of {entries}"),
                format!("{packed} bytes from byte {at} on reach beyond the file's {}", bytes.len()),
            ));
        };
        if unpacked > 0 {
            let wanted = expected.get(slices.len()).copied();
            if wanted != Some(unpacked) {
                return Err(wrong(
                    &format!("stream {entry} of {entries}"),
                    format!("unpacks to {unpacked} bytes, expected {}", wanted.unwrap_or(0)),
                ));
            }
            slices.push((&bytes[at as usize..end as usize], unpacked));
        }
        at = end;
    }
    if slices.len() != expected.len() {
        return Err(wrong(
            "the table of contents",
            format!("lists {} streams of splats, expected {}", slices.len(), expected.len()),
        ));
    }
    let total = bytes.len() as u64;
    let unpacked = slices
        .into_par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(index, (packed, unpacked))| {
            ctx.advance(source, 0, total)?;
            let stream = inflate(packed, unpacked)
                .map_err(|problem| wrong(&format!("stream {index} of {entries}"), problem))?;
            ctx.advance(source, packed.len() as u64, total)?;
            Ok(stream)
        })
        .collect::<Result<Vec<_>, SceneError>>()?;
    let mut next = unpacked.iter().map(Vec::as_slice);
    let attributes =
        header.sizes().map(|size| if size * header.count > 0 { next.next().unwrap_or(&[]) } else { &[] });
    Ok(decode::decode(&header, &attributes, range))
}

/// One zstd stream.
fn inflate(packed: &[u8], unpacked: u64) -> Result<Vec<u8>, String> {
    /// Windows of zstd's ordinary levels; a longer one than the contents is of no use, but allowed.
    const WINDOW: u64 = 8 << 20;
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(unpacked.max(WINDOW));
    let mut bytes = vec![0; unpacked as usize];
    let length = decoder.decode_all(packed, &mut bytes).map_err(|error| error.to_string())?;
    if length as u64 != unpacked {
        return Err(format!("unpacks to {length} bytes, expected {unpacked}"));
    }
    Ok(bytes)
}

/// The values of the bytes 0 and 255 of higher bands, where an extension record states them. Records are a type, the
/// length of what follows, and that; unknown ones are skipped.
fn sh_range(source: &Source, header: &Header, mut records: &[u8]) -> Result<Option<[f32; 2]>, SceneError> {
    let mut range = None;
    if header.flags & HAS_EXTENSIONS == 0 {
        return Ok(range);
    }
    while let Some((&[t0, t1, t2, t3, l0, l1, l2, l3], rest)) = records.split_first_chunk::<8>() {
        let length = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
        let Some((payload, rest)) = rest.split_at_checked(length) else {
            return Err(SceneError::malformed(
                source.path(),
                "the extension records",
                format!("one of {length} bytes reaches beyond their end"),
                DAMAGED,
            ));
        };
        if u32::from_le_bytes([t0, t1, t2, t3]) == SH_QUANTISATION
            && let &[_, _, a0, a1, a2, a3, b0, b1, b2, b3] = payload
        {
            range = Some([f32::from_le_bytes([a0, a1, a2, a3]), f32::from_le_bytes([b0, b1, b2, b3])]);
        }
        records = rest;
    }
    Ok(range)
}
