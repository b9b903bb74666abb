//! Sorts on a thread of its own, while frames go on being drawn.

use super::{OrderRequest, Positions, SortBuffers, SplatOrder};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Sorts on a thread of its own. Three buffers travel round: one being sorted, one finished, one in use.
pub struct SortWorker {
    requests: Option<SyncSender<OrderRequest>>,
    finished: Receiver<SplatOrder>,
    spare: Arc<Mutex<Vec<SplatOrder>>>,
    thread: Option<JoinHandle<()>>,
    pending: usize,
    newest: SplatOrder,
    interval: u32,
    /// Frames since the last order was asked for.
    waited: u32,
}

impl SortWorker {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(positions: Arc<Positions>) -> std::io::Result<Self> {
        // One order is under way at a time. Bounded channels allocate nothing once they are made.
        let (requests, inbox) = sync_channel::<OrderRequest>(1);
        let (outbox, finished) = sync_channel(1);
        let spare = Arc::new(Mutex::new(vec![SplatOrder::default(), SplatOrder::default()]));
        let spare_of_thread = spare.clone();
        let thread = std::thread::Builder::new().name("sort".into()).spawn(move || {
            let mut buffers = SortBuffers::default();
            while let Ok(request) = inbox.recv() {
                let mut order =
                    spare_of_thread.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
                order.sort(&positions, &request, &mut buffers);
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
            interval: 1,
            waited: u32::MAX,
        })
    }

    /// From now on, of the requests of successive frames only every `frames`-th is followed (1: all of them).
    pub fn set_interval(&mut self, frames: u32) {
        self.interval = frames.max(1);
    }

    /// Whether an order is being made.
    pub fn is_sorting(&self) -> bool {
        self.pending > 0
    }

    /// Asks for an order, once a frame. Does nothing where one is being made already, the newest is as good, or it is
    /// not yet this frame's turn ([`SortWorker::set_interval`]).
    pub fn request(&mut self, request: OrderRequest) {
        self.waited = self.waited.saturating_add(1);
        if self.waited >= self.interval {
            self.send(request);
        }
    }

    fn send(&mut self, request: OrderRequest) {
        if self.pending == 0
            && self.newest.made_for != Some(request)
            && let Some(requests) = &self.requests
            && requests.send(request).is_ok()
        {
            self.pending += 1;
            self.waited = 0;
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
            self.send(request);
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
    use crate::{KeyBits, OrderKey, TimeCull};
    use glam::DVec3;

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
            second: None,
            time: 0.0,
            time_cull: TimeCull::Index,
            parts: 0,
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
    #[test]
    fn the_worker_follows_every_nth_request() {
        let splats = motes_scenes::synthetic::Recipe::default().still();
        let mut worker = SortWorker::new(Arc::new(Positions::of(&splats))).unwrap();
        worker.set_interval(3);
        let request = |x: f64| OrderRequest {
            key: OrderKey::Radial,
            bits: KeyBits::B32,
            center: DVec3::new(x, 0.0, 0.0),
            forward: DVec3::Z,
            second: None,
            time: 0.0,
            time_cull: TimeCull::Index,
            parts: 0,
        };
        let mut made = Vec::new();
        for frame in 0..9 {
            worker.request(request(f64::from(frame)));
            // Whatever was asked for is given time to be made.
            while worker.pending > 0 {
                worker.newest();
                std::thread::yield_now();
            }
            made.push(worker.newest().0.made_for.unwrap().center.x);
        }
        assert_eq!(made, [0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 6.0, 6.0, 6.0]);
    }
}
