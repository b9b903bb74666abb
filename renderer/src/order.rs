//! The order in which splats are blended, sorted on the processor: keys, a radix sort, and a worker that sorts
//! while frames go on being drawn.

use crate::{KeyBits, OrderKey};
use glam::{DVec3, Vec3};
use motes_scenes::{Motion, Splats};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// What an order depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderRequest {
    /// Radial distance or depth.
    pub key: OrderKey,
    /// Bits of the key.
    pub bits: KeyBits,
    /// Point between the eyes, scene axes.
    pub center: DVec3,
    /// Forward direction (for depth), scene axes.
    pub forward: DVec3,
    /// Time in a moving scene.
    pub time: f32,
}

/// Where splats are, kept on the processor for sorting: 12 bytes a splat, and the motion of a moving scene.
#[derive(Clone, Debug, Default)]
pub struct Positions {
    origin: DVec3,
    means: Vec<[f32; 3]>,
    motion: Option<Motion>,
}

impl Positions {
    /// Copies what sorting needs.
    pub fn of(splats: &Splats) -> Self {
        Self { origin: splats.origin.into(), means: splats.means.clone(), motion: splats.motion.clone() }
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
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

/// Buffers of the sort, kept from one to the next so that nothing is allocated in the steady state.
#[derive(Default)]
pub struct SortBuffers {
    pairs: Vec<u64>,
    scratch: Vec<u64>,
}

/// Order-preserving bits of a float: a smaller float has smaller bits; NaN comes last.
pub fn float_key(v: f32) -> u32 {
    if v.is_nan() {
        return u32::MAX;
    }
    let bits = v.to_bits();
    bits ^ (((bits as i32 >> 31) as u32) | 0x8000_0000)
}

/// A 16-bit key on a logarithmic scale: the upper half of the float's bits, sign, exponent and 7 bits of mantissa,
/// so that neighbours are told apart within 0.8 % of their distance, near or far.
pub fn float_key_16(v: f32) -> u32 {
    float_key(v) >> 16
}

/// Sorts splats front to back into `order` (stable: equal keys keep the scene's order).
pub fn sort_front_to_back(
    positions: &Positions,
    request: &OrderRequest,
    buffers: &mut SortBuffers,
    order: &mut Vec<u32>,
) {
    // In two parts: an f32 holds a place far from the scene's origin too coarsely to tell near splats apart.
    let from_origin = request.center - positions.origin;
    let center = from_origin.as_vec3();
    let rest = (from_origin - center.as_dvec3()).as_vec3();
    let forward = request.forward.as_vec3();
    let value = |i: usize| {
        let d = (positions.mean(i, request.time) - center) - rest;
        match request.key {
            OrderKey::Radial => d.length_squared(),
            OrderKey::Depth => d.dot(forward),
        }
    };
    let n = positions.len();
    buffers.pairs.clear();
    match request.bits {
        KeyBits::B32 => buffers.pairs.extend((0..n).map(|i| u64::from(float_key(value(i))) << 32 | i as u64)),
        // The root first: half the exponent's range, twice the resolution.
        KeyBits::B16 => buffers.pairs.extend((0..n).map(|i| {
            let v = value(i);
            let v = if request.key == OrderKey::Radial { v.sqrt() } else { v };
            u64::from(float_key_16(v)) << 32 | i as u64
        })),
    }
    radix_sort(buffers, if request.bits == KeyBits::B16 { 16 } else { 32 });
    order.clear();
    order.extend(buffers.pairs.iter().map(|p| *p as u32));
}

/// Stable least-significant-digit radix sort of `pairs` by their upper halves, 11 bits at a time.
/// A digit that all keys share costs no pass.
pub fn radix_sort(buffers: &mut SortBuffers, key_bits: u32) {
    const DIGIT: u32 = 11;
    const BUCKETS: usize = 1 << DIGIT;
    let SortBuffers { pairs, scratch } = buffers;
    let n = pairs.len();
    scratch.resize(n, 0);
    let passes = key_bits.div_ceil(DIGIT) as usize;
    let mut histograms = [[0u32; BUCKETS]; 3];
    for p in pairs.iter() {
        let key = (*p >> 32) as u32;
        for (pass, histogram) in histograms[..passes].iter_mut().enumerate() {
            histogram[(key >> (DIGIT * pass as u32)) as usize & (BUCKETS - 1)] += 1;
        }
    }
    for (pass, histogram) in histograms[..passes].iter_mut().enumerate() {
        if histogram.iter().any(|&h| h as usize == n) {
            continue;
        }
        let mut sum = 0;
        for h in histogram.iter_mut() {
            let count = *h;
            *h = sum;
            sum += count;
        }
        let shift = 32 + DIGIT * pass as u32;
        for p in pairs.iter() {
            let bucket = &mut histogram[(*p >> shift) as usize & (BUCKETS - 1)];
            scratch[*bucket as usize] = *p;
            *bucket += 1;
        }
        std::mem::swap(pairs, scratch);
    }
}

/// The buffers' pairs: key in the upper half, index in the lower.
impl SortBuffers {
    /// Takes pairs to sort.
    pub fn set(&mut self, pairs: impl Iterator<Item = (u32, u32)>) {
        self.pairs.clear();
        self.pairs.extend(pairs.map(|(key, index)| u64::from(key) << 32 | u64::from(index)));
    }

    /// The pairs as they stand.
    pub fn pairs(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.pairs.iter().map(|p| ((*p >> 32) as u32, *p as u32))
    }
}

/// An order and what it was made for.
#[derive(Clone, Debug, Default)]
pub struct SplatOrder {
    /// Indices of the splats, front to back.
    pub indices: Vec<u32>,
    /// What it was made for; none before the first sort.
    pub made_for: Option<OrderRequest>,
    /// Differs between any two sorts of the program, so that an order that is on the device already is known.
    pub id: u64,
}

impl SplatOrder {
    /// Marks the indices as freshly sorted.
    pub fn made(&mut self, request: OrderRequest) {
        static SORTS: AtomicU64 = AtomicU64::new(1);
        self.made_for = Some(request);
        self.id = SORTS.fetch_add(1, Ordering::Relaxed);
    }
}

/// Sorts on a thread of its own. Three buffers travel round: one being sorted, one finished, one in use.
pub struct SortWorker {
    requests: Option<Sender<OrderRequest>>,
    finished: Receiver<SplatOrder>,
    spare: Arc<Mutex<Vec<SplatOrder>>>,
    thread: Option<JoinHandle<()>>,
    pending: usize,
    newest: SplatOrder,
}

impl SortWorker {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(positions: Arc<Positions>) -> std::io::Result<Self> {
        let (requests, inbox) = channel::<OrderRequest>();
        let (outbox, finished) = channel();
        let spare = Arc::new(Mutex::new(vec![SplatOrder::default(), SplatOrder::default()]));
        let spare_of_thread = spare.clone();
        let thread = std::thread::Builder::new().name("sort".into()).spawn(move || {
            let mut buffers = SortBuffers::default();
            while let Ok(request) = inbox.recv() {
                let mut order =
                    spare_of_thread.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
                sort_front_to_back(&positions, &request, &mut buffers, &mut order.indices);
                order.made(request);
                if outbox.send(order).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self {
            requests: Some(requests),
            finished,
            spare,
            thread: Some(thread),
            pending: 0,
            newest: SplatOrder::default(),
        })
    }

    /// Asks for an order unless one is being made already or the newest is as good.
    pub fn request(&mut self, request: OrderRequest) {
        if self.pending == 0
            && self.newest.made_for != Some(request)
            && let Some(requests) = &self.requests
            && requests.send(request).is_ok()
        {
            self.pending += 1;
        }
    }

    fn accept(&mut self, order: SplatOrder) {
        self.pending -= 1;
        let used = std::mem::replace(&mut self.newest, order);
        self.spare.lock().unwrap_or_else(PoisonError::into_inner).push(used);
    }

    /// The newest finished order, and whether it is newer than at the last call. Never waits.
    pub fn newest(&mut self) -> (&SplatOrder, bool) {
        let mut fresh = false;
        loop {
            match self.finished.try_recv() {
                Ok(order) => {
                    self.accept(order);
                    fresh = true;
                }
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => return (&self.newest, fresh),
            }
        }
    }

    /// Waits for exactly this order.
    pub fn wait_for(&mut self, request: OrderRequest) -> &SplatOrder {
        while self.newest.made_for != Some(request) {
            self.request(request);
            match self.finished.recv() {
                Ok(order) => self.accept(order),
                Err(_) => break,
            }
        }
        &self.newest
    }
}

impl Drop for SortWorker {
    fn drop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the sorting thread had panicked");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(keys: &[u32], bits: u32) {
        let mut buffers = SortBuffers::default();
        buffers.set(keys.iter().copied().zip(0..));
        radix_sort(&mut buffers, bits);
        let sorted: Vec<_> = buffers.pairs().collect();
        let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
        expected.sort_by_key(|p| p.0);
        assert_eq!(sorted, expected);
    }

    #[test]
    fn radix_sort_equals_the_stable_sort() {
        let mut state = 7u32;
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            state
        };
        for n in [0, 1, 2, 255, 256, 257, 2047, 2048, 2049, 10_000] {
            let keys: Vec<u32> = (0..n).map(|_| random()).collect();
            check(&keys, 32);
            check(&keys.iter().map(|k| k & 0xffff).collect::<Vec<_>>(), 16);
            check(&keys.iter().map(|k| k & 3).collect::<Vec<_>>(), 32);
            check(&(0..n).collect::<Vec<_>>(), 32);
            check(&(0..n).rev().collect::<Vec<_>>(), 32);
            check(&vec![u32::MAX; n as usize], 32);
            check(&vec![0; n as usize], 16);
        }
    }

    #[test]
    fn float_keys_keep_the_order() {
        let values = [
            f32::NEG_INFINITY,
            f32::MIN,
            -1.0,
            -1e-40,
            -0.0,
            0.0,
            1e-40,
            1e-3,
            1.0,
            1.0000001,
            1e30,
            f32::MAX,
            f32::INFINITY,
            f32::NAN,
        ];
        for pair in values.windows(2) {
            assert!(float_key(pair[0]) < float_key(pair[1]), "{pair:?}");
            assert!(float_key_16(pair[0]) <= float_key_16(pair[1]), "{pair:?}");
        }
    }

    #[test]
    fn the_worker_sorts_what_it_is_asked() {
        let splats = motes_scenes::Splats {
            means: (0..1000).map(|i| [((i * 37) % 1000) as f32, 0.0, 0.0]).collect(),
            ..Default::default()
        };
        let mut worker = SortWorker::new(Arc::new(Positions::of(&splats))).unwrap();
        let mut request = OrderRequest {
            key: OrderKey::Radial,
            bits: KeyBits::B32,
            center: DVec3::new(-1.0, 0.0, 0.0),
            forward: DVec3::Z,
            time: 0.0,
        };
        let order = worker.wait_for(request).indices.clone();
        let x = |i: &u32| splats.means[*i as usize][0];
        assert!(order.windows(2).all(|w| x(&w[0]) <= x(&w[1])));
        // A head turn changes nothing; a step to the other side reverses everything.
        request.forward = DVec3::X;
        assert_eq!(worker.wait_for(request).indices, order);
        request.center.x = 2000.0;
        assert_eq!(worker.wait_for(request).indices, order.into_iter().rev().collect::<Vec<_>>());
    }
}
