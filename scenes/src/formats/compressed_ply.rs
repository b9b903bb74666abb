//! PlayCanvas's `.compressed.ply`: a PLY with an element `chunk` (bounds of 256 splats each), an element `vertex`
//! (four u32 a splat, positions within those bounds), and perhaps an element `sh` (a byte per coefficient).
//!
//! Means and log-scales have 11, 10, 11 bits for x, y, z; colours and opacity 8 each (colours within the chunk's
//! bounds, where it has them); a rotation the index of its largest component (in the order w, x, y, z) and the other
//! three in 10 bits each, `(q − ½) · √2`. Coefficients above the constant band cover −4 ..= 4.

use std::f32::consts::SQRT_2;

use ply_rs_bw::ply::{Encoding, PropertyType, ScalarType};

use super::ply::header::{Element, Header, scalar_bytes};
use super::values::{dc_of_color, f32_at, u32_at};
use crate::chunks::{SplatsMut, read_rows};
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats, sh_coefficients};

/// Splats that share their bounds.
const CHUNK: usize = 256;

const REMEDY: &str = "Export the scene again";

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let path = source.path();
    let header = Header::read(source)?;
    if header.encoding != Encoding::BinaryLittleEndian {
        return Err(SceneError::unsupported(path, "a compressed PLY that is not little-endian", REMEDY));
    }
    let (chunk, chunk_offset) = locate(source, &header, "chunk")?;
    let (vertex, vertex_offset) = locate(source, &header, "vertex")?;
    if chunk.count != vertex.count.div_ceil(CHUNK as u64) {
        return Err(SceneError::malformed(
            path,
            "element 'chunk'",
            format!("{} chunks of {CHUNK} splats cannot hold {} vertices", chunk.count, vertex.count),
            REMEDY,
        ));
    }
    let sh = match header.element("sh") {
        None => None,
        Some(_) => {
            let (sh, offset) = locate(source, &header, "sh")?;
            if sh.count != vertex.count {
                return Err(SceneError::malformed(
                    path,
                    "element 'sh'",
                    format!("it has {} rows for {} vertices", sh.count, vertex.count),
                    REMEDY,
                ));
            }
            let rest = sh.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
            let degree = match rest {
                0 => 0,
                9 => 1,
                24 => 2,
                45 => 3,
                _ => {
                    return Err(SceneError::malformed(
                        path,
                        "element 'sh'",
                        format!("{rest} properties 'f_rest_*', but degrees 1, 2, 3 have 9, 24, 45"),
                        REMEDY,
                    ));
                }
            };
            Some((sh, offset, degree))
        }
    };
    let degree = sh.map_or(0, |(.., degree)| degree);
    let bounds = read_bounds(source, chunk, chunk_offset)?;
    let n = ctx.admit(source, vertex.count, degree, false)?;
    let mut splats = Splats::zeroed(n, degree, false);

    let [position, rotation, scale, color] =
        ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
            .map(|name| column(source, vertex, name, ScalarType::UInt));
    let (position, rotation, scale, color) = (position?, rotation?, scale?, color?);
    let row_bytes = vertex.min_row_bytes() as usize;
    read_rows(source, ctx, vertex_offset, row_bytes, SplatsMut::all(&mut splats), |bytes, out| {
        for (i, row) in bytes.chunks_exact(row_bytes).enumerate() {
            let bounds = &bounds[(out.first + i) / CHUNK];
            out.means[i] = bounds.within(0, unpack_11_10_11(u32_at(row, position)));
            out.rotations[i] = unpack_rotation(u32_at(row, rotation));
            out.log_scales[i] = bounds.within(6, unpack_11_10_11(u32_at(row, scale)));
            let [r, g, b, a] = u32_at(row, color).to_be_bytes().map(|v| f32::from(v) / 255.0);
            out.sh[i * out.coefficients] = bounds.within(12, [r, g, b]).map(dc_of_color);
            out.opacities[i] = a;
        }
    })?;

    if let Some((sh, offset, degree)) = sh {
        let rest = sh_coefficients(degree) - 1;
        let columns = (0..3 * rest)
            .map(|i| column(source, sh, &format!("f_rest_{i}"), ScalarType::UChar))
            .collect::<Result<Vec<_>, _>>()?;
        let row_bytes = sh.min_row_bytes() as usize;
        read_rows(source, ctx, offset, row_bytes, SplatsMut::all(&mut splats), |bytes, out| {
            let n = out.coefficients;
            for (row, values) in bytes.chunks_exact(row_bytes).zip(out.sh.chunks_exact_mut(n)) {
                for (k, value) in values[1..].iter_mut().enumerate() {
                    *value = std::array::from_fn(|c| unpack_sh(row[columns[c * rest + k]]));
                }
            }
        })?;
    }
    Ok(splats)
}

/// An element and where its first row begins, all its rows being in the file.
fn locate<'h>(source: &Source, header: &'h Header, name: &str) -> Result<(&'h Element, u64), SceneError> {
    let mut offset = header.data_offset;
    for element in &header.elements {
        if !element.is_fixed() {
            return Err(SceneError::malformed(
                source.path(),
                format!("element '{}'", element.name),
                "a compressed PLY has no lists",
                REMEDY,
            ));
        }
        let end = offset.saturating_add(element.count.saturating_mul(element.min_row_bytes()));
        if end > source.len() {
            return Err(source.ends_early(offset, end));
        }
        if element.name == name {
            return Ok((element, offset));
        }
        offset = end;
    }
    Err(SceneError::malformed(source.path(), "header", format!("there is no element '{name}'"), REMEDY))
}

/// Where in a row a property of that type is.
fn column(source: &Source, element: &Element, name: &str, scalar: ScalarType) -> Result<usize, SceneError> {
    let mut offset = 0;
    for property in &element.properties {
        if let PropertyType::Scalar(found) = &property.kind {
            if property.name == name && *found == scalar {
                return Ok(offset);
            }
            offset += scalar_bytes(found);
        }
    }
    Err(SceneError::malformed(
        source.path(),
        format!("element '{}'", element.name),
        format!("there is no property '{name}' of type {scalar:?}"),
        REMEDY,
    ))
}

/// A chunk's bounds: min and max of mean, log-scale, colour, three numbers each.
struct Bounds([f32; 18]);

impl Bounds {
    /// `t` from `0 ..= 1` to the bounds that begin at `first`.
    fn within(&self, first: usize, t: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| self.0[first + k] * (1.0 - t[k]) + self.0[first + 3 + k] * t[k])
    }
}

fn read_bounds(source: &Source, chunk: &Element, offset: u64) -> Result<Vec<Bounds>, SceneError> {
    let names = |stem: &str, axes: [&str; 3]| {
        ["min", "max"].map(|end| axes.map(|axis| format!("{end}_{stem}{axis}"))).concat()
    };
    let mut columns = Vec::with_capacity(18);
    for name in [names("", ["x", "y", "z"]), names("scale_", ["x", "y", "z"])].concat() {
        columns.push(column(source, chunk, &name, ScalarType::Float)?);
    }
    let has_colors = chunk.has("min_r");
    if has_colors {
        for name in names("", ["r", "g", "b"]) {
            columns.push(column(source, chunk, &name, ScalarType::Float)?);
        }
    }
    // In the file as a whole: `locate` has seen to it.
    let row_bytes = chunk.min_row_bytes() as usize;
    let mut bytes = vec![0; chunk.count as usize * row_bytes];
    source.read_at(offset, &mut bytes)?;
    let bounds = bytes.chunks_exact(row_bytes).map(|row| {
        // Without bounds of their own, colours cover 0 ..= 1.
        let mut bounds = [0.0; 18];
        bounds[15..].fill(1.0);
        for (value, column) in bounds.iter_mut().zip(&columns) {
            *value = f32_at(row, *column);
        }
        Bounds(bounds)
    });
    Ok(bounds.collect())
}

fn unpack_11_10_11(packed: u32) -> [f32; 3] {
    [(packed >> 21) as f32 / 2047.0, ((packed >> 11) & 1023) as f32 / 1023.0, (packed & 2047) as f32 / 2047.0]
}

/// `(x, y, z, w)`.
fn unpack_rotation(packed: u32) -> [f32; 4] {
    let largest = (packed >> 30) as usize;
    let others = [20, 10, 0].map(|shift| (((packed >> shift) & 1023) as f32 / 1023.0 - 0.5) * SQRT_2);
    let missing = (1.0 - others.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    let mut wxyz = [missing; 4];
    let places = (0..4).filter(|i| *i != largest);
    for (place, value) in places.zip(others) {
        wxyz[place] = value;
    }
    [wxyz[1], wxyz[2], wxyz[3], wxyz[0]]
}

/// Bytes 1 ..= 254 are the middles of 256 equal steps, 0 and 255 the ends.
fn unpack_sh(byte: u8) -> f32 {
    let t = match byte {
        0 => 0.0,
        255 => 1.0,
        v => (f32::from(v) + 0.5) / 256.0,
    };
    (t - 0.5) * 8.0
}
