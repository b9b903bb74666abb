//! Who has which places of a memory of fixed size: pages of equal length, given out and taken back.

use std::ops::Range;

/// Splats of a page: a compromise between pages that are not full and lists of pages that are long.
pub const PAGE: u32 = 64;

/// Pages that nobody has.
#[derive(Clone, Debug)]
pub struct Pages {
    /// Runs of free pages, rising, none touching the next.
    free: Vec<Range<u32>>,
}

impl Pages {
    /// So many, all free.
    pub fn new(pages: u32) -> Self {
        Self { free: std::iter::once(0..pages).filter(|r| !r.is_empty()).collect() }
    }

    /// Pages that so many splats take.
    pub fn of_splats(splats: u64) -> u64 {
        splats.div_ceil(u64::from(PAGE))
    }

    /// How many are free.
    pub fn free(&self) -> u64 {
        self.free.iter().map(|r| r.len() as u64).sum()
    }

    /// Gives so many, in as few runs as the largest free ones make; none where there are fewer.
    pub fn take(&mut self, pages: u64) -> Option<Vec<Range<u32>>> {
        if self.free() < pages {
            return None;
        }
        let (mut taken, mut missing) = (Vec::new(), pages);
        while missing > 0 {
            // The smallest run that is enough, else the largest.
            let enough = (0..self.free.len()).filter(|&i| self.free[i].len() as u64 >= missing);
            let best = enough.min_by_key(|&i| self.free[i].len());
            let best = best.or_else(|| (0..self.free.len()).max_by_key(|&i| self.free[i].len()))?;
            let run = &mut self.free[best];
            let count = (run.len() as u64).min(missing) as u32;
            taken.push(run.start..run.start + count);
            run.start += count;
            missing -= u64::from(count);
            if run.start == run.end {
                self.free.remove(best);
            }
        }
        Some(taken)
    }

    /// Takes pages back that it gave.
    pub fn give_back(&mut self, pages: &[Range<u32>]) {
        self.free.extend(pages.iter().cloned());
        self.free.sort_unstable_by_key(|r| r.start);
        self.free.dedup_by(|next, run| {
            let touch = run.end == next.start;
            if touch {
                run.end = next.end;
            }
            touch
        });
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::single_range_in_vec_init, reason = "a test may")]
mod tests {
    use super::*;

    #[test]
    fn pages_are_given_once_and_come_back_in_one_piece() {
        let mut pages = Pages::new(10);
        let (a, b, c) = (pages.take(3).unwrap(), pages.take(3).unwrap(), pages.take(4).unwrap());
        assert_eq!((a.clone(), b.clone(), c.clone()), (vec![0..3], vec![3..6], vec![6..10]));
        assert!(pages.free() == 0 && pages.take(1).is_none() && pages.take(0).unwrap().is_empty());
        pages.give_back(&a);
        pages.give_back(&c);
        // The smallest run that is enough; both, where none is.
        assert_eq!(pages.take(2).unwrap(), [0..2]);
        assert_eq!(pages.take(5).unwrap(), [6..10, 2..3]);
        pages.give_back(&[0..2, 6..10, 2..3]);
        pages.give_back(&b);
        assert_eq!((pages.free(), pages.take(10).unwrap()), (10, vec![0..10]));
        assert_eq!(Pages::of_splats(65), 2);
    }
}
