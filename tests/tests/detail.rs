//! Labels of real scenes: read from a labelling service, and voted back from masks that were made of them.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_renderer::detail::vote::{Elected, Votes, mask_of};
use motes_renderer::detail::{Census, Importance};
use motes_renderer::reference::ReferenceOptions;
use motes_renderer::{Fov, View};
use motes_scenes::labels::Labels;
use motes_scenes::{LoadOptions, Scene, Splats, load};
use motes_tests::sample;

/// Every third splat, of two statues side by side (in their files both stand at the origin), labelled by file of origin.
fn statues() -> (Splats, Vec<u16>) {
    let mut parts = Vec::new();
    for (label, (name, aside)) in [("st-peter", -1.2), ("narcissus", 1.2)].into_iter().enumerate() {
        let file = sample(format!("static/statues/{name}.sog"));
        let whole = load(&file, &LoadOptions::default()).unwrap().splats;
        let every_third: Vec<u32> = (0..whole.len() as u32).step_by(3).collect();
        let mut part = whole.selected(&every_third);
        part.means.iter_mut().for_each(|mean| mean[0] += aside);
        part.labels = Some(vec![label as u16 + 1; part.len()]);
        parts.push(part);
    }
    let mut splats = Scene::joined(parts);
    let truth = splats.labels.take().unwrap();
    (splats, truth)
}

/// Share of the splats that show with at least a tenth of some pixel and have the right class.
fn right(elected: &Elected, truth: &[u16], seen: &Importance) -> f64 {
    let visible: Vec<usize> = (0..truth.len()).filter(|&i| seen.peak[i] > 0.1).collect();
    assert!(visible.len() > 5_000, "{} are visible", visible.len());
    visible.iter().filter(|&&i| elected.labels[i] == truth[i]).count() as f64 / visible.len() as f64
}

#[test]
fn statues_get_their_files_of_origin_back_from_masks() {
    let (splats, truth) = statues();
    let options = ReferenceOptions { stop_below: 1e-4, ..Default::default() };
    let (mut weights, mut centres) = (Votes::new(splats.len(), 2), Votes::new(splats.len(), 2));
    let mut wrong = Votes::new(splats.len(), 2);
    let mut census = Census::new(splats.len());
    for turn in [0.3f64, 2.4, 4.5] {
        let (size, eye) = ([160, 120], DVec3::new(turn.sin(), -0.1, turn.cos()) * 6.0);
        let view = View::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, Fov::vertical(1.0, size), size);
        let mask = mask_of(&splats, &truth, &view, 0.5, &options).unwrap();
        weights.by_weight(&splats, &view, &mask, 4, &options).unwrap();
        centres.by_centres(&splats, &view, &mask, &options).unwrap();
        census.look(&splats, &view, &options).unwrap();
        let mirrored: Vec<u8> = mask.chunks(160).flat_map(|row| row.iter().rev().copied()).collect();
        wrong.by_weight(&splats, &view, &mirrored, 4, &options).unwrap();
    }
    let seen = census.finish();
    let by_weight = right(&weights.elect_among_neighbours(&splats), &truth, &seen);
    let by_centres = right(&centres.elect(), &truth, &seen);
    let control = right(&wrong.elect_among_neighbours(&splats), &truth, &seen);
    println!("by weight {by_weight:.4}, by centres {by_centres:.4}, masks mirrored {control:.4}");
    assert!(by_weight >= 0.99, "{by_weight}");
    // Side by side, neither statue hides the other: centres do as well. Masks of another picture do not.
    assert!(by_centres >= 0.99 && control < 0.9, "{by_centres} {control}");
}

#[test]
fn annotations_of_a_labelling_service_are_read() {
    let labels = Labels::load(&sample("static/fruit_drops_minimal.json")).unwrap();
    assert_eq!(labels.counts(), [229, 542, 680, 398, 1038, 616, 396, 556, 266]);
    assert_eq!(labels.class(1).unwrap().colour, [0, 120, 240]);
    let file = sample("static/fruit_drops_minimal.ply");
    let mut splats = load(&file, &LoadOptions::default()).unwrap().splats;
    labels.apply(&mut splats, &file).unwrap();
    // Classes are the printed letters: a splat's nearest neighbour is mostly of its class, which chance would not make.
    let ids = splats.labels.as_ref().unwrap();
    let nearest = |i: usize| {
        let at = DVec3::from(splats.mean_of(i));
        let others = (0..splats.len()).filter(|&j| j != i);
        others.min_by(|&a, &b| {
            let d = |j: usize| at.distance_squared(splats.mean_of(j).into());
            d(a).total_cmp(&d(b))
        })
    };
    let sampled: Vec<usize> = (0..splats.len()).step_by(23).collect();
    let same = sampled.iter().filter(|&&i| nearest(i).is_some_and(|j| ids[j] == ids[i])).count();
    let shuffled =
        sampled.iter().filter(|&&i| nearest(i).is_some_and(|j| ids[j] == ids[(i + 2000) % ids.len()]));
    let (same, shuffled) =
        (same as f64 / sampled.len() as f64, shuffled.count() as f64 / sampled.len() as f64);
    assert!(same > 0.8 && shuffled < 0.4, "{same} {shuffled}");
}
