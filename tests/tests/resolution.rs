//! Reduced resolution: samples lie where they should, reconstruction beats bilinear, history leaves no ghosts.
#![allow(clippy::unwrap_used, reason = "a test may")]

use glam::DVec3;
use motes_desktop::measure::{Picture as Measured, Settings, compare};
use motes_renderer::resolution::Resolution;
use motes_renderer::{
    Axis, Composite, Expansion, Fov, Offscreen, Packing, Picture, Precision, Projection, QuadShape,
    RadiusRule, RenderConfig, SceneOnDevice, ShPrecision, Stereo, TargetFormat, Upscale, View,
};
use motes_scenes::Splats;
use motes_scenes::synthetic::Recipe;
use motes_tests::{TestGpu, psnr};

const PLAIN: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };
const SIZE: [u32; 2] = [97, 80];

/// Small and large splats, so that pixels differ from their neighbours.
fn scene() -> Splats {
    Recipe { count: 900, seed: 5, ..Default::default() }.still()
}

fn eye(x: f64) -> View {
    let fov = Fov { left: -1.0, right: 0.8, up: -0.7, down: 0.8 };
    View::look_at(DVec3::new(x, 0.2, -2.2), DVec3::new(x, 0.0, 0.0), DVec3::NEG_Y, fov, SIZE)
}

fn reduced(scale: f32, upscale: Upscale) -> RenderConfig {
    RenderConfig { resolution_scale: scale, upscale, ..Default::default() }
}

fn colours(picture: &Picture) -> Vec<[u8; 3]> {
    picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect()
}

fn flip(truth: &Picture, picture: &Picture) -> f64 {
    let measured = |p: &Picture| {
        Measured::from_rgb8(p.size, &colours(p).into_iter().flatten().collect::<Vec<_>>()).unwrap()
    };
    compare(&measured(truth), &measured(picture), &Settings::default()).unwrap().flip.mean
}

fn largest_difference(a: [u8; 4], b: [u8; 4]) -> u8 {
    a.iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap()
}

/// Shown pixels that a frame samples: index in the picture, and the index that the opposite offset would sample.
fn sampled(r: &Resolution) -> Vec<(usize, usize)> {
    let [width, height] = r.shown;
    let mut places = Vec::new();
    for row in 0..height {
        for cell in 0..r.rendered[0] {
            let (x, begin, end) = (r.sample_column(cell, row), r.cell_begin(cell), r.cell_begin(cell + 1));
            let mirrored = begin + end - 1 - x;
            if x < width && mirrored < width {
                let at = |x| (row * width + x) as usize;
                places.push((at(x), at(mirrored)));
            }
        }
    }
    places
}

#[test]
fn samples_are_pixels_of_full_resolution() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let views = [eye(0.0)];
    let mut check = |config: RenderConfig| {
        // Cut where no splat is seen any more: a grown polygon would show more of a rim that is cut at √8.
        let config = RenderConfig { radius: RadiusRule::Full, ..config };
        let name = format!(
            "{} {} {} {}",
            config.projection, config.shape, config.expansion, config.resolution_scale
        );
        let (mut full, _) = offscreen
            .render(&on_device, &views, &RenderConfig { resolution_scale: 1.0, ..config.clone() })
            .unwrap();
        let (mut picture, report) = offscreen.render(&on_device, &views, &config).unwrap();
        let (full, picture) = (full.remove(0), picture.remove(0));
        let r = Resolution::of(&config, SIZE, 0);
        assert_eq!(report.pixels, u64::from(r.rendered[0]) * u64::from(r.rendered[1]));
        let places = sampled(&r);
        let worst = |wrong: bool| {
            places
                .iter()
                .map(|&(at, mirrored)| {
                    largest_difference(picture.pixels[at], full.pixels[if wrong { mirrored } else { at }])
                })
                .max()
                .unwrap()
        };
        println!("{name}: at most {} / 255 off", worst(false));
        assert!(worst(false) <= 2, "{name}: {} / 255", worst(false));
        assert!(worst(true) > 40, "{name}: offsets of the wrong sign must not pass");
    };
    for &projection in Projection::ALL {
        for &shape in QuadShape::ALL {
            // A diamond cuts its splats' rims, and grown ones cut less.
            if shape != QuadShape::Diamond {
                let composite = Composite::FrontToBack;
                check(RenderConfig { projection, shape, composite, ..reduced(0.707, Upscale::Interleaved) });
            }
        }
    }
    for scale in [0.5, 0.6, 0.9] {
        let composite = Composite::FrontToBack;
        check(RenderConfig { composite, ..reduced(scale, Upscale::Interleaved) });
    }
    for expansion in [Expansion::Instanced, Expansion::Geometry] {
        let composite = Composite::BackToFront;
        check(RenderConfig { expansion, composite, ..reduced(0.707, Upscale::Interleaved) });
    }
}

#[test]
fn interleaved_beats_bilinear_and_offsets_of_the_wrong_sign_lose() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut render =
        |config: &RenderConfig| offscreen.render(&on_device, &[eye(0.0)], config).unwrap().0.remove(0);
    let full = render(&RenderConfig::default());
    for scale in [0.5, 0.6, 0.7, 0.85] {
        let bilinear = flip(&full, &render(&reduced(scale, Upscale::Bilinear)));
        let config = reduced(scale, Upscale::Interleaved);
        let picture = render(&config);
        let interleaved = flip(&full, &picture);
        println!("{scale}: FLIP {interleaved:.4} interleaved, {bilinear:.4} bilinear");
        assert!(interleaved < bilinear, "{scale}: {interleaved} against {bilinear}");
        if scale == 0.7 {
            let mut swapped = picture.clone();
            for (at, mirrored) in sampled(&Resolution::of(&config, SIZE, 0)) {
                swapped.pixels.swap(at, mirrored);
            }
            let wrong = flip(&full, &swapped);
            assert!(wrong > 1.6 * interleaved, "control: {wrong} against {interleaved}");
        }
    }
}

/// What a checkerboard's samples say of the pixels between them, from a picture that has all of them: along the row and along
/// the column, each trusted the more the less it changes (`upscale.frag`). `turned`: the less, of the other direction.
fn filled(full: &Picture, r: &Resolution, turned: bool) -> Vec<(usize, [f64; 3])> {
    let [width, height] = r.shown.map(|s| s as i64);
    let at = |x: i64, y: i64| (y * width + x) as usize;
    let colour = |x, y| full.pixels[at(x, y)].map(|c| f64::from(c) / 255.0);
    let apart = |a: [f64; 4], b: [f64; 4]| (0..4).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>() + 6e-5;
    let mut between = Vec::new();
    for y in 0..height {
        for x in 1..width - 1 {
            if i64::from(r.sample_column(x as u32 / 2, y as u32)) == x {
                continue;
            }
            let row = [colour(x - 1, y), colour(x + 1, y)];
            // Beyond the first and the last row lies what is on their other side.
            let column = [if y == 0 { 1 } else { y - 1 }, if y + 1 == height { y - 1 } else { y + 1 }]
                .map(|y| colour(x, y));
            let mut weights = [apart(column[0], column[1]), apart(row[0], row[1])];
            if turned {
                weights.swap(0, 1);
            }
            let sum = weights[0] + weights[1];
            between.push((
                at(x, y),
                [0, 1, 2].map(|i| {
                    let mean = |pair: [[f64; 4]; 2]| 127.5 * (pair[0][i] + pair[1][i]);
                    (weights[0] * mean(row) + weights[1] * mean(column)) / sum
                }),
            ));
        }
    }
    between
}

#[test]
fn a_checkerboard_is_filled_from_the_four_samples_beside_each_pixel() {
    let gpu = TestGpu::new();
    let mut splats = scene();
    // Before a wall, so that the picture shows all there is: opacities count too.
    for i in 0..3 {
        splats.means[i] = [0.0, 0.0, 3.0];
        splats.log_scales[i] = [3.0; 3];
        splats.opacities[i] = 0.99;
    }
    let on_device = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let mut render = |config: &RenderConfig| {
        let config =
            RenderConfig { radius: RadiusRule::Full, target: TargetFormat::Rgba32F, ..config.clone() };
        offscreen.render(&on_device, &[eye(0.0)], &config).unwrap().0.remove(0)
    };
    let every = RenderConfig { composite: Composite::FrontToBack, ..Default::default() };
    let full = render(&every);
    let config = RenderConfig { resolution_scale: 0.7072, upscale: Upscale::Interleaved, ..every };
    let picture = render(&config);
    let r = Resolution::of(&config, SIZE, 0);
    let mean = |turned: bool| {
        let places = filled(&full, &r, turned);
        let off = |&(at, expected): &(usize, [f64; 3])| {
            (0..3).map(|i| (f64::from(picture.pixels[at][i]) - expected[i]).abs()).fold(0.0, f64::max)
        };
        let [sum, most] = places.iter().map(off).fold([0.0, 0.0f64], |[sum, most], d| [sum + d, most.max(d)]);
        [sum / places.len() as f64, most]
    };
    let ([off, most], [turned, _]) = (mean(false), mean(true));
    println!("{off:.3} of 255 off, at most {most:.2}; with the weights exchanged {turned:.3}");
    // The samples of a picture of eight bits are half a step off, and so are the weights that they make.
    assert!(off < 0.6 && most < 4.0, "{off} {most}");
    assert!(turned > 2.0, "{turned}");
}

/// Bilinear is a picture of the rendered size, with that size's low-pass filter, enlarged.
#[test]
fn bilinear_enlarges_the_picture_of_the_rendered_size() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let view = View { size: [96, 80], ..eye(0.0) };
    let small_view = View { size: [48, 40], ..view };
    let small = offscreen.render(&on_device, &[small_view], &RenderConfig::default()).unwrap().0.remove(0);
    let picture =
        offscreen.render(&on_device, &[view], &reduced(0.5, Upscale::Bilinear)).unwrap().0.remove(0);
    let texel = |x: i32, y: i32| small.pixels[(y.clamp(0, 39) * 48 + x.clamp(0, 47)) as usize].map(f64::from);
    let enlarged = |smooth: bool| -> Vec<[u8; 3]> {
        (0..80 * 96)
            .map(|i| {
                let (x, y) = (f64::from(i % 96) / 2.0 - 0.25, f64::from(i / 96) / 2.0 - 0.25);
                let (x0, y0) = (x.floor() as i32, y.floor() as i32);
                let (fx, fy) = if smooth { (x - x.floor(), y - y.floor()) } else { (0.0, 0.0) };
                [0, 1, 2].map(|c| {
                    let row = |y| texel(x0, y)[c] * (1.0 - fx) + texel(x0 + 1, y)[c] * fx;
                    (row(y0) * (1.0 - fy) + row(y0 + 1) * fy).round() as u8
                })
            })
            .collect()
    };
    let db = psnr(&colours(&picture), &enlarged(true));
    assert!(db > 48.0, "{db:.1} dB");
    let control = psnr(&colours(&picture), &enlarged(false));
    assert!(control < 40.0, "the nearest pixel must not pass: {control:.1} dB");
}

#[test]
fn eight_frames_of_a_still_eye_are_full_resolution_and_motion_leaves_no_ghost() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for scale in [0.5, 0.7, 0.8] {
        let config = reduced(scale, Upscale::InterleavedTemporal);
        let whole = RenderConfig::default();
        let mut render = |view: View, config: &RenderConfig| {
            offscreen.render(&on_device, &[view], config).unwrap().0.remove(0)
        };
        let full = render(eye(0.0), &whole);
        let single =
            psnr(&colours(&render(eye(0.0), &reduced(scale, Upscale::Interleaved))), &colours(&full));
        let still = (0..8).map(|_| render(eye(0.0), &config)).last().unwrap();
        let db = psnr(&colours(&still), &colours(&full));
        println!("{scale}: {db:.1} dB still, {single:.1} dB from one frame");
        assert!(db >= 46.0 && single < 38.0, "{scale}: {db:.1} dB, one frame {single:.1} dB");

        // The eye jumps: the picture of before is wrong everywhere.
        let moved = render(eye(0.35), &config);
        let full = render(eye(0.35), &whole);
        let single =
            psnr(&colours(&render(eye(0.35), &reduced(scale, Upscale::Interleaved))), &colours(&full));
        let db = psnr(&colours(&moved), &colours(&full));
        println!("{scale}: {db:.1} dB after a jump, {single:.1} dB from one frame");
        assert!(db >= single - 0.5, "{scale}: {db:.1} dB after a jump, one frame {single:.1} dB");
        let ghost = psnr(&colours(&still), &colours(&full));
        assert!(ghost < single - 3.0, "control: the frame before must be worse: {ghost:.1} dB");
    }
}

/// What a window goes by to draw a view that stays until its picture is finished, and no longer.
#[test]
fn a_still_picture_is_finished_when_it_says_so() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for (scale, upscale, frames) in [
        (0.5, Upscale::InterleavedTemporal, 8),
        (0.7, Upscale::InterleavedTemporal, 8),
        (0.5, Upscale::Interleaved, 1),
        (1.0, Upscale::InterleavedTemporal, 1),
    ] {
        let config = reduced(scale, upscale);
        offscreen.renderer().forget_history();
        let mut shown: Vec<Picture> = Vec::new();
        let mut finished = None;
        for frame in 1..=12 {
            shown.push(offscreen.render(&on_device, &[eye(0.0)], &config).unwrap().0.remove(0));
            if offscreen.renderer().lacks() == 0 {
                finished.get_or_insert(frame);
            }
        }
        assert_eq!(finished, Some(frames), "{scale}, {upscale}");
        // Where the last change came.
        let changed = (1..12).rfind(|i| shown[*i].pixels != shown[i - 1].pixels).map_or(1, |i| i + 1);
        println!("{scale}, {upscale}: {changed} of {frames} frames");
        assert!(changed <= frames, "{scale}, {upscale}: frame {changed} differs from the one before");
        // Control: a picture that is made from several frames is not finished by the first.
        assert_eq!(changed > 1, frames > 1, "{scale}, {upscale}: {changed} frames");
        // And what moves begins anew.
        offscreen.render(&on_device, &[eye(0.1)], &config).unwrap();
        assert_eq!(offscreen.renderer().lacks() as usize, frames - 1, "{scale}, {upscale}");
    }
}

/// The bound of ghosting: nothing is shown beyond the range of this frame's own samples next to it.
#[test]
fn what_has_moved_away_stays_within_the_samples_beside_it() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let config = reduced(0.7, Upscale::InterleavedTemporal);
    let mut render = |x| offscreen.render(&on_device, &[eye(x)], &config).unwrap().0.remove(0);
    let before = (0..8).map(|_| render(0.0)).last().unwrap();
    let after = render(0.4);
    let [w, h] = SIZE.map(|s| s as usize);
    let violations = |shown: &Picture| {
        let mut count = 0;
        for y in 1..h - 1 {
            // Eight frames before: the ninth has the checkerboard of the first.
            for x in (1..w - 2).filter(|x| (x + y) % 2 == 1) {
                let at = y * w + x;
                for c in 0..3 {
                    let beside = [at - 1, at + 1, at - w, at + w].map(|i| after.pixels[i][c]);
                    let (low, high) = (beside.iter().min().unwrap(), beside.iter().max().unwrap());
                    let v = shown.pixels[at][c];
                    count += usize::from(v + 1 < *low || v > high.saturating_add(1));
                }
            }
        }
        count
    };
    assert_eq!(violations(&after), 0);
    assert!(violations(&before) > 1000, "control: the frame before lies outside: {}", violations(&before));
}

/// A turn of the head is followed exactly, so history helps while it lasts.
#[test]
fn turning_the_head_keeps_history_useful() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let turned = |i: u32| {
        let view = eye(0.0);
        View { rotation: glam::DMat3::from_rotation_y(0.004 * f64::from(i)) * view.rotation, ..view }
    };
    let config = reduced(0.5, Upscale::InterleavedTemporal);
    let mut render = |i, config: &RenderConfig| {
        colours(&offscreen.render(&on_device, &[turned(i)], config).unwrap().0.remove(0))
    };
    let last = (0..8).map(|i| render(i, &config)).last().unwrap();
    let full = render(7, &RenderConfig::default());
    let db = psnr(&last, &full);
    let single = psnr(&render(7, &reduced(0.5, Upscale::Interleaved)), &full);
    println!("{db:.1} dB while turning, {single:.1} dB from one frame");
    assert!(db > single + 0.5, "{db:.1} dB while turning, one frame {single:.1} dB");
}

#[test]
fn stereo_early_stop_and_every_format_work_at_every_resolution() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let eyes = [eye(-0.032), eye(0.032)];
    for &upscale in Upscale::ALL {
        for composite in [Composite::EarlyStop, Composite::FrontToBack] {
            let config = RenderConfig { composite, ..reduced(0.7, upscale) };
            let mut frames = |stereo| {
                offscreen.set_stereo(stereo);
                // From the start of the cycle, without a past.
                offscreen.renderer().forget_history();
                (0..3).map(|_| offscreen.render(&on_device, &eyes, &config).unwrap().0).last().unwrap()
            };
            let (one, two) = (frames(Stereo::Multiview), frames(Stereo::TwoPass));
            assert_eq!(one, two, "{upscale} {composite}");
            assert_ne!(one[0], one[1], "both eyes must not see the same");
        }
    }
    for &target in TargetFormat::ALL {
        let at = |scale| RenderConfig {
            target,
            composite: Composite::BackToFront,
            ..reduced(scale, Upscale::Interleaved)
        };
        let mut render =
            |config: &RenderConfig| offscreen.render(&on_device, &eyes[..1], config).unwrap().0.remove(0);
        let (full, picture) = (render(&at(1.0)), render(&at(0.7)));
        let db = psnr(&colours(&picture), &colours(&full));
        println!("{target}: {db:.1} dB at 70 %");
        assert!(db > 30.0, "{target}: {db:.1} dB at 70 %");
    }
}

#[test]
fn sharpening_steepens_edges_within_the_range_beside_them() {
    let gpu = TestGpu::new();
    let on_device = SceneOnDevice::new(&gpu, &scene(), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    for (scale, upscale) in [(1.0, Upscale::Bilinear), (0.7, Upscale::Bilinear), (0.7, Upscale::Interleaved)]
    {
        let mut at = |sharpen| {
            let config = RenderConfig { sharpen, ..reduced(scale, upscale) };
            offscreen.render(&on_device, &[eye(0.0)], &config).unwrap().0.remove(0)
        };
        let (plain, sharp) = (at(0.0), at(0.6));
        let [w, h] = SIZE.map(|s| s as usize);
        let (mut steep, mut steeper) = (0u64, 0u64);
        for y in 1..h - 1 {
            for x in 1..w - 1 {
                let i = y * w + x;
                for c in 0..3 {
                    let near = [i, i - 1, i + 1, i - w, i + w].map(|i| plain.pixels[i][c]);
                    let (low, high) = (near.iter().min().unwrap(), near.iter().max().unwrap());
                    let v = sharp.pixels[i][c];
                    assert!(v.saturating_add(1) >= *low && v <= high.saturating_add(1), "({x}, {y})");
                    steep += u64::from(plain.pixels[i][c].abs_diff(plain.pixels[i + 1][c]));
                    steeper += u64::from(sharp.pixels[i][c].abs_diff(sharp.pixels[i + 1][c]));
                }
            }
        }
        assert!(steeper * 100 > steep * 104, "{scale} {upscale}: {steep} to {steeper}");
    }
}
