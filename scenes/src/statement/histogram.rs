//! Histograms with edges that read well.

use rayon::prelude::*;

/// How values are spread.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Histogram {
    /// Bins in rising order, without gaps; from the first to the last with values in it where they are logarithmic.
    pub bins: Vec<Bin>,
    /// Number of values.
    pub count: usize,
    /// Least value, 0 without any.
    pub min: f64,
    /// The value in the middle, 0 without any.
    pub median: f64,
    /// What one in a hundred values lies above, 0 without any.
    pub p99: f64,
    /// Greatest value, 0 without any.
    pub max: f64,
}

/// Values from `from` on and below `to` (the last bin of a linear histogram: up to and with `to`).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Bin {
    /// Lower edge.
    pub from: f64,
    /// Upper edge.
    pub to: f64,
    /// Values in it.
    pub count: usize,
}

/// Exponents of ten that logarithmic histograms tell apart: beyond what scales of splats can give.
const DECADES: std::ops::Range<i32> = -40..40;

/// Lower edges within a decade.
const STEPS: [f64; 3] = [1.0, 2.0, 5.0];

impl Histogram {
    /// `bins` bins of equal width from 0 to 1. Values outside fall into the outer bins.
    pub(super) fn linear(bins: usize, values: impl ParallelIterator<Item = f64>) -> Self {
        let edge = |i: usize| i as f64 / bins as f64;
        Self::of(bins, values, |v| (v * bins as f64) as usize, |i| [edge(i), edge(i + 1)])
    }

    /// Bins from 1 to 2, 2 to 5 and 5 to 10 of every decade. Values must be positive.
    pub(super) fn logarithmic(values: impl ParallelIterator<Item = f64>) -> Self {
        let count = (DECADES.end - DECADES.start) as usize * STEPS.len();
        let edge = |i: usize| {
            let decade = DECADES.start + (i / STEPS.len()) as i32;
            // By parsing, for a power of ten times a digit is not always the nearest number.
            format!("{}e{decade}", STEPS[i % STEPS.len()]).parse().unwrap_or(f64::NAN)
        };
        let edges: Vec<f64> = (0..=count).map(edge).collect();
        let mut histogram = Self::of(
            count,
            values,
            |v| edges.partition_point(|&edge| edge <= v).saturating_sub(1),
            |i| [edges[i], edges[i + 1]],
        );
        let filled = |bin: &Bin| bin.count > 0;
        let end = histogram.bins.iter().rposition(filled).map_or(0, |last| last + 1);
        histogram.bins.truncate(end);
        let start = histogram.bins.iter().position(filled).unwrap_or(0);
        histogram.bins.drain(..start);
        histogram
    }

    fn of(
        bins: usize,
        values: impl ParallelIterator<Item = f64>,
        index: impl Fn(f64) -> usize,
        edges: impl Fn(usize) -> [f64; 2],
    ) -> Self {
        let mut values: Vec<f64> = values.collect();
        let mut counts = vec![0; bins];
        for &value in &values {
            if let Some(count) = counts.get_mut(index(value).min(bins - 1)) {
                *count += 1;
            }
        }
        let bins = counts
            .into_iter()
            .enumerate()
            .map(|(i, count)| {
                let [from, to] = edges(i);
                Bin { from, to, count }
            })
            .collect();
        let Some(last) = values.len().checked_sub(1) else {
            return Self { bins, ..Default::default() };
        };
        let mut at = |index: usize| *values.select_nth_unstable_by(index, f64::total_cmp).1;
        let (min, median, p99, max) = (at(0), at(last / 2), at(last - last / 100), at(last));
        Self { bins, count: last + 1, min, median, p99, max }
    }
}
