//! A scene that need not fit into memory: regions at levels are read in the order of need, by a thread of its own, into a
//! memory of fixed size.
//!
//! Every frame says what it wishes for and what it draws. The thread reads the first wish that is not there yet; where there
//! is no room, what was drawn last the longest ago goes, but nothing that is wished for, and nothing that a frame under way
//! may still draw. Nobody waits for the disk: until a level is there, what is there is drawn.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use glam::DVec3;
use motes_renderer::gpu::Gpu;
use motes_renderer::parts::{Part, Parts};
use motes_renderer::{Packing, SceneOnDevice, Uploader};
use motes_scenes::SceneError;
use motes_scenes::levels::{LevelFile, Range as FileRange};

use super::levels::region_of;
use super::pages::{PAGE, Pages};
use super::{LevelChoice, Model, Store, Tuning};
use crate::loader::LoadError;

/// Frames that may be under way: what one of the last so many drew stays.
const IN_USE: u64 = 3;
/// Share of the memory that regions in view may be promised: the rest is for what they change from and to.
const PROMISED: f64 = 0.8;
/// Words of the buffer through which splats are brought: 1 MiB.
const STAGING_WORDS: usize = 1 << 18;

/// A region at a level.
type Key = (usize, usize);

struct Held {
    /// Places in the scene on the device, of its splats.
    places: Vec<Range<u32>>,
    pages: Vec<Range<u32>>,
    /// The frame that drew it last.
    drawn: u64,
}

struct State {
    wishes: Vec<Key>,
    held: BTreeMap<Key, Held>,
    failed: BTreeMap<Key, String>,
    pages: Pages,
    frame: u64,
    peak: u64,
    read: u64,
    quit: bool,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    pages: u32,
}

/// What is in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Memory {
    /// Bytes of the splats that are there, on the device and for sorting.
    pub resident: u64,
    /// The most there ever were.
    pub peak: u64,
    /// All the bytes that were set aside.
    pub budget: u64,
    /// Bytes read from the file so far.
    pub read: u64,
    /// Regions at levels that could not be read.
    pub failed: usize,
}

/// A scene's regions and levels, as far as they are in memory.
pub struct Resident {
    shared: Arc<Shared>,
    scene: Arc<SceneOnDevice>,
    thread: Option<JoinHandle<()>>,
    splat_bytes: u64,
}

impl Resident {
    /// Opens a file of levels for a memory of so many bytes; reads nothing of it yet. Also the choice of its levels.
    ///
    /// # Errors
    /// The file is none; there is not even memory for its largest region; the driver's.
    pub fn open(
        gpu: &Arc<Gpu>,
        path: &Path,
        packing: Packing,
        budget: u64,
        tuning: Tuning,
    ) -> Result<(Self, LevelChoice), LoadError> {
        let file = LevelFile::open(path)?;
        let model = Model::of_file(&file).unwrap_or_else(|why| {
            log::warn!("{why}: until then regions are coarse only where memory is short");
            Model::default()
        });
        let regions: Vec<_> = file.groups().iter().map(|g| region_of(g, &model)).collect();
        let steps: Vec<f64> = file.levels().iter().map(|l| l.step).collect();
        let packing = Packing { sh_degree: packing.sh_degree.min(degree(&file)?), ..packing };
        // Beside what is on the device, means are kept for sorting.
        let splat_bytes = 4 * (packing.geometry_words() + packing.sh_words()) as u64 + 12;
        let pages = (budget / (splat_bytes * u64::from(PAGE))).min(u64::from(u32::MAX / PAGE)) as u32;
        // So much at least, or something would always be missing.
        let takes = |splats: u32| Pages::of_splats(splats.into());
        let coarsest: u64 = regions.iter().filter_map(|r| r.splats.last()).map(|&n| takes(n)).sum();
        let least = (coarsest as f64 / PROMISED).ceil() as u64;
        if u64::from(pages) < least {
            return Err(LoadError::Scene(SceneError::TooLarge {
                path: path.to_owned(),
                what: format!("its coarsest level needs {} bytes", least * splat_bytes * u64::from(PAGE)),
                limit: format!(
                    "{budget} bytes; allow more, or build it with a coarser level or larger cells (--cell)"
                ),
            }));
        }
        let origin = middle(&file);
        let scene = Arc::new(SceneOnDevice::with_room(gpu, pages * PAGE, origin, packing)?);
        let state = State {
            wishes: Vec::new(),
            held: BTreeMap::new(),
            failed: BTreeMap::new(),
            pages: Pages::new(pages),
            frame: 0,
            peak: 0,
            read: 0,
            quit: false,
        };
        let shared = Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new(), pages });
        let uploader = Uploader::with_words(gpu, STAGING_WORDS)?;
        let (of_thread, onto) = (shared.clone(), scene.clone());
        let thread = std::thread::Builder::new()
            .name("levels".into())
            .spawn(move || of_thread.run(&file, &onto, uploader))
            .map_err(|e| LoadError::Thread(e.to_string()))?;
        let choice = LevelChoice::new(steps, regions, tuning);
        Ok((Self { shared, scene, thread: Some(thread), splat_bytes }, choice))
    }

    /// The scene on the device, in which splats come and go.
    pub fn scene(&self) -> &Arc<SceneOnDevice> {
        &self.scene
    }

    /// Lets a choice go on by a frame, within the memory, and tells the thread what it wishes for. The scene's parts are
    /// then those of this frame.
    pub fn advance(
        &self,
        choice: &mut LevelChoice,
        views: &[motes_renderer::View],
        seconds: f64,
        ease: f64,
    ) -> bool {
        let mut state = self.shared.lock();
        state.frame += 1;
        let room = (PROMISED * f64::from(self.shared.pages)) as u64;
        let held = &state.held;
        let takes = |splats: u32| Pages::of_splats(splats.into());
        let store =
            Store { room, takes: &takes, holds: &|region, level| held.contains_key(&(region, level)) };
        let changed = choice.advance_within(views, seconds, ease, &store);
        let mut wishes = std::mem::take(&mut state.wishes);
        wishes.clear();
        wishes.extend(choice.wishes());
        state.wishes = wishes;
        let frame = state.frame;
        for (region, level, _) in choice.shares() {
            if let Some(held) = state.held.get_mut(&(region, level)) {
                held.drawn = frame;
            }
        }
        if changed {
            let held = &state.held;
            let part = |p: &Range<u32>, share| Part { first: p.start, splats: p.end - p.start, share };
            let parts = choice.shares().filter_map(|(region, level, share)| {
                held.get(&(region, level)).map(|h| h.places.iter().map(move |p| part(p, share)))
            });
            let parts = Parts::new(parts.flatten());
            self.scene.positions.choose(Some(parts));
        }
        drop(state);
        self.shared.changed.notify_all();
        changed
    }

    /// What is in memory now.
    pub fn memory(&self) -> Memory {
        let state = self.shared.lock();
        let page = self.splat_bytes * u64::from(PAGE);
        let pages = u64::from(self.shared.pages);
        Memory {
            resident: (pages - state.pages.free()) * page,
            peak: state.peak * page,
            budget: pages * page,
            read: state.read,
            failed: state.failed.len(),
        }
    }
}

impl Drop for Resident {
    fn drop(&mut self) {
        self.shared.lock().quit = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the thread that reads levels had panicked");
        }
    }
}

impl State {
    /// The first wish that is not there, that could be read, and that there is room for; with its range and pages.
    fn next(&mut self, file: &LevelFile) -> Option<(Key, FileRange, Vec<Range<u32>>)> {
        let there = |key: &&Key| self.held.contains_key(key) || self.failed.contains_key(key);
        let missing: Vec<Key> = self.wishes.iter().filter(|key| !there(key)).copied().collect();
        // Where there was no room once, nothing is left that could go: only what is free.
        let mut full = false;
        missing.into_iter().find_map(|key| {
            let range = *file.groups().get(key.0)?.ranges.get(key.1)?;
            let needed = Pages::of_splats(range.splats);
            let pages = if full { self.pages.take(needed) } else { self.make_room(needed) };
            full |= pages.is_none();
            Some((key, range, pages?))
        })
    }

    /// Pages for a wish; what is needed least goes for them. None where everything is needed.
    fn make_room(&mut self, pages: u64) -> Option<Vec<Range<u32>>> {
        if self.pages.free() < pages {
            let wished: BTreeSet<Key> = self.wishes.iter().copied().collect();
            let mut idle: Vec<(u64, Key)> = self
                .held
                .iter()
                .filter(|(key, held)| held.drawn + IN_USE < self.frame && !wished.contains(key))
                .map(|(key, held)| (held.drawn, *key))
                .collect();
            idle.sort_unstable();
            for (_, key) in idle {
                if let Some(held) = self.held.remove(&key) {
                    self.pages.give_back(&held.pages);
                }
                if self.pages.free() >= pages {
                    break;
                }
            }
        }
        self.pages.take(pages)
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, file: &LevelFile, scene: &SceneOnDevice, mut uploader: Uploader) {
        let mut state = self.lock();
        while !state.quit {
            let wish = state.next(file);
            let Some((key, range, pages)) = wish else {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            state.peak = state.peak.max(u64::from(self.pages) - state.pages.free());
            drop(state);
            let mut bring = || -> Result<Vec<Range<u32>>, LoadError> {
                let splats = file.read(key.0, key.1)?;
                let places = places(&pages, splats.len() as u64);
                scene.write(&mut uploader, places.iter().cloned(), &splats)?;
                Ok(places)
            };
            let brought = bring();
            state = self.lock();
            match brought {
                Ok(places) => {
                    state.read += range.bytes;
                    let drawn = state.frame;
                    state.held.insert(key, Held { places, pages, drawn });
                }
                Err(why) => {
                    log::error!("level {} of region {} is left out: {why}", key.1, key.0);
                    state.pages.give_back(&pages);
                    state.failed.insert(key, why.to_string());
                }
            }
        }
    }
}

/// Places of so many splats on pages.
fn places(pages: &[Range<u32>], splats: u64) -> Vec<Range<u32>> {
    let mut left = splats;
    let place = |run: &Range<u32>| {
        let first = run.start * PAGE;
        let count = left.min(u64::from(run.end * PAGE - first)) as u32;
        left -= u64::from(count);
        first..first + count
    };
    pages.iter().map(place).collect()
}

/// The degree of a file's spherical harmonics, by one of its groups.
fn degree(file: &LevelFile) -> Result<u8, SceneError> {
    if let Some(degree) = file.sh_degree() {
        return Ok(degree);
    }
    let mut degree = 0;
    if let Some(group) = file.groups().iter().position(|g| g.ranges.iter().any(|r| r.splats > 0)) {
        for level in 0..file.levels().len() {
            degree = degree.max(file.read(group, level)?.sh_degree);
        }
    }
    Ok(degree)
}

/// The middle of a scene: means are kept relative to it, so that single floats hold them.
fn middle(file: &LevelFile) -> DVec3 {
    let mut bounds = super::Bounds::EMPTY;
    for group in file.groups() {
        group.bounds.iter().for_each(|&corner| bounds.include(corner.into(), 0.0));
    }
    let middle = 0.5 * (bounds.0[0] + bounds.0[1]);
    // Near scenes keep their axes' origin, so that nothing is rounded anew.
    if middle.is_finite() && middle.length() > 1e4 { middle } else { DVec3::ZERO }
}
