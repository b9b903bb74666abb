//! Rows of a binary PLY.

use ply_rs_bw::ply::{PropertyType, ScalarType};

use super::header::{Element, scalar_bytes};
use super::layout::{Layout, Row};
use crate::chunks::SplatsMut;
use crate::early::read_rows;
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, recentre};

/// Every wanted column is a little-endian f32: nearly every file there is.
struct PackedRow<'a> {
    bytes: &'a [u8],
    offsets: &'a [usize],
}

impl Row for PackedRow<'_> {
    #[inline]
    fn f32(&self, column: usize) -> f32 {
        crate::formats::values::f32_at(self.bytes, self.offsets[column])
    }

    #[inline]
    fn f64(&self, column: usize) -> f64 {
        f64::from(self.f32(column))
    }
}

/// Columns of any type in any byte order.
struct TypedRow<'a> {
    bytes: &'a [u8],
    fields: &'a [(usize, ScalarType)],
    big_endian: bool,
}

impl Row for TypedRow<'_> {
    fn f32(&self, column: usize) -> f32 {
        self.f64(column) as f32
    }

    fn f64(&self, column: usize) -> f64 {
        let (offset, scalar) = &self.fields[column];
        number(&self.bytes[*offset..], scalar, self.big_endian)
    }
}

/// Columns that are already numbers.
pub(crate) struct ParsedRow<'a> {
    /// Per property.
    pub(crate) values: &'a [f64],
    /// Property per column.
    pub(crate) columns: &'a [usize],
}

impl Row for ParsedRow<'_> {
    fn f32(&self, column: usize) -> f32 {
        self.f64(column) as f32
    }

    fn f64(&self, column: usize) -> f64 {
        self.values[self.columns[column]]
    }
}

/// A number at the front of `bytes`, which must have it.
fn number(bytes: &[u8], scalar: &ScalarType, big_endian: bool) -> f64 {
    fn first<const N: usize>(bytes: &[u8], big_endian: bool) -> [u8; N] {
        // Little-endian from here on.
        std::array::from_fn(|i| bytes[if big_endian { N - 1 - i } else { i }])
    }
    match scalar {
        ScalarType::Char => f64::from(bytes[0] as i8),
        ScalarType::UChar => f64::from(bytes[0]),
        ScalarType::Short => f64::from(i16::from_le_bytes(first(bytes, big_endian))),
        ScalarType::UShort => f64::from(u16::from_le_bytes(first(bytes, big_endian))),
        ScalarType::Int => f64::from(i32::from_le_bytes(first(bytes, big_endian))),
        ScalarType::UInt => f64::from(u32::from_le_bytes(first(bytes, big_endian))),
        ScalarType::Float => f64::from(f32::from_le_bytes(first(bytes, big_endian))),
        ScalarType::Double => f64::from_le_bytes(first(bytes, big_endian)),
    }
}

/// Reads rows without lists, in parallel, from `offset` on. Returns the origin that was subtracted.
pub(crate) fn read_fixed(
    source: &Source,
    ctx: &LoadContext<'_>,
    vertex: &Element,
    layout: &Layout,
    big_endian: bool,
    offset: u64,
    out: SplatsMut<'_>,
) -> Result<[f64; 3], SceneError> {
    let mut row_bytes = 0;
    let all: Vec<(usize, ScalarType)> = vertex
        .properties
        .iter()
        .filter_map(|p| match &p.kind {
            PropertyType::Scalar(scalar) => {
                row_bytes += scalar_bytes(scalar);
                Some((row_bytes - scalar_bytes(scalar), scalar.clone()))
            }
            PropertyType::List(..) => None,
        })
        .collect();
    let fields: Vec<(usize, ScalarType)> = layout.columns.iter().map(|&i| all[i].clone()).collect();

    if !big_endian && fields.iter().all(|(_, scalar)| *scalar == ScalarType::Float) {
        let offsets: Vec<usize> = fields.iter().map(|(offset, _)| *offset).collect();
        read_rows(source, ctx, offset, row_bytes, [0.0; 3], out, |bytes, mut out| {
            for (i, bytes) in bytes.chunks_exact(row_bytes).enumerate() {
                layout.store(&PackedRow { bytes, offsets: &offsets }, [0.0; 3], &mut out, i);
            }
        })?;
        return Ok([0.0; 3]);
    }

    // Doubles hold what f32 would round away far from the origin: find the scene's centre before reading it.
    let mut origin = [0.0; 3];
    if fields[..3].iter().any(|(_, scalar)| *scalar == ScalarType::Double) {
        let mut samples = Vec::with_capacity(recentre::SAMPLES);
        let mut bytes = vec![0; row_bytes];
        for i in (0..out.len()).step_by(out.len().div_ceil(recentre::SAMPLES).max(1)) {
            source.read_at(offset + i as u64 * row_bytes as u64, &mut bytes)?;
            samples.push(Layout::mean(&TypedRow { bytes: &bytes, fields: &fields, big_endian }));
        }
        origin = recentre::centre(samples.into_iter());
    }
    read_rows(source, ctx, offset, row_bytes, origin, out, |bytes, mut out| {
        for (i, bytes) in bytes.chunks_exact(row_bytes).enumerate() {
            layout.store(&TypedRow { bytes, fields: &fields, big_endian }, origin, &mut out, i);
        }
    })?;
    Ok(origin)
}

/// Reads rows with lists, one after the other; the lists are skipped.
pub(crate) fn read_ragged(
    source: &Source,
    ctx: &LoadContext<'_>,
    vertex: &Element,
    layout: &Layout,
    window: &mut Window<'_>,
    mut out: SplatsMut<'_>,
) -> Result<(), SceneError> {
    let mut values = vec![0.0; vertex.properties.len()];
    for i in 0..out.len() {
        window.row(vertex, i as u64, Some(&mut values))?;
        layout.store(&ParsedRow { values: &values, columns: &layout.columns }, [0.0; 3], &mut out, i);
        if i % 4096 == 4095 {
            ctx.advance(source, 4096, out.len() as u64)?;
        }
    }
    Ok(())
}

/// Sequential reading through a small buffer.
pub(crate) struct Window<'a> {
    source: &'a Source,
    big_endian: bool,
    /// Where the next byte is.
    offset: u64,
    buffer: Vec<u8>,
    /// Where `buffer` begins.
    base: u64,
}

const WINDOW_BYTES: u64 = 64 << 10;

impl<'a> Window<'a> {
    pub(crate) fn new(source: &'a Source, big_endian: bool, offset: u64) -> Self {
        Self { source, big_endian, offset, buffer: Vec::new(), base: 0 }
    }

    /// Where the next byte is.
    pub(crate) fn offset(&self) -> u64 {
        self.offset
    }

    /// Skips an element's rows.
    pub(crate) fn skip_element(
        &mut self,
        ctx: &LoadContext<'_>,
        element: &Element,
    ) -> Result<(), SceneError> {
        if element.is_fixed() {
            return self.skip(element.count.saturating_mul(element.min_row_bytes()));
        }
        for i in 0..element.count {
            self.row(element, i, None)?;
            if i % 4096 == 4095 {
                ctx.advance(self.source, 0, 1)?;
            }
        }
        Ok(())
    }

    /// Reads a row's numbers, or skips them; lists leave their place in `values` as it is.
    fn row(&mut self, element: &Element, row: u64, mut values: Option<&mut [f64]>) -> Result<(), SceneError> {
        for (i, property) in element.properties.iter().enumerate() {
            match &property.kind {
                PropertyType::Scalar(scalar) => {
                    let value = self.number(scalar)?;
                    if let Some(values) = &mut values {
                        values[i] = value;
                    }
                }
                PropertyType::List(count, item) => {
                    let place = self.offset;
                    let n = self.number(count)?;
                    // A count may be of a float type, too.
                    if !(n >= 0.0 && n <= f64::from(u32::MAX) && n.fract() == 0.0) {
                        return Err(SceneError::malformed(
                            self.source.path(),
                            format!("byte {place}, {} {row}, property '{}'", element.name, property.name),
                            format!("a list cannot have {n} items"),
                            "The file is damaged: export or download it again",
                        ));
                    }
                    self.skip(n as u64 * scalar_bytes(item) as u64)?;
                }
            }
        }
        Ok(())
    }

    fn number(&mut self, scalar: &ScalarType) -> Result<f64, SceneError> {
        let bytes = scalar_bytes(scalar);
        let inside = self.offset.wrapping_sub(self.base);
        if self.offset < self.base || inside + bytes as u64 > self.buffer.len() as u64 {
            let available = self.source.len().saturating_sub(self.offset).min(WINDOW_BYTES);
            self.buffer.resize((available as usize).max(bytes), 0);
            self.source.read_at(self.offset, &mut self.buffer)?;
            self.base = self.offset;
        }
        let start = (self.offset - self.base) as usize;
        let value = number(&self.buffer[start..], scalar, self.big_endian);
        self.offset += bytes as u64;
        Ok(value)
    }

    fn skip(&mut self, bytes: u64) -> Result<(), SceneError> {
        let end = self.offset.saturating_add(bytes);
        if end > self.source.len() {
            return Err(self.source.ends_early(self.offset, end));
        }
        self.offset = end;
        Ok(())
    }
}
