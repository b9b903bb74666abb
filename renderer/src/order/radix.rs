//! Sort keys, and a stable radix sort on the processor.

/// Buffers of the sort, kept from one to the next so that nothing is allocated in the steady state.
#[derive(Default)]
pub struct SortBuffers {
    /// Key in the upper half, index in the lower.
    pub(super) pairs: Vec<u64>,
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

/// Stable least-significant-digit radix sort of `pairs` by their upper halves, 10 bits at a time: the places of 1024
/// buckets stay in the first-level cache, and the two uppermost bits, left to a pass of their own, are those that keys of
/// distances share. A digit that all keys share costs no pass.
pub fn radix_sort(buffers: &mut SortBuffers, key_bits: u32) {
    const DIGIT: u32 = 10;
    const BUCKETS: usize = 1 << DIGIT;
    let SortBuffers { pairs, scratch } = buffers;
    let n = pairs.len();
    scratch.resize(n, 0);
    let passes = key_bits.div_ceil(DIGIT) as usize;
    let mut histograms = [[0u32; BUCKETS]; 4];
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
        // Neighbours 0.8 % apart have keys of their own, in 16 bits.
        for near in [1e-3f32, 1.0, 700.0] {
            assert!(float_key_16(near) < float_key_16(1.008 * near), "{near}");
            assert!(float_key_16(near) <= 0xffff);
        }
    }
}
