//! Levels of detail in one file, `.mlod`: read a part at a time.
//!
//! ```text
//! bytes 0–7    "MOTESLOD"
//! bytes 8–11   version, u32 little-endian: 1
//! bytes 12–19  length of the index, u64 little-endian
//! then         the index, JSON; then the parts, in any order
//! ```
//!
//! The index lists levels (0 is the finest), classes, and **groups**: splats of one class in one region, with a box and, for
//! every level, the range of the file that holds them (`offset` counts from the end of the index). A range is a whole scene
//! file by itself (SPZ, or the trainers' PLY), so that each is decoded, checked and limited like any other scene. What belongs
//! to levels but is no concern of this crate (fitted curves) is kept in `extra` as it is.
//!
//! A streamed SOG scene ([`crate::StreamedLevel`]) is read the same way: each leaf of its tree is a group. It has no `extra`.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::formats::streamed_parts::StreamedParts;
use crate::labels::Class;
use crate::load::LoadContext;
use crate::source::Source;
use crate::{LoadOptions, Scene, SceneError, Splats, formats, load_bytes};

/// The first bytes of a file.
pub const MAGIC: &[u8; 8] = b"MOTESLOD";
const VERSION: u32 = 1;
const HEADER: u64 = 20;
/// An index longer than this is none.
const MAX_INDEX: u64 = 256 << 20;
/// No scene file has more splats than this per byte (an SPZ of equal splats, compressed 1000 : 1).
const MOST_SPLATS_PER_BYTE: u64 = 64;
/// Standard deviations beyond which no splat changes a pixel: √(2 ln 255).
pub(crate) const REACH: f64 = 3.33;
const DAMAGED: &str =
    "The file is damaged or incomplete: copy it again, or build it anew by `motes lod build`";

/// A level of detail.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Level {
    /// What it is called, e.g. the snapshot's file name.
    pub name: String,
    /// What the quality's curve calls `i`: the training iteration, or for simplified levels the share of splats in 1/1000.
    pub step: f64,
    /// Splats in all groups.
    pub splats: u64,
}

/// Where a group's splats of one level are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// First byte, from the end of the index.
    pub offset: u64,
    /// Bytes; 0 where the level has no splats here.
    pub bytes: u64,
    /// Splats.
    pub splats: u64,
}

/// Splats of one class in one region.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Group {
    /// The class, 0: unlabelled.
    pub class: u16,
    /// Lowest and highest corner of the box around all means of all levels, scene axes and units.
    pub bounds: [[f64; 3]; 2],
    /// The box around all that its splats may cover at any level, 3.33 standard deviations (√(2 ln 255)); files of before
    /// have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reach: Option<[[f64; 3]; 2]>,
    /// One range a level.
    pub ranges: Vec<Range>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct StoredClass {
    id: u16,
    name: String,
    colour: [u8; 3],
}

/// What a file holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Index {
    levels: Vec<Level>,
    classes: Vec<StoredClass>,
    groups: Vec<Group>,
    #[serde(default)]
    extra: Value,
}

/// An open file of levels, or a streamed SOG scene.
#[derive(Debug)]
pub struct LevelFile {
    parts: Parts,
    index: Index,
}

/// Where the parts are.
#[derive(Debug)]
enum Parts {
    /// In a file, from this byte on.
    File(Source, u64),
    /// In pieces beside a `lod-meta.json`.
    Streamed(StreamedParts),
}

impl LevelFile {
    /// Opens a file and reads its index; or a streamed scene, by its folder or its `lod-meta.json`.
    ///
    /// # Errors
    /// [`SceneError`] where it cannot be read, is no such file, or its index contradicts itself or the file's length.
    pub fn open(path: &Path) -> Result<Self, SceneError> {
        let source = Source::open(path)?;
        if !(source.is_folder() || path.file_name().is_some_and(|name| name == "lod-meta.json")) {
            return Self::of(source);
        }
        let (parts, levels, groups) = StreamedParts::open(&source)?;
        let index = Index { levels, classes: Vec::new(), groups, extra: Value::Null };
        Ok(Self { parts: Parts::Streamed(parts), index })
    }

    /// From bytes in memory; `name` stands for the path.
    ///
    /// # Errors
    /// As [`LevelFile::open`].
    pub fn from_bytes(name: &Path, bytes: Arc<[u8]>) -> Result<Self, SceneError> {
        Self::of(Source::from_bytes(name, bytes))
    }

    pub(crate) fn of(source: Source) -> Result<Self, SceneError> {
        let refuse =
            |place: String, problem: String| SceneError::malformed(source.path(), place, problem, DAMAGED);
        let head = source.head(HEADER as usize)?;
        if !head.starts_with(MAGIC) || head.len() < HEADER as usize {
            return Err(refuse(
                "byte 0".into(),
                "a file of levels begins with MOTESLOD and 12 more bytes".into(),
            ));
        }
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        if word(8) != VERSION {
            return Err(SceneError::unsupported(
                source.path(),
                format!("levels of version {}, and this program knows {VERSION}", word(8)),
                "Use a newer version of Motes",
            ));
        }
        let length = u64::from(word(12)) | u64::from(word(16)) << 32;
        if length > MAX_INDEX {
            return Err(refuse("byte 12".into(), format!("an index of {length} bytes is too long")));
        }
        let start = HEADER + length;
        if start > source.len() {
            return Err(source.ends_early(HEADER, start));
        }
        let mut text = vec![0; length as usize];
        source.read_at(HEADER, &mut text)?;
        let index: Index = serde_json::from_slice(&text).map_err(|e| {
            refuse(
                format!("the index, line {}, column {}", e.line(), e.column()),
                format!("cannot be read: {e}"),
            )
        })?;
        index.check(source.len() - start).map_err(|(place, problem)| refuse(place, problem))?;
        Ok(Self { parts: Parts::File(source, start), index })
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        match &self.parts {
            Parts::File(source, _) => source.path(),
            Parts::Streamed(parts) => parts.path(),
        }
    }

    /// Length of the file, or of all files of a streamed scene, bytes.
    pub fn bytes(&self) -> u64 {
        match &self.parts {
            Parts::File(source, _) => source.len(),
            Parts::Streamed(parts) => parts.bytes(),
        }
    }

    /// The highest degree of spherical harmonics, where it is known without reading parts.
    pub fn sh_degree(&self) -> Option<u8> {
        match &self.parts {
            Parts::File(..) => None,
            Parts::Streamed(parts) => Some(parts.sh_degree()),
        }
    }

    /// The levels, the finest first; never empty.
    pub fn levels(&self) -> &[Level] {
        &self.index.levels
    }

    /// The groups.
    pub fn groups(&self) -> &[Group] {
        &self.index.groups
    }

    /// The classes.
    pub fn classes(&self) -> Vec<Class> {
        let class = |c: &StoredClass| Class { id: c.id, name: c.name.clone(), colour: c.colour };
        self.index.classes.iter().map(class).collect()
    }

    /// What others keep in the index.
    pub fn extra(&self) -> &Value {
        &self.index.extra
    }

    /// Reads a group at a level, labelled with its class. Of a streamed scene there can be fewer splats than are listed: those
    /// of which no picture can be made are left out, which the log tells.
    ///
    /// # Errors
    /// [`SceneError`] where the range is damaged or holds another number of splats than the index says; the error for a
    /// group or level that there is not is [`SceneError::Unsupported`].
    pub fn read(&self, group: usize, level: usize) -> Result<Splats, SceneError> {
        let found = self.index.groups.get(group).and_then(|g| Some((g, *g.ranges.get(level)?)));
        let Some((Group { class, .. }, range)) = found else {
            let what = format!("it has no group {group} with a level {level}");
            return Err(SceneError::unsupported(self.path(), what, "Ask for one that its index lists"));
        };
        if range.bytes == 0 {
            return Ok(Splats { labels: Some(Vec::new()), ..Splats::zeroed(0, 0, false) });
        }
        let (source, start) = match &self.parts {
            Parts::File(source, start) => (source, start),
            Parts::Streamed(parts) => {
                let mut splats = parts.read(group, level, range.splats)?;
                splats.labels = Some(vec![*class; splats.len()]);
                return Ok(splats);
            }
        };
        let mut bytes = vec![0; range.bytes as usize];
        source.read_at(start + range.offset, &mut bytes)?;
        // Named after the file; the extension would decide only where the content does not.
        let mut options = LoadOptions::default();
        options.limits.splats = range.splats;
        let mut splats = load_bytes(self.path(), bytes.into(), &options)?.splats;
        if splats.len() as u64 != range.splats {
            return Err(SceneError::malformed(
                self.path(),
                format!("group {group}, level {level}"),
                format!("holds {} splats, and the index says {}", splats.len(), range.splats),
                DAMAGED,
            ));
        }
        splats.labels = Some(vec![*class; splats.len()]);
        Ok(splats)
    }

    /// Writes the same file with other things in `extra`. A reader sees the old file or the new one, never a part.
    ///
    /// # Errors
    /// [`SceneError::Io`] where the disk refuses; a streamed scene has no place for it.
    pub fn save_with(&self, path: &Path, extra: Value) -> Result<(), SceneError> {
        let Parts::File(source, start) = &self.parts else {
            let what = "a streamed scene keeps nothing else in its index";
            return Err(SceneError::unsupported(
                self.path(),
                what,
                "Build levels of it by `motes lod build`",
            ));
        };
        let index = Index { extra, ..self.index.clone() };
        write(path, &index, |out| {
            let mut block = vec![0; 1 << 20];
            let mut at = *start;
            while at < source.len() {
                let n = (source.len() - at).min(block.len() as u64) as usize;
                source.read_at(at, &mut block[..n]).map_err(std::io::Error::other)?;
                out.write_all(&block[..n])?;
                at += n as u64;
            }
            Ok(())
        })
    }
}

/// One level of all groups, labelled by classes, as the loader reads it. See [`formats`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let file = LevelFile::of(source.again()?)?;
    let level = (ctx.options().level as usize).min(file.levels().len() - 1);
    ctx.admit(source, file.levels()[level].splats, 0, false)?;
    let bytes = |group: &Group| group.ranges[level].bytes;
    let total = file.groups().iter().map(bytes).sum();
    let mut parts = Vec::new();
    for (i, group) in file.groups().iter().enumerate() {
        parts.push(file.read(i, level)?);
        ctx.advance(source, bytes(group), total)?;
    }
    Ok(Scene::joined(parts))
}

impl Index {
    /// Whether the index makes sense for parts of so many bytes; else the place and the problem.
    fn check(&self, bytes: u64) -> Result<(), (String, String)> {
        let refuse = |place: String, problem: String| Err((place, problem));
        if self.levels.is_empty() {
            return refuse("the index".into(), "lists no level".into());
        }
        if let Some(level) = self.levels.iter().find(|l| !(l.step.is_finite() && l.step > 0.0)) {
            return refuse(
                format!("level '{}'", level.name),
                format!("its step is {}, expected above 0", level.step),
            );
        }
        let mut sums = vec![0u64; self.levels.len()];
        for (i, group) in self.groups.iter().enumerate() {
            for [low, high] in std::iter::once(group.bounds).chain(group.reach) {
                if !(0..3).all(|k| low[k] <= high[k] && low[k].is_finite() && high[k].is_finite()) {
                    return refuse(format!("group {i}"), format!("its box is {low:?} to {high:?}"));
                }
            }
            if group.ranges.len() != self.levels.len() {
                let (ranges, levels) = (group.ranges.len(), self.levels.len());
                return refuse(format!("group {i}"), format!("has {ranges} ranges for {levels} levels"));
            }
            for (level, range) in group.ranges.iter().enumerate() {
                let place = format!("group {i}, level {level}");
                if range.offset.checked_add(range.bytes).is_none_or(|end| end > bytes) {
                    let Range { offset, bytes: length, .. } = range;
                    return refuse(
                        place,
                        format!("{length} bytes from {offset} on reach beyond the file's end"),
                    );
                }
                if range.splats > range.bytes.saturating_mul(MOST_SPLATS_PER_BYTE) {
                    return refuse(
                        place,
                        format!("{} splats do not fit into {} bytes", range.splats, range.bytes),
                    );
                }
                sums[level] = sums[level].saturating_add(range.splats);
            }
        }
        for (level, sum) in self.levels.iter().zip(sums) {
            if level.splats != sum {
                let problem = format!("has {} splats, and its groups {sum}", level.splats);
                return refuse(format!("level '{}'", level.name), problem);
            }
        }
        Ok(())
    }
}

fn write(
    path: &Path,
    index: &Index,
    parts: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), SceneError> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".part");
    let partial = PathBuf::from(partial);
    let write = || -> std::io::Result<()> {
        let text = serde_json::to_vec(index)?;
        let mut out = BufWriter::with_capacity(1 << 18, File::create(&partial)?);
        out.write_all(MAGIC)?;
        out.write_all(&VERSION.to_le_bytes())?;
        out.write_all(&(text.len() as u64).to_le_bytes())?;
        out.write_all(&text)?;
        parts(&mut out)?;
        out.flush()?;
        drop(out);
        std::fs::rename(&partial, path)
    };
    write().map_err(|error| {
        // Nothing to be done about a leftover that cannot be removed either; the first error is the one to tell.
        let _ = std::fs::remove_file(&partial);
        SceneError::io(path)(error)
    })
}

/// How ranges are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// SPZ: some 20 bytes a splat and more with harmonics, in steps that do not show.
    #[default]
    Spz,
    /// PLY: every bit, 60 to 250 bytes a splat.
    Ply,
}

/// A level before it is written: its name, its step, and its splats with a class each where they have labels.
#[derive(Clone, Debug)]
pub struct NewLevel {
    /// As [`Level::name`].
    pub name: String,
    /// As [`Level::step`].
    pub step: f64,
    /// The splats.
    pub splats: Splats,
}

/// Sorts splats into groups by class and by cubes with sides of `cell` (none: one group a class), and writes them.
///
/// # Errors
/// [`SceneError`] where the disk refuses, or a level is none: no level at all, a moving scene, a step that is not positive.
pub fn save(
    path: &Path,
    levels: &[NewLevel],
    classes: &[Class],
    cell: Option<f64>,
    storage: Storage,
) -> Result<(), SceneError> {
    if let Some(moving) = levels.iter().find(|l| l.splats.motion.is_some()) {
        let what = format!("the level '{}' moves, and files of levels hold still scenes", moving.name);
        return Err(SceneError::unsupported(path, what, "Build levels of a still scene"));
    }
    let key = |splats: &Splats, i: usize| {
        let class = splats.labels.as_ref().map_or(0, |l| l[i]);
        let at = splats.mean_of(i);
        (class, cell.map_or([0; 3], |side| at.map(|v| (v / side).floor() as i64)))
    };
    let mut members: std::collections::BTreeMap<(u16, [i64; 3]), Vec<Vec<u32>>> = Default::default();
    for (k, level) in levels.iter().enumerate() {
        for i in 0..level.splats.len() {
            let of_levels =
                members.entry(key(&level.splats, i)).or_insert_with(|| vec![Vec::new(); levels.len()]);
            of_levels[k].push(i as u32);
        }
    }
    let (mut groups, mut parts) = (Vec::new(), Vec::new());
    let mut offset = 0;
    for ((class, _), of_levels) in members {
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        let mut reach = bounds;
        let mut ranges = Vec::new();
        for (level, indices) in levels.iter().zip(of_levels) {
            if indices.is_empty() {
                ranges.push(Range::default());
                continue;
            }
            for &i in &indices {
                let at = level.splats.mean_of(i as usize);
                let widest =
                    level.splats.log_scales[i as usize].iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
                let radius = REACH * f64::from(widest).exp();
                for k in 0..3 {
                    bounds[0][k] = bounds[0][k].min(at[k]);
                    bounds[1][k] = bounds[1][k].max(at[k]);
                    reach[0][k] = reach[0][k].min(at[k] - radius);
                    reach[1][k] = reach[1][k].max(at[k] + radius);
                }
            }
            let mut bytes = Vec::new();
            let part = level.splats.selected(&indices);
            match storage {
                Storage::Spz => formats::spz::write(&part, &mut bytes),
                Storage::Ply => formats::ply::write(&part, &mut bytes),
            }
            .map_err(SceneError::io(path))?;
            ranges.push(Range { offset, bytes: bytes.len() as u64, splats: indices.len() as u64 });
            offset += bytes.len() as u64;
            parts.push(bytes);
        }
        groups.push(Group { class, bounds, reach: Some(reach), ranges });
    }
    let stored = |c: &Class| StoredClass { id: c.id, name: c.name.clone(), colour: c.colour };
    let level = |l: &NewLevel| Level { name: l.name.clone(), step: l.step, splats: l.splats.len() as u64 };
    let index = Index {
        levels: levels.iter().map(level).collect(),
        classes: classes.iter().map(stored).collect(),
        groups,
        extra: Value::Null,
    };
    index.check(offset).map_err(|(place, problem)| {
        SceneError::malformed(path, place, problem, "Give levels with names and positive steps")
    })?;
    write(path, &index, |out| parts.iter().try_for_each(|bytes| out.write_all(bytes)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use crate::synthetic::{Random, Recipe};

    fn levels() -> Vec<NewLevel> {
        let level = |count, step| {
            let mut splats = Recipe { count, sh_degree: 1, ..Default::default() }.still();
            splats.labels = Some((0..count).map(|i| (i % 3) as u16).collect());
            NewLevel { name: format!("level {step}"), step, splats }
        };
        vec![level(300, 1000.0), level(100, 250.0)]
    }

    fn class(id: u16) -> Class {
        Class { id, name: format!("c{id}"), colour: [id as u8; 3] }
    }

    #[test]
    fn every_group_of_every_level_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        for (cell, storage, name) in [
            (None, Storage::Ply, "a.mlod"),
            (Some(0.7), Storage::Spz, "b.mlod"),
            (Some(0.7), Storage::Ply, "c.mlod"),
        ] {
            let path = folder.path().join(name);
            save(&path, &levels(), &[class(1), class(2)], cell, storage).unwrap();
            let file = LevelFile::open(&path).unwrap();
            assert_eq!((file.levels().len(), file.classes().len()), (2, 2));
            assert_eq!(file.groups().len() > 3, cell.is_some());
            for (k, level) in levels().iter().enumerate() {
                let mut found = 0;
                for (g, group) in file.groups().iter().enumerate() {
                    let splats = file.read(g, k).unwrap();
                    found += splats.len();
                    assert!(splats.labels.as_ref().unwrap().iter().all(|&l| l == group.class));
                    for i in 0..splats.len() {
                        let at = splats.mean_of(i);
                        assert!((0..3).all(|k| {
                            (group.bounds[0][k] - 1e-3..=group.bounds[1][k] + 1e-3).contains(&at[k])
                        }));
                    }
                    if storage == Storage::Ply && cell.is_none() {
                        let of_class: Vec<u32> = (0..level.splats.len() as u32)
                            .filter(|i| (i % 3) as u16 == group.class)
                            .collect();
                        assert_eq!(splats.means, level.splats.selected(&of_class).means);
                    }
                }
                assert_eq!(found, level.splats.len());
            }
            for (k, level) in levels().iter().enumerate() {
                let options = LoadOptions { level: k as u32, ..Default::default() };
                let scene = crate::load(&path, &options).unwrap();
                assert_eq!(
                    (scene.splats.len(), scene.sources[0].format),
                    (level.splats.len(), crate::Format::Levels)
                );
                assert_eq!(
                    scene.splats.labels.unwrap().iter().filter(|&&l| l == 2).count(),
                    level.splats.len() / 3
                );
            }
            let again = folder.path().join("again.mlod");
            file.save_with(&again, serde_json::json!({"curves": [1, 2]})).unwrap();
            let again = LevelFile::open(&again).unwrap();
            assert_eq!((again.groups(), &again.extra()["curves"][1]), (file.groups(), &serde_json::json!(2)));
            assert_eq!(again.read(0, 1).unwrap(), file.read(0, 1).unwrap());
            assert!(file.read(0, 2).is_err() && file.read(999, 0).is_err());
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.mlod");
        let mut bad = levels();
        bad[0].step = f64::NAN;
        assert!(save(&path, &bad, &[], None, Storage::Spz).is_err());
        assert!(save(&path, &[], &[], None, Storage::Spz).is_err());
        let mut moving = levels();
        moving[1].splats.motion = Some(crate::Motion::zeroed(100));
        assert!(save(&path, &moving, &[], None, Storage::Spz).unwrap_err().to_string().contains("moves"));
        assert!(!path.exists());
    }

    /// Cut and altered files are errors or read as something sound; nothing panics, hangs, or takes memory without bound.
    #[test]
    fn damage_is_found_or_harmless() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.mlod");
        save(&path, &levels(), &[class(1)], None, Storage::Spz).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let open = |bytes: Vec<u8>| LevelFile::from_bytes(Path::new("x.mlod"), bytes.into());
        assert!(open(whole.clone()).is_ok());
        for cut in [0, 5, 19, 20, 100, whole.len() - 1] {
            assert!(open(whole[..cut].to_vec()).is_err(), "cut at {cut}");
        }
        let mut huge = whole.clone();
        huge[12..20].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(open(huge).unwrap_err().to_string().contains("too long"));
        let mut newer = whole.clone();
        newer[8] = 2;
        assert!(open(newer).unwrap_err().to_string().contains("version 2"));
        let (mut random, mut refused) = (Random::new(5), 0);
        for _ in 0..400 {
            let mut bytes = whole.clone();
            for _ in 0..=random.below(3) {
                let at = random.below(bytes.len() as u64) as usize;
                bytes[at] = random.bits() as u8;
            }
            match open(bytes) {
                Err(_) => refused += 1,
                Ok(file) => {
                    for g in 0..file.groups().len() {
                        refused += usize::from(file.read(g, 0).is_err() || file.read(g, 1).is_err());
                    }
                }
            }
        }
        assert!(refused > 200, "{refused}");
    }
}
