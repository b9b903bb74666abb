//! Encoders of SOG and SPZ, written from the formats' descriptions and apart from the crate's own writer. Tables and
//! palettes hold the splats' own values, so that only what the formats quantise at any rate is lost.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use std::collections::BTreeSet;
use std::io::{Cursor, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use half::f16;
use image_webp::{ColorType, WebPEncoder};
use motes_scenes::{Splats, sh_coefficients};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use zip::write::SimpleFileOptions;

/// The files of a SOG scene by name; `meta.json` is the last.
pub type Files = Vec<(String, Vec<u8>)>;

/// A lossless WebP.
pub fn webp(width: u32, height: u32, rgba: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    WebPEncoder::new(&mut bytes).encode(rgba, width, height, ColorType::Rgba8).unwrap();
    bytes
}

/// An image whose pixel `i` is `pixel(i)`, rows of `width`.
fn image(width: usize, count: usize, pixel: impl Fn(usize) -> [u8; 4]) -> Vec<u8> {
    let height = count.div_ceil(width);
    let rgba: Vec<u8> =
        (0..width * height).flat_map(|i| if i < count { pixel(i) } else { [0, 0, 0, 255] }).collect();
    webp(width as u32, height as u32, &rgba)
}

/// 256 values, of which the first are those given.
struct Table(Vec<f32>);

impl Table {
    fn of<'a>(values: impl Iterator<Item = &'a f32>) -> Self {
        let distinct: BTreeSet<u32> = values.map(|v| v.to_bits()).collect();
        assert!(distinct.len() <= 256, "{} distinct values", distinct.len());
        let mut table: Vec<f32> = distinct.into_iter().map(f32::from_bits).collect();
        table.resize(256, 77.0);
        Self(table)
    }

    fn index(&self, value: f32) -> u8 {
        self.0.iter().position(|v| v.to_bits() == value.to_bits()).unwrap() as u8
    }
}

fn log(v: f32) -> f64 {
    f64::from(v).abs().ln_1p().copysign(v.into())
}

/// The bytes of a rotation in SOG.
fn sog_rotation([x, y, z, w]: [f32; 4]) -> [u8; 4] {
    let q = [w, x, y, z];
    let largest = (0..4).max_by(|&a, &b| q[a].abs().total_cmp(&q[b].abs())).unwrap();
    let sign = q[largest].signum();
    let others: Vec<u8> = (0..4)
        .filter(|&i| i != largest)
        .map(|i| ((q[i] * sign * std::f32::consts::SQRT_2 * 0.5 + 0.5) * 255.0).round() as u8)
        .collect();
    [others[0], others[1], others[2], 252 + largest as u8]
}

/// A SOG scene of version 1 or 2.
pub fn sog(splats: &Splats, version: u32) -> Files {
    let n = splats.len();
    let width = (n as f64).sqrt().ceil().max(1.0) as usize;
    let coefficients = sh_coefficients(splats.sh_degree);
    let ends = |values: &mut dyn Iterator<Item = f64>| {
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
    };
    let axes: [[f64; 2]; 3] = std::array::from_fn(|k| ends(&mut splats.means.iter().map(|m| log(m[k]))));
    let means: Vec<[u16; 3]> = splats
        .means
        .iter()
        .map(|m| {
            std::array::from_fn(|k| {
                ((log(m[k]) - axes[k][0]) / (axes[k][1] - axes[k][0]) * 65535.0).round() as u16
            })
        })
        .collect();
    let mut files: Files = Vec::new();
    let mut add = |name: &str, bytes: Vec<u8>| files.push((name.to_owned(), bytes));
    add("means_l.webp", image(width, n, |i| [means[i][0] as u8, means[i][1] as u8, means[i][2] as u8, 255]));
    add(
        "means_u.webp",
        image(width, n, |i| {
            [(means[i][0] >> 8) as u8, (means[i][1] >> 8) as u8, (means[i][2] >> 8) as u8, 255]
        }),
    );
    add("quats.webp", image(width, n, |i| sog_rotation(splats.rotations[i])));

    let scales = Table::of(splats.log_scales.as_flattened().iter());
    let dc: Vec<[f32; 3]> = (0..n).map(|i| splats.sh_of(i)[0]).collect();
    let sh0 = Table::of(dc.as_flattened().iter());
    let higher = || (0..n).flat_map(|i| splats.sh_of(i)[1..].iter().flatten());
    let sh_n = Table::of(higher());

    // Version 1 knows ranges only.
    let linear = |v: f32, [min, max]: [f64; 2]| ((f64::from(v) - min) / (max - min) * 255.0).round() as u8;
    let scale_ends: [[f64; 2]; 3] =
        std::array::from_fn(|k| ends(&mut splats.log_scales.iter().map(|s| s[k].into())).map(f64::from));
    let scale_ends = scale_ends.map(|[a, b]| if a == b { [a, a + 1.0] } else { [a, b] });
    let dc_ends: [[f64; 2]; 3] = std::array::from_fn(|k| {
        let [a, b] = ends(&mut dc.iter().map(|c| c[k].into()));
        if a == b { [a, a + 1.0] } else { [a, b] }
    });
    let logit = |p: f32| (f64::from(p) / (1.0 - f64::from(p))).ln();
    let opacity_ends = [-6.0, 6.0];
    let sh_ends = ends(&mut higher().map(|v| (*v).into()));

    add(
        "scales.webp",
        image(width, n, |i| {
            let s = splats.log_scales[i];
            let byte = |k: usize| if version == 1 { linear(s[k], scale_ends[k]) } else { scales.index(s[k]) };
            [byte(0), byte(1), byte(2), 255]
        }),
    );
    add(
        "sh0.webp",
        image(width, n, |i| {
            let byte =
                |k: usize| if version == 1 { linear(dc[i][k], dc_ends[k]) } else { sh0.index(dc[i][k]) };
            let opacity = splats.opacities[i];
            let alpha = if version == 1 {
                linear(logit(opacity) as f32, opacity_ends)
            } else {
                (opacity * 255.0).round() as u8
            };
            [byte(0), byte(1), byte(2), alpha]
        }),
    );
    if coefficients > 1 {
        let per = coefficients - 1;
        let rows = n.div_ceil(64);
        add(
            "shN_centroids.webp",
            image(64 * per, rows * 64 * per, |pixel| {
                let (row, column) = (pixel / (64 * per), pixel % (64 * per));
                let entry = row * 64 + column / per;
                if entry >= n {
                    return [0, 0, 0, 255];
                }
                let v = splats.sh_of(entry)[1 + column % per];
                let byte = |c: usize| if version == 1 { linear(v[c], sh_ends) } else { sh_n.index(v[c]) };
                [byte(0), byte(1), byte(2), 255]
            }),
        );
        add("shN_labels.webp", image(width, n, |i| [i as u8, (i >> 8) as u8, 0, 255]));
    }

    let list = |ends: &[[f64; 2]], side: usize| ends.iter().map(|e| e[side]).collect::<Vec<_>>();
    let (mins, maxs) = (list(&axes, 0), list(&axes, 1));
    let meta = if version == 1 {
        let mut meta = serde_json::json!({
            "means": {"shape": [n, 3], "dtype": "float32", "mins": mins, "maxs": maxs,
                      "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"shape": [n, 3], "mins": list(&scale_ends, 0), "maxs": list(&scale_ends, 1),
                       "files": ["scales.webp"]},
            "quats": {"shape": [n, 4], "encoding": "quaternion_packed", "files": ["quats.webp"]},
            "sh0": {"shape": [n, 1, 4],
                    "mins": [dc_ends[0][0], dc_ends[1][0], dc_ends[2][0], opacity_ends[0]],
                    "maxs": [dc_ends[0][1], dc_ends[1][1], dc_ends[2][1], opacity_ends[1]],
                    "files": ["sh0.webp"]},
        });
        if coefficients > 1 {
            meta["shN"] = serde_json::json!({"shape": [n, coefficients - 1], "mins": sh_ends[0], "maxs": sh_ends[1],
                "quantization": 8, "files": ["shN_centroids.webp", "shN_labels.webp"]});
        }
        meta
    } else {
        let mut meta = serde_json::json!({
            "version": 2, "count": n,
            "means": {"mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"codebook": scales.0, "files": ["scales.webp"]},
            "quats": {"files": ["quats.webp"]},
            "sh0": {"codebook": sh0.0, "files": ["sh0.webp"]},
        });
        if coefficients > 1 {
            meta["shN"] = serde_json::json!({"count": n, "bands": splats.sh_degree, "codebook": sh_n.0,
                "files": ["shN_centroids.webp", "shN_labels.webp"]});
        }
        meta
    };
    files.push(("meta.json".to_owned(), serde_json::to_vec(&meta).unwrap()));
    files
}

/// Zips files, stored or deflated, below a folder name (which may be empty).
pub fn zip(files: &Files, below: &str, deflate: bool) -> Vec<u8> {
    let mut out = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let method = if deflate { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
    for (name, bytes) in files {
        let options = SimpleFileOptions::default().compression_method(method);
        out.start_file(format!("{below}{name}"), options).unwrap();
        out.write_all(bytes).unwrap();
    }
    out.finish().unwrap().into_inner()
}

/// Writes files into a folder.
pub fn unzip(files: &Files, folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    for (name, bytes) in files {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}

/// The attributes of an SPZ file: means, opacities, colours, scales, rotations, higher bands (of a degree that may be
/// higher than the splats': zeros follow).
pub fn spz_attributes(splats: &Splats, version: u32, degree: u8, fractional_bits: u8) -> [Vec<u8>; 6] {
    let byte = |v: f32| v.round().clamp(0.0, 255.0) as u8;
    let mut all: [Vec<u8>; 6] = Default::default();
    for i in 0..splats.len() {
        for v in splats.means[i] {
            if version == 1 {
                all[0].extend(f16::from_f32(v).to_le_bytes());
            } else {
                let fixed = (v * f32::from(fractional_bits).exp2()).round() as i32;
                all[0].extend(&fixed.to_le_bytes()[..3]);
            }
        }
        all[1].push(byte(splats.opacities[i] * 255.0));
        let sh = splats.sh_of(i);
        all[2].extend(sh[0].map(|v| byte(v * 0.15 * 255.0 + 127.5)));
        all[3].extend(splats.log_scales[i].map(|v| byte((v + 10.0) * 16.0)));
        let q = splats.rotations[i];
        if version < 3 {
            let sign = if q[3] < 0.0 { -1.0 } else { 1.0 };
            all[4].extend([q[0], q[1], q[2]].map(|v| byte(v * sign * 127.5 + 127.5)));
        } else {
            let largest = (0..4).max_by(|&a, &b| q[a].abs().total_cmp(&q[b].abs())).unwrap();
            let mut bits = largest as u32;
            for k in (0..4).filter(|&k| k != largest) {
                let v = q[k] * q[largest].signum();
                let magnitude = (511.0 * v.abs() * std::f32::consts::SQRT_2 + 0.5) as u32;
                bits = (bits << 10) | (u32::from(v < 0.0) << 9) | magnitude;
            }
            all[4].extend(bits.to_le_bytes());
        }
        for k in 1..sh_coefficients(degree) {
            let v = sh.get(k).copied().unwrap_or_default();
            all[5].extend(v.map(|v| byte(v * 128.0 + 128.0)));
        }
    }
    all
}

/// A header's first 16 bytes.
pub fn spz_header(version: u32, count: u32, degree: u8, fractional_bits: u8, flags: u8, last: u8) -> Vec<u8> {
    let mut header = b"NGSP".to_vec();
    header.extend(version.to_le_bytes());
    header.extend(count.to_le_bytes());
    header.extend([degree, fractional_bits, flags, last]);
    header
}

/// Compresses as versions 1 to 3 are.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::default());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// Assembles version 4 from plain streams, with extension records.
pub fn spz_4(header: &[u8], extensions: &[u8], streams: &[Vec<u8>]) -> Vec<u8> {
    let mut out = header.to_vec();
    out.extend((32 + extensions.len() as u32).to_le_bytes());
    out.extend([0; 12]);
    out.extend(extensions);
    let packed: Vec<Vec<u8>> =
        streams.iter().map(|s| compress_to_vec(s.as_slice(), CompressionLevel::Fastest)).collect();
    for (packed, plain) in packed.iter().zip(streams) {
        out.extend((packed.len() as u64).to_le_bytes());
        out.extend((plain.len() as u64).to_le_bytes());
    }
    out.extend(packed.concat());
    out
}

/// An SPZ file of any version.
pub fn spz(splats: &Splats, version: u32) -> Vec<u8> {
    let bits = 12;
    let attributes = spz_attributes(splats, version, splats.sh_degree, bits);
    let streams: Vec<Vec<u8>> = attributes.into_iter().filter(|a| !a.is_empty()).collect();
    let last = if version == 4 { streams.len() as u8 } else { 0 };
    let header = spz_header(version, splats.len() as u32, splats.sh_degree, bits, 0, last);
    if version == 4 { spz_4(&header, &[], &streams) } else { gzip(&[header, streams.concat()].concat()) }
}
