//! Frames of a sequence (a folder of still scenes), read ahead of playback on a thread of their own, within a budget of
//! memory.
//!
//! The reader always reads the frame that playback needs next and is not there yet. A medium that is too slow so makes
//! playback skip frames, evenly, and never makes it wait: [`ReadAhead::show`] returns at once with the best there is.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use motes_renderer::gpu::Gpu;
use motes_renderer::{Packing, SceneOnDevice};
use motes_scenes::{LoadOptions, load_many};

use crate::time::TimeControl;

/// Frames a second of a sequence, whose files do not say.
const FRAMES_PER_SECOND: f64 = 30.0;
/// Memory for the frames of a sequence, bytes: on the device and on the processor together.
pub const BUDGET: u64 = if cfg!(target_os = "android") { 512 << 20 } else { 1 << 30 };

/// Frames that were shown last and are not let go of: the device may still draw them.
const IN_USE: usize = 3;

/// A frame as the reader hands it over, and the bytes of memory that it takes.
pub type Read<T> = Result<(T, u64), String>;

struct State<T> {
    wanted: usize,
    backwards: bool,
    loaded: BTreeMap<usize, (Arc<T>, u64)>,
    failed: BTreeMap<usize, String>,
    in_use: VecDeque<usize>,
    bytes: u64,
    largest: u64,
    peak: u64,
    quit: bool,
}

impl<T> State<T> {
    /// How many frames from now playback comes to a frame.
    fn ahead(&self, frame: usize, frames: usize) -> usize {
        let forwards = (frame + frames - self.wanted) % frames;
        if self.backwards { (frames - forwards) % frames } else { forwards }
    }

    /// The next frame that is missing, and how far ahead it is.
    fn next_missing(&self, frames: usize) -> Option<(usize, usize)> {
        (0..frames)
            .map(|ahead| {
                let back = frames - ahead % frames;
                ((self.wanted + if self.backwards { back } else { ahead }) % frames, ahead)
            })
            .find(|(frame, _)| !self.loaded.contains_key(frame) && !self.failed.contains_key(frame))
    }

    /// Lets go of frames that are needed last, but none as near as `nearer`, until so many bytes fit.
    fn make_room(&mut self, bytes: u64, budget: u64, nearer: usize, frames: usize) -> bool {
        while self.bytes + bytes > budget {
            let farthest = self
                .loaded
                .keys()
                .filter(|frame| !self.in_use.contains(frame))
                .map(|&frame| (self.ahead(frame, frames), frame))
                .max();
            match farthest {
                Some((ahead, frame)) if ahead > nearer => {
                    if let Some((_, size)) = self.loaded.remove(&frame) {
                        self.bytes -= size;
                    }
                }
                _ => return false,
            }
        }
        true
    }
}

struct Shared<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
    frames: usize,
    budget: u64,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, mut read: impl FnMut(usize) -> Read<T>) {
        let mut state = self.lock();
        while !state.quit {
            let largest = state.largest;
            let missing = state.next_missing(self.frames);
            let room =
                missing.filter(|&(_, ahead)| state.make_room(largest, self.budget, ahead, self.frames));
            let Some((frame, ahead)) = room else {
                if let Some((frame, 0)) = missing {
                    // Everything else was let go of, and waiting would not help.
                    let (held, budget) = (state.bytes, self.budget);
                    let why =
                        format!("no room: {held} of {budget} bytes are taken by frames that are still drawn");
                    state.failed.insert(frame, why);
                    self.changed.notify_all();
                    continue;
                }
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            drop(state);
            let result = read(frame);
            state = self.lock();
            match result {
                Ok((_, bytes)) if bytes > self.budget => {
                    let budget = self.budget;
                    let why = format!("it takes {bytes} bytes, and all frames together may take {budget}");
                    state.failed.insert(frame, why);
                }
                Ok((item, bytes)) => {
                    state.largest = state.largest.max(bytes);
                    // Playback may have gone on meanwhile: the frame is judged by where it lies now.
                    let ahead = ahead.min(state.ahead(frame, self.frames));
                    if state.make_room(bytes, self.budget, ahead, self.frames) {
                        state.bytes += bytes;
                        state.peak = state.peak.max(state.bytes);
                        state.loaded.insert(frame, (Arc::new(item), bytes));
                    }
                }
                Err(why) => {
                    log::warn!("frame {frame} is left out: {why}");
                    state.failed.insert(frame, why);
                }
            }
            self.changed.notify_all();
        }
    }
}

/// Reads the frames of a sequence ahead of playback.
pub struct ReadAhead<T: Send + Sync + 'static> {
    shared: Arc<Shared<T>>,
    thread: Option<JoinHandle<()>>,
    shown: VecDeque<(usize, Arc<T>)>,
}

impl<T: Send + Sync + 'static> ReadAhead<T> {
    /// Starts to read. `read(frame)` is called on another thread; all frames that are held take at most `budget` bytes.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(
        frames: usize,
        budget: u64,
        read: impl FnMut(usize) -> Read<T> + Send + 'static,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                wanted: 0,
                backwards: false,
                loaded: BTreeMap::new(),
                failed: BTreeMap::new(),
                in_use: VecDeque::new(),
                bytes: 0,
                largest: 0,
                peak: 0,
                quit: frames == 0,
            }),
            changed: Condvar::new(),
            frames,
            budget,
        });
        let of_thread = shared.clone();
        let thread =
            std::thread::Builder::new().name("read ahead".into()).spawn(move || of_thread.run(read))?;
        Ok(Self { shared, thread: Some(thread), shown: VecDeque::new() })
    }

    /// The frame of a time, `0 ..= 1`.
    pub fn frame_at(&self, time: f32) -> usize {
        ((f64::from(time) * self.shared.frames as f64) as usize).min(self.shared.frames.saturating_sub(1))
    }

    /// What to show for a frame now, in the direction of playback: the frame itself, else the last one before it that is
    /// there, else what was shown last. Never waits; nothing only before the first frame is there.
    pub fn show(&mut self, frame: usize, backwards: bool) -> Option<(usize, Arc<T>)> {
        let frames = self.shared.frames;
        if frames == 0 {
            return None;
        }
        let mut state = self.shared.lock();
        state.wanted = frame.min(frames - 1);
        state.backwards = backwards;
        let last = self.shown.back().map(|(frame, _)| *frame);
        // Behind playback, but not behind what was shown last.
        let behind = |f: usize| (frames - state.ahead(f, frames)) % frames;
        let limit = last.map_or(frames, behind);
        let best = state
            .loaded
            .iter()
            .map(|(&f, (item, _))| (behind(f), f, item))
            .filter(|(behind, ..)| *behind <= limit)
            .min_by_key(|(behind, ..)| *behind)
            .map(|(_, f, item)| (f, item.clone()));
        if let Some((f, item)) = best
            && last != Some(f)
        {
            self.shown.push_back((f, item));
            if self.shown.len() > IN_USE {
                self.shown.pop_front();
            }
            state.in_use = self.shown.iter().map(|(frame, _)| *frame).collect();
        }
        drop(state);
        self.shared.changed.notify_all();
        self.shown.back().cloned()
    }

    /// As [`ReadAhead::show`], but waits for the frame itself: for pictures, not for playback.
    ///
    /// # Errors
    /// Why the frame cannot be read.
    pub fn wait_for(&mut self, frame: usize) -> Result<Arc<T>, String> {
        loop {
            if let Some((shown, item)) = self.show(frame, false)
                && shown == frame
            {
                return Ok(item);
            }
            let state = self.shared.lock();
            if let Some(why) = state.failed.get(&frame) {
                return Err(why.clone());
            }
            if frame >= self.shared.frames {
                return Err(format!("there are {} frames", self.shared.frames));
            }
            if !state.loaded.contains_key(&frame) {
                drop(self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner));
            }
        }
    }

    /// Frames that could not be read, and why.
    pub fn failed(&self) -> BTreeMap<usize, String> {
        self.shared.lock().failed.clone()
    }

    /// Frames that are there.
    pub fn loaded(&self) -> Vec<usize> {
        self.shared.lock().loaded.keys().copied().collect()
    }

    /// Most bytes that were held at once.
    pub fn peak(&self) -> u64 {
        self.shared.lock().peak
    }
}

impl<T: Send + Sync + 'static> Drop for ReadAhead<T> {
    fn drop(&mut self) {
        self.shared.lock().quit = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the reading thread had panicked");
        }
    }
}

/// A sequence that is shown: its frames are read and brought to the device ahead of playback.
pub struct SequenceOnDevice {
    reader: ReadAhead<SceneOnDevice>,
    frames: usize,
}

impl SequenceOnDevice {
    /// Begins to read frames; those that are held take at most `budget` bytes.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(gpu: &Arc<Gpu>, frames: &[PathBuf], packing: Packing, budget: u64) -> std::io::Result<Self> {
        let (gpu, paths) = (gpu.clone(), frames.to_vec());
        let read = move |frame: usize| {
            let path = paths.get(frame).ok_or("there is no such frame")?;
            let splats = load_many(&[path], &LoadOptions::default()).map_err(|e| e.to_string())?.splats;
            let scene = SceneOnDevice::new(&gpu, &splats, packing).map_err(|e| e.to_string())?;
            // Beside what is on the device, its means are kept for sorting.
            let bytes = scene.bytes() + 12 * u64::from(scene.splats);
            Ok((scene, bytes))
        };
        Ok(Self { reader: ReadAhead::new(frames.len(), budget, read)?, frames: frames.len() })
    }

    /// Its playback: frames as they are, 30 a second.
    pub fn time_control(&self) -> TimeControl {
        let count = self.frames.max(1) as u32;
        TimeControl::new(f64::from(count) / FRAMES_PER_SECOND, count)
    }

    /// What to show now; nothing before the first frame is there. Never waits. The three frames that were shown last
    /// stay: the device may still draw them.
    pub fn show(&mut self, time: &TimeControl) -> Option<(usize, Arc<SceneOnDevice>)> {
        self.reader.show(time.frame() as usize, time.backwards())
    }

    /// Waits for a frame.
    ///
    /// # Errors
    /// Why it cannot be read.
    pub fn wait_for(&mut self, frame: usize) -> Result<Arc<SceneOnDevice>, String> {
        self.reader.wait_for(frame)
    }

    /// Most bytes that frames took at once.
    pub fn peak(&self) -> u64 {
        self.reader.peak()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    /// Waits until the reader has nothing left to do.
    fn settle(reader: &ReadAhead<usize>, frames: &[usize]) {
        for _ in 0..2000 {
            if reader.loaded() == frames {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert_eq!(reader.loaded(), frames);
    }

    #[test]
    fn reads_ahead_either_way_within_its_budget() {
        let mut reader = ReadAhead::new(10, 4, |frame| Ok((frame, 1))).unwrap();
        settle(&reader, &[0, 1, 2, 3]);
        for frame in [0, 1, 2] {
            assert_eq!(reader.show(frame, false).unwrap().0, frame);
        }
        // The three that were shown may still be drawn; one is left for reading ahead.
        settle(&reader, &[0, 1, 2, 3]);
        assert_eq!(reader.show(3, false).unwrap().0, 3);
        settle(&reader, &[1, 2, 3, 4]);
        // Backwards over the seam.
        assert!(reader.wait_for(0).is_ok());
        reader.show(0, true);
        // Which of the old frames are still in use depends on what was shown while 0 was waited for.
        for _ in 0..2000 {
            if reader.loaded().contains(&9) {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let loaded = reader.loaded();
        assert!(loaded.len() == 4 && loaded.contains(&0) && loaded.contains(&9), "{loaded:?}");
        assert_eq!(reader.peak(), 4);
    }

    #[test]
    fn a_slow_medium_skips_evenly_and_never_waits() {
        let (go, wait) = channel::<()>();
        let mut reader = ReadAhead::new(100, 50, move |frame| {
            wait.recv().map_err(|e| e.to_string())?;
            Ok((frame, 1))
        })
        .unwrap();
        go.send(()).unwrap();
        settle(&reader, &[0]);
        let mut shown = vec![reader.show(0, false).unwrap().0];
        // The medium gives one frame for every three that playback wants.
        for frame in 1..40 {
            let before = reader.loaded().len();
            shown.push(reader.show(frame, false).unwrap().0);
            if frame % 3 == 0 {
                go.send(()).unwrap();
                while reader.loaded().len() == before {
                    std::thread::yield_now();
                }
            }
        }
        assert!(shown.windows(2).all(|w| w[0] <= w[1]), "never back: {shown:?}");
        let mut distinct = shown.clone();
        distinct.dedup();
        assert!((12..=14).contains(&distinct.len()), "a third of them: {distinct:?}");
        assert!(distinct.windows(2).all(|w| w[1] - w[0] <= 5), "evenly: {distinct:?}");
        assert!(shown.iter().zip(0..).all(|(s, wanted)| wanted - s <= 6), "not far behind: {shown:?}");
        drop(go);
    }

    #[test]
    fn frames_that_cannot_be_read_are_passed_over() {
        let read = |frame| {
            if frame == 2 { Err("torn".to_owned()) } else { Ok((frame, if frame == 3 { 99 } else { 1 })) }
        };
        let mut reader = ReadAhead::new(5, 20, read).unwrap();
        settle(&reader, &[0, 1, 4]);
        let shown: Vec<_> = (0..5).map(|f| reader.show(f, false).unwrap().0).collect();
        assert_eq!(shown, [0, 1, 1, 1, 4]);
        assert_eq!(reader.wait_for(2).unwrap_err(), "torn");
        assert!(reader.wait_for(3).unwrap_err().contains("99 bytes"));
        assert!(reader.wait_for(9).is_err());
        assert_eq!(reader.failed().len(), 2);
        let mut narrow = ReadAhead::new(5, 2, |frame| Ok((frame, 1))).unwrap();
        assert!(narrow.wait_for(0).is_ok() && narrow.wait_for(1).is_ok());
        assert!(narrow.wait_for(2).unwrap_err().contains("no room"));
        let mut none = ReadAhead::<usize>::new(0, 1, |_| Err(String::new())).unwrap();
        assert!(none.show(0, false).is_none() && none.wait_for(0).is_err());
    }

    #[test]
    fn times_fall_into_frames() {
        let reader = ReadAhead::new(4, 9, |frame| Ok((frame, 1))).unwrap();
        let frames: Vec<_> =
            [-1.0, 0.0, 0.24, 0.25, 0.99, 1.0, 7.0, f32::NAN].map(|t| reader.frame_at(t)).into();
        assert_eq!(frames, [0, 0, 0, 1, 3, 3, 3, 0]);
    }
}
