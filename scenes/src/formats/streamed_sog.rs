//! PlayCanvas's streamed SOG: a `lod-meta.json` beside SOG folders, each a piece of one level of detail.
//!
//! The file lists the pieces (`filenames`), and a tree whose leaves say, per level, which range of which piece holds
//! their splats. Level 0 is the finest. An environment (sky), where there is one, belongs to every level.
//!
//! Source: PlayCanvas, "The streamed SOG format" (developer manual), and the sample files.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Component, Path};

use serde::de::{DeserializeSeed, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::sog::{Sog, Target};
use crate::load::LoadContext;
use crate::source::Source;
use crate::{LoadOptions, SceneError, Splats, sh_coefficients};

const EXPORT_AGAIN: &str = "The scene is incomplete or damaged: copy or export it again";

/// A level of detail of a streamed scene.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct StreamedLevel {
    /// Number of the level, 0 is the finest: what [`LoadOptions::level`] takes.
    pub level: u32,
    /// Splats of this level, the environment not counted.
    pub splats: u64,
    /// Files that it is in.
    pub files: usize,
}

/// Lists the levels of a streamed scene, the finest first.
///
/// # Errors
/// [`SceneError`] where `path` is neither a folder with a `lod-meta.json` nor such a file, or the file is damaged.
pub fn streamed_levels(path: &Path) -> Result<Vec<StreamedLevel>, SceneError> {
    let source = Source::open(path)?;
    let options = LoadOptions::default();
    let index = Index::read(&source, &LoadContext::new(&options, 0, 1))?;
    Ok((0..index.levels)
        .map(|level| {
            let pieces = index.pieces(level);
            StreamedLevel {
                level,
                splats: pieces.values().flatten().fold(0, |sum, range| range.count.saturating_add(sum)),
                files: pieces.len(),
            }
        })
        .collect())
}

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let index = Index::read(source, ctx)?;
    let level = ctx.options().level.min(index.levels - 1);
    let folder =
        if source.is_folder() { source.path() } else { source.path().parent().unwrap_or(Path::new("")) };

    // Every piece is opened before any is decoded, so that there is one allocation for all of them.
    let mut pieces = Vec::new();
    for (&file, ranges) in &index.pieces(level) {
        let name = index.names.get(file as usize).map(String::as_str).unwrap_or_default();
        let sog = open_piece(&folder.join(name), ctx)?;
        let mut ranges = ranges.clone();
        ranges.sort_unstable_by_key(|range| range.offset);
        let mut end = 0;
        for range in &ranges {
            if range.offset < end {
                return Err(index.wrong(
                    format!("level {level} of file {file} ({name})"),
                    format!("two nodes claim splat {}", range.offset),
                ));
            }
            end = range.offset.saturating_add(range.count);
        }
        if end > sog.count() {
            return Err(index.wrong(
                format!("level {level} of file {file} ({name})"),
                format!("a node reaches splat {end}, and the file has {}", sog.count()),
            ));
        }
        pieces.push((sog, ranges));
    }
    if let Some(environment) = &index.environment {
        let sog = open_piece(&folder.join(environment), ctx)?;
        let all = Range { level, file: 0, offset: 0, count: sog.count(), leaf: 0 };
        pieces.push((sog, vec![all]));
    }

    let mut counts = Vec::new();
    for (sog, ranges) in &pieces {
        sog.admit(source, ctx)?;
        counts.push(ranges.iter().map(|range| range.count).sum::<u64>());
    }
    let sh_degree = pieces.iter().map(|(sog, _)| sog.sh_degree()).max().unwrap_or(0);
    let total = pieces.iter().map(|(sog, _)| sog.compressed()).sum();
    let count = ctx.admit(source, counts.iter().sum(), sh_degree, false)?;
    let mut splats = Splats::zeroed(count, sh_degree, false);
    let mut rest = Target::of(&mut splats);
    for ((sog, ranges), count) in pieces.into_iter().zip(counts) {
        let (target, after) = rest.split_at(count as usize);
        rest = after;
        if count == sog.count() {
            sog.unpack(source, ctx, total, target)?;
        } else {
            let mut all = Splats::zeroed(sog.admit(source, ctx)?, sh_degree, false);
            sog.unpack(source, ctx, total, Target::of(&mut all))?;
            target.gather(&all, ranges.iter().map(|r| r.offset as usize..(r.offset + r.count) as usize));
        }
    }
    Ok(splats)
}

/// Opens a piece, whose bytes on disk count.
pub(super) fn open_piece(path: &Path, ctx: &LoadContext<'_>) -> Result<Sog, SceneError> {
    let source = Source::open(path)?;
    ctx.add_bytes(source.len());
    Sog::open(&source, ctx)
}

/// A leaf's splats of one level.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub level: u32,
    pub file: u32,
    pub offset: u64,
    pub count: u64,
    /// Which leaf, counted from 0.
    pub leaf: u32,
}

/// Lowest and highest corner of a box, metres.
pub(super) type Corners = [[f64; 3]; 2];

/// `lod-meta.json`.
pub(super) struct Index {
    pub path: std::path::PathBuf,
    pub levels: u32,
    pub names: Vec<String>,
    pub environment: Option<String>,
    pub ranges: Vec<Range>,
    /// The box of each leaf: its own, or of the nearest node above that has one.
    pub leaves: Vec<Option<Corners>>,
}

/// More levels than any scene has.
const MAX_LEVELS: u32 = 64;

#[derive(serde::Deserialize)]
struct Head {
    version: Option<u64>,
    #[serde(rename = "lodLevels")]
    levels: u32,
    environment: Option<String>,
    filenames: Vec<String>,
}

impl Index {
    pub fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Self, SceneError> {
        let (path, text) = if source.is_folder() {
            let file = Source::open(&source.path().join("lod-meta.json"))?;
            ctx.add_bytes(file.len());
            (file.path().to_owned(), file.read_all()?)
        } else {
            (source.path().to_owned(), source.read_all()?)
        };
        let wrong_json = |error: serde_json::Error| {
            let place = format!("line {}, column {}", error.line(), error.column());
            SceneError::malformed(&path, place, error.to_string(), EXPORT_AGAIN)
        };
        let head: Head = serde_json::from_slice(&text).map_err(wrong_json)?;
        if head.version.is_some_and(|version| version != 1) {
            return Err(SceneError::unsupported(
                &path,
                format!("version {} of streamed SOG (Motes reads 1)", head.version.unwrap_or_default()),
                "Export it as version 1, or look for a newer Motes",
            ));
        }
        let mut found = Found::default();
        Tree(&mut found).deserialize(&mut serde_json::Deserializer::from_slice(&text)).map_err(wrong_json)?;
        let index = Self {
            path: path.clone(),
            levels: head.levels,
            names: head.filenames,
            environment: head.environment,
            ranges: found.ranges,
            leaves: found.leaves,
        };
        index.check()?;
        Ok(index)
    }

    fn check(&self) -> Result<(), SceneError> {
        if !(1..=MAX_LEVELS).contains(&self.levels) {
            return Err(self.wrong("lodLevels", format!("is {}, expected 1 to {MAX_LEVELS}", self.levels)));
        }
        for name in self.names.iter().chain(&self.environment) {
            // A downloaded scene must not make the viewer read files elsewhere on the disk.
            let inside = !name.is_empty()
                && Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
            if !inside {
                return Err(self.wrong("filenames", format!("“{name}” leads out of the scene's folder")));
            }
        }
        for range in &self.ranges {
            if range.level >= self.levels {
                return Err(self.wrong(
                    "the tree",
                    format!("a node has level {}, and there are {} (from 0)", range.level, self.levels),
                ));
            }
            if range.file as usize >= self.names.len() {
                return Err(self.wrong(
                    "the tree",
                    format!("a node names file {}, and {} are listed (from 0)", range.file, self.names.len()),
                ));
            }
        }
        Ok(())
    }

    /// The ranges of a level by file.
    fn pieces(&self, level: u32) -> BTreeMap<u32, Vec<Range>> {
        let mut pieces = BTreeMap::<u32, Vec<Range>>::new();
        for range in self.ranges.iter().filter(|range| range.level == level && range.count > 0) {
            pieces.entry(range.file).or_default().push(*range);
        }
        pieces
    }

    pub fn wrong(&self, place: impl Into<String>, problem: impl Into<String>) -> SceneError {
        SceneError::malformed(&self.path, place, problem, EXPORT_AGAIN)
    }
}

/// The leaves of the tree.
#[derive(Default)]
struct Found {
    ranges: Vec<Range>,
    leaves: Vec<Option<Corners>>,
}

/// Takes the leaves out of the file without building the tree, which a damaged file could make large.
/// (The JSON reader bounds its depth.)
struct Tree<'a>(&'a mut Found);

/// A node, or a list of nodes, within the box of the node above.
struct Node<'a>(&'a mut Found, Option<Corners>);

/// A leaf's levels.
struct Levels<'a>(&'a mut Found);

/// A node's box, where it says something of use.
#[derive(serde::Deserialize)]
#[serde(untagged)]
enum Bound {
    Box { min: [f64; 3], max: [f64; 3] },
    Other(IgnoredAny),
}

impl Bound {
    fn corners(self) -> Option<Corners> {
        match self {
            Self::Box { min, max } => (0..3)
                .all(|k| min[k].is_finite() && max[k].is_finite() && min[k] <= max[k])
                .then_some([min, max]),
            Self::Other(_) => None,
        }
    }
}

#[derive(serde::Deserialize)]
struct Piece {
    file: u32,
    offset: u64,
    count: u64,
}

macro_rules! seed {
    ($name:ident) => {
        impl<'de> DeserializeSeed<'de> for $name<'_> {
            type Value = ();
            fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
                deserializer.deserialize_any(self)
            }
        }
    };
}
seed!(Tree);
seed!(Node);
seed!(Levels);

impl<'de> Visitor<'de> for Tree<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object with a tree")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let mut found = false;
        while let Some(key) = map.next_key::<Cow<str>>()? {
            if key == "tree" {
                map.next_value_seed(Node(&mut *self.0, None))?;
                found = true;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        if found { Ok(()) } else { Err(A::Error::missing_field("tree")) }
    }
}

impl<'de> Visitor<'de> for Node<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a node of the tree")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut nodes: A) -> Result<(), A::Error> {
        while nodes.next_element_seed(Node(&mut *self.0, self.1))?.is_some() {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let (mut own, mut leaf) = (None, None);
        let first = self.0.leaves.len();
        while let Some(key) = map.next_key::<Cow<str>>()? {
            match key.as_ref() {
                "bound" => own = map.next_value::<Bound>()?.corners(),
                "children" => map.next_value_seed(Node(&mut *self.0, own.or(self.1)))?,
                "lods" => {
                    leaf = Some(self.0.leaves.len());
                    self.0.leaves.push(self.1);
                    map.next_value_seed(Levels(&mut *self.0))?;
                }
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        // A box may come after what lies in it.
        if let Some(own) = own {
            for (at, bounds) in self.0.leaves.iter_mut().enumerate().skip(first) {
                if Some(at) == leaf || bounds.is_none() {
                    *bounds = Some(own);
                }
            }
        }
        Ok(())
    }
}

impl<'de> Visitor<'de> for Levels<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object of levels")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let leaf = self.0.leaves.len().saturating_sub(1) as u32;
        while let Some(key) = map.next_key::<Cow<str>>()? {
            let level = key.parse().map_err(|_| A::Error::custom(format!("“{key}” is no level")))?;
            let Piece { file, offset, count } = map.next_value()?;
            self.0.ranges.push(Range { level, file, offset, count, leaf });
        }
        Ok(())
    }
}

impl<'a> Target<'a> {
    /// The first `count` splats, and the others.
    fn split_at(self, count: usize) -> (Self, Self) {
        let stride = sh_coefficients(self.sh_degree);
        let (means, m) = self.means.split_at_mut(count);
        let (rotations, r) = self.rotations.split_at_mut(count);
        let (log_scales, l) = self.log_scales.split_at_mut(count);
        let (opacities, o) = self.opacities.split_at_mut(count);
        let (sh, s) = self.sh.split_at_mut(count * stride);
        let sh_degree = self.sh_degree;
        (
            Self { means, rotations, log_scales, opacities, sh, sh_degree },
            Self { means: m, rotations: r, log_scales: l, opacities: o, sh: s, sh_degree },
        )
    }

    /// Copies ranges of `from`, of the same degree and together as many as there is room for.
    fn gather(self, from: &Splats, ranges: impl Iterator<Item = std::ops::Range<usize>>) {
        let stride = sh_coefficients(self.sh_degree);
        let mut at = 0;
        for range in ranges {
            let to = at..at + range.len();
            self.means[to.clone()].copy_from_slice(&from.means[range.clone()]);
            self.rotations[to.clone()].copy_from_slice(&from.rotations[range.clone()]);
            self.log_scales[to.clone()].copy_from_slice(&from.log_scales[range.clone()]);
            self.opacities[to.clone()].copy_from_slice(&from.opacities[range.clone()]);
            self.sh[to.start * stride..to.end * stride]
                .copy_from_slice(&from.sh[range.start * stride..range.end * stride]);
            at = to.end;
        }
    }
}
