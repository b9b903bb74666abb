//! Head and hands driven from outside, through the whole stack: packets to Monado, OpenXR, the viewer, pixels.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test may")]

#[path = "../../desktop/tests/common/display.rs"]
mod display;

use glam::{DAffine3, DQuat, DVec3};
use motes_app::headset::{Comfort, EyeFov, HandInput, Placement};
use motes_app::opened::Opened;
use motes_renderer::gpu::Gpu;
use motes_renderer::{
    Offscreen, Packing, Picture, Precision, RenderConfig, SceneOnDevice, ShPrecision, View,
};
use motes_scenes::synthetic::{Random, Recipe};
use motes_scenes::{LoadOptions, Splats};
use motes_tests::monado::{
    Compositor, Inside, Monado, Source, free_port, inside, log_to_stderr, with_monado,
};
use motes_tests::remote::{Remote, RemoteControl, RemotePose};
use motes_tests::sample;
use motes_xr::{
    Content, FirstView, Headset, Runtime, RuntimeHeadset, RuntimeOptions, SessionOptions, SessionState,
    Viewer,
};
use std::path::Path;
use std::sync::Arc;

const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 1 };

/// A session under remote control, showing something.
struct Session {
    // In this order they go: the viewer before its headset.
    viewer: Viewer,
    headset: RuntimeHeadset,
    remote: RemoteControl,
}

impl Session {
    fn new(content: impl FnOnce(&Arc<Gpu>) -> Content, read_back: bool) -> Self {
        let options = SessionOptions { resolution_scale: 0.5, whole_images: true, ..Default::default() };
        Self::open(content, read_back, &options)
    }

    fn open(content: impl FnOnce(&Arc<Gpu>) -> Content, read_back: bool, options: &SessionOptions) -> Self {
        let remote = RemoteControl::connect();
        let runtime =
            Runtime::new(&(), RuntimeOptions { validation: true, readable: true, ..Default::default() })
                .unwrap();
        let headset = RuntimeHeadset::new(runtime, options).unwrap();
        let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
        viewer.read_back(&headset, read_back).unwrap();
        viewer.show(content(headset.gpu())).unwrap();
        let mut session = Self { viewer, headset, remote };
        session.until("focused", |s| s.headset.state() == SessionState::Focused && s.viewer.frames() > 0);
        session
    }

    fn step(&mut self) {
        assert_eq!(self.viewer.step(&mut self.headset).unwrap(), None, "the session ended");
    }

    fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        for _ in 0..400 {
            self.step();
            if done(self) {
                return;
            }
        }
        panic!("never {what}: {:?}", self.viewer.last_frame());
    }

    /// Sends, and steps until the frame shows the head as sent, in an order made for it.
    fn show(&mut self, remote: &Remote) {
        self.remote.send(remote);
        let wanted = *remote;
        self.until("the head is where it was sent to", |s| {
            s.viewer.last_frame().is_some_and(|f| {
                f.used == f.wanted
                    && (0..2).all(|i| {
                        let (eye, fov) = (&f.eyes[i], wanted.fovs[i]);
                        let (rotation, place) = sent(&wanted, i);
                        eye.fov == EyeFov { left: fov[0], right: fov[1], up: fov[2], down: fov[3] }
                            && (eye.pose.place() - place).length() < 1e-5
                            && eye.pose.rotation().angle_between(rotation) < 1e-3
                    })
            })
        });
    }

    fn end(mut self) {
        self.headset.request_exit().unwrap();
        while self.viewer.step(&mut self.headset).unwrap().is_none() {}
        drop(self.viewer);
        let said = self.headset.runtime().messages();
        assert!(said.is_empty(), "OpenXR's core validation complains: {said:#?}");
        let said = self.headset.gpu().messages();
        assert!(said.is_empty(), "Vulkan's validation complains: {said:#?}");
    }
}

/// Where an eye is, computed from what was sent.
fn sent(remote: &Remote, eye: usize) -> (DQuat, DVec3) {
    let pose = |p: &RemotePose| {
        (DQuat::from_array(p.0.map(f64::from)).normalize(), DVec3::from_array(p.1.map(f64::from)))
    };
    let ((turn, place), (eye_turn, eye_place)) = (pose(&remote.head), pose(&remote.eyes[eye]));
    (turn * eye_turn, place + turn * eye_place)
}

/// The view of an eye, computed from what was sent and where the stage stands: independent of what the session says.
fn view(remote: &Remote, eye: usize, placement: &Placement, to_world: &DAffine3, size: [u32; 2]) -> View {
    let (rotation, place) = sent(remote, eye);
    let [left, right, up, down] = remote.fovs[eye].map(|a| f64::from(a).tan());
    let world_to_scene = to_world.inverse();
    let place = world_to_scene.transform_point3(placement.to_world(place));
    let turn =
        DQuat::from_mat3(&(world_to_scene.matrix3 * world_to_scene.matrix3.determinant().cbrt().recip()));
    let fov = motes_renderer::Fov { left, right, up: -up, down: -down };
    View::from_gl_pose(turn * placement.turn() * rotation, place, fov, size)
}

/// The largest difference of two pictures' colours, in steps of 255.
fn worst(a: &Picture, b: &Picture) -> u8 {
    assert_eq!(a.size, b.size);
    let steps = a.pixels.iter().zip(&b.pixels).flat_map(|(a, b)| (0..3).map(|i| a[i].abs_diff(b[i])));
    steps.max().unwrap()
}

#[test]
fn twenty_poses_are_seen_as_offscreen() {
    with_monado("twenty_poses_are_seen_as_offscreen", Source::Remote(free_port()), || {
        let path = sample("static/fruit_drops_minimal.ply");
        let opened = Opened::load(&[path], &LoadOptions::default()).unwrap();
        let to_world = opened.settings.scene_to_world();
        let mut session = Session::new(|gpu| Content::new(gpu, &opened, PACKING).unwrap(), true);
        let gpu = session.headset.gpu().clone();
        let scene = SceneOnDevice::new(&gpu, &opened.scene.splats, PACKING).unwrap();
        let mut offscreen = Offscreen::new(&gpu).unwrap();
        let size = session.headset.images().size;
        let placement = *session.viewer.placement().unwrap();
        let units = placement.scene_units(&to_world) as f32;
        let mut config = RenderConfig::default();
        config.near *= units;
        config.near_fade *= units;
        let mut random = Random::new(20);
        let mut before: Option<[Picture; 2]> = None;
        let mut largest = 0;
        for n in 0..20 {
            // Looks around and moves by up to 0.1 m; each eye has a field of view of its own.
            let mut any = |low, high| random.uniform(low, high);
            let turn = DQuat::from_euler(
                glam::EulerRot::YXZ,
                f64::from(any(-0.4, 0.4)),
                f64::from(any(-0.3, 0.3)),
                f64::from(any(-0.3, 0.3)),
            );
            let place = [any(-0.1, 0.1), 1.6 + any(-0.1, 0.1), any(-0.1, 0.1)];
            let mut fov = || [any(-1.0, -0.6), any(0.6, 1.0), any(0.6, 1.0), any(-1.0, -0.6)];
            let fovs = [fov(), fov()];
            let head = RemotePose(turn.to_array().map(|v| v as f32), place);
            let remote = Remote { head, fovs, ..Default::default() };
            session.show(&remote);
            let seen = session.viewer.pictures().unwrap();
            let views = [0, 1].map(|eye| view(&remote, eye, &placement, &to_world, size));
            let (expected, _) = offscreen.render(&scene, &views, &config).unwrap();
            let off = [worst(&seen[0], &expected[0]), worst(&seen[1], &expected[1])];
            println!("pose {n}: {off:?} of 255");
            largest = largest.max(off[0]).max(off[1]);
            assert!(off.iter().all(|o| *o <= 1), "pose {n}: {off:?}");
            // Controls: neither the other eye's picture nor the last pose's would pass.
            assert!(worst(&seen[0], &expected[1]) > 20);
            if let Some(before) = before.replace(seen) {
                assert!(worst(&before[0], &expected[0]) > 20, "the turned head dragged the picture along");
            }
        }
        println!("largest difference: {largest} of 255");
        assert_eq!(*session.viewer.placement().unwrap(), placement, "a moving head moves no world");
        drop((offscreen, scene));
        session.end();
    });
}

#[test]
fn what_the_lenses_hide_is_not_drawn() {
    with_monado("what_the_lenses_hide_is_not_drawn", Source::Remote(free_port()), || {
        // All around the head.
        let around =
            Recipe { count: 3000, bounds: 3.0, log_scales: [-2.5, -1.0], ..Recipe::default() }.still();
        let content = |gpu: &Arc<Gpu>| Content {
            scene: Arc::new(SceneOnDevice::new(gpu, &around, PACKING).unwrap()),
            detail: None,
            ..hanging(gpu, DVec3::ZERO)
        };
        let options = SessionOptions { resolution_scale: 0.5, ..Default::default() };
        let mut session = Session::open(content, true, &options);
        assert!(session.headset.runtime().optional().visibility_mask, "Monado offers a mask");
        let background = [1.0, 0.0, 1.0];
        session.viewer.config.background = background;
        let remote = Remote::default();
        session.show(&remote);
        session.step();
        let (seen, fragments) = (session.viewer.pictures().unwrap(), session.viewer.report().fragments);
        let gpu = session.headset.gpu().clone();
        let scene = SceneOnDevice::new(&gpu, &around, PACKING).unwrap();
        let mut offscreen = Offscreen::new(&gpu).unwrap();
        let last = *session.viewer.last_frame().unwrap();
        let config = RenderConfig { background, ..RenderConfig::default() };
        let (whole, report) = offscreen.render(&scene, &last.views, &config).unwrap();
        let [width, height] = session.headset.images().size;
        for (eye, (seen, whole)) in seen.iter().zip(&whole).enumerate() {
            let mut hidden = 0;
            for (i, (a, b)) in seen.pixels.iter().zip(&whole.pixels).enumerate() {
                if (0..3).all(|k| a[k].abs_diff(b[k]) <= 1) {
                    continue;
                }
                assert_eq!(a[..3], [255, 0, 255], "eye {eye}, pixel {i}: {a:?} for {b:?}");
                hidden += 1;
                let [x, y] = [i as u32 % width, i as u32 / width].map(f64::from);
                let out = (2.0 * x / f64::from(width) - 1.0).hypot(2.0 * y / f64::from(height) - 1.0);
                assert!(out > 0.6, "eye {eye}: hidden in the middle, at {x} {y}");
            }
            let share = f64::from(hidden) / f64::from(width * height);
            println!("eye {eye}: {:.1} % of the image is hidden", 100.0 * share);
            assert!(share > 0.005 && share < 0.4, "{share}");
        }
        println!("{fragments} fragments, {} without the mask", report.fragments);
        assert!(fragments < report.fragments);
        drop((offscreen, scene));
        session.end();
    });
}

/// One bright ball of 1 cm in an empty scene (y up, metres).
fn ball(at: DVec3) -> Splats {
    let mut splats = Splats::zeroed(1, 0, false);
    splats.means[0] = at.as_vec3().to_array();
    splats.log_scales[0] = [(0.01f32).ln(); 3];
    splats.rotations[0] = [0.0, 0.0, 0.0, 1.0];
    splats.opacities[0] = 1.0;
    splats.sh[0] = [1.7; 3];
    splats
}

/// A ball hanging in the world, which is the stage.
fn hanging(gpu: &Arc<Gpu>, at: DVec3) -> Content {
    Content {
        scene: Arc::new(SceneOnDevice::new(gpu, &ball(at), PACKING).unwrap()),
        detail: None,
        sequence: None,
        scene_to_world: DAffine3::IDENTITY,
        first_view: FirstView { place: DVec3::new(0.0, 1.6, 0.0), forward: DVec3::NEG_Z, floor_known: true },
        about: None,
    }
}

/// The middle of what shines in a picture, pixels.
fn middle(picture: &Picture) -> [f64; 2] {
    let mut sums = [0.0; 3];
    for (i, pixel) in picture.pixels.iter().enumerate() {
        let (x, y) = (i as u32 % picture.size[0], i as u32 / picture.size[0]);
        let light = f64::from(pixel[1]);
        sums[0] += light * (f64::from(x) + 0.5);
        sums[1] += light * (f64::from(y) + 0.5);
        sums[2] += light;
    }
    assert!(sums[2] > 0.0, "nothing shines");
    [sums[0] / sums[2], sums[1] / sums[2]]
}

#[test]
fn a_known_object_has_the_right_disparity() {
    with_monado("a_known_object_has_the_right_disparity", Source::Remote(free_port()), || {
        // The world is the stage: the ball hangs 1.2 m ahead of the eyes and a little to the right.
        let ahead = 1.2;
        let mut session = Session::new(|gpu| hanging(gpu, DVec3::new(0.1, 1.7, -ahead)), true);
        let size = session.headset.images().size.map(f64::from);
        let mut check = |remote: &Remote, what: &str| {
            session.show(remote);
            let seen = session.viewer.pictures().unwrap();
            let found = [middle(&seen[0]), middle(&seen[1])];
            // Eyes look straight ahead, 64 mm apart: x = f · X / z from each principal point.
            let expected = [0, 1].map(|i| {
                let [left, right, up, down] = remote.fovs[i].map(|a| f64::from(a).tan());
                let (_, eye) = sent(remote, i);
                let focal = [size[0] / (right - left), size[1] / (up - down)];
                let to = DVec3::new(0.1, 1.7, -ahead) - eye;
                [focal[0] * (to.x / -to.z - left), focal[1] * (up - to.y / -to.z)]
            });
            println!("{what}: {found:?}, expected {expected:?}");
            for i in 0..2 {
                assert!((found[i][0] - expected[i][0]).abs() < 0.5, "{what}: {found:?} {expected:?}");
                assert!((found[i][1] - expected[i][1]).abs() < 0.5, "{what}: {found:?} {expected:?}");
            }
            found
        };
        let symmetric = Remote { fovs: [[-0.8, 0.8, 0.7, -0.7]; 2], ..Default::default() };
        let found = check(&symmetric, "symmetric");
        // Mirrored fields of view shift the pictures, and must not shift the object.
        check(&Remote::default(), "asymmetric");
        let focal = size[0] / (2.0 * f64::from(0.8f32).tan());
        let disparity = found[0][0] - found[1][0];
        let wanted = focal * 0.064 / ahead;
        println!("disparity {disparity:.2} pixels, f · IPD / z = {wanted:.2}");
        assert!((disparity - wanted).abs() < 1.0 && wanted > 2.0, "{disparity} {wanted}");
        // Control: eyes twice as far apart see twice the disparity.
        let eyes = [RemotePose::at([-0.064, 0.0, 0.0]), RemotePose::at([0.064, 0.0, 0.0])];
        let found = check(&Remote { eyes, ..symmetric }, "twice as far apart");
        assert!((found[0][0] - found[1][0] - 2.0 * wanted).abs() < 1.0);
        session.end();
    });
}

/// The middle of what shines in each half of the compositor's window, pixels of the half.
fn middles(screen: &motes_desktop::measure::Picture) -> [[f64; 2]; 2] {
    let [width, height] = screen.size();
    let half = (width / 2) as usize;
    [0, 1].map(|eye| {
        let rows = screen.to_rgb8();
        let rows = rows.chunks_exact(3 * width as usize);
        let pixels = rows
            .flat_map(|row| row[3 * eye * half..3 * (eye + 1) * half].chunks_exact(3))
            .map(|pixel| [pixel[0], pixel[1], pixel[2], 255]);
        middle(&Picture { size: [width / 2, height], pixels: pixels.collect() })
    })
}

#[test]
#[cfg(target_os = "linux")]
fn the_compositor_shows_both_eyes_upright_and_at_the_right_depth() {
    const NAME: &str = "the_compositor_shows_both_eyes_upright_and_at_the_right_depth";
    /// Where the inner process finds the screen.
    const SCREEN: &str = "MOTES_TEST_SCREEN";
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("compositor");
    if !inside() {
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        // As large as Monado's window.
        let display = display::Display::new(&folder, [960, 540]);
        let source = Source::Remote(free_port());
        let mut monado = Monado::start_with(source, Compositor::Window(display.name.clone()));
        let mut environment = monado.environment();
        environment.push((SCREEN, display.folder.clone().into()));
        Inside::start(NAME, &environment).finish();
        assert!(monado.stop().success());
        return;
    }
    log_to_stderr();
    let screen = std::env::var_os(SCREEN).unwrap();
    let screen = || display::screen(Path::new(&screen));
    // Above the eyes' height, and to the right.
    let (ahead, aside, above) = (0.8, 0.1, 0.15);
    let coarse = SessionOptions { resolution_scale: 0.25, whole_images: true, ..Default::default() };
    let ball = |gpu: &Arc<Gpu>| hanging(gpu, DVec3::new(aside, 1.6 + above, -ahead));
    let mut session = Session::open(ball, false, &coarse);
    let remote = Remote { fovs: [[-0.75, 0.75, 0.8, -0.8]; 2], ..Default::default() };
    session.show(&remote);
    // What was drawn is on the screen some frames later.
    for _ in 0..10 {
        session.step();
    }
    let seen = screen();
    seen.save(&folder.join("ball.png")).unwrap();
    let [width, height] = seen.size().map(f64::from);
    let found = middles(&seen);
    // Whatever the images' fields of view, Monado shows them on a display of 130 mm x 70 mm that is seen by each eye from
    // straight before its half, which is 85 degrees wide.
    let tangent = 42.5f64.to_radians().tan();
    let focal = [width / 4.0 / tangent, height / 2.0 / (tangent * 70.0 / 65.0)];
    let expected = [-0.032, 0.032]
        .map(|eye| [width / 4.0 + focal[0] * (aside - eye) / ahead, height / 2.0 - focal[1] * above / ahead]);
    println!("compositor: {found:?}, expected {expected:?}");
    for (found, expected) in found.iter().zip(expected) {
        assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1.5), "{found:?} {expected:?}");
    }
    // Controls: neither upside down nor with the eyes exchanged would it pass, nor at another depth.
    let disparity = focal[0] * 0.064 / ahead;
    assert!(height / 2.0 - expected[0][1] > 20.0 && disparity > 10.0);
    assert!((found[0][0] - found[1][0] - disparity).abs() < 1.0, "{disparity}");
    // Something to look at.
    let opened = Opened::load(&[], &LoadOptions::default()).unwrap();
    let plant = Content::new(session.headset.gpu(), &opened, PACKING).unwrap();
    session.viewer.config.background = [0.9, 0.9, 0.93];
    session.viewer.show(plant).unwrap();
    session.step();
    // From the first view nearer, and down to the plant's height: it stands on the floor.
    session.remote.send(&Remote { head: RemotePose::at([0.0, 0.6, -0.3]), ..remote });
    for _ in 0..3 {
        session.step();
    }
    let picture = folder.join("plant.png");
    let seen = screen();
    seen.save(&picture).unwrap();
    println!("look at {}", picture.display());
    for eye in 0..2 {
        let rows = seen.pixels().chunks_exact(seen.size()[0] as usize);
        let half = rows.flat_map(|row| row.chunks_exact(row.len() / 2).nth(eye)).flatten();
        let green = half.filter(|p| p[1] > p[2] + 0.1).count();
        assert!(green > 1000, "eye {eye} sees no leaves: {green}");
    }
    session.end();
}

#[test]
fn a_bare_hand_points_and_pinches() {
    with_monado("a_bare_hand_points_and_pinches", Source::Remote(free_port()), || {
        let mut session = Session::new(|gpu| hanging(gpu, DVec3::new(0.1, 1.7, -1.2)), false);
        assert!(session.headset.runtime().optional().hand_tracking, "Monado tracks the remote's hands");
        let hands = |s: &mut Session| {
            s.step();
            let time = s.viewer.last_frame().unwrap().time;
            s.headset.input(&time).unwrap().hands
        };
        let [_, held] = hands(&mut session);
        let mut remote = Remote::default();
        let (open, closed) = ([0.0; 5], [1.0; 5]);
        let mut until = |session: &mut Session, bare, what: &str, done: &dyn Fn(&HandInput) -> bool| {
            remote.hands[1].bare = bare;
            session.remote.send(&remote);
            for _ in 0..100 {
                let [_, right] = hands(session);
                if done(&right) {
                    return right;
                }
            }
            panic!("never {what}: {:?}", hands(session));
        };
        let right = until(&mut session, Some(open), "a bare hand", &|h| h.aim.is_some() && h.aim != held.aim);
        let place = DVec3::from_array(remote_place(1));
        println!("bare hand: {right:?}, sent to {place}");
        assert!(!right.select && !right.grab);
        // The palm is near where the hand was sent to, and the ray goes ahead.
        let (grip, aim) = (right.grip.unwrap(), right.aim.unwrap());
        assert!((grip.place() - place).length() < 0.15 && (aim.place() - place).length() < 0.2);
        let pinched = until(&mut session, Some(closed), "a pinch", &|h| h.select);
        assert!(pinched.grab && pinched.aim.is_some());
        until(&mut session, Some(open), "let go", &|h| !h.select);
        // A controller again: its own ray.
        until(&mut session, None, "a controller", &|h| h.aim == held.aim);
        session.end();
    });
}

/// Where a hand is at first.
fn remote_place(hand: usize) -> [f64; 3] {
    Remote::default().hands[hand].pose.1.map(f64::from)
}

#[test]
fn hands_and_buttons_do_what_is_specified() {
    with_monado("hands_and_buttons_do_what_is_specified", Source::Remote(free_port()), || {
        let mut session = Session::new(|gpu| hanging(gpu, DVec3::new(0.1, 1.7, -1.2)), false);
        let placement = |s: &Session| *s.viewer.placement().unwrap();
        let home = placement(&session);
        assert!((home.translation.length(), home.yaw.abs()) < (1e-6, 1e-6), "{home:?}");

        // One hand holds the world and moves it.
        let mut remote = Remote::default();
        remote.hands[1].squeeze = 1.0;
        session.remote.send(&remote);
        session.until("held", |s| s.viewer.locomotion().unwrap().holding() == [false, true]);
        assert_eq!(placement(&session), home, "holding moves nothing");
        remote.hands[1].pose.1 = [0.45, 1.325, -0.525];
        session.remote.send(&remote);
        session.until("moved", |s| s.viewer.placement() != Some(&home));
        let moved = placement(&session).translation - home.translation;
        // By as much as the hand, the other way round: the world comes along.
        let by = |a: f32, b: f32| f64::from(a) - f64::from(b);
        let expected = DVec3::new(by(0.2, 0.45), by(1.2, 1.325), by(-0.4, -0.525));
        println!("grab: moved by {moved}, expected {expected}");
        assert!((moved - expected).length() < 1e-6, "{moved} {expected}");
        assert_eq!((placement(&session).scale, placement(&session).yaw), (home.scale, home.yaw));

        // The other hand too: twice as far apart, and turned by a quarter.
        let before = placement(&session);
        remote.hands[0].squeeze = 1.0;
        session.remote.send(&remote);
        session.until("held by both", |s| s.viewer.locomotion().unwrap().holding() == [true, true]);
        assert!((placement(&session).translation - before.translation).length() < 1e-12);
        let at_first = remote.hands.map(|h| DVec3::from_array(h.pose.1.map(f64::from)));
        let (middle, apart) = ((at_first[0] + at_first[1]) / 2.0, at_first[1] - at_first[0]);
        let turned = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2) * apart * 2.0;
        for (hand, side) in remote.hands.iter_mut().zip([-0.5, 0.5]) {
            hand.pose.1 = (middle + side * turned).to_array().map(|v| v as f32);
        }
        session.remote.send(&remote);
        session.until("scaled", |s| s.viewer.placement().unwrap().scale < 0.75);
        let after = placement(&session);
        println!("two hands: {before:?} -> {after:?}");
        assert!((after.scale - before.scale / 2.0).abs() < 1e-6, "{after:?}");
        assert!((after.yaw - (before.yaw - std::f64::consts::FRAC_PI_2)).abs() < 1e-6, "{after:?}");
        for (hand, place) in remote.hands.iter().zip(at_first) {
            let held = after.to_world(DVec3::from_array(hand.pose.1.map(f64::from)));
            assert!((held - before.to_world(place)).length() < 1e-6, "each hand still has what it held");
        }

        // A push of the stick: 30° to the right about the head, once.
        remote = Remote::default();
        session.remote.send(&remote);
        session.until("let go", |s| s.viewer.locomotion().unwrap().holding() == [false, false]);
        let before = placement(&session);
        remote.hands[1].stick = [1.0, 0.0];
        session.remote.send(&remote);
        session.until("turned", |s| s.viewer.placement().unwrap().yaw != before.yaw);
        for _ in 0..3 {
            session.step();
        }
        let after = placement(&session);
        let angle = before.yaw - after.yaw;
        println!("snap turn: {}° to the right", angle.to_degrees());
        assert!((angle - 30f64.to_radians()).abs() < 1e-12, "{}", angle.to_degrees());
        let head = session.viewer.head().place();
        assert!((after.to_world(head) - before.to_world(head)).length() < 1e-12, "about the head");
        remote.hands[1].stick = [0.0; 2];

        // Walking: ahead, and the rim darkens, on a layer of its own.
        session.remote.send(&remote);
        session.step();
        let before = placement(&session);
        remote.hands[0].stick = [0.0, 1.0];
        session.remote.send(&remote);
        session.until("the rim is dark", |s| s.viewer.locomotion().unwrap().vignette() > 0.5);
        remote.hands[0].stick = [0.0; 2];
        session.remote.send(&remote);
        session.until("the rim is clear", |s| s.viewer.locomotion().unwrap().vignette() == 0.0);
        let walked = placement(&session).translation - before.translation;
        let ahead = before.turn() * DVec3::NEG_Z;
        println!("walked {walked}, heading {ahead}");
        assert!(walked.length() > 0.1 && (walked.normalize() - ahead).length() < 1e-6, "{walked} {ahead}");

        // A jump: the ring shows where, and the feet come there.
        remote.hands[1].a = true;
        session.remote.send(&remote);
        session.until("a landing is shown", |s| s.viewer.locomotion().unwrap().landing().is_some());
        session.step();
        // Along the arc, from the hand to the ring.
        let arc = session.viewer.locomotion().unwrap().arc().unwrap();
        assert!(arc.windows(2).all(|w| w[1].y < w[0].y + 1.0 && (w[1] - w[0]).length() < 3.0), "{arc:?}");
        let landing = session.viewer.locomotion().unwrap().landing().unwrap();
        remote.hands[1].a = false;
        session.remote.send(&remote);
        session.until("jumped", |s| s.viewer.locomotion().unwrap().landing().is_none());
        assert_eq!(session.viewer.locomotion().unwrap().arc(), None);
        let mut feet = session.viewer.head().place();
        feet.y = 0.0;
        let feet = placement(&session).to_world(feet);
        println!("jump: feet at {feet}, landing {landing}");
        assert!((feet - landing).length() < 1e-6 && landing.y == 0.0, "{feet} {landing}");

        // The panel comes, is pointed at and clicked; the hand that clicks holds nothing.
        remote.hands[0].a = true;
        session.remote.send(&remote);
        session.until("the panel came", |s| s.viewer.panel().shown());
        remote.hands[0].a = false;
        let panel = session.viewer.panel().pose().place();
        assert!((panel - DVec3::new(0.0, 1.48, -1.0)).length() < 1e-5, "{panel}");
        session.remote.send(&remote);
        session.step();
        remote.hands[1].pose = RemotePose::at([0.09, 1.48 + 0.135, -0.3]);
        session.remote.send(&remote);
        session.until("pointed at", |s| s.viewer.panel_events().pointer.is_some());
        let aim = session.viewer.panel_events().pointer.unwrap();
        println!("panel: pointer at {aim:?}");
        remote.hands[1].trigger = 1.0;
        remote.hands[1].squeeze = 1.0;
        session.remote.send(&remote);
        session.until("clicked", |s| s.viewer.panel_events().pressed);
        assert_eq!(session.viewer.panel_events().pointer, Some(aim));
        session.step();
        assert!(!session.viewer.panel_events().pressed, "one click a press");
        assert_eq!(session.viewer.locomotion().unwrap().holding(), [false, false]);
        remote.hands[1].trigger = 0.0;
        session.remote.send(&remote);
        session.until("let go of", |s| s.viewer.panel_events().released);

        // The panel's own button, clicked: exit.
        remote.hands[1].squeeze = 0.0;
        remote.hands[1].pose = RemotePose::at([0.324, 1.48 + 0.4257, -0.3]);
        session.remote.send(&remote);
        session.until("pointed at exit", |s| {
            s.viewer.panel_events().pointer.is_some_and(|[u, v]| u > 0.9 && v < 0.1)
        });
        session.step();
        remote.hands[1].trigger = 1.0;
        session.remote.send(&remote);
        session.until("pressed", |s| s.viewer.panel_events().pressed);
        remote.hands[1].trigger = 0.0;
        session.remote.send(&remote);
        let mut seconds = 0.0;
        let ended = loop {
            match session.viewer.step(&mut session.headset).unwrap() {
                Some(ended) => break ended,
                None => seconds += 0.05,
            }
            assert!(seconds < 20.0, "never ended");
        };
        assert_eq!(ended, SessionState::Exiting);
        let Session { viewer, headset, .. } = session;
        drop(viewer);
        assert!(headset.runtime().messages().is_empty(), "{:#?}", headset.runtime().messages());
        assert!(headset.gpu().messages().is_empty(), "{:#?}", headset.gpu().messages());
    });
}
