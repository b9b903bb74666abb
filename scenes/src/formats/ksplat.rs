//! mkkellogg's `.ksplat` (GaussianSplats3D), compression levels 0, 1 and 2.
//!
//! A header of 4096 bytes, a header of 1024 bytes per section, then the sections: lengths of the partially filled
//! buckets (u32), buckets' centres (3 f32), and rows of mean, scale (linear), rotation (w first), colour and opacity
//! (4 bytes), spherical harmonics. Level 0 has f32 throughout; levels 1 and 2 have halves, means in 16-bit steps
//! around their bucket's centre, and harmonics in halves (1) or bytes between two bounds of the header (2).
//! Harmonics are stored band by band, and within a band channel by channel.

use super::values::{dc_of_color, f16_at, f32_at, u16_at, u32_at};
use crate::chunks::{SplatsMut, read_rows};
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, Splats, sh_coefficients};

const HEADER_BYTES: u64 = 4096;
const SECTION_HEADER_BYTES: u64 = 1024;
const REMEDY: &str = "The file is damaged, or not a .ksplat: export or download it again";

/// Half the range of harmonics in bytes, where the header states none.
const SH_RANGE: f32 = 1.5;

/// One section, checked: everything it speaks of is in the file.
struct Section {
    splats: u64,
    sh_degree: u8,
    row_bytes: u64,
    /// Where its rows begin.
    data: u64,
    /// Centres of its buckets; none at level 0.
    centers: Vec<[f32; 3]>,
    /// Splats per full bucket, and how many full buckets come first.
    bucket_size: u64,
    full_buckets: u64,
    /// Index of the first splat behind each partially filled bucket.
    partial_ends: Vec<u64>,
    /// The step that stands for zero, and the length of a step.
    zero: f32,
    step: f32,
}

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let mut header = [0; 44];
    source.read_at(0, &mut header)?;
    let malformed =
        |place: &str, problem: String| SceneError::malformed(source.path(), place, problem, REMEDY);
    if header[0] != 0 || header[1] < 1 {
        return Err(malformed("byte 0", format!("version {}.{} is not 0.1", header[0], header[1])));
    }
    let level = u16_at(&header, 20);
    if level > 2 {
        return Err(malformed("byte 20", format!("compression level {level} is none of 0, 1, 2")));
    }
    let or = |value: f32, default: f32| if value == 0.0 { default } else { value };
    let sh_bounds = [or(f32_at(&header, 36), -SH_RANGE), or(f32_at(&header, 40), SH_RANGE)];

    let max_sections = u64::from(u32_at(&header, 4));
    let mut offset = HEADER_BYTES + max_sections * SECTION_HEADER_BYTES;
    if offset > source.len() {
        return Err(source.ends_early(HEADER_BYTES, offset));
    }
    let mut sections = Vec::new();
    for i in 0..max_sections {
        let (section, end) = read_section(source, i, level, offset)?;
        sections.push(section);
        offset = end;
    }

    let count = sections.iter().map(|s| s.splats).sum::<u64>();
    let degree = sections.iter().map(|s| s.sh_degree).max().unwrap_or(0);
    if count != u64::from(u32_at(&header, 16)) {
        ctx.warn(format!(
            "{}: the header speaks of {} splats, its sections of {count}",
            source.path().display(),
            u32_at(&header, 16)
        ));
    }
    let n = ctx.admit(source, count, degree, false)?;
    let mut splats = Splats::zeroed(n, degree, false);
    let mut rest = SplatsMut::all(&mut splats);
    for section in &sections {
        let (out, others) = rest.split_at(section.splats as usize);
        rest = others;
        let (first, row_bytes) = (out.first, section.row_bytes as usize);
        read_rows(source, ctx, section.data, row_bytes, out, |bytes, mut out| {
            for (i, row) in bytes.chunks_exact(row_bytes).enumerate() {
                section.store(level, sh_bounds, row, (out.first - first + i) as u64, &mut out, i);
            }
        })?;
    }
    Ok(splats)
}

/// Reads and checks a section's header and buckets; `offset` is where the section's contents begin. Returns where
/// they end, too.
fn read_section(source: &Source, index: u64, level: u16, offset: u64) -> Result<(Section, u64), SceneError> {
    let at = HEADER_BYTES + index * SECTION_HEADER_BYTES;
    let malformed = |byte: u64, problem: String| {
        SceneError::malformed(source.path(), format!("byte {}, section {index}", at + byte), problem, REMEDY)
    };
    let mut header = [0; 42];
    source.read_at(at, &mut header)?;
    let field = |byte: usize| u64::from(u32_at(&header, byte));
    let sh_degree = u16_at(&header, 40);
    if sh_degree > 3 {
        return Err(malformed(
            40,
            format!("degree {sh_degree} of the spherical harmonics is none of 0 to 3"),
        ));
    }
    let sh_degree = sh_degree as u8;
    let sh_numbers = 3 * (sh_coefficients(sh_degree) - 1) as u64;
    let row_bytes = match level {
        0 => 44 + 4 * sh_numbers,
        1 => 24 + 2 * sh_numbers,
        _ => 24 + sh_numbers,
    };
    let (splats, capacity) = (field(0), field(4));
    let (bucket_size, buckets, full_buckets, partial_buckets) = (field(8), field(12), field(32), field(36));
    let bucket_bytes = u64::from(u16_at(&header, 20));
    let bounds = offset + 4 * partial_buckets;
    let data = bounds + bucket_bytes * buckets;
    let end = data + row_bytes * capacity;
    if end > source.len() {
        return Err(source.ends_early(offset, end));
    }
    if splats > capacity {
        return Err(malformed(0, format!("{splats} splats in a section made for {capacity}")));
    }

    let (mut centers, mut partial_ends) = (Vec::new(), Vec::new());
    let steps = match field(24) {
        0 => 32767,
        steps => steps,
    };
    if level > 0 {
        if bucket_bytes < 12 {
            return Err(malformed(20, format!("{bucket_bytes} bytes cannot hold a bucket's centre")));
        }
        let mut bytes = vec![0; (data - offset) as usize];
        source.read_at(offset, &mut bytes)?;
        let (lengths, rows) = bytes.split_at((bounds - offset) as usize);
        centers.extend(
            rows.chunks_exact(bucket_bytes as usize).map(|row| std::array::from_fn(|k| f32_at(row, 4 * k))),
        );
        partial_ends.extend(lengths.chunks_exact(4).scan(full_buckets * bucket_size, |end, length| {
            *end = end.saturating_add(u64::from(u32_at(length, 0)));
            Some(*end)
        }));
        let held = partial_ends.last().copied().unwrap_or(full_buckets * bucket_size);
        if full_buckets + partial_buckets > buckets || held < splats {
            return Err(malformed(
                32,
                format!(
                    "{full_buckets} full and {partial_buckets} other buckets, of {buckets}, hold {held} splats, \
                     but there are {splats}"
                ),
            ));
        }
    }
    let step = f32_at(&header, 16) / 2.0 / steps as f32;
    let zero = steps as f32;
    Ok((
        Section {
            splats,
            sh_degree,
            row_bytes,
            data,
            centers,
            bucket_size,
            full_buckets,
            partial_ends,
            zero,
            step,
        },
        end,
    ))
}

impl Section {
    /// Writes the row of the section's splat `index` to splat `i` of `out`.
    fn store(
        &self,
        level: u16,
        sh_bounds: [f32; 2],
        row: &[u8],
        index: u64,
        out: &mut SplatsMut<'_>,
        i: usize,
    ) {
        // Positions of scale, rotation, colour and harmonics in a row.
        let [scale, rotation, color, sh_at] = if level == 0 { [12, 24, 40, 44] } else { [6, 12, 20, 24] };
        let number = |start: usize, k: usize| {
            if level == 0 { f32_at(row, start + 4 * k) } else { f16_at(row, start + 2 * k) }
        };
        out.means[i] = if level == 0 {
            std::array::from_fn(|k| f32_at(row, 4 * k))
        } else {
            let center = self.centers[self.bucket(index)];
            std::array::from_fn(|k| (f32::from(u16_at(row, 2 * k)) - self.zero) * self.step + center[k])
        };
        out.log_scales[i] = std::array::from_fn(|k| number(scale, k).ln());
        let q = |k: usize| number(rotation, k);
        out.rotations[i] = [q(1), q(2), q(3), q(0)];
        let sh = &mut out.sh[i * out.coefficients..(i + 1) * out.coefficients];
        sh[0] = std::array::from_fn(|c| dc_of_color(f32::from(row[color + c]) / 255.0));
        out.opacities[i] = f32::from(row[color + 3]) / 255.0;
        for band in 1..=usize::from(self.sh_degree) {
            // The band begins behind those below it, and has 2 band + 1 coefficients per channel.
            let (before, width) = (band * band, 2 * band + 1);
            for k in 0..width {
                sh[before + k] = std::array::from_fn(|c| {
                    let index = 3 * (before - 1) + c * width + k;
                    match level {
                        0 | 1 => number(sh_at, index),
                        _ => {
                            let [low, high] = sh_bounds;
                            low + f32::from(row[sh_at + index]) / 255.0 * (high - low)
                        }
                    }
                });
            }
        }
    }

    /// The bucket of a splat: full ones first.
    fn bucket(&self, index: u64) -> usize {
        let in_full = self.full_buckets * self.bucket_size;
        if index < in_full {
            return (index / self.bucket_size) as usize;
        }
        self.full_buckets as usize + self.partial_ends.partition_point(|end| *end <= index)
    }
}
