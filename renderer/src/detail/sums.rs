//! Sums that many threads add to, equal on every run.

use std::sync::atomic::{AtomicI64, Ordering};

/// Fixed point: 32 bits behind the point. A sum over 2²⁷ pixels of values up to 4 (squared differences of three channels)
/// stays below 2³⁰, an addend is cut at 2 · 10⁻¹⁰.
const ONE: f64 = (1u64 << 32) as f64;

/// One sum per splat (or per whatever is counted).
pub(super) struct Sums(Vec<AtomicI64>);

impl Sums {
    pub fn new(count: usize) -> Self {
        Self((0..count).map(|_| AtomicI64::new(0)).collect())
    }

    /// Adds a finite value.
    pub fn add(&self, i: usize, value: f64) {
        self.0[i].fetch_add((value * ONE) as i64, Ordering::Relaxed);
    }

    /// Raises an entry to a value that it does not reach yet. Not to be mixed with [`Sums::add`].
    pub fn raise(&self, i: usize, value: f64) {
        self.0[i].fetch_max((value * ONE) as i64, Ordering::Relaxed);
    }

    /// The values.
    pub fn values(&self) -> impl Iterator<Item = f64> + '_ {
        self.0.iter().map(|v| v.load(Ordering::Relaxed) as f64 / ONE)
    }

    /// The values, after which all are 0 again.
    pub fn take(&mut self) -> impl Iterator<Item = f64> + '_ {
        self.0.iter_mut().map(|v| std::mem::take(v.get_mut()) as f64 / ONE)
    }
}
