//! Which splats of a moving scene are alive when, so that a frame costs what is alive and not what is stored.

use motes_scenes::Splats;

/// Entries of all lists together, as a multiple of the scene's splats: bounds the index to 32 bytes a splat.
const ENTRIES_PER_SPLAT: usize = 8;
/// Entries that the device binds at once: 128 MiB.
const MOST_ENTRIES: usize = 1 << 25;
/// Most lists.
const MOST_LISTS: usize = 1024;
/// An index is kept where its lists hold less than this part of the splats on average: else it saves too little.
const WORTHWHILE: f64 = 0.75;

/// The times at which splat `i` of a moving scene can change a pixel: opacity · `exp(−(dt / width)²)` ≥ 1/255, so
/// `|dt| ≤ width √ln(255 opacity)`. None where its opacity never reaches 1/255.
pub fn support(splats: &Splats, i: usize) -> Option<(f32, f32)> {
    let Some(motion) = &splats.motion else { return Some((f32::NEG_INFINITY, f32::INFINITY)) };
    let log = (255.0 * f64::from(splats.opacities[i])).ln();
    if !(log >= 0.0) {
        return None;
    }
    let center = f64::from(motion.centers[i]);
    let reach = f64::from(motion.widths[i]) * log.sqrt();
    // A little wider than it is: the device rounds the same formula, and stores widths as halves.
    let margin = 1e-3 * reach + 1e-6;
    Some(((center - reach - margin) as f32, (center + reach + margin) as f32))
}

/// The splats alive in each of equal intervals of the scene's time, `0 ..= 1`; a time outside belongs to the nearest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AliveIndex {
    /// First entry of each list, and the end of the last.
    starts: Vec<u32>,
    /// Splats of all lists, each in the scene's order.
    entries: Vec<u32>,
}

impl AliveIndex {
    /// Lists a moving scene's splats, in as many intervals as fit into 8 entries a splat. None for a still scene, and
    /// where the lists would hold most of the splats anyway.
    pub fn new(splats: &Splats) -> Option<Self> {
        splats.motion.as_ref()?;
        let n = splats.len();
        if n == 0 {
            return None;
        }
        let supports: Vec<_> = (0..n).map(|i| support(splats, i)).collect();
        let most = (ENTRIES_PER_SPLAT * n).min(MOST_ENTRIES);
        let mut lists = MOST_LISTS;
        while lists >= 2 {
            let total: usize = supports
                .iter()
                .flatten()
                .map(|&s| {
                    let (first, last) = lists_of(s, lists);
                    last - first + 1
                })
                .sum();
            if total <= most {
                let worthwhile = total as f64 <= WORTHWHILE * (n * lists) as f64;
                return worthwhile.then(|| Self::build(&supports, lists, total));
            }
            lists /= 2;
        }
        None
    }

    fn build(supports: &[Option<(f32, f32)>], lists: usize, total: usize) -> Self {
        let mut starts = vec![0u32; lists + 1];
        for &s in supports.iter().flatten() {
            let (first, last) = lists_of(s, lists);
            for start in &mut starts[first + 1..=last + 1] {
                *start += 1;
            }
        }
        for list in 0..lists {
            starts[list + 1] += starts[list];
        }
        let mut next = starts.clone();
        let mut entries = vec![0; total];
        for (i, s) in (0..).zip(supports) {
            if let &Some(s) = s {
                let (first, last) = lists_of(s, lists);
                for next in &mut next[first..=last] {
                    entries[*next as usize] = i;
                    *next += 1;
                }
            }
        }
        Self { starts, entries }
    }

    /// Number of lists.
    pub fn lists(&self) -> usize {
        self.starts.len() - 1
    }

    /// All lists, one after the other.
    pub fn entries(&self) -> &[u32] {
        &self.entries
    }

    /// Where the list for a time lies in [`AliveIndex::entries`].
    pub fn range_at(&self, time: f32) -> std::ops::Range<usize> {
        let list = list_of(time, self.lists());
        self.starts[list] as usize..self.starts[list + 1] as usize
    }

    /// Every splat that is alive at a time, and a few that are alive shortly before or after, in the scene's order.
    pub fn at(&self, time: f32) -> &[u32] {
        &self.entries[self.range_at(time)]
    }
}

/// The list that a time falls into; NaN into the first.
fn list_of(time: f32, lists: usize) -> usize {
    ((time * lists as f32) as usize).min(lists - 1)
}

/// First and last list that a support reaches. A support outside of `0 ..= 1` is in the list at that end, for the
/// times there.
fn lists_of((from, to): (f32, f32), lists: usize) -> (usize, usize) {
    (list_of(from, lists), list_of(to, lists))
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_scenes::synthetic::{Animation, Recipe};

    fn scene(fleeting: f32, width: f32) -> Splats {
        let animation = Animation { fleeting, width, ..Default::default() };
        Recipe { count: 2000, seed: 5, ..Default::default() }.moving(&animation)
    }

    #[test]
    fn every_list_holds_all_that_is_visible() {
        let splats = scene(1.0, 0.02);
        let index = AliveIndex::new(&splats).unwrap();
        let mut missed_by_the_next = 0;
        for step in 0..=500 {
            let t = -0.1 + step as f32 * 1.2 / 500.0;
            let list = index.at(t);
            assert!(list.windows(2).all(|w| w[0] < w[1]), "in the scene's order, each once");
            let next = index.at(t + 0.1);
            for i in 0..splats.len() {
                let m = crate::motion::moment(&splats, i, f64::from(t)).unwrap();
                if m.opacity >= 1.0 / 255.0 {
                    assert!(list.binary_search(&(i as u32)).is_ok(), "{i} is missing at {t}");
                    missed_by_the_next += usize::from(next.binary_search(&(i as u32)).is_err());
                }
            }
        }
        // Control: another time's list lacks some.
        assert!(missed_by_the_next > 1000);
        assert!(index.entries().len() <= 8 * splats.len());
    }

    #[test]
    fn scenes_that_are_mostly_alive_or_still_have_no_index() {
        assert_eq!(AliveIndex::new(&scene(0.1, 0.02)), None);
        assert_eq!(AliveIndex::new(&Recipe::default().still()), None);
        assert_eq!(AliveIndex::new(&Splats::zeroed(0, 0, true)), None);
    }

    #[test]
    fn extreme_widths_and_times_are_listed() {
        let mut splats = scene(1.0, 0.01);
        if let Some(motion) = &mut splats.motion {
            motion.widths[0] = f32::MAX;
            motion.widths[1] = motes_scenes::MIN_WIDTH;
            motion.centers[2] = -3.0;
            motion.centers[3] = 1e6;
        }
        splats.opacities[4] = 0.001;
        let index = AliveIndex::new(&splats).unwrap();
        for t in [f32::NEG_INFINITY, -1e9, 0.0, 0.5, 1.0, 7.0, f32::INFINITY, f32::NAN] {
            assert!(index.at(t).contains(&0));
            assert!(!index.at(t).contains(&4), "never visible");
        }
        assert!(index.at(-3.0).contains(&2) && index.at(1e6).contains(&3));
    }
}
