//! Digests of what the processor computes of a scene, stage by stage: reading, examining, ordering, packing, projecting.
//! Two machines, or two builds, compute the same where their digests agree.
//!
//! What is made of additions, multiplications and roots alone is the same bit for bit everywhere. Exponentials,
//! logarithms and sines are the system's own, and may differ in their last digits: so the values themselves are kept in
//! a second file, and tell by how much. Orders and half floats are the same or not.

use std::hash::Hasher;
use std::path::{Path, PathBuf};

use glam::DVec3;
use motes_renderer::order::{OrderRequest, Positions, SortBuffers, SplatOrder};
use motes_renderer::reference::{self, ReferenceError, ReferenceOptions};
use motes_renderer::{Axis, Fov, OrderKey, Packing, Precision, Projection, RenderConfig, ShPrecision, View};
use motes_scenes::statement::Statement;
use serde::{Deserialize, Serialize};

use crate::framing::Framing;
use crate::opened::Opened;

/// Splats that are projected and blended, at most: a picture of all takes minutes where the processor is emulated.
const PROJECTED: usize = 4096;
/// Size of the pictures that they are projected into, pixels.
const SIZE: [u32; 2] = [48, 36];
/// From the middle of a scene's dense part to the eye, in radii.
const ASIDE: DVec3 = DVec3::new(0.75, -0.5, -2.5);
/// The moment of a moving scene.
const TIME: f32 = 0.4;

/// What a machine computed of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Digest {
    /// Operating system and architecture.
    pub machine: String,
    /// The scene's name.
    pub scene: String,
    /// Its splats.
    pub splats: usize,
    /// Stages, in the order in which they were computed.
    pub stages: Vec<Stage>,
}

/// One step of the computation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// What was computed.
    pub name: String,
    /// Number of values.
    pub count: usize,
    /// FNV-1a of all values' bits, in hexadecimal.
    pub hash: String,
    /// The values, of stages whose values are numbers; they are in a file of their own.
    #[serde(skip)]
    pub values: Vec<f64>,
}

impl Stage {
    /// Whether its values are numbers, and kept: an order's places and packed half floats are the same or not.
    fn has_values(&self) -> bool {
        !(self.name.starts_with("order") || self.name == format!("pack, {}", Precision::F16))
    }
}

/// How a stage of two digests agrees.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// The stage.
    pub name: String,
    /// Number of values.
    pub count: usize,
    /// Whether every bit of every value is the same.
    pub identical: bool,
    /// Largest difference of two values, as a part of the larger magnitude, or by itself where that is below 1; infinite
    /// where an order or a packed word differs.
    pub worst: f64,
}

/// Why a digest is not there.
#[derive(Debug, thiserror::Error)]
pub enum DigestError {
    /// The reference refuses the scene: its arrays do not fit together.
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's word.
        source: std::io::Error,
    },
    /// A file is no digest.
    #[error("{} is no digest: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What was found.
        problem: String,
    },
}

/// FNV-1a, which is easy to state and the same on every machine.
struct Fnv(u64);

impl Hasher for Fnv {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

/// Collects a stage's values.
struct Values {
    fnv: Fnv,
    count: usize,
    all: Vec<f64>,
}

impl Values {
    fn new() -> Self {
        Self { fnv: Fnv(0xcbf2_9ce4_8422_2325), count: 0, all: Vec::new() }
    }

    fn f32s(&mut self, values: impl IntoIterator<Item = f32>) {
        for value in values {
            self.fnv.write(&value.to_bits().to_le_bytes());
            self.all.push(value.into());
            self.count += 1;
        }
    }

    fn f64s(&mut self, values: impl IntoIterator<Item = f64>) {
        for value in values {
            self.fnv.write(&value.to_bits().to_le_bytes());
            self.all.push(value);
            self.count += 1;
        }
    }

    fn u32s(&mut self, values: impl IntoIterator<Item = u32>) {
        for value in values {
            self.fnv.write(&value.to_le_bytes());
            self.count += 1;
        }
    }

    fn stage(self, name: &str) -> Stage {
        let hash = format!("{:016x}", self.fnv.finish());
        Stage { name: name.to_owned(), count: self.count, hash, values: self.all }
    }
}

/// The file of a digest's values.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".values");
    name.into()
}

/// The numbers of a JSON value, in its own order.
fn numbers(value: &serde_json::Value, found: &mut Vec<f64>) {
    match value {
        serde_json::Value::Number(n) => found.extend(n.as_f64()),
        serde_json::Value::Array(list) => list.iter().for_each(|v| numbers(v, found)),
        serde_json::Value::Object(map) => map.values().for_each(|v| numbers(v, found)),
        _ => {}
    }
}

impl Digest {
    /// Computes everything.
    ///
    /// # Errors
    /// The reference refuses the scene: its arrays do not fit together.
    pub fn of(opened: &Opened) -> Result<Self, DigestError> {
        let splats = &opened.scene.splats;
        let mut stages = Vec::new();

        let mut read = Values::new();
        read.f32s(splats.means.iter().flatten().copied());
        read.f32s(splats.rotations.iter().flatten().copied());
        read.f32s(splats.log_scales.iter().flatten().copied());
        read.f32s(splats.opacities.iter().copied());
        read.f32s(splats.sh.iter().flatten().copied());
        if let Some(motion) = &splats.motion {
            read.f32s(motion.centers.iter().chain(&motion.widths).copied());
            read.f32s(motion.polynomials.iter().flatten().flatten().copied());
            read.f32s(motion.omegas.iter().flatten().copied());
        }
        stages.push(read.stage("read"));

        let mut examined = Values::new();
        let statement = serde_json::to_value(Statement::of(&opened.scene)).unwrap_or_default();
        let mut found = Vec::new();
        numbers(&statement, &mut found);
        examined.f64s(found);
        stages.push(examined.stage("examine"));

        // Nothing that a machine may round in its own way decides from where the scene is looked at.
        let Framing { center, radius, .. } = Framing::of(splats, &opened.settings);
        let fov = Fov { left: -0.6, right: 0.6, up: -0.45, down: 0.45 };
        let view = View::look_at(center + ASIDE * radius, center, DVec3::NEG_Y, fov, SIZE);

        let positions = Positions::of(splats);
        for &key in OrderKey::ALL {
            let config = RenderConfig { order: key, time: TIME, ..RenderConfig::default() };
            let mut order = SplatOrder::default();
            order.sort(&positions, &OrderRequest::new(&[view], &config), &mut SortBuffers::default());
            let mut sorted = Values::new();
            sorted.u32s(order.indices);
            stages.push(sorted.stage(&format!("order, {key}")));
        }

        for (precision, sh_precision) in
            [(Precision::F32, ShPrecision::F32), (Precision::F16, ShPrecision::F16)]
        {
            let packing = Packing { precision, sh_precision, sh_degree: splats.sh_degree };
            let mut words = vec![0; packing.geometry_words() * splats.len()];
            packing.geometry(splats, 0, &mut words);
            let mut harmonics = vec![0; packing.sh_words() * splats.len()];
            packing.harmonics(splats, 0, &mut harmonics);
            words.append(&mut harmonics);
            if splats.motion.is_some() {
                let mut motion = vec![0; packing.motion_words() * splats.len()];
                packing.motion(splats, 0, &mut motion);
                words.append(&mut motion);
            }
            let mut packed = Values::new();
            // Scales are exponentials: numbers of which the last digit is the system's.
            match precision {
                Precision::F32 => packed.f32s(words.into_iter().map(f32::from_bits)),
                _ => packed.u32s(words),
            }
            stages.push(packed.stage(&format!("pack, {precision}")));
        }

        let mut some = splats.clone();
        let step = splats.len().div_ceil(PROJECTED).max(1);
        some.retain(|i| i % step == 0);
        for &projection in Projection::ALL {
            let config = RenderConfig { projection, time: TIME, ..RenderConfig::default() };
            let image = reference::render(&some, &view, &ReferenceOptions::of_config(&config))?;
            let mut projected = Values::new();
            for pixel in &image.pixels {
                projected.f64s(pixel.colour);
                projected.f64s([pixel.transmittance, pixel.layers.into()]);
            }
            stages.push(projected.stage(&format!("project and blend, {projection}")));
        }

        Ok(Self {
            machine: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            scene: opened.name.clone(),
            splats: splats.len(),
            stages,
        })
    }

    /// Writes the digest, and its values beside it (`FILE.values`: 64-bit floats, the lowest byte first).
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), DigestError> {
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| DigestError::Io { path, source }
        };
        let text = serde_json::to_vec_pretty(self).map_err(std::io::Error::other).map_err(io(path))?;
        std::fs::write(path, text).map_err(io(path))?;
        let bytes: Vec<u8> =
            self.stages.iter().flat_map(|s| &s.values).flat_map(|v| v.to_bits().to_le_bytes()).collect();
        let values = beside(path);
        std::fs::write(&values, bytes).map_err(io(&values))
    }

    /// Reads what [`Digest::save`] wrote.
    ///
    /// # Errors
    /// A file cannot be read, or is none.
    pub fn load(path: &Path) -> Result<Self, DigestError> {
        let read = |path: &Path| {
            std::fs::read(path).map_err(|source| DigestError::Io { path: path.to_owned(), source })
        };
        let no_digest = |path: &Path, problem: String| DigestError::File { path: path.to_owned(), problem };
        let mut digest: Self =
            serde_json::from_slice(&read(path)?).map_err(|e| no_digest(path, e.to_string()))?;
        let values = beside(path);
        let bytes = read(&values)?;
        let mut words = bytes.as_chunks::<8>().0.iter().map(|b| f64::from_bits(u64::from_le_bytes(*b)));
        for stage in digest.stages.iter_mut().filter(|s| s.has_values()) {
            stage.values = words.by_ref().take(stage.count).collect();
            if stage.values.len() != stage.count {
                return Err(no_digest(&values, format!("it ends within the stage '{}'", stage.name)));
            }
        }
        Ok(digest)
    }

    /// How two digests agree, stage by stage; nothing where they are not of the same stages of equally many values.
    pub fn agreement(&self, other: &Self) -> Option<Vec<Agreement>> {
        let same = self.splats == other.splats
            && self.stages.len() == other.stages.len()
            && self.stages.iter().zip(&other.stages).all(|(a, b)| a.name == b.name && a.count == b.count);
        same.then(|| {
            let pairs = self.stages.iter().zip(&other.stages);
            pairs
                .map(|(a, b)| {
                    let difference = |(a, b): (&f64, &f64)| {
                        let off = (a - b).abs() / a.abs().max(b.abs()).max(1.0);
                        // Two infinities, or two that are no numbers, are no difference.
                        if a.to_bits() == b.to_bits() {
                            0.0
                        } else if off.is_nan() {
                            f64::INFINITY
                        } else {
                            off
                        }
                    };
                    let identical = a.hash == b.hash;
                    let numbers = a.values.len() == a.count && b.values.len() == b.count;
                    let worst = match (identical, numbers) {
                        (true, _) => 0.0,
                        (false, true) => a.values.iter().zip(&b.values).map(difference).fold(0.0, f64::max),
                        (false, false) => f64::INFINITY,
                    };
                    Agreement { name: a.name.clone(), count: a.count, identical, worst }
                })
                .collect()
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use motes_scenes::LoadOptions;
    use motes_scenes::synthetic::{Animation, Recipe};

    fn opened(change: f32) -> Opened {
        let mut opened = Opened::load(&[], &LoadOptions::default()).unwrap();
        opened.scene.splats = Recipe { count: 300, ..Recipe::default() }.moving(&Animation::default());
        opened.scene.splats.means[7][1] += change;
        opened
    }

    #[test]
    fn the_same_scene_has_the_same_digest_and_another_has_not() {
        let digest = Digest::of(&opened(0.0)).unwrap();
        assert!(digest.stages.len() >= 9 && digest.stages.iter().all(|s| s.count > 0), "{digest:?}");
        assert!(digest.stages.iter().all(|s| s.has_values() == (s.values.len() == s.count)));
        let folder = std::env::temp_dir().join(format!("motes-digest-file-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("digest.json");
        digest.save(&file).unwrap();
        let again = Digest::load(&file).unwrap();
        assert_eq!(again, digest);
        let same = digest.agreement(&again).unwrap();
        assert!(same.iter().all(|a| a.identical && a.worst == 0.0), "{same:?}");
        std::fs::write(beside(&file), [0; 80]).unwrap();
        assert!(Digest::load(&file).unwrap_err().to_string().contains("within the stage 'read'"));
        std::fs::remove_dir_all(&folder).unwrap();
        // Controls: one mean elsewhere is seen, however many there are, and by how much.
        let moved = digest.agreement(&Digest::of(&opened(0.5)).unwrap()).unwrap();
        assert!(!moved[0].identical && (0.1..1.0).contains(&moved[0].worst), "{moved:?}");
        assert!(moved.iter().any(|a| a.name.starts_with("pack") && a.worst.is_infinite()));
        let mut fewer = opened(0.0);
        fewer.scene.splats.retain(|i| i != 3);
        assert_eq!(digest.agreement(&Digest::of(&fewer).unwrap()), None);
    }
}
