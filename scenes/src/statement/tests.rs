use super::*;
use crate::{DropReason, Format};

/// Four splats of which every figure is known.
fn known() -> Scene {
    let mut splats = Splats::zeroed(4, 1, false);
    splats.origin = [100.0, 0.0, 0.0];
    for i in 0..4 {
        let t = i as f32;
        splats.means[i] = [t, -t, 10.0 * t];
        splats.rotations[i] = [0.0, 0.0, 0.0, 1.0];
        splats.log_scales[i] = [(0.03_f32).ln(), (0.003_f32).ln(), (0.003_f32).ln()];
        splats.opacities[i] = [0.0, 0.35, 0.35, 1.0][i];
    }
    splats.log_scales[3] = [(3.0_f32).ln(); 3];
    // 2 √π times a colour of one step of 255 in band 1, and twice that in one channel of another splat.
    let step = 2.0 * std::f32::consts::PI.sqrt() / 255.0;
    splats.sh[4 * 2 + 1] = [step * 1.001; 3];
    splats.sh[4 * 3 + 2] = [0.0, 2.0 * step, 0.0];
    splats.labels = Some(vec![0, 7, 7, 2]);
    let mut report = LoadReport { read: 6, kept: 4, ..Default::default() };
    report.dropped.insert(DropReason::Mean, 2);
    report.warnings.push("something to know".to_owned());
    let sources = vec![SourceInfo {
        path: "a/b.sog".into(),
        format: Format::Sog,
        bytes: 4096,
        splats: 0..4,
        sh_degree: 1,
        antialiased: true,
    }];
    Scene { splats, report, sources }
}

#[test]
fn figures_are_right() {
    let statement = Statement::of(&known());
    assert_eq!((statement.splats, statement.sh_degree), (4, 1));
    assert_eq!((statement.bytes_on_disk, statement.bytes_in_memory), (4096, 4 * (44 + 48 + 2)));
    let bounds = statement.bounds.unwrap();
    assert_eq!((bounds.min, bounds.max), ([100.0, -3.0, 0.0], [103.0, 0.0, 30.0]));
    assert_eq!((statement.opacity.exactly_zero, statement.opacity.exactly_one), (1, 1));
    let counts: Vec<usize> = statement.opacity.histogram.bins.iter().map(|bin| bin.count).collect();
    assert_eq!(counts, [1, 0, 0, 2, 0, 0, 0, 0, 0, 1]);

    // 0.03 thrice between 0.02 and 0.05, and 3 between 2 and 5; five empty bins between.
    let bins = &statement.size.bins;
    assert_eq!((bins[0].from, bins[0].to, bins[0].count), (0.02, 0.05, 3));
    assert_eq!((bins[6].from, bins[6].to, bins[6].count, bins.len()), (2.0, 5.0, 1, 7));
    assert!((statement.size.median - 0.03).abs() < 1e-8 && (statement.size.max - 3.0).abs() < 1e-6);
    // The ratio 10 may land on either side of its edge by rounding.
    let anisotropy = &statement.anisotropy;
    assert_eq!((anisotropy.bins[0].from, anisotropy.bins[0].to, anisotropy.bins[0].count), (1.0, 2.0, 1));
    assert_eq!(anisotropy.bins.iter().map(|bin| bin.count).sum::<usize>(), 4);
    assert!((anisotropy.median - 10.0).abs() < 1e-4);

    let band = statement.bands[1];
    // Three channels of one step, and one of two: Σ = 7 steps² over 4 splats × 3 channels.
    let expected = (7.0_f64 / 12.0).sqrt() / 255.0;
    assert!((band.rms - expected).abs() < 1e-3 * expected, "{} where {expected} is meant", band.rms);
    assert_eq!((band.degree, band.visible), (1, 0.5));
    assert_eq!(statement.labels.unwrap(), BTreeMap::from([(0, 1), (2, 1), (7, 2)]));
    assert_eq!(statement.motion, None);
}

#[test]
fn inner_bounds_leave_out_a_hundredth_at_either_end() {
    let mut scene = Scene { splats: Splats::zeroed(1001, 0, false), ..Default::default() };
    for (i, mean) in scene.splats.means.iter_mut().enumerate() {
        // In no order, and the ends far out.
        let v = (i * 8) % 1001;
        mean[0] = if v == 0 {
            -1e6
        } else if v == 1000 {
            1e6
        } else {
            v as f32
        };
    }
    let bounds = Statement::of(&scene).bounds.unwrap();
    assert_eq!((bounds.min[0], bounds.max[0]), (-1e6, 1e6));
    assert_eq!((bounds.inner_min[0], bounds.inner_max[0]), (10.0, 990.0));
}

#[test]
fn motion_is_stated() {
    let n = 4;
    let mut splats = Splats::zeroed(n, 0, true);
    splats.rotations.fill([0.0, 0.0, 0.0, 1.0]);
    splats.log_scales.fill([0.0; 3]);
    // α = e/255 at the centre: seen as long as |dt| is at most the width.
    splats.opacities = vec![std::f32::consts::E / 255.0; n];
    let motion = splats.motion.as_mut().unwrap();
    // Permanent and still; from 0.4 to 0.6 and moving by 3 · 0.1; turning by 90° at dt = ½; never seen.
    motion.centers[1] = 0.5;
    motion.widths[1] = 0.1;
    motion.polynomials[1][0] = [3.0, 0.0, 0.0];
    motion.omegas[2] = [0.0, 0.0, 2.0, 0.0];
    motion.widths[2] = 0.5;
    splats.opacities[3] = 0.5 / 255.0;
    let scene = Scene { splats, ..Default::default() };
    let motion = Statement::of(&scene).motion.unwrap();
    assert_eq!((motion.moving, motion.turning, motion.permanent), (0.25, 0.25, 0.25));
    assert!((motion.alive - 1.7).abs() < 1e-4, "{}", motion.alive);
    let counts: Vec<usize> = motion.support.bins.iter().map(|bin| bin.count).collect();
    assert_eq!(counts.iter().sum::<usize>(), 4);
    assert_eq!((counts[0], counts[9]), (1, 1));
    assert!((motion.displacement.max - 0.3).abs() < 1e-6 && motion.displacement.count == 1);
}

#[test]
fn an_empty_scene_has_a_statement() {
    let statement = Statement::of(&Scene::default());
    assert_eq!((statement.splats, statement.bounds), (0, None));
    assert!(statement.size.bins.is_empty());
    let text = statement.to_string();
    assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    let moving = Scene { splats: Splats::zeroed(0, 3, true), ..Default::default() };
    assert!(!Statement::of(&moving).to_string().contains("NaN"));
}

#[test]
fn the_text_says_it_and_json_holds_it() {
    let statement = Statement::of(&known());
    let text = statement.to_string();
    for words in [
        "a/b.sog: SOG, 4 splats, SH degree 1, 4.0 KiB, trained antialiased",
        "dropped             2   of 6:",
        "position is not finite or out of range",
        "warning: something to know",
        "kept relative to [100.0, 0.0, 0.0]",
        "opacity: median 0.35; 1 exactly 0; 1 exactly 1",
        "0.02 – 0.05",
        "75.0 %",
        "labels: 3 classes",
        "████████████████████████████████████████",
    ] {
        assert!(text.contains(words), "“{words}” is not in\n{text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    let json = serde_json::to_value(&statement).unwrap();
    assert_eq!(json["opacity"]["exactly_one"], 1);
    assert_eq!(json["loading"]["dropped"]["mean"], 2);
    assert_eq!(json["labels"]["7"], 2);
    assert_eq!(json["sources"][0]["format"], "sog");
}
