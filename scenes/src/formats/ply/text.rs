//! Rows of an ASCII PLY: one a line.

use ply_rs_bw::ply::PropertyType;
use rayon::prelude::*;

use super::binary::ParsedRow;
use super::header::{Element, Header};
use super::layout::Layout;
use crate::chunks::SplatsMut;
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, recentre};

/// Bytes that are read at a time; no line may be longer.
const BLOCK_BYTES: usize = 1 << 20;

/// Rows that a thread parses at a time.
const ROWS: usize = 128;

/// A line of the current block.
#[derive(Clone, Copy)]
struct Line {
    /// Counted from 1 in the file.
    number: u64,
    start: u32,
    end: u32,
}

/// Reads the vertices. Returns the origin that was subtracted.
pub(crate) fn read(
    source: &Source,
    ctx: &LoadContext<'_>,
    header: &Header,
    layout: &Layout,
    out: SplatsMut<'_>,
) -> Result<[f64; 3], SceneError> {
    let mut lines = Lines::new(source, header);
    let mut block = Vec::new();
    let mut vertex = None;
    // Rows of elements before the vertices.
    let mut skipped = 0_u64;
    for element in &header.elements {
        if element.name == "vertex" {
            vertex = Some(element);
            break;
        }
        if !element.properties.is_empty() {
            skipped = skipped.saturating_add(element.count);
        }
    }
    let Some(vertex) = vertex else { return Ok([0.0; 3]) };
    let wanted: Vec<bool> = (0..vertex.properties.len()).map(|i| layout.columns.contains(&i)).collect();

    let mut rest = out;
    let mut origin = None;
    let total = rest.len();
    while rest.len() > 0 {
        let bytes = lines.next_block(&mut block)?;
        if block.is_empty() {
            return Err(SceneError::malformed(
                source.path(),
                format!("line {}", lines.number),
                format!("the file ends after {} of {total} vertices", total - rest.len()),
                "It was cut off: copy or download it again",
            ));
        }
        let skip = (skipped.min(block.len() as u64)) as usize;
        skipped -= skip as u64;
        let rows = (block.len() - skip).min(rest.len());
        let rows = &block[skip..skip + rows];
        let text = lines.text();
        let parse = |line: &Line, values: &mut [f64]| {
            parse_row(&text[line.start as usize..line.end as usize], vertex, &wanted, values).map_err(
                |(place, problem)| {
                    SceneError::malformed(
                        source.path(),
                        format!("line {}, {place}", line.number),
                        problem,
                        "Correct the line, or export the scene again",
                    )
                },
            )
        };
        let origin = match origin {
            Some(origin) => origin,
            None if rows.is_empty() => [0.0; 3],
            None => {
                // Text holds what f32 would round away far from the origin: the first rows tell where it is.
                let mut values = vec![0.0; wanted.len()];
                let mut means = Vec::new();
                for line in rows.iter().take(recentre::SAMPLES) {
                    parse(line, &mut values)?;
                    means.push(Layout::mean(&ParsedRow { values: &values, columns: &layout.columns }));
                }
                *origin.insert(recentre::centre(means.into_iter()))
            }
        };
        let (now, later) = rest.split_at(rows.len());
        rest = later;
        now.chunks(ROWS).into_par_iter().zip(rows.par_chunks(ROWS)).try_for_each_init(
            || vec![0.0; wanted.len()],
            |values, (mut out, rows)| {
                for (i, line) in rows.iter().enumerate() {
                    parse(line, values)?;
                    layout.store(&ParsedRow { values, columns: &layout.columns }, origin, &mut out, i);
                }
                Ok::<(), SceneError>(())
            },
        )?;
        ctx.advance(source, bytes, source.len())?;
    }
    Ok(origin.unwrap_or_default())
}

/// Parses a row; only wanted columns become numbers. An error is a place and a problem.
fn parse_row(
    line: &[u8],
    element: &Element,
    wanted: &[bool],
    values: &mut [f64],
) -> Result<(), (String, String)> {
    let line = std::str::from_utf8(line)
        .map_err(|e| (format!("byte {} of the line", e.valid_up_to()), "this is not text".to_owned()))?;
    let mut tokens = line.split_ascii_whitespace();
    for (i, property) in element.properties.iter().enumerate() {
        let place = || format!("property '{}'", property.name);
        let mut next = || tokens.next().ok_or_else(|| (place(), "the line ends before it".to_owned()));
        match &property.kind {
            PropertyType::Scalar(_) => {
                let token = next()?;
                if wanted[i] {
                    values[i] = number(token)
                        .ok_or_else(|| (place(), format!("'{}' is not a number", preview(token))))?;
                }
            }
            PropertyType::List(..) => {
                let token = next()?;
                let count: u32 = token
                    .parse()
                    .map_err(|_| (place(), format!("'{}' is not a list's length", preview(token))))?;
                for _ in 0..count {
                    next()?;
                }
            }
        }
    }
    match tokens.next() {
        None => Ok(()),
        Some(token) => Err((
            format!("'{}'", preview(token)),
            format!("there are more numbers than the {} properties of the header", element.properties.len()),
        )),
    }
}

fn number(token: &str) -> Option<f64> {
    token.parse().ok().or_else(|| {
        // As printed by the C runtimes of Windows.
        let unsigned = token.trim_start_matches(['-', '+']).to_ascii_lowercase();
        if unsigned.starts_with("nan") || unsigned.starts_with("1.#") { Some(f64::NAN) } else { None }
    })
}

fn preview(token: &str) -> String {
    token.chars().take(24).flat_map(char::escape_default).collect()
}

/// Whole lines, a block at a time.
struct Lines<'a> {
    source: &'a Source,
    /// Where in the file the next block's new bytes are.
    offset: u64,
    buffer: Vec<u8>,
    /// Bytes of `buffer` that make up whole lines; what follows them belongs to the next block.
    whole: usize,
    /// Lines so far, the header's included.
    number: u64,
}

impl<'a> Lines<'a> {
    fn new(source: &'a Source, header: &Header) -> Self {
        let number = header.lines as u64;
        Self { source, offset: header.data_offset, buffer: Vec::new(), whole: 0, number }
    }

    fn text(&self) -> &[u8] {
        &self.buffer
    }

    /// Replaces the block by the next one that has lines, blank ones left out; an empty block is the end.
    /// Returns how many bytes were read.
    fn next_block(&mut self, block: &mut Vec<Line>) -> Result<u64, SceneError> {
        block.clear();
        let mut read = 0;
        while block.is_empty() {
            self.buffer.drain(..self.whole);
            self.whole = 0;
            let kept = self.buffer.len();
            let room = BLOCK_BYTES.saturating_sub(kept) as u64;
            let fresh = self.source.len().saturating_sub(self.offset).min(room);
            self.buffer.resize(kept + fresh as usize, 0);
            self.source.read_at(self.offset, &mut self.buffer[kept..])?;
            self.offset += fresh;
            read += fresh;
            let is_last = self.offset >= self.source.len();
            self.whole = match memchr::memrchr(b'\n', &self.buffer) {
                _ if is_last => self.buffer.len(),
                Some(i) => i + 1,
                None => {
                    return Err(SceneError::malformed(
                        self.source.path(),
                        format!("line {}", self.number + 1),
                        format!("it is longer than {BLOCK_BYTES} bytes"),
                        "This is no ASCII PLY: the header's format line is wrong, or the file is damaged",
                    ));
                }
            };
            if self.whole == 0 {
                break;
            }
            let text = &self.buffer[..self.whole];
            let mut start = 0;
            while start < text.len() {
                let end = memchr::memchr(b'\n', &text[start..]).map_or(text.len(), |i| start + i + 1);
                self.number += 1;
                if !text[start..end].trim_ascii().is_empty() {
                    block.push(Line { number: self.number, start: start as u32, end: end as u32 });
                }
                start = end;
            }
        }
        Ok(read)
    }
}
