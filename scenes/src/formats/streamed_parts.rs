//! A streamed SOG scene a region at a time: each leaf of its tree is a group of [`crate::levels`], each level a range of a
//! piece.
//!
//! A piece is a whole SOG scene, whose images can only be decoded whole. The piece that was read last is kept, since the next
//! wish is often for another part of it; so beside what is read there is memory for one piece at most, twice while it is
//! decoded.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::sog::Target;
use super::streamed_sog::{Corners, Index, open_piece};
use crate::levels::{Group, Level, REACH, Range};
use crate::load::LoadContext;
use crate::source::Source;
use crate::{LoadOptions, SceneError, Splats, sanitise};

/// An open streamed scene.
#[derive(Debug)]
pub(crate) struct StreamedParts {
    path: PathBuf,
    folder: PathBuf,
    /// Names of pieces; the environment is the last, where there is one.
    names: Vec<String>,
    bytes: u64,
    sh_degree: u8,
    /// By group: the box that its means lie in.
    bounds: Vec<Corners>,
    /// By group and level: piece and first splat.
    places: Vec<Vec<(usize, u64)>>,
    last: Mutex<Option<(usize, Arc<Splats>)>>,
}

/// What is known of a piece before it is decoded.
struct Piece {
    splats: u64,
    bytes: u64,
    means: Corners,
    radius: f64,
}

impl StreamedParts {
    /// Opens every piece once, to know how many splats it has and how far they reach; decodes none.
    pub(crate) fn open(source: &Source) -> Result<(Self, Vec<Level>, Vec<Group>), SceneError> {
        let options = LoadOptions::default();
        let ctx = LoadContext::new(&options, 0, 1);
        let index = Index::read(source, &ctx)?;
        let folder = match source.is_folder() {
            true => source.path(),
            false => source.path().parent().unwrap_or(Path::new("")),
        };
        let names: Vec<String> = index.names.iter().chain(&index.environment).cloned().collect();
        let (mut pieces, mut sh_degree) = (Vec::new(), 0);
        for name in &names {
            let sog = open_piece(&folder.join(name), &ctx)?;
            sh_degree = sog.sh_degree().max(sh_degree);
            pieces.push(Piece {
                splats: sog.count(),
                bytes: sog.compressed(),
                means: sog.means_within(),
                radius: REACH * f64::from(sog.largest_log_scale().min(crate::MAX_LOG_SCALE)).exp(),
            });
        }
        let levels = index.levels as usize;
        let (mut groups, mut places) = (Vec::new(), Vec::new());
        let mut of_leaves: Vec<Vec<super::streamed_sog::Range>> = vec![Vec::new(); index.leaves.len()];
        for range in &index.ranges {
            of_leaves[range.leaf as usize].push(*range);
        }
        for (leaf, ranges) in of_leaves.iter().enumerate() {
            let mut group = NewGroup::new(levels, index.leaves[leaf]);
            for range in ranges.iter().filter(|r| r.count > 0) {
                let (level, file) = (range.level as usize, range.file as usize);
                let piece = &pieces[file];
                let name = &names[file];
                let place = format!("level {level} of file {file} ({name})");
                if range.offset.checked_add(range.count).is_none_or(|end| end > piece.splats) {
                    let (end, has) = (range.offset.saturating_add(range.count), piece.splats);
                    return Err(
                        index.wrong(place, format!("a node reaches splat {end}, and the file has {has}"))
                    );
                }
                if group.ranges[level].splats > 0 {
                    return Err(index.wrong(place, "a node has the level twice"));
                }
                group.add(level, (file, range.offset), range.count, piece);
            }
            groups.extend(group.finish(&mut places));
        }
        if let Some(piece) = pieces.get(index.names.len()) {
            // It belongs to every level.
            let mut group = NewGroup::new(levels, None);
            for level in (0..levels).filter(|_| piece.splats > 0) {
                group.add(level, (index.names.len(), 0), piece.splats, piece);
            }
            groups.extend(group.finish(&mut places));
        }
        let splats = |level: usize| groups.iter().map(|g: &Group| g.ranges[level].splats).sum::<u64>();
        let finest = splats(0).max(1) as f64;
        let level = |level: usize| Level {
            name: format!("level {level}"),
            step: (1000.0 * splats(level) as f64 / finest).max(1e-3),
            splats: splats(level),
        };
        let levels = (0..levels).map(level).collect();
        let bytes = pieces.iter().map(|p| p.bytes).sum();
        let bounds = groups.iter().map(|g| g.bounds).collect();
        let (path, folder) = (source.path().to_owned(), folder.to_owned());
        Ok((
            Self { path, folder, names, bytes, sh_degree, bounds, places, last: Mutex::default() },
            levels,
            groups,
        ))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of all pieces.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Highest degree of spherical harmonics of any piece.
    pub(crate) fn sh_degree(&self) -> u8 {
        self.sh_degree
    }

    /// Splats of a group at a level that there are. Fewer than listed where some make no picture.
    pub(crate) fn read(&self, group: usize, level: usize, splats: u64) -> Result<Splats, SceneError> {
        let (piece, first) = self.places[group][level];
        let all = self.piece(piece)?;
        let indices: Vec<u32> = (first..first + splats).filter_map(|i| u32::try_from(i).ok()).collect();
        let mut part = all.selected(&indices);
        let sanitised = sanitise(&mut part);
        if !sanitised.dropped.is_empty() {
            let name = &self.names[piece];
            log::warn!(
                "{}: {} of {splats} splats from {first} on are left out",
                name,
                splats - part.len() as u64
            );
        }
        let [low, high] = self.bounds[group];
        // Steps of the stored means reach a little beyond.
        let spare: [f64; 3] = std::array::from_fn(|k| 1e-2 * (high[k] - low[k]) + 1e-3);
        let outside = (0..part.len()).map(|i| part.mean_of(i));
        let outside =
            outside.filter(|m| (0..3).any(|k| m[k] < low[k] - spare[k] || m[k] > high[k] + spare[k]));
        let outside = outside.count();
        if outside > 0 {
            log::warn!(
                "{}: {outside} splats of level {level} lie outside of the box that the tree states for them: at the \
                 edge of a view they may be missing. Export the scene again",
                self.path.display()
            );
        }
        Ok(part)
    }

    fn piece(&self, piece: usize) -> Result<Arc<Splats>, SceneError> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((held, splats)) = &*last
            && *held == piece
        {
            return Ok(splats.clone());
        }
        // Room first.
        *last = None;
        let options = LoadOptions::default();
        let ctx = LoadContext::new(&options, 0, 1);
        let source = Source::open(&self.folder.join(&self.names[piece]))?;
        let sog = open_piece(source.path(), &ctx)?;
        let mut splats = Splats::zeroed(sog.admit(&source, &ctx)?, sog.sh_degree(), false);
        let total = sog.compressed();
        sog.unpack(&source, &ctx, total, Target::of(&mut splats))?;
        let splats = Arc::new(splats);
        *last = Some((piece, splats.clone()));
        Ok(splats)
    }
}

/// A group while its levels are found.
struct NewGroup {
    bounds: Option<Corners>,
    means: Option<Corners>,
    radius: f64,
    ranges: Vec<Range>,
    places: Vec<(usize, u64)>,
}

impl NewGroup {
    fn new(levels: usize, bounds: Option<Corners>) -> Self {
        let (ranges, places) = (vec![Range::default(); levels], vec![(0, 0); levels]);
        Self { bounds, means: None, radius: 0.0, ranges, places }
    }

    fn add(&mut self, level: usize, place: (usize, u64), splats: u64, piece: &Piece) {
        // A piece is read whole: this is the range's share of it.
        let bytes = (piece.bytes as f64 * splats as f64 / piece.splats.max(1) as f64).ceil() as u64;
        self.ranges[level] = Range { offset: place.1, bytes, splats };
        self.places[level] = place;
        self.radius = self.radius.max(piece.radius);
        self.means = Some(self.means.map_or(piece.means, |a| {
            let b = piece.means;
            [std::array::from_fn(|k| a[0][k].min(b[0][k])), std::array::from_fn(|k| a[1][k].max(b[1][k]))]
        }));
    }

    /// The group, unless it has no splat.
    fn finish(self, places: &mut Vec<Vec<(usize, u64)>>) -> Option<Group> {
        let bounds = self.bounds.or(self.means)?;
        self.means?;
        places.push(self.places);
        // The box holds means; no splat of the piece is wider than its largest.
        let reach = [bounds[0].map(|v| v - self.radius), bounds[1].map(|v| v + self.radius)];
        Some(Group { class: 0, bounds, reach: Some(reach), ranges: self.ranges })
    }
}
