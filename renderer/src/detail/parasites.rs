//! Parasite splats: large ones that hang before a camera, made by a trainer to correct that one photograph. The report
//! (`002`, §5.2.1.1) found such splats in the middle of optimised scenes and removed them by hand.

use glam::DVec3;
use motes_scenes::Splats;

use super::Importance;
use crate::View;

/// When a splat is a parasite; all three must hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// It is nearer to a camera than this share of that camera's distance to the scene, `0 ..= 1`.
    pub near: f64,
    /// From there its standard deviation (the middle of the three) spans at least this angle, as a tangent.
    pub size: f64,
    /// One view has at least this share of all it gives to pictures, or no view sees it, `0 ..= 1`.
    pub favourite: f64,
}

impl Default for Rule {
    /// Within a fifth of the way, wider than 3° (one deviation), and nine tenths of it for one view: what others look through
    /// as well, pictures from between them show too.
    fn default() -> Self {
        Self { near: 0.2, size: 0.05, favourite: 0.9 }
    }
}

/// The parasites of a scene, in its order. `distances`: how far each view's eye is from what it shows, scene units; views
/// for which it is not finite are left out.
pub fn parasites(
    splats: &Splats,
    views: &[View],
    distances: &[f64],
    importance: &Importance,
    rule: Rule,
) -> Vec<u32> {
    let eyes: Vec<(DVec3, f64)> = views
        .iter()
        .zip(distances)
        .filter(|(_, d)| d.is_finite())
        .map(|(v, &d)| (v.eye, rule.near * d))
        .collect();
    let hangs_before = |i: usize| {
        let mean = DVec3::from_array(splats.mean_of(i));
        let mut scales = splats.log_scales[i];
        scales.sort_by(f32::total_cmp);
        let deviation = f64::from(scales[1]).exp();
        eyes.iter().any(|&(eye, within)| {
            let distance = mean.distance(eye);
            distance < within && deviation >= rule.size * distance
        })
    };
    let of_one_view = |i: usize| importance.weight[i] == 0.0 || importance.favourite[i] >= rule.favourite;
    (0..splats.len()).filter(|&i| of_one_view(i) && hangs_before(i)).map(|i| i as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Census;
    use super::super::tests::{ahead, balls};
    use super::*;
    use crate::reference::ReferenceOptions;

    #[test]
    fn what_hangs_before_one_camera_is_found_and_nothing_else() {
        let wall = (0..100).map(|k| {
            let (x, y) = ((k % 10) as f32 - 4.5, (k / 10) as f32 - 4.5);
            ([0.4 * x, 0.4 * y, 4.0], 0.3, 0.9, [0.5; 3])
        });
        let mut list: Vec<_> = wall.collect();
        list.push(([0.1, 0.0, 0.4], 0.1, 0.3, [1.0; 3])); // before the first camera
        list.push(([0.0, 0.1, 0.3], 0.001, 0.9, [1.0; 3])); // there too, but a speck
        list.push(([0.0, 0.0, 2.0], 0.3, 0.3, [1.0; 3])); // half-way to the wall: part of the scene
        let splats = balls(&list);
        let views = [-2.0, 0.0, 2.0].map(|x| {
            let view = ahead();
            View { eye: DVec3::new(x, 0.0, 0.0), ..view }
        });
        let mut census = Census::new(splats.len());
        for view in &views {
            census.look(&splats, view, &ReferenceOptions::default()).unwrap();
        }
        let importance = census.finish();
        let found = |rule| parasites(&splats, &views, &[4.0; 3], &importance, rule);
        assert_eq!(found(Rule::default()), [100]);
        // Controls: each part of the rule matters.
        assert_eq!(found(Rule { size: 0.0, ..Rule::default() }), [100, 101]);
        assert!(found(Rule { near: 0.6, favourite: 0.3, ..Rule::default() }).contains(&102));
        assert!(parasites(&splats, &views, &[f64::INFINITY; 3], &importance, Rule::default()).is_empty());
        // What a second camera looks through as well is not there for one photograph.
        let mut census = Census::new(splats.len());
        let views = [0.0, 0.05].map(|x| View { eye: DVec3::new(x, 0.0, 0.0), ..ahead() });
        for view in &views {
            census.look(&splats, view, &ReferenceOptions::default()).unwrap();
        }
        let importance = census.finish();
        let shared = |favourite| {
            let rule = Rule { favourite, ..Rule::default() };
            parasites(&splats, &views, &[4.0; 2], &importance, rule).contains(&100)
        };
        assert!(!shared(Rule::default().favourite) && shared(0.4), "{}", importance.favourite[100]);
    }
}
