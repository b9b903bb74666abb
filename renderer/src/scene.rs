//! A scene on the device.

use crate::TimeCull;
use crate::gpu::{Buffer, Gpu, GpuError};
use crate::order::{OrderRequest, Positions};
use crate::packing::Packing;
use crate::parts::Parts;
use crate::upload::Uploader;
use ash::vk;
use glam::DVec3;
use gpu_allocator::MemoryLocation;
use motes_scenes::Splats;
use motes_shaders::layout::{MOTION_SHIFT, MOTION_SLOTS, STREAM_SLOTS};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// One attribute stream, split over bindings of at most the device's limit at a power of two of splats.
pub struct Stream {
    /// One buffer a binding; none where the scene lacks the attribute.
    pub buffers: Vec<Buffer>,
    /// log2 of the splats in one binding.
    pub shift: u32,
    /// Bytes a splat.
    pub splat_bytes: u64,
}

impl Stream {
    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        if self.splat_bytes == 0 { 0 } else { self.buffers.iter().map(Buffer::bytes).sum() }
    }
}

/// A scene on the device, and what sorting needs of it on the processor.
pub struct SceneOnDevice {
    /// Differs between any two scenes of the program.
    pub id: u64,
    /// Number of splats.
    pub splats: u32,
    /// The scene's origin, subtracted from every position.
    pub origin: DVec3,
    /// How it is stored.
    pub packing: Packing,
    /// Means, rotations, scales, opacities, base colours.
    pub geometry: Stream,
    /// Spherical harmonics above the constant band.
    pub harmonics: Stream,
    /// Motion.
    pub motion: Stream,
    /// Whether splats move.
    pub moving: bool,
    /// Positions for sorting.
    pub positions: Arc<Positions>,
    /// The lists of [`AliveIndex`](crate::order::AliveIndex), where the scene has them.
    alive: Option<Buffer>,
}

/// The splats that a sort on the device looks at: a part of a list of lists.
pub(crate) struct Listed<'a> {
    pub entries: &'a Buffer,
    pub range: std::ops::Range<usize>,
}

impl SceneOnDevice {
    /// Packs and uploads a scene.
    ///
    /// # Errors
    /// More than the device can bind or hold; the error says what would fit.
    pub fn new(gpu: &Arc<Gpu>, splats: &Splats, packing: Packing) -> Result<Self, GpuError> {
        let packing = Packing { sh_degree: packing.sh_degree.min(splats.sh_degree), ..packing };
        let mut uploader = Uploader::new(gpu)?;
        let mut stream = |name, words: usize, slots, shift, pack: &(dyn Fn(usize, &mut [u32]) + Sync)| {
            upload_stream(gpu, &mut uploader, splats.len(), &StreamShape { name, words, slots, shift }, pack)
        };
        let geometry =
            stream("splat geometry", packing.geometry_words(), STREAM_SLOTS, None, &|first, words| {
                packing.geometry(splats, first, words)
            })?;
        let harmonics =
            stream("spherical harmonics", packing.sh_words(), STREAM_SLOTS, None, &|first, words| {
                packing.harmonics(splats, first, words)
            })?;
        let motion_words = if splats.motion.is_some() { packing.motion_words() } else { 0 };
        let motion = stream("motion", motion_words, MOTION_SLOTS, Some(MOTION_SHIFT), &|first, words| {
            packing.motion(splats, first, words);
        })?;
        let positions = Arc::new(Positions::of(splats));
        let alive = match positions.alive() {
            None => None,
            Some(index) => {
                let entries = index.entries();
                let usage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_DST;
                let bytes = 4 * entries.len() as u64;
                let buffer = Buffer::new(gpu, "alive splats", bytes, usage, MemoryLocation::GpuOnly)?;
                uploader.fill(&buffer, entries.len(), 1, |at, chunk| {
                    chunk.copy_from_slice(&entries[at..at + chunk.len()]);
                })?;
                Some(buffer)
            }
        };
        Ok(Self {
            id: next_id(),
            splats: splats.len() as u32,
            origin: splats.origin.into(),
            packing,
            geometry,
            harmonics,
            motion,
            moving: splats.motion.is_some(),
            positions,
            alive,
        })
    }

    /// Places for splats that come and go ([`SceneOnDevice::write`]), none of which is drawn before it is in a part
    /// ([`Positions::choose`]).
    ///
    /// # Errors
    /// More than the device can bind or hold.
    pub fn with_room(gpu: &Arc<Gpu>, splats: u32, origin: DVec3, packing: Packing) -> Result<Self, GpuError> {
        let stream = |name, words: usize| {
            let shape = StreamShape { name, words, slots: STREAM_SLOTS, shift: None };
            make_stream(gpu, splats as usize, &shape)
        };
        let geometry = stream("splat geometry", packing.geometry_words())?;
        let harmonics = stream("spherical harmonics", packing.sh_words())?;
        let positions = Arc::new(Positions::with_room(splats, origin));
        positions.choose(Some(Parts::new([])));
        let motion = Stream { buffers: Vec::new(), shift: 0, splat_bytes: 0 };
        let id = next_id();
        Ok(Self {
            id,
            splats,
            origin,
            packing,
            geometry,
            harmonics,
            motion,
            moving: false,
            positions,
            alive: None,
        })
    }

    /// Puts still splats, as many as `places` have room for or fewer, into places that no frame draws that is under way. May
    /// be called from any thread.
    ///
    /// # Errors
    /// The driver's.
    pub fn write(
        &self,
        uploader: &mut Uploader,
        places: impl Iterator<Item = Range<u32>>,
        splats: &Splats,
    ) -> Result<(), GpuError> {
        let shift = (DVec3::from(splats.origin) - self.origin).as_vec3().to_array();
        let means = |i: usize| std::array::from_fn(|k| splats.means[i][k] + shift[k]);
        let moved = Splats { means: (0..splats.len()).map(means).collect(), ..splats.clone() };
        let mut from = 0;
        for place in places {
            let count = (place.len()).min(splats.len() - from);
            let first = place.start as usize;
            self.positions.write(first, &moved.means[from..from + count]);
            let (geometry, sh) = (self.packing.geometry_words(), self.packing.sh_words());
            write_stream(uploader, &self.geometry, geometry, first, count, &|at, words| {
                self.packing.geometry(&moved, from + at, words);
            })?;
            write_stream(uploader, &self.harmonics, sh, first, count, &|at, words| {
                self.packing.harmonics(&moved, from + at, words);
            })?;
            from += count;
        }
        Ok(())
    }

    /// Bytes on the device, all streams.
    pub fn bytes(&self) -> u64 {
        let alive = self.alive.as_ref().map_or(0, Buffer::bytes);
        self.geometry.bytes() + self.harmonics.bytes() + self.motion.bytes() + alive
    }

    /// The splats that an order has to look at; none for all of them.
    pub(crate) fn alive_at(&self, request: &OrderRequest) -> Option<Listed<'_>> {
        match (request.time_cull, self.positions.alive(), &self.alive) {
            (TimeCull::Index, Some(index), Some(entries)) => {
                Some(Listed { entries, range: index.range_at(request.time) })
            }
            _ => None,
        }
    }
}

struct StreamShape {
    name: &'static str,
    words: usize,
    slots: u32,
    shift: Option<u32>,
}

fn next_id() -> u64 {
    static SCENES: AtomicU64 = AtomicU64::new(1);
    SCENES.fetch_add(1, Ordering::Relaxed)
}

/// The buffers of a stream, with nothing in them yet.
fn make_stream(gpu: &Arc<Gpu>, splats: usize, shape: &StreamShape) -> Result<Stream, GpuError> {
    let &StreamShape { name, words, slots, shift } = shape;
    let usage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_DST;
    let splat_bytes = words as u64 * 4;
    if words == 0 {
        return Ok(Stream { buffers: Vec::new(), shift: 0, splat_bytes });
    }
    if splats == 0 {
        let buffer = Buffer::new(gpu, name, 16, usage, MemoryLocation::GpuOnly)?;
        return Ok(Stream { buffers: vec![buffer], shift: 0, splat_bytes });
    }
    let limit = gpu.capabilities.max_storage_range;
    let shift = shift.unwrap_or_else(|| (limit / splat_bytes).ilog2().min(30));
    let per_binding = (1u64 << shift).min(limit / splat_bytes);
    // A single binding needs no split, so it may be filled up to the limit.
    let single = splats as u64 * splat_bytes <= limit;
    let fits = if single { splats as u64 } else { per_binding * u64::from(slots) };
    if splats as u64 > fits {
        let needed = splats as u64 * splat_bytes;
        return Err(GpuError::SceneTooLarge {
            splats,
            stream: name,
            needed,
            available: limit * u64::from(slots),
            fits,
        });
    }
    let step = if single { splats } else { per_binding as usize };
    let buffers = (0..splats).step_by(step).map(|first| {
        let count = step.min(splats - first);
        Buffer::new(gpu, name, count as u64 * splat_bytes, usage, MemoryLocation::GpuOnly)
    });
    Ok(Stream { buffers: buffers.collect::<Result<_, _>>()?, shift, splat_bytes })
}

fn upload_stream(
    gpu: &Arc<Gpu>,
    uploader: &mut Uploader,
    splats: usize,
    shape: &StreamShape,
    pack: &(dyn Fn(usize, &mut [u32]) + Sync),
) -> Result<Stream, GpuError> {
    let stream = make_stream(gpu, splats, shape)?;
    write_stream(uploader, &stream, shape.words, 0, splats, pack)?;
    Ok(stream)
}

/// Writes `count` splats from place `first` on; `pack(at, words)` packs those from the `at`-th of them on.
fn write_stream(
    uploader: &mut Uploader,
    stream: &Stream,
    words: usize,
    first: usize,
    count: usize,
    pack: &(dyn Fn(usize, &mut [u32]) + Sync),
) -> Result<(), GpuError> {
    if words == 0 {
        return Ok(());
    }
    let mut begins = 0;
    for buffer in &stream.buffers {
        let ends = begins + (buffer.bytes() / stream.splat_bytes) as usize;
        let (from, to) = (first.max(begins), (first + count).min(ends));
        if from < to {
            uploader.fill_from(
                buffer,
                (from - begins) * words,
                (to - from) * words,
                words,
                |at, chunk| {
                    // Chunks begin at whole splats.
                    let per_task = 4096 * words;
                    chunk
                        .par_chunks_mut(per_task)
                        .enumerate()
                        .for_each(|(task, part)| pack(from - first + (at + task * per_task) / words, part));
                },
            )?;
        }
        begins = ends;
    }
    Ok(())
}
