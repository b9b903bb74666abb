//! The reference against closed forms, against a second renderer that shares nothing with it but the definition, and
//! under transformations that must not change the picture.

use glam::{DMat3, DQuat, DVec3};
use motes_scenes::{Motion, SH_C0, Splats};

use super::textbook::textbook;
use super::*;
use crate::config::Axis;
use crate::view::Fov;

/// Deterministic numbers in 0 .. 1 (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    fn point(&mut self, low: f64, high: f64) -> DVec3 {
        DVec3::new(self.between(low, high), self.between(low, high), self.between(low, high))
    }
}

fn push(splats: &mut Splats, mean: DVec3, rotation: DQuat, scales: DVec3, opacity: f64, colour: [f64; 3]) {
    splats.means.push(mean.as_vec3().to_array());
    splats.rotations.push(rotation.normalize().as_quat().to_array());
    splats.log_scales.push(scales.to_array().map(|s| s.ln() as f32));
    splats.opacities.push(opacity as f32);
    splats.sh.push(colour.map(|c| ((c - 0.5) / f64::from(SH_C0)) as f32));
}

fn one(mean: DVec3, rotation: DQuat, scales: DVec3, opacity: f64) -> Splats {
    let mut splats = Splats::default();
    push(&mut splats, mean, rotation, scales, opacity, [0.8, 0.4, 0.2]);
    splats
}

/// Splats all around the eye at the origin, some of them around the eye itself, from needles to blankets.
fn surrounding(seed: u64, count: usize) -> Splats {
    let mut random = Random(seed);
    let mut splats = Splats::default();
    for _ in 0..count {
        let mean = random.point(-3.0, 3.0) * random.between(0.05, 1.0);
        let rotation = DQuat::from_xyzw(
            random.next() - 0.5,
            random.next() - 0.5,
            random.next() - 0.5,
            random.next() - 0.5,
        );
        let scales = random.point(-4.0, 0.5).exp();
        let colour = random.point(0.0, 1.0).to_array();
        push(&mut splats, mean, rotation, scales, random.between(0.02, 1.0), colour);
    }
    splats
}

fn straight(fov: Fov, size: [u32; 2]) -> View {
    View { rotation: DMat3::IDENTITY, eye: DVec3::ZERO, fov, size }
}

fn off_axis() -> View {
    View {
        rotation: DMat3::from_quat(DQuat::from_xyzw(0.1, -0.2, 0.3, 0.9).normalize()),
        eye: DVec3::new(0.1, 0.05, -0.2),
        fov: Fov { left: -0.6, right: 1.3, up: -0.9, down: 0.5 },
        size: [70, 45],
    }
}

fn truth(projection: Projection, low_pass: LowPass) -> ReferenceOptions {
    ReferenceOptions { projection, low_pass, ..ReferenceOptions::default() }
}

/// Largest difference of any channel.
fn difference(a: &ReferenceImage, b: &ReferenceImage) -> f64 {
    assert_eq!(a.size, b.size);
    a.pixels
        .iter()
        .zip(&b.pixels)
        .flat_map(|(p, q)| (0..3).map(|c| (p.colour[c] - q.colour[c]).abs()))
        .fold(0.0, f64::max)
}

/// Bounds, tiles, order and arithmetic, for splats before, beside, around and behind the eye.
#[test]
fn agrees_with_the_textbook_definition() {
    for &projection in Projection::ALL {
        for seed in 0..6 {
            let splats = surrounding(seed, 120);
            let view = off_axis();
            let image = render(&splats, &view, &truth(projection, LowPass::Planar)).unwrap();
            let error = |expected: &[[f64; 3]]| {
                let differences = image
                    .pixels
                    .iter()
                    .zip(expected)
                    .flat_map(|(p, e)| (0..3).map(|c| (p.colour[c] - e[c]).abs()));
                differences.fold(0.0, f64::max)
            };
            let expected = textbook(projection, &splats, &view);
            assert!(error(&expected) < 1e-6, "{projection}, seed {seed}: {}", error(&expected));
            assert!(
                image.mean(|p| p.transmittance) < 0.9,
                "{projection}, seed {seed}: an empty picture proves nothing"
            );
            // Control: an eye that is off by 2 cm is seen.
            let aside = View { eye: view.eye + DVec3::new(0.02, 0.0, 0.0), ..view };
            assert!(error(&textbook(projection, &splats, &aside)) > 1e-2);
        }
    }
}

#[test]
fn one_splat_on_the_axis_is_a_closed_form() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [64, 64]);
    let sigma = 0.1;
    let splats = one(DVec3::new(0.0, 0.0, 2.0), DQuat::IDENTITY, DVec3::splat(sigma), 0.7);
    for (low_pass, filter) in [(LowPass::Off, 0.0), (LowPass::Planar, 0.3), (LowPass::Volumetric, 0.3)] {
        let image = render(&splats, &view, &truth(Projection::Affine, low_pass)).unwrap();
        // 64 px per metre at depth 1.
        let variance = (sigma * 64.0 / 2.0f64).powi(2) + filter;
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (dx, dy) = ((i % 64) as f64 + 0.5 - 32.0, (i / 64) as f64 + 0.5 - 32.0);
            let alpha = 0.7f32 as f64 * (-0.5 * (dx * dx + dy * dy) / variance).exp();
            let alpha = if alpha >= 1.0 / 255.0 { alpha } else { 0.0 };
            assert!((pixel.transmittance - (1.0 - alpha)).abs() < 1e-7, "{low_pass} pixel {i}");
            assert_eq!(pixel.layers, u32::from(alpha > 0.0));
        }
    }
}

/// A ball: the distance of a ray from its centre is plane geometry, at any angle, and from inside too.
#[test]
fn a_ball_is_exact_at_every_angle() {
    let view = straight(Fov { left: -2.5, right: 2.5, up: -1.5, down: 1.5 }, [50, 30]);
    for (mean, sigma) in [
        (DVec3::new(4.0, 1.0, 2.0), 0.8),
        (DVec3::new(-0.1, 0.05, 0.2), 0.9),
        (DVec3::new(0.3, 0.0, -0.1), 2.0),
    ] {
        let mut splats = one(mean, DQuat::IDENTITY, DVec3::splat(sigma), 0.9);
        let mean = DVec3::from_array(splats.means[0].map(f64::from));
        let sigma = f64::from(splats.log_scales[0][0]).exp();
        let image = render(&splats, &view, &truth(Projection::Exact, LowPass::Off)).unwrap();
        let worst = |image: &ReferenceImage| {
            let mut worst = 0.0f64;
            for y in 0..30 {
                for x in 0..50 {
                    let d = DVec3::new(-2.5 + (x as f64 + 0.5) * 0.1, -1.5 + (y as f64 + 0.5) * 0.1, 1.0)
                        .normalize();
                    let along = d.dot(mean);
                    let square = (mean.length_squared() - along * along) / (sigma * sigma);
                    let alpha = (0.9f32 as f64 * (-0.5 * square).exp()).min(0.99);
                    let alpha = if along > 0.0 && alpha >= 1.0 / 255.0 { alpha } else { 0.0 };
                    worst = worst.max((image.pixel(x, y).transmittance - (1.0 - alpha)).abs());
                }
            }
            worst
        };
        assert!(worst(&image) < 1e-9, "{mean}: {}", worst(&image));
        assert!(image.pixels.iter().any(|p| p.layers == 1), "{mean} is not seen at all");
        // Controls: affine is not exact there, nor is another size.
        splats.log_scales[0] = [splats.log_scales[0][0] + 0.01; 3];
        assert!(worst(&render(&splats, &view, &truth(Projection::Exact, LowPass::Off)).unwrap()) > 1e-4);
    }
}

#[test]
fn nothing_is_seen_of_a_splat_whose_densest_part_lies_behind() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [32, 32]);
    let behind = one(DVec3::new(0.0, 0.0, -0.5), DQuat::IDENTITY, DVec3::splat(2.0), 1.0);
    let ahead = one(DVec3::new(0.0, 0.0, 0.5), DQuat::IDENTITY, DVec3::splat(2.0), 1.0);
    for &projection in Projection::ALL {
        let layers =
            |s| render(s, &view, &truth(projection, LowPass::Planar)).unwrap().mean(|p| p.layers.into());
        assert_eq!(layers(&behind), 0.0, "{projection}");
        assert_eq!(layers(&ahead), 1.0, "{projection}");
    }
}

/// The whole picture under a common translation, rotation and scale of scene and eye.
#[test]
fn a_common_motion_changes_nothing() {
    let splats = surrounding(11, 60);
    let view = off_axis();
    let turn = DQuat::from_xyzw(0.3, -0.5, 0.2, 0.6).normalize();
    let (shift, scale) = (DVec3::new(4.0, -7.0, 2.5), 3.0);
    let mut moved = splats.clone();
    for i in 0..moved.len() {
        let mean = turn * DVec3::from_array(splats.means[i].map(f64::from)) * scale;
        moved.means[i] = mean.as_vec3().to_array();
        let rotation = turn * DQuat::from_array(splats.rotations[i].map(f64::from));
        moved.rotations[i] = rotation.as_quat().to_array();
        moved.log_scales[i] = splats.log_scales[i].map(|s| (f64::from(s) + scale.ln()) as f32);
    }
    moved.origin = shift.to_array();
    let moved_view = View {
        rotation: view.rotation * DMat3::from_quat(turn.conjugate()),
        eye: turn * view.eye * scale + shift,
        ..view
    };
    for &projection in Projection::ALL {
        for &low_pass in LowPass::ALL {
            let a = render(&splats, &view, &truth(projection, low_pass)).unwrap();
            let b = render(&moved, &moved_view, &truth(projection, low_pass)).unwrap();
            // Means, rotations and scales went through f32, and a layer may cross 1/255 by it.
            let bound = 1.0 / 255.0;
            assert!(difference(&a, &b) < bound, "{projection} {low_pass}: {}", difference(&a, &b));
            // Control: a turned scene without a turned eye is another picture.
            let c =
                render(&moved, &View { rotation: view.rotation, ..moved_view }, &truth(projection, low_pass))
                    .unwrap();
            assert!(difference(&a, &c) > 0.1);
        }
    }
}

/// 10⁶ m from the origin nothing is lost: the same picture, but for the rounding of the eye's own position.
#[test]
fn a_scene_far_from_its_origin_is_the_same_picture() {
    let near = surrounding(5, 50);
    let view = off_axis();
    let shift = DVec3::new(1.0e6, -2.0e6, 5.0e5);
    let far = Splats { origin: shift.to_array(), ..near.clone() };
    let far_view = View { eye: view.eye + shift, ..view };
    for &projection in Projection::ALL {
        let options = truth(projection, LowPass::Planar);
        let a = render(&near, &view, &options).unwrap();
        assert!(difference(&a, &render(&far, &far_view, &options).unwrap()) < 1e-4);
        assert!(difference(&a, &render(&far, &view, &options).unwrap()) > 0.1);
    }
}

/// A part of a picture, taken with the asymmetric frustum of that part, is that part of the picture.
#[test]
fn an_asymmetric_frustum_is_a_crop() {
    let splats = surrounding(3, 80);
    let whole = straight(Fov { left: -1.2, right: 1.2, up: -0.9, down: 0.9 }, [96, 72]);
    let part = straight(Fov { left: -0.7, right: 0.5, up: -0.4, down: 0.8 }, [48, 48]);
    for projection in [Projection::Tangent, Projection::Exact] {
        let options = truth(projection, LowPass::Planar);
        let (a, b) = (render(&splats, &whole, &options).unwrap(), render(&splats, &part, &options).unwrap());
        let offset = |dx, dy| {
            let mut worst = 0.0f64;
            for y in 0..48 {
                for x in 0..48 {
                    for c in 0..3 {
                        worst =
                            worst.max((a.pixel(x + dx, y + dy).colour[c] - b.pixel(x, y).colour[c]).abs());
                    }
                }
            }
            worst
        };
        assert!(offset(20, 20) < 1e-9, "{projection}: {}", offset(20, 20));
        assert!(offset(21, 20) > 1e-3);
    }
}

/// A turn of the head changes which way the image plane lies, not what a direction sees: exact does not depend on it.
#[test]
fn exact_depends_on_the_ray_alone_and_affine_does_not() {
    let splats =
        one(DVec3::new(2.0, 0.0, 2.0), DQuat::from_xyzw(0.2, 0.1, 0.4, 0.8), DVec3::new(0.6, 0.1, 0.02), 0.9);
    let fov = Fov { left: -0.02, right: 0.02, up: -0.02, down: 0.02 };
    let towards = |target: DVec3| View::look_at(DVec3::ZERO, target, DVec3::NEG_Y, fov, [1, 1]);
    // One pixel in the direction of `target`, as the centre of its own picture and as a pixel beside that of another.
    let target = DVec3::new(1.9, 0.1, 2.0);
    let ahead = towards(target);
    let aside = View { rotation: DMat3::IDENTITY, ..ahead };
    let slope = target / target.z;
    let aside = View {
        fov: Fov { left: slope.x - 0.02, right: slope.x + 0.02, up: slope.y - 0.02, down: slope.y + 0.02 },
        ..aside
    };
    let alpha = |view: &View, projection| {
        1.0 - render(&splats, view, &truth(projection, LowPass::Off)).unwrap().pixel(0, 0).transmittance
    };
    for projection in [Projection::Exact, Projection::Tangent] {
        assert!((alpha(&ahead, projection) - alpha(&aside, projection)).abs() < 1e-9, "{projection}");
    }
    assert!((alpha(&ahead, Projection::Affine) - alpha(&aside, Projection::Affine)).abs() > 1e-3);
}

/// The smaller a splat, the less its projection matters: all rungs tend to the same picture.
#[test]
fn rungs_agree_on_small_splats() {
    let view = straight(Fov { left: -1.0, right: 1.0, up: -1.0, down: 1.0 }, [128, 128]);
    let apart = |size: f64| {
        let splats = one(
            DVec3::new(1.0, -1.2, 2.0),
            DQuat::from_xyzw(0.5, 0.1, -0.3, 0.7),
            DVec3::new(1.0, 0.5, 0.2) * size,
            0.9,
        );
        let image = |p| render(&splats, &view, &truth(p, LowPass::Planar)).unwrap();
        let exact = image(Projection::Exact);
        (difference(&image(Projection::Affine), &exact), difference(&image(Projection::Tangent), &exact))
    };
    let (small, large) = (apart(0.01), apart(0.5));
    assert!(small.0 < 0.01 && small.1 < 0.01, "{small:?}");
    assert!(large.0 > 0.1 && large.0 > 1.5 * large.1, "{large:?}");
}

#[test]
fn layers_transmittance_and_depth_of_a_stack() {
    // Eight sheets, each far wider than the picture: alpha is the opacity.
    let view = straight(Fov { left: -0.01, right: 0.01, up: -0.01, down: 0.01 }, [3, 2]);
    let mut splats = Splats::default();
    for i in (0..8).rev() {
        let colour = if i == 0 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
        push(
            &mut splats,
            DVec3::new(0.0, 0.0, 1.0 + f64::from(i)),
            DQuat::IDENTITY,
            DVec3::new(100.0, 100.0, 1e-3),
            0.25,
            colour,
        );
    }
    for &projection in Projection::ALL {
        for order in [ReferenceOrder::Depth, ReferenceOrder::Radial(None)] {
            let options = ReferenceOptions {
                order,
                count_until: 0.5,
                background: [0.0, 1.0, 0.0],
                ..truth(projection, LowPass::Off)
            };
            let image = render(&splats, &view, &options).unwrap();
            for pixel in &image.pixels {
                assert_eq!((pixel.layers, pixel.layers_until), (8, 3), "{projection}");
                assert!((pixel.transmittance - 0.75f64.powi(8)).abs() < 1e-6);
                // 0.75³ < ½: the third sheet.
                assert!((pixel.median_depth - 3.0).abs() < 1e-3, "{projection} {}", pixel.median_depth);
                let [r, g, b] = pixel.colour;
                assert!((r - 0.25).abs() < 1e-6 && (g - 0.75f64.powi(8)).abs() < 1e-6);
                assert!((b - (0.75 - 0.75f64.powi(8))).abs() < 1e-6);
            }
            // The trainers' stop: the layer that would go below is not blended.
            let stopped = render(&splats, &view, &ReferenceOptions { stop_below: 0.4, ..options }).unwrap();
            assert_eq!(stopped.pixel(0, 0).layers, 3);
            assert!((stopped.pixel(0, 0).transmittance - 0.75f64.powi(3)).abs() < 1e-6);
        }
    }
    let none = render(&Splats::default(), &view, &ReferenceOptions::default()).unwrap();
    assert_eq!((none.pixel(2, 1).median_depth, none.pixel(2, 1).transmittance), (f64::INFINITY, 1.0));
}

/// Two sheets that cross: along the ray each side has its own order, with one key both sides have the same.
#[test]
fn order_along_the_ray_solves_crossing_sheets() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [32, 8]);
    let mut splats = Splats::default();
    for (angle, colour, z) in [(0.6, [1.0, 0.0, 0.0], 2.0), (-0.6, [0.0, 0.0, 1.0], 2.001)] {
        let rotation = DQuat::from_rotation_y(angle);
        push(&mut splats, DVec3::new(0.0, 0.0, z), rotation, DVec3::new(5.0, 5.0, 1e-3), 1.0, colour);
    }
    let red = |order| {
        let image =
            render(&splats, &view, &ReferenceOptions { order, ..truth(Projection::Exact, LowPass::Off) })
                .unwrap();
        [image.pixel(2, 4).colour[0] > 0.5, image.pixel(29, 4).colour[0] > 0.5]
    };
    assert_ne!(red(ReferenceOrder::AlongRay)[0], red(ReferenceOrder::AlongRay)[1]);
    assert_eq!(red(ReferenceOrder::Depth), [true, true]);
}

#[test]
fn radial_order_can_be_taken_from_between_the_eyes() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [8, 8]);
    let mut splats = Splats::default();
    for (mean, colour) in
        [(DVec3::new(0.2, 0.0, 2.0), [1.0, 0.0, 0.0]), (DVec3::new(-0.2, 0.0, 2.01), [0.0, 0.0, 1.0])]
    {
        push(&mut splats, mean, DQuat::IDENTITY, DVec3::splat(0.5), 1.0, colour);
    }
    let red = |centre| {
        let options =
            ReferenceOptions { order: ReferenceOrder::Radial(centre), ..ReferenceOptions::default() };
        render(&splats, &view, &options).unwrap().pixel(4, 4).colour[0] > 0.5
    };
    assert!(red(None));
    assert!(red(Some(DVec3::new(0.03, 0.0, 0.0))));
    assert!(!red(Some(DVec3::new(-0.5, 0.0, 0.0))));
}

/// A shift by one pixel shifts the picture by one pixel: centres lie at ½, and no pixel is special.
#[test]
fn a_shift_by_a_pixel_shifts_the_picture() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [64, 64]);
    let at = |x: f64| {
        one(DVec3::new(x, 0.0, 2.0), DQuat::from_xyzw(0.1, 0.3, 0.2, 0.9), DVec3::new(0.09, 0.02, 0.05), 0.95)
    };
    let base = render(&at(0.0), &view, &truth(Projection::Affine, LowPass::Planar)).unwrap();
    // 32 px per metre at depth 2; affine depends on x/z a little, so the splat is turned by that much less.
    let moved = render(&at(1.0 / 32.0), &view, &truth(Projection::Affine, LowPass::Planar)).unwrap();
    let error = |shift: u32| {
        let mut worst = 0.0f64;
        for y in 0..64 {
            for x in 0..60 {
                worst = worst
                    .max((base.pixel(x, y).transmittance - moved.pixel(x + shift, y).transmittance).abs());
            }
        }
        worst
    };
    assert!(error(1) < 0.02, "{}", error(1));
    assert!(error(0) > 0.1 && error(2) > 0.1);
}

/// What the filter adds to a far splat's total, the compensation takes away again; nothing else changes.
#[test]
fn compensation_keeps_the_total() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [64, 64]);
    // 0.3 px wide, on a pixel's centre.
    let splats = one(
        DVec3::new(0.5 / 64.0 * 4.0, 0.5 / 64.0 * 4.0, 4.0),
        DQuat::IDENTITY,
        DVec3::splat(0.3 * 4.0 / 64.0),
        0.8,
    );
    let total = |projection, low_pass| {
        let image = render(&splats, &view, &truth(projection, low_pass)).unwrap();
        image.pixels.iter().map(|p| 1.0 - p.transmittance).sum::<f64>()
    };
    let area = 0.8 * std::f64::consts::TAU * 0.09;
    for &projection in Projection::ALL {
        for (compensated, plain) in [
            (LowPass::PlanarCompensated, LowPass::Planar),
            (LowPass::VolumetricCompensated, LowPass::Volumetric),
        ] {
            let (a, b) = (total(projection, compensated), total(projection, plain));
            assert!((a / area - 1.0).abs() < 0.1, "{projection} {compensated}: {a} {area}");
            assert!(b / area > 3.0, "{projection} {plain}: {b} {area}");
        }
    }
}

#[test]
fn a_fixed_reach_cuts_and_full_reach_does_not() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [64, 64]);
    let splats = one(
        DVec3::new(0.1, 0.0, 2.0),
        DQuat::from_xyzw(0.1, 0.3, 0.2, 0.9),
        DVec3::new(0.09, 0.02, 0.05),
        1.0,
    );
    for &projection in Projection::ALL {
        let smallest = |rule| {
            let options = ReferenceOptions { reach: Reach::Rule(rule), ..truth(projection, LowPass::Planar) };
            let image = render(&splats, &view, &options).unwrap();
            image.pixels.iter().map(|p| 1.0 - p.transmittance).filter(|&a| a > 0.0).fold(1.0, f64::min)
        };
        assert!(smallest(RadiusRule::Full) < 1.2 / 255.0);
        // exp(−8/2) = 4.7 / 255
        for rule in [RadiusRule::OpacityAware, RadiusRule::Sqrt8] {
            assert!(smallest(rule) > 4.6 / 255.0 && smallest(rule) < 8.0 / 255.0, "{projection} {rule}");
        }
    }
}

/// The trainers' mode differs from the affine one by its rectangles alone, and they cut only where little is left.
#[test]
fn the_trainers_rectangles_cut_little() {
    let mut random = Random(8);
    let mut splats = Splats::default();
    for _ in 0..200 {
        let mean = DVec3::new(random.between(-1.0, 1.0), random.between(-1.0, 1.0), random.between(1.5, 5.0));
        let rotation =
            DQuat::from_xyzw(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5, random.next());
        push(
            &mut splats,
            mean,
            rotation,
            random.point(-5.0, -2.0).exp(),
            random.between(0.05, 1.0),
            random.point(0.0, 1.0).to_array(),
        );
    }
    let view = straight(Fov { left: -0.6, right: 0.6, up: -0.4, down: 0.4 }, [120, 80]);
    let trainer = ReferenceOptions::inria();
    let affine = ReferenceOptions { reach: Reach::Rule(RadiusRule::Full), ..trainer.clone() };
    let (a, b) = (render(&splats, &view, &trainer).unwrap(), render(&splats, &view, &affine).unwrap());
    assert!(difference(&a, &b) < 0.02, "{}", difference(&a, &b));
    assert!(a.tile_pairs != b.tile_pairs);
    // Near plane: depth for affine.
    let close = one(DVec3::new(0.0, 0.0, 0.19), DQuat::IDENTITY, DVec3::splat(0.01), 1.0);
    assert_eq!(render(&close, &view, &trainer).unwrap().visible, 0);
    let beyond = one(DVec3::new(0.0, 0.0, 0.21), DQuat::IDENTITY, DVec3::splat(0.01), 1.0);
    assert_eq!(render(&beyond, &view, &trainer).unwrap().visible, 1);
}

#[test]
fn near_plane_fades_by_distance() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [9, 9]);
    let alpha = |z: f64| {
        let splats = one(DVec3::new(0.0, 0.0, z), DQuat::IDENTITY, DVec3::splat(1.0), 0.8);
        let options = ReferenceOptions { near: 0.5, near_fade: 0.5, ..ReferenceOptions::default() };
        1.0 - render(&splats, &view, &options).unwrap().pixel(4, 4).transmittance
    };
    assert_eq!(alpha(0.45), 0.0);
    assert!((alpha(0.75) - 0.4).abs() < 1e-6);
    assert!((alpha(1.25) - 0.8).abs() < 1e-6);
}

#[test]
fn moving_splats_are_drawn_where_they_are_at_the_time() {
    let view = straight(Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 }, [64, 64]);
    let mut moving = one(DVec3::new(0.0, 0.0, 2.0), DQuat::IDENTITY, DVec3::new(0.05, 0.02, 0.02), 0.9);
    moving.motion = Some(Motion {
        centers: vec![0.5],
        widths: vec![0.4],
        polynomials: vec![[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -3.0]]],
        omegas: vec![[0.0, 0.0, 1.5, 0.0]],
    });
    let (t, dt) = (0.75, 0.25f64);
    let still = one(
        DVec3::new(dt, 2.0 * dt * dt, 2.0 - 3.0 * dt.powi(3)),
        DQuat::from_xyzw(0.0, 0.0, 1.5 * dt, 1.0),
        DVec3::new(0.05, 0.02, 0.02),
        f64::from(moving.opacities[0]) * (-(dt / f64::from(0.4f32)).powi(2)).exp(),
    );
    let options = ReferenceOptions { time: t, ..ReferenceOptions::default() };
    let expected = render(&still, &view, &options).unwrap();
    assert!(difference(&render(&moving, &view, &options).unwrap(), &expected) < 1e-5);
    let before = ReferenceOptions { time: 0.5, ..options.clone() };
    assert!(difference(&render(&moving, &view, &before).unwrap(), &expected) > 0.1);
    // Faded below 1/255 it is not there at all.
    let late = ReferenceOptions { time: 2.0, ..options };
    assert_eq!(render(&moving, &view, &late).unwrap().visible, 0);
}

/// Values at and beyond the edge: nothing panics, and every pixel is a number.
#[test]
fn extreme_splats_give_finite_pictures() {
    let mut splats = surrounding(21, 40);
    let extremes = [
        ([0.0f32; 3], [-60.0f32; 3], 1.0f32),
        ([0.0, 0.0, 1.0], [-100.0, -100.0, 3.0], 1.0),
        ([0.0, 0.0, 1e-30], [0.0, 0.0, 0.0], 1.0),
        ([0.0, 0.0, 2.0], [88.0, -100.0, 88.0], 1.0),
        ([1e30, -1e30, 1e30], [60.0; 3], 0.9),
        ([f32::NAN, 0.0, 1.0], [0.0; 3], 0.9),
        ([0.0, 0.0, 3.0], [f32::INFINITY, 0.0, f32::NEG_INFINITY], 0.9),
        ([0.0, 0.0, 3.0], [f32::NEG_INFINITY, 0.0, 0.0], 0.9),
        ([0.0, 0.0, 3.0], [0.0; 3], f32::NAN),
        ([1.0, 0.0, 0.0], [0.0; 3], 1.0),
        ([0.5, 0.5, -0.0], [-2.0; 3], 1.0),
    ];
    for (mean, log_scale, opacity) in extremes {
        splats.means.push(mean);
        splats.log_scales.push(log_scale);
        splats.rotations.push([0.5; 4]);
        splats.opacities.push(opacity);
        splats.sh.push([1e3, -1e3, 0.0]);
    }
    for size in [[1, 1], [17, 33]] {
        let view = straight(Fov { left: -10.0, right: 8.0, up: -9.0, down: 7.0 }, size);
        for &projection in Projection::ALL {
            for &low_pass in LowPass::ALL {
                let image = render(&splats, &view, &truth(projection, low_pass)).unwrap();
                for pixel in &image.pixels {
                    assert!(
                        pixel.colour.iter().all(|c| c.is_finite() && *c >= 0.0),
                        "{projection} {low_pass}"
                    );
                    assert!((0.0..=1.0).contains(&pixel.transmittance));
                }
            }
        }
    }
}

#[test]
fn refuses_what_makes_no_picture() {
    let splats = one(DVec3::Z, DQuat::IDENTITY, DVec3::ONE, 1.0);
    let view = off_axis();
    let good = ReferenceOptions::default();
    assert!(render(&splats, &view, &good).is_ok());
    let bad_views = [
        View { size: [0, 4], ..view },
        View { size: [1 << 20, 1 << 20], ..view },
        View { eye: DVec3::new(f64::NAN, 0.0, 0.0), ..view },
        View { fov: Fov { left: 1.0, right: -1.0, ..view.fov }, ..view },
        View { fov: Fov { up: f64::INFINITY, ..view.fov }, ..view },
        View { rotation: DMat3::from_diagonal(DVec3::new(1.0, 2.0, 1.0)), ..view },
        View { rotation: DMat3::from_diagonal(DVec3::splat(f64::NAN)), ..view },
    ];
    for bad in bad_views {
        assert!(matches!(render(&splats, &bad, &good), Err(ReferenceError::View { .. })), "{bad:?}");
    }
    let bad_options = [
        ReferenceOptions { near: -1.0, ..good.clone() },
        ReferenceOptions { stop_below: f64::NAN, ..good.clone() },
        ReferenceOptions { time: f64::INFINITY, ..good.clone() },
        ReferenceOptions { reach: Reach::TrainerTiles, ..good.clone() },
        ReferenceOptions { order: ReferenceOrder::AlongRay, projection: Projection::Tangent, ..good.clone() },
    ];
    for bad in bad_options {
        assert!(matches!(render(&splats, &view, &bad), Err(ReferenceError::Options { .. })), "{bad:?}");
    }
    let short = Splats { opacities: vec![], ..splats.clone() };
    let error = render(&short, &view, &good).unwrap_err();
    assert_eq!(error.to_string(), "the scene has 1 means but 0 opacities (1 expected)");
}

#[test]
fn the_trainers_options_are_the_configurations() {
    let options = ReferenceOptions::of_config(&RenderConfig::inria());
    let inria = ReferenceOptions::inria();
    assert_eq!(options.projection, inria.projection);
    assert_eq!(options.order, inria.order);
    assert!((options.near - inria.near).abs() < 1e-6 && options.near_fade == 0.0);
    assert_eq!(options.reach, Reach::TrainerTiles);
}
