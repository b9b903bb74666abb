//! The order in which splats are blended: what it depends on, and the three who make it: this thread, a worker
//! thread ([`SortWorker`]), or the device ([`device`]).

mod alive;
pub mod device;
mod radix;
mod worker;

pub use alive::{AliveIndex, support};
pub use radix::{SortBuffers, float_key, float_key_16, radix_sort};
pub use worker::SortWorker;

use crate::renderer::midpoint;
use crate::{KeyBits, OrderKey, RenderConfig, TimeCull, View};
use glam::{DVec3, Vec3};
use motes_scenes::{Motion, Splats};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

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
        }
    }
}

/// Where splats are, kept on the processor for sorting: 12 bytes a splat, and the motion of a moving scene.
#[derive(Clone, Debug, Default)]
pub struct Positions {
    origin: DVec3,
    means: Vec<[f32; 3]>,
    motion: Option<Motion>,
    alive: Option<Arc<AliveIndex>>,
}

impl Positions {
    /// Copies what sorting needs, and lists which splats are alive when.
    pub fn of(splats: &Splats) -> Self {
        Self {
            origin: splats.origin.into(),
            means: splats.means.clone(),
            motion: splats.motion.clone(),
            alive: AliveIndex::new(splats).map(Arc::new),
        }
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
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

    /// The mean of splat `i` at a time, relative to the scene's origin.
    fn mean(&self, i: usize, time: f32) -> Vec3 {
        let mean = Vec3::from(self.means[i]);
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
    let key_of = |i: u32| {
        let d = (positions.mean(i as usize, time) - center) - rest;
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
    match positions.candidates(request) {
        None => buffers.set((0..positions.len() as u32).map(|i| (key_of(i), i))),
        Some(alive) => buffers.set(alive.iter().map(|&i| (key_of(i), i))),
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
