//! What no other configuration beats, and whether two runs agree.

/// Indices of the points (error, cost) that no other point beats in one without losing in the other, from the least
/// error up. Of equal points the first counts. Points with NaN are never among them.
pub fn pareto(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&i| !(points[i].0 + points[i].1).is_nan()).collect();
    order.sort_by(|&a, &b| points[a].0.total_cmp(&points[b].0).then(points[a].1.total_cmp(&points[b].1)));
    let mut best = f64::INFINITY;
    order.retain(|&i| {
        let better = points[i].1 < best;
        best = best.min(points[i].1);
        better
    });
    order
}

/// The cheapest point whose error is at most `limit`; of equally cheap ones the one with the least error.
pub fn cheapest(points: &[(f64, f64)], limit: f64) -> Option<usize> {
    (0..points.len())
        .filter(|&i| points[i].0 <= limit && !points[i].1.is_nan())
        .min_by(|&a, &b| points[a].1.total_cmp(&points[b].1).then(points[a].0.total_cmp(&points[b].0)))
}

/// Spearman's rank correlation of two series, equal values sharing the mean of their ranks; `None` for fewer than three
/// pairs, or where one series does not vary.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.len() != b.len() || a.len() < 3 {
        return None;
    }
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 + 1.0) / 2.0;
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    let scale = (product(&a, &a) * product(&b, &b)).sqrt();
    (scale > 0.0).then(|| product(&a, &b) / scale)
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut start = 0;
    while start < order.len() {
        let same = order[start..].iter().take_while(|&&i| values[i] == values[order[start]]).count();
        for &i in &order[start..start + same] {
            ranks[i] = start as f64 + (same as f64 + 1.0) / 2.0;
        }
        start += same;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fronts_hold_what_nothing_beats() {
        let points =
            [(0.0, 10.0), (0.1, 5.0), (0.1, 6.0), (0.2, 5.0), (0.3, 1.0), (0.05, 11.0), (f64::NAN, 0.0)];
        assert_eq!(pareto(&points), [0, 1, 4]);
        for i in pareto(&points) {
            for (j, p) in points.iter().enumerate() {
                let beats =
                    p.0 <= points[i].0 && p.1 <= points[i].1 && (p.0 < points[i].0 || p.1 < points[i].1);
                assert!(!beats, "{j} beats {i}");
            }
        }
        assert!(pareto(&[]).is_empty());
    }

    #[test]
    fn the_cheapest_within_a_limit() {
        let points = [(0.0, 10.0), (0.009, 5.0), (0.01, 5.0), (0.3, 1.0)];
        assert_eq!(cheapest(&points, 0.01), Some(1));
        assert_eq!(cheapest(&points, 0.001), Some(0));
        assert_eq!(cheapest(&points, 1.0), Some(3));
        assert_eq!(cheapest(&points[1..], 0.001), None);
    }

    /// Pearson's correlation of the ranks, computed apart: 0.9009375 for these two series.
    #[test]
    fn rank_correlation_is_spearmans() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0, 5.0, 7.0];
        let b = [2.0, 1.0, 3.0, 5.0, 4.0, 6.0, 7.0];
        let found = rank_correlation(&a, &b).unwrap();
        assert!((found - 0.900_937_46).abs() < 1e-8, "{found}");
        assert!((rank_correlation(&a, &a).unwrap() - 1.0).abs() < 1e-12);
        let reversed: Vec<f64> = a.iter().map(|v| -v).collect();
        assert!((rank_correlation(&a, &reversed).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(rank_correlation(&a, &[1.0; 7]), None);
        assert_eq!(rank_correlation(&a[..2], &b[..2]), None);
    }
}
