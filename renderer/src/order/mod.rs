//! The order in which splats are blended: what it depends on, and the three who make it: this thread, a worker
//! thread ([`SortWorker`]), or the device ([`device`]).

mod alive;
pub mod device;
mod radix;
mod worker;

pub use alive::{AliveIndex, support};
pub use radix::{SortBuffers, float_key, float_key_16, radix_sort};
pub use worker::SortWorker;

use crate::parts::{Part, Parts};
use crate::renderer::midpoint;
use crate::{KeyBits, OrderKey, RenderConfig, TimeCull, View};
use glam::{DVec3, Vec3};
use motes_scenes::{Motion, Splats};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

/// What an order depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderRequest {
    /// Radial distance or depth.
    pub key: OrderKey,
    /// Bits of the key.
    pub bits: KeyBits,
    /// Point between the eyes (the first eye, where each has its own order), scene axes.
    pub center: DVec3,
    /// Forward direction (for depth), scene axes.
    pub forward: DVec3,
    /// Centre and forward direction of the second eye's own order; none where one order serves both.
    pub second: Option<(DVec3, DVec3)>,
    /// Time in a moving scene.
    pub time: f32,
    /// Whether splats that are invisible around that time are left out.
    pub time_cull: TimeCull,
    /// Which parts of the scene, as [`Parts::id`]; 0: all of it. A sort takes the parts that are chosen when it begins.
    pub parts: u64,
}

impl OrderRequest {
    /// The order that a frame with these views and choices is to be drawn in.
    pub fn new(views: &[View], config: &RenderConfig) -> Self {
        let forward = |v: &View| v.rotation.row(2);
        let per_eye = config.sort_per_eye && views.len() == 2;
        Self {
            key: config.order,
            bits: config.key_bits,
            center: if per_eye { views[0].eye } else { midpoint(views) },
            forward: views.first().map_or(DVec3::Z, forward),
            second: per_eye.then(|| (views[1].eye, forward(&views[1]))),
            time: config.time,
            time_cull: config.time_cull,
            parts: 0,
        }
    }

    /// The same of the parts of a scene that are drawn now.
    pub fn of_parts(self, positions: &Positions) -> Self {
        Self { parts: positions.parts().map_or(0, |p| p.id()), ..self }
    }
}

/// Where splats are, kept on the processor for sorting: 12 bytes a splat, and the motion of a moving scene.
#[derive(Debug, Default)]
pub struct Positions {
    origin: DVec3,
    count: usize,
    /// Written only where a scene's splats come and go.
    means: RwLock<Vec<[f32; 3]>>,
    motion: Option<Motion>,
    alive: Option<Arc<AliveIndex>>,
    parts: Mutex<Option<Arc<Parts>>>,
}

impl Positions {
    /// Copies what sorting needs, and lists which splats are alive when.
    pub fn of(splats: &Splats) -> Self {
        Self {
            origin: splats.origin.into(),
            count: splats.len(),
            means: RwLock::new(splats.means.clone()),
            motion: splats.motion.clone(),
            alive: AliveIndex::new(splats).map(Arc::new),
            parts: Mutex::new(None),
        }
    }

    /// From now on, only these parts are sorted and drawn; those that reach beyond the scene are left out. None: all of it.
    /// Where there are parts, [`TimeCull`] has no say.
    pub fn choose(&self, parts: Option<Parts>) {
        let end = self.count as u64;
        let within = |p: Parts| match p.list().last() {
            Some(last) if u64::from(last.first) + u64::from(last.splats) > end => {
                let inside = |p: &&Part| u64::from(p.first) + u64::from(p.splats) <= end;
                Parts::new(p.list().iter().filter(inside).copied())
            }
            _ => p,
        };
        *self.parts.lock().unwrap_or_else(PoisonError::into_inner) = parts.map(within).map(Arc::new);
    }

    /// The parts that are sorted and drawn; none: all of the scene.
    pub fn parts(&self) -> Option<Arc<Parts>> {
        self.parts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Places for so many splats that come and go, relative to an origin.
    pub(crate) fn with_room(splats: u32, origin: DVec3) -> Self {
        let means = RwLock::new(vec![[0.0; 3]; splats as usize]);
        Self { origin, count: splats as usize, means, ..Self::default() }
    }

    /// Puts splats in their places, from `first` on.
    pub(crate) fn write(&self, first: usize, means: &[[f32; 3]]) {
        let mut all = self.means.write().unwrap_or_else(PoisonError::into_inner);
        all[first..first + means.len()].copy_from_slice(means);
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Which splats are alive when; none for a still scene, or one where leaving out the others would save little.
    pub fn alive(&self) -> Option<&Arc<AliveIndex>> {
        self.alive.as_ref()
    }

    /// The splats that a frame at a time has to look at, in the scene's order; none for all of them.
    fn candidates(&self, request: &OrderRequest) -> Option<&[u32]> {
        match (request.time_cull, &self.alive) {
            (TimeCull::Index, Some(index)) => Some(index.at(request.time)),
            _ => None,
        }
    }

    /// Where splat `i` with a mean is at a time, relative to the scene's origin.
    fn moved(&self, mean: [f32; 3], i: usize, time: f32) -> Vec3 {
        let mean = Vec3::from(mean);
        match &self.motion {
            None => mean,
            Some(m) => {
                let dt = time - m.centers[i];
                let [p1, p2, p3] = m.polynomials[i].map(Vec3::from);
                mean + dt * (p1 + dt * (p2 + dt * p3))
            }
        }
    }
}

/// A place as the nearest f32 and what that leaves: an f32 alone holds a place far from the scene's origin too coarsely
/// to tell near splats apart.
pub(crate) fn two_parts(place: DVec3) -> (Vec3, Vec3) {
    let nearest = place.as_vec3();
    (nearest, (place - nearest.as_dvec3()).as_vec3())
}

/// Sorts splats front to back into `order` (stable: equal keys keep the scene's order). Where each eye has its own
/// order this is the first eye's; [`SplatOrder::sort`] makes both.
pub fn sort_front_to_back(
    positions: &Positions,
    request: &OrderRequest,
    buffers: &mut SortBuffers,
    order: &mut Vec<u32>,
) {
    let (center, rest) = two_parts(request.center - positions.origin);
    let forward = request.forward.as_vec3();
    let (bits, key, time) = (request.bits, request.key, request.time);
    let means = positions.means.read().unwrap_or_else(PoisonError::into_inner);
    let key_of = |i: u32| {
        let mean = means[i as usize];
        let d = (positions.moved(mean, i as usize, time) - center) - rest;
        let value = match (key, bits) {
            (OrderKey::Radial, KeyBits::B32) => d.length_squared(),
            // The root: half the exponent's range, twice the resolution.
            (OrderKey::Radial, KeyBits::B16) => d.length(),
            (OrderKey::Depth, _) => d.dot(forward),
        };
        match bits {
            KeyBits::B32 => float_key(value),
            KeyBits::B16 => float_key_16(value),
        }
    };
    match (positions.parts(), positions.candidates(request)) {
        (Some(parts), _) => buffers.set(parts.indices().map(|i| (key_of(i), i))),
        (None, Some(alive)) => buffers.set(alive.iter().map(|&i| (key_of(i), i))),
        (None, None) => buffers.set((0..positions.len() as u32).map(|i| (key_of(i), i))),
    }
    radix_sort(buffers, if bits == KeyBits::B16 { 16 } else { 32 });
    order.clear();
    order.extend(buffers.pairs().map(|(_, index)| index));
}

/// An order and what it was made for.
#[derive(Clone, Debug, Default)]
pub struct SplatOrder {
    /// Indices of the splats, front to back. Splats that are invisible at the order's time may be missing.
    pub indices: Vec<u32>,
    /// The second eye's own order; empty where one serves both.
    pub second: Vec<u32>,
    /// What it was made for; none before the first sort.
    pub made_for: Option<OrderRequest>,
    /// Differs between any two sorts of the program, so that an order that is on the device already is known.
    pub id: u64,
}

impl SplatOrder {
    /// Sorts anew, for one eye or both.
    pub fn sort(&mut self, positions: &Positions, request: &OrderRequest, buffers: &mut SortBuffers) {
        sort_front_to_back(positions, request, buffers, &mut self.indices);
        self.second.clear();
        if let Some((center, forward)) = request.second {
            let of_second = OrderRequest { center, forward, ..*request };
            sort_front_to_back(positions, &of_second, buffers, &mut self.second);
        }
        self.made(*request);
    }

    /// Marks the indices as freshly sorted.
    pub fn made(&mut self, request: OrderRequest) {
        static SORTS: AtomicU64 = AtomicU64::new(1);
        self.made_for = Some(request);
        self.id = SORTS.fetch_add(1, Ordering::Relaxed);
    }

    /// The indices for an eye: its own, or the one order for both.
    pub fn of_eye(&self, eye: usize) -> &[u32] {
        if eye == 1 && !self.second.is_empty() { &self.second } else { &self.indices }
    }
}
