//! Splats per voxel (`000`, §4.2): where a scene is dense.

use std::collections::HashMap;

use motes_scenes::Splats;

/// Voxels along the longest side of a scene, where nobody names a size.
const VOXELS: f64 = 64.0;

/// A scene counted by voxels.
#[derive(Clone, Debug, PartialEq)]
pub struct Density {
    /// Side of a voxel, scene units.
    pub side: f64,
    /// For every splat, the splats in its voxel.
    pub of_splats: Vec<u32>,
    /// For every voxel that is not empty, its splats, rising.
    pub of_voxels: Vec<u32>,
}

impl Density {
    /// Counts in voxels with this side (scene units, positive); without one, of a 64th of the longest side of the scene's
    /// middle 98 %, so that no far outlier makes them huge.
    pub fn of(splats: &Splats, side: Option<f64>) -> Self {
        let range = |k: usize| {
            let mut values: Vec<f32> = splats.means.iter().map(|m| m[k]).collect();
            let n = values.len();
            if n == 0 {
                return 0.0;
            }
            let mut at =
                |share: usize| *values.select_nth_unstable_by((n - 1) * share / 100, f32::total_cmp).1;
            f64::from(at(99) - at(1))
        };
        let side = side.filter(|s| *s > 0.0);
        let side = side.unwrap_or_else(|| (0..3).map(range).fold(0.0, f64::max).max(1e-9) / VOXELS);
        let voxel = |i: usize| splats.mean_of(i).map(|v| (v / side).floor() as i64);
        let mut counts: HashMap<[i64; 3], u32> = HashMap::new();
        for i in 0..splats.len() {
            *counts.entry(voxel(i)).or_default() += 1;
        }
        let of_splats = (0..splats.len()).map(|i| counts.get(&voxel(i)).copied().unwrap_or(0)).collect();
        let mut of_voxels: Vec<u32> = counts.into_values().collect();
        of_voxels.sort_unstable();
        Self { side, of_splats, of_voxels }
    }

    /// What this share of the voxels does not exceed; 0 of an empty scene.
    pub fn quantile(&self, share: f64) -> u32 {
        let last = self.of_voxels.len().saturating_sub(1) as f64;
        self.of_voxels.get((last * share.clamp(0.0, 1.0)).round() as usize).copied().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_scenes::synthetic::Recipe;

    #[test]
    fn densities_count_neighbours() {
        let mut splats = Recipe { count: 50, ..Default::default() }.still();
        for (i, mean) in splats.means.iter_mut().enumerate() {
            *mean = if i < 20 { [0.1, 0.1, 0.1] } else { [i as f32, 0.1, 0.1] };
        }
        for found in [Density::of(&splats, None), Density::of(&splats, Some(1.0))] {
            let counts = &found.of_splats;
            assert!(
                counts[..20].iter().all(|&n| n == 20) && counts[20..].iter().all(|&n| n == 1),
                "{counts:?}"
            );
            assert_eq!((found.of_voxels.len(), found.quantile(0.5), found.quantile(1.0)), (31, 1, 20));
        }
        // A larger voxel holds more: 20 to 49 lie in four of 10 m, with the twenty at 0 in the first of five.
        let coarse = Density::of(&splats, Some(10.0));
        assert_eq!((coarse.of_voxels.as_slice(), coarse.side), (&[10, 10, 10, 20][..], 10.0));
        let empty = Density::of(&Splats::zeroed(0, 0, false), Some(1.0));
        assert_eq!((empty.quantile(0.5), empty.of_voxels.len()), (0, 0));
    }
}
