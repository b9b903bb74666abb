//! Encoders of every format, written from the formats' descriptions and apart from the crate's own writers, so that a
//! reader and a writer that share an error do not hide it. `Splats` go in; the scene's origin must be zero.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "used by tests only")]

use half::f16;
use motes_scenes::synthetic::Random;
use motes_scenes::{SH_C0, Splats, sh_coefficients};

fn logit(p: f32) -> f64 {
    let p = f64::from(p);
    (p / (1.0 - p)).ln()
}

fn color(dc: f32) -> f32 {
    0.5 + SH_C0 * dc
}

fn byte(v: f32) -> u8 {
    (v * 255.0).round().clamp(0.0, 255.0) as u8
}

/// How a PLY stores its rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    Ascii,
    Little,
    Big,
}

/// One property: its type, its name, its numbers. A type `list` stands for lists of `row % 4` short integers.
pub struct Column {
    pub kind: &'static str,
    pub name: String,
    pub values: Vec<f64>,
}

fn column(name: impl Into<String>, values: impl Iterator<Item = f64>) -> Column {
    Column { kind: "float", name: name.into(), values: values.collect() }
}

/// The columns of a still scene in the trainers' order, or of a moving one in Spacetime Gaussians' order.
pub fn columns(splats: &Splats) -> Vec<Column> {
    let n = splats.len();
    let each = |f: &dyn Fn(usize) -> f64| (0..n).map(f).collect::<Vec<_>>().into_iter();
    let mut columns: Vec<Column> = ["x", "y", "z"]
        .iter()
        .enumerate()
        .map(|(k, name)| column(*name, each(&|i| splats.means[i][k].into())))
        .collect();
    if let Some(motion) = &splats.motion {
        columns.push(column("trbf_center", each(&|i| motion.centers[i].into())));
        columns.push(column("trbf_scale", each(&|i| f64::from(motion.widths[i]).ln())));
    }
    columns.extend(["nx", "ny", "nz"].map(|name| column(name, each(&|_| 0.0))));
    if let Some(motion) = &splats.motion {
        for k in 0..9 {
            columns
                .push(column(format!("motion_{k}"), each(&|i| motion.polynomials[i][k / 3][k % 3].into())));
        }
    }
    for c in 0..3 {
        let raw = splats.motion.is_some();
        columns.push(column(
            format!("f_dc_{c}"),
            each(&|i| {
                let dc = splats.sh_of(i)[0][c];
                if raw { color(dc).into() } else { dc.into() }
            }),
        ));
    }
    let rest = if splats.motion.is_some() { 0 } else { sh_coefficients(splats.sh_degree) - 1 };
    for k in 0..3 * rest {
        columns
            .push(column(format!("f_rest_{k}"), each(&|i| splats.sh_of(i)[1 + k % rest][k / rest].into())));
    }
    columns.push(column("opacity", each(&|i| logit(splats.opacities[i]))));
    for k in 0..3 {
        columns.push(column(format!("scale_{k}"), each(&|i| splats.log_scales[i][k].into())));
    }
    for k in 0..4 {
        columns.push(column(format!("rot_{k}"), each(&|i| splats.rotations[i][(k + 3) % 4].into())));
    }
    if let Some(motion) = &splats.motion {
        for k in 0..4 {
            columns.push(column(format!("omega_{k}"), each(&|i| motion.omegas[i][(k + 3) % 4].into())));
        }
    }
    columns
}

/// Another order, other types, additional properties and a list.
pub fn disorder(columns: &mut Vec<Column>, seed: u64) {
    let n = columns[0].values.len();
    let mut random = Random::new(seed);
    columns.push(column("confidence", (0..n).map(|i| i as f64)));
    columns.push(Column { kind: "uchar", name: "red".into(), values: vec![200.0; n] });
    columns.push(Column { kind: "short", name: "segment".into(), values: vec![-3.0; n] });
    columns.push(Column { kind: "list", name: "neighbours".into(), values: vec![0.0; n] });
    for i in (1..columns.len()).rev() {
        columns.swap(i, random.below(i as u64 + 1) as usize);
        if columns[i].kind == "float" && random.below(3) == 0 {
            columns[i].kind = "double";
        }
    }
}

/// A PLY of those columns. An element with a list comes before the vertices, and one behind them, if `more`.
pub fn ply(columns: &[Column], encoding: Encoding, more: bool) -> Vec<u8> {
    let n = columns[0].values.len();
    let format = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut header = format!("ply\nformat {format} 1.0\ncomment by a test\n");
    if more {
        header += "element face 2\nproperty list uchar int vertex_indices\nproperty float area\n";
    }
    header += &format!("element vertex {n}\n");
    for c in columns {
        let kind = if c.kind == "list" { "list uchar short" } else { c.kind };
        header += &format!("property {kind} {}\n", c.name);
    }
    if more {
        header += "element camera 1\nproperty double focal\n";
    }
    header += "end_header\n";
    let mut out = header.into_bytes();
    if more {
        for face in [3, 2] {
            put(&mut out, encoding, "uchar", f64::from(face));
            (0..face).for_each(|v| put(&mut out, encoding, "int", f64::from(v)));
            put(&mut out, encoding, "float", 0.25);
            end_row(&mut out, encoding);
        }
    }
    for i in 0..n {
        for c in columns {
            if c.kind == "list" {
                put(&mut out, encoding, "uchar", (i % 4) as f64);
                (0..i % 4).for_each(|v| put(&mut out, encoding, "short", v as f64));
            } else {
                put(&mut out, encoding, c.kind, c.values[i]);
            }
        }
        end_row(&mut out, encoding);
    }
    if more {
        put(&mut out, encoding, "double", 500.0);
        end_row(&mut out, encoding);
    }
    out
}

fn end_row(out: &mut Vec<u8>, encoding: Encoding) {
    if encoding == Encoding::Ascii {
        out.push(b'\n');
    }
}

fn put(out: &mut Vec<u8>, encoding: Encoding, kind: &str, value: f64) {
    if encoding == Encoding::Ascii {
        let text = if kind == "float" { format!("{} ", value as f32) } else { format!("{value} ") };
        out.extend(text.bytes());
        return;
    }
    let mut bytes: Vec<u8> = match kind {
        "float" => (value as f32).to_le_bytes().into(),
        "double" => value.to_le_bytes().into(),
        "int" => (value as i32).to_le_bytes().into(),
        "short" => (value as i16).to_le_bytes().into(),
        _ => vec![value as u8],
    };
    if encoding == Encoding::Big {
        bytes.reverse();
    }
    out.extend(bytes);
}

/// A whole scene as little-endian PLY in the usual order.
pub fn plain_ply(splats: &Splats) -> Vec<u8> {
    ply(&columns(splats), Encoding::Little, false)
}

/// PlayCanvas's compressed PLY.
pub fn compressed_ply(splats: &Splats) -> Vec<u8> {
    let n = splats.len();
    let rest = sh_coefficients(splats.sh_degree) - 1;
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement chunk {}\n", n.div_ceil(256));
    for stem in ["", "scale_", ""] {
        let axes = if header.contains("min_scale_x") { ["r", "g", "b"] } else { ["x", "y", "z"] };
        for end in ["min", "max"] {
            axes.iter().for_each(|a| header += &format!("property float {end}_{stem}{a}\n"));
        }
    }
    header += &format!("element vertex {n}\n");
    for what in ["position", "rotation", "scale", "color"] {
        header += &format!("property uint packed_{what}\n");
    }
    if rest > 0 {
        header += &format!("element sh {n}\n");
        (0..3 * rest).for_each(|k| header += &format!("property uchar f_rest_{k}\n"));
    }
    header += "end_header\n";

    let colors: Vec<[f32; 3]> = (0..n).map(|i| splats.sh_of(i)[0].map(color)).collect();
    let bounds = |values: &[[f32; 3]]| {
        let fold = |f: fn(f32, f32) -> f32| {
            values[1..].iter().fold(values[0], |m, v| std::array::from_fn(|k| f(m[k], v[k])))
        };
        [fold(f32::min), fold(f32::max)]
    };
    let unit = |v: [f32; 3], [low, high]: [[f32; 3]; 2]| -> [f32; 3] {
        std::array::from_fn(|k| if high[k] > low[k] { (v[k] - low[k]) / (high[k] - low[k]) } else { 0.0 })
    };
    let pack = |[x, y, z]: [f32; 3]| {
        let bits = |v: f32, max: f32| (v * max).round() as u32;
        bits(x, 2047.0) << 21 | bits(y, 1023.0) << 11 | bits(z, 2047.0)
    };
    let (mut chunks, mut rows) = (Vec::new(), Vec::new());
    for first in (0..n).step_by(256) {
        let range = first..(first + 256).min(n);
        let all = [
            bounds(&splats.means[range.clone()]),
            bounds(&splats.log_scales[range.clone()]),
            bounds(&colors[range.clone()]),
        ];
        chunks.extend(all.iter().flatten().flatten().flat_map(|v| v.to_le_bytes()));
        for i in range {
            let [x, y, z, w] = splats.rotations[i];
            let q = [w, x, y, z];
            let largest = (0..4).max_by(|a, b| q[*a].abs().total_cmp(&q[*b].abs())).unwrap();
            let sign = q[largest].signum();
            let mut rotation = largest as u32;
            for k in (0..4).filter(|k| *k != largest) {
                let t = q[k] * sign / std::f32::consts::SQRT_2 + 0.5;
                rotation = rotation << 10 | (t * 1023.0).round().clamp(0.0, 1023.0) as u32;
            }
            let [r, g, b] = unit(colors[i], all[2]);
            let color = u32::from_be_bytes([byte(r), byte(g), byte(b), byte(splats.opacities[i])]);
            for packed in [
                pack(unit(splats.means[i], all[0])),
                rotation,
                pack(unit(splats.log_scales[i], all[1])),
                color,
            ] {
                rows.extend(packed.to_le_bytes());
            }
        }
    }
    let mut out = header.into_bytes();
    out.extend(chunks);
    out.extend(rows);
    for i in 0..n {
        for k in 0..3 * rest {
            let v = splats.sh_of(i)[1 + k % rest][k / rest];
            out.push(((v / 8.0 + 0.5) * 256.0).floor().clamp(0.0, 255.0) as u8);
        }
    }
    out
}

/// antimatter15's `.splat`.
pub fn splat(splats: &Splats) -> Vec<u8> {
    let mut out = Vec::new();
    for i in 0..splats.len() {
        out.extend(splats.means[i].iter().flat_map(|v| v.to_le_bytes()));
        out.extend(splats.log_scales[i].iter().flat_map(|v| v.exp().to_le_bytes()));
        out.extend(splats.sh_of(i)[0].map(|dc| byte(color(dc))));
        out.push(byte(splats.opacities[i]));
        let [x, y, z, w] = splats.rotations[i];
        out.extend([w, x, y, z].map(|v| byte((v + 1.0) / 2.0)));
    }
    out
}

fn halves(out: &mut Vec<u8>, values: &[f32]) {
    out.extend(values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()));
}

/// splaTV's `.splatv`.
pub fn splatv(splats: &Splats) -> Vec<u8> {
    let json = br#"[{"type":"splat","size":0,"texwidth":4096,"texheight":1,"cameras":[]}]"#;
    let mut out = 0x674b_u32.to_le_bytes().to_vec();
    out.extend((json.len() as u32).to_le_bytes());
    out.extend(json);
    let motion = splats.motion.as_ref().expect("a moving scene");
    for i in 0..splats.len() {
        out.extend(splats.means[i].iter().flat_map(|v| v.to_le_bytes()));
        let [x, y, z, w] = splats.rotations[i];
        halves(&mut out, &[w, x, y, z]);
        halves(&mut out, &splats.log_scales[i].map(f32::exp));
        out.extend([0, 0]);
        out.extend(splats.sh_of(i)[0].map(|dc| byte(color(dc))));
        out.push(byte(splats.opacities[i]));
        halves(&mut out, motion.polynomials[i].as_flattened());
        out.extend([0, 0]);
        let [x, y, z, w] = motion.omegas[i];
        halves(&mut out, &[w, x, y, z]);
        halves(&mut out, &[motion.centers[i], motion.widths[i]]);
    }
    out
}

/// Splats per bucket in [`ksplat`]; one more bucket holds what is left over, one holds the last splat.
const BUCKET: usize = 4;

/// mkkellogg's `.ksplat`, one section, at a compression level 0, 1 or 2.
pub fn ksplat(splats: &Splats, level: u16) -> Vec<u8> {
    // Full buckets, then a partial one with all but one of the others, then one with the last splat.
    let full = (splats.len() - 1) / BUCKET;
    ksplat_in_buckets(splats, level, full, &[splats.len() - 1 - full * BUCKET, 1])
}

/// The same in full buckets alone: the splats are a multiple of 4.
pub fn ksplat_in_full_buckets(splats: &Splats, level: u16) -> Vec<u8> {
    ksplat_in_buckets(splats, level, splats.len() / BUCKET, &[])
}

/// Files of one section each as one of several.
pub fn ksplat_of_sections(files: &[Vec<u8>]) -> Vec<u8> {
    const HEADER: usize = 4096;
    const SECTION: usize = 1024;
    let mut out = files[0][..HEADER].to_vec();
    let count = |file: &[u8]| u32::from_le_bytes([file[16], file[17], file[18], file[19]]);
    let splats: u32 = files.iter().map(|f| count(f)).sum();
    for (at, value) in [(4, files.len() as u32), (8, files.len() as u32), (12, splats), (16, splats)] {
        out[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    out.extend(files.iter().flat_map(|f| &f[HEADER..HEADER + SECTION]));
    out.extend(files.iter().flat_map(|f| &f[HEADER + SECTION..]));
    out
}

fn ksplat_in_buckets(splats: &Splats, level: u16, full: usize, partial: &[usize]) -> Vec<u8> {
    let n = splats.len();
    let steps = 32767.0;
    let block = 5.0_f32;
    let sizes: Vec<usize> = std::iter::repeat_n(BUCKET, full).chain(partial.iter().copied()).collect();
    let mut firsts = vec![0];
    firsts.extend(sizes.iter().scan(0, |end, size| {
        *end += size;
        Some(*end)
    }));
    let buckets = if level == 0 { 0 } else { sizes.len() };

    let mut out = vec![0; 4096 + 1024];
    out[1] = 1;
    let mut set32 = |at: usize, v: u32| out[at..at + 4].copy_from_slice(&v.to_le_bytes());
    set32(4, 1);
    set32(8, 1);
    set32(12, n as u32);
    set32(16, n as u32);
    set32(20, u32::from(level));
    set32(36, (-1.0_f32).to_bits());
    set32(40, 1.0_f32.to_bits());
    let section = 4096;
    set32(section, n as u32);
    set32(section + 4, n as u32);
    if level > 0 {
        set32(section + 8, BUCKET as u32);
        set32(section + 12, buckets as u32);
        set32(section + 16, block.to_bits());
        set32(section + 20, 12);
        set32(section + 24, steps as u32);
        set32(section + 32, full as u32);
        set32(section + 36, partial.len() as u32);
    }
    set32(section + 40, u32::from(splats.sh_degree));

    let mut centers = vec![[0.0_f32; 3]; buckets];
    if level > 0 {
        out.extend(partial.iter().flat_map(|size| (*size as u32).to_le_bytes()));
        for (b, center) in centers.iter_mut().enumerate() {
            // Not the splats' own mean, so that an error in the choice of bucket shows.
            *center = splats.means[firsts[b].min(n - 1)].map(|v| v + 0.01 * b as f32);
            out.extend(center.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    for i in 0..n {
        let [x, y, z, w] = splats.rotations[i];
        let scale = splats.log_scales[i].map(f32::exp);
        if level == 0 {
            let numbers = splats.means[i].into_iter().chain(scale).chain([w, x, y, z]);
            out.extend(numbers.flat_map(f32::to_le_bytes));
        } else {
            let bucket = firsts[1..].partition_point(|end| *end <= i);
            for (mean, center) in splats.means[i].iter().zip(centers[bucket]) {
                let step = block / 2.0 / steps;
                let q = ((mean - center) / step + steps).round();
                out.extend((q.clamp(0.0, 65535.0) as u16).to_le_bytes());
            }
            halves(&mut out, &scale);
            halves(&mut out, &[w, x, y, z]);
        }
        let sh = splats.sh_of(i);
        out.extend(sh[0].map(|dc| byte(color(dc))));
        out.push(byte(splats.opacities[i]));
        for band in 1..=usize::from(splats.sh_degree) {
            for c in 0..3 {
                for v in &sh[band * band..(band + 1) * (band + 1)] {
                    match level {
                        0 => out.extend(v[c].to_le_bytes()),
                        1 => halves(&mut out, &[v[c]]),
                        _ => out.push(byte((v[c] + 1.0) / 2.0)),
                    }
                }
            }
        }
    }
    out
}
