//! Moving through the world: walking, rising, turning, holding the world with one hand or two, jumping.

use super::{Comfort, Hand, Input, Placement, Pose, Vignette};
use glam::DVec3;

/// Sticks nearer to the middle do nothing.
const DEAD_ZONE: f64 = 0.15;
/// A snap turn is made where the stick passes the first, and the next one is armed where it falls below the second.
const SNAP_AT: f64 = 0.7;
const SNAP_ARMED_BELOW: f64 = 0.4;
/// Speed of what flies along the arc, and what pulls it down: metres of the stage and seconds.
const ARC_SPEED: f64 = 7.0;
const ARC_GRAVITY: f64 = 9.8;
/// Places along the arc that are shown.
pub const ARC_DOTS: usize = 8;
/// A jump is no farther than this, metres of the stage.
const ARC_REACH: f64 = 20.0;

/// Locomotion's state: where the stage stands, and what is being done about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Locomotion {
    placement: Placement,
    home: Placement,
    /// Places of the world that the hands hold.
    held: [Option<DVec3>; 2],
    snap_armed: bool,
    landing: Option<DVec3>,
    /// From where what flies along the arc starts, how fast, and for how many seconds, while a jump is aimed and possible;
    /// in the stage.
    arc: Option<(DVec3, DVec3, f64)>,
    previous: Input,
    vignette: Vignette,
}

impl Locomotion {
    /// Begins at a place that reset leads back to.
    pub fn new(home: Placement) -> Self {
        Self {
            placement: home,
            home,
            held: [None; 2],
            snap_armed: true,
            landing: None,
            arc: None,
            previous: Input::default(),
            vignette: Vignette::default(),
        }
    }

    /// Where the stage stands.
    pub fn placement(&self) -> &Placement {
        &self.placement
    }

    /// Where the arc ends, in the world, while a jump is aimed and possible.
    pub fn landing(&self) -> Option<DVec3> {
        self.landing
    }

    /// Places along the arc in even steps of time, in the stage: while a jump is aimed and possible.
    pub fn arc(&self) -> Option<[DVec3; ARC_DOTS]> {
        self.arc.map(|(start, speed, time)| {
            std::array::from_fn(|i| {
                let t = time * (i + 1) as f64 / (ARC_DOTS + 1) as f64;
                start + t * speed - DVec3::Y * (0.5 * ARC_GRAVITY * t * t)
            })
        })
    }

    /// Darkness of the rim, `0 ..= 1`.
    pub fn vignette(&self) -> f64 {
        self.vignette.strength()
    }

    /// Puts the world back as it was at first.
    pub fn reset(&mut self) {
        self.placement = self.home;
        self.held = [None; 2];
    }

    /// Which hands hold the world.
    pub fn holding(&self) -> [bool; 2] {
        self.held.map(|held| held.is_some())
    }

    /// Follows one frame of input. `busy` hands do something else, such as pointing at the panel, and do not begin to
    /// hold the world; `dt` is the time since the frame before, seconds.
    pub fn update(&mut self, input: &Input, busy: [bool; 2], head: &Pose, comfort: &Comfort, dt: f64) {
        let pressed = |now: bool, before: bool| now && !before;
        if pressed(input.reset, self.previous.reset) {
            self.reset();
        }
        if pressed(input.recentre, self.previous.recentre) {
            self.recentre(head);
        }
        self.hold(input, busy);
        let mut speed = self.walk(input, head, comfort, dt);
        speed = speed.max(self.turn(input, head, comfort, dt));
        self.teleport(input, head, comfort);
        self.vignette.update(speed, comfort, dt);
        self.previous = *input;
    }

    /// Puts the head back over the first place, heading as at first; height and scale stay.
    pub fn recentre(&mut self, head: &Pose) {
        let height = self.placement.translation.y;
        let forward = self.home.turn() * DVec3::NEG_Z;
        let yaw = super::placement::yaw_of(forward) - super::placement::yaw_of(head.forward());
        let mut flat = head.place();
        flat.y = 0.0;
        let home = self.home.translation;
        self.placement = Placement { yaw, ..self.placement }.with_place_at(flat, home);
        self.placement.translation.y = height;
        self.held = [None; 2];
    }

    /// One hand moves the world, two turn and scale it too: what a hand holds stays in it.
    fn hold(&mut self, input: &Input, busy: [bool; 2]) {
        let mut places = [None; 2];
        let mut changed = false;
        for hand in Hand::BOTH {
            let i = hand as usize;
            let now = input.hand(hand);
            let holds = now.grab && (self.held[i].is_some() || !self.previous.hands[i].grab && !busy[i]);
            places[i] = now.grip.filter(|_| holds).map(|grip| grip.place());
            changed |= places[i].is_some() != self.held[i].is_some();
        }
        if changed {
            // A hand more or less: both hold what they hold from here on.
            self.held = places.map(|place| place.map(|stage| self.placement.to_world(stage)));
        }
        self.placement = match (places, self.held) {
            ([Some(left), Some(right)], [Some(of_left), Some(of_right)]) => {
                self.placement.through([left, right], [of_left, of_right])
            }
            ([Some(place), _], [Some(held), _]) | ([_, Some(place)], [_, Some(held)]) => {
                self.placement.with_place_at(place, held)
            }
            _ => self.placement,
        };
    }

    /// Smooth motion; returns its speed, 1 at full stick.
    fn walk(&mut self, input: &Input, head: &Pose, comfort: &Comfort, dt: f64) -> f64 {
        let [right, ahead] = input.walk.map(f64::from);
        // Who turns does not rise: a stick has one meaning at a time.
        let rise = if input.rise.abs() > input.turn.abs() { f64::from(input.rise) } else { 0.0 };
        let wish = DVec3::new(live(right), live(rise), -live(ahead));
        let wish = wish / wish.length().max(1.0);
        let heading = glam::DQuat::from_rotation_y(super::placement::yaw_of(head.forward()));
        let step = self.placement.turn() * (heading * wish);
        self.placement.translation += self.placement.scale * comfort.walk_speed * dt * step;
        wish.length()
    }

    /// Snap or smooth turn about the head; returns the speed of the smooth one, 1 at full stick.
    fn turn(&mut self, input: &Input, head: &Pose, comfort: &Comfort, dt: f64) -> f64 {
        let stick = f64::from(input.turn);
        if comfort.snap_degrees > 0.0 {
            if stick.abs() < SNAP_ARMED_BELOW {
                self.snap_armed = true;
            } else if self.snap_armed && stick.abs() >= SNAP_AT && input.turn.abs() > input.rise.abs() {
                self.snap_armed = false;
                let angle = -stick.signum() * comfort.snap_degrees.to_radians();
                self.placement = self.placement.turned_about(head.place(), angle);
            }
            return 0.0;
        }
        let stick = if input.turn.abs() > input.rise.abs() { live(stick) } else { 0.0 };
        let angle = -stick * comfort.turn_speed.to_radians() * dt;
        self.placement = self.placement.turned_about(head.place(), angle);
        stick.abs()
    }

    /// Aims while the button is held, jumps when it is let go.
    fn teleport(&mut self, input: &Input, head: &Pose, comfort: &Comfort) {
        if input.teleport {
            let lead = if comfort.left_handed { Hand::Left } else { Hand::Right };
            let aim = input.hand(lead).aim.or(input.hand(lead.other()).aim);
            let end = aim.and_then(|aim| self.arc_end(&aim));
            (self.landing, self.arc) = (end.map(|end| end.0), end.map(|end| end.1));
        } else if let Some(landing) = self.landing.take() {
            let mut feet = head.place();
            feet.y = 0.0;
            self.placement = self.placement.with_place_at(feet, landing);
            self.arc = None;
        }
    }

    /// Where a throw along the ray meets the world's floor (y = 0), in the world, and the arc up to there; none out of reach or
    /// from below it.
    #[allow(clippy::type_complexity, reason = "a place and what the field holds")]
    fn arc_end(&self, aim: &Pose) -> Option<(DVec3, (DVec3, DVec3, f64))> {
        let floor = -self.placement.translation.y / self.placement.scale;
        let (start, speed) = (aim.place(), ARC_SPEED * aim.forward());
        let height = start.y - floor;
        // height + speed.y · t − gravity / 2 · t² = 0, the later root.
        let discriminant = speed.y * speed.y + 2.0 * ARC_GRAVITY * height;
        if !(height > 0.0 && discriminant >= 0.0) {
            return None;
        }
        let time = (speed.y + discriminant.sqrt()) / ARC_GRAVITY;
        let mut end = start + time * speed;
        end.y = floor;
        let reach = DVec3::new(end.x - start.x, 0.0, end.z - start.z).length();
        let mut world = self.placement.to_world(end);
        world.y = 0.0;
        (reach <= ARC_REACH && world.is_finite()).then_some((world, (start, speed, time)))
    }
}

/// A stick's value with the dead zone taken out: 0 within it, and still 1 at the end.
fn live(value: f64) -> f64 {
    let beyond = (value.abs() - DEAD_ZONE).max(0.0) / (1.0 - DEAD_ZONE);
    beyond.min(1.0).copysign(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::headset::HandInput;
    use glam::DQuat;

    const HEAD: Pose = Pose { orientation: [0.0, 0.0, 0.0, 1.0], position: [0.2, 1.6, 0.1] };

    fn at(position: [f32; 3]) -> Pose {
        Pose { position, ..Pose::default() }
    }

    fn grabbing(hands: [Option<[f32; 3]>; 2]) -> Input {
        let hand = |place: Option<[f32; 3]>| HandInput {
            grip: Some(at(place.unwrap_or([9.0, 9.0, 9.0]))),
            grab: place.is_some(),
            ..Default::default()
        };
        Input { hands: hands.map(hand), ..Default::default() }
    }

    fn step(l: &mut Locomotion, input: &Input) {
        l.update(input, [false; 2], &HEAD, &Comfort::default(), 0.1);
    }

    #[test]
    fn one_hand_moves_the_world() {
        let mut l = Locomotion::new(Placement::default());
        step(&mut l, &grabbing([None, Some([0.0, 1.0, -0.5])]));
        assert_eq!(l.placement(), &Placement::default(), "beginning to hold moves nothing");
        step(&mut l, &grabbing([None, Some([0.25, 1.5, -0.5])]));
        assert_eq!(l.placement().translation, DVec3::new(-0.25, -0.5, 0.0));
        step(&mut l, &grabbing([None, None]));
        step(&mut l, &grabbing([None, Some([3.0, 3.0, 3.0])]));
        assert_eq!(l.placement().translation, DVec3::new(-0.25, -0.5, 0.0), "a new hold begins where it is");
    }

    #[test]
    fn two_hands_scale_and_turn() {
        let mut l = Locomotion::new(Placement::default());
        step(&mut l, &grabbing([Some([-0.25, 1.0, -0.5]), Some([0.25, 1.0, -0.5])]));
        // Twice as far apart: everything looks twice as large, so the user is half as large.
        step(&mut l, &grabbing([Some([-0.5, 1.0, -0.5]), Some([0.5, 1.0, -0.5])]));
        assert_eq!(l.placement().scale, 0.5);
        let held = l.placement().to_world(DVec3::new(-0.5, 1.0, -0.5));
        assert!((held - DVec3::new(-0.25, 1.0, -0.5)).length() < 1e-12, "{held}");
        // A quarter turn of the hands to the left turns the world with them.
        step(&mut l, &grabbing([Some([0.0, 1.0, 0.0]), Some([0.0, 1.0, -1.0])]));
        for (stage, world) in [([0.0, 1.0, 0.0], [-0.25, 1.0, -0.5]), ([0.0, 1.0, -1.0], [0.25, 1.0, -0.5])] {
            let held = l.placement().to_world(DVec3::from_array(stage));
            assert!((held - DVec3::from_array(world)).length() < 1e-12, "{held}");
        }
        // One hand let go: the other goes on holding what it holds.
        let before = *l.placement();
        step(&mut l, &grabbing([Some([0.0, 1.0, 0.0]), None]));
        assert!((l.placement().translation - before.translation).length() < 1e-12);
        assert_eq!(l.holding(), [true, false]);
    }

    #[test]
    fn the_arc_leads_from_the_hand_to_where_the_jump_lands() {
        let mut l = Locomotion::new(Placement::default());
        let aim = HandInput { aim: Some(at([0.3, 1.2, -0.2])), ..Default::default() };
        let aiming = Input { hands: [HandInput::default(), aim], teleport: true, ..Default::default() };
        step(&mut l, &aiming);
        let (arc, landing) = (l.arc().unwrap(), l.landing().unwrap());
        // Level at first, then ever steeper: even steps ahead, and falls that grow by as much each time.
        let steps: Vec<DVec3> = arc.windows(2).map(|w| w[1] - w[0]).collect();
        assert!(steps.windows(2).all(|w| (w[1].z - w[0].z).abs() < 1e-12 && w[1].y < w[0].y && w[0].z < 0.0));
        assert!((arc[0].x - 0.3).abs() < 1e-6 && arc[0].y < 1.2 && arc[ARC_DOTS - 1].y > 0.0);
        let last = steps[ARC_DOTS - 2];
        let next = arc[ARC_DOTS - 1] + last + (last - steps[ARC_DOTS - 3]);
        assert!((next - landing).length() < 1e-9, "{next} {landing}");
        step(&mut l, &Input { teleport: false, ..aiming });
        assert_eq!((l.arc(), l.landing()), (None, None));
        // Out of reach, no arc.
        l.placement.translation.y = 100.0;
        step(&mut l, &aiming);
        assert_eq!(l.arc(), None);
    }

    #[test]
    fn a_hand_at_the_panel_does_not_begin_to_hold() {
        let mut l = Locomotion::new(Placement::default());
        let comfort = Comfort::default();
        l.update(&grabbing([None, Some([0.0; 3])]), [false, true], &HEAD, &comfort, 0.1);
        l.update(&grabbing([None, Some([1.0; 3])]), [false, false], &HEAD, &comfort, 0.1);
        assert_eq!(l.placement(), &Placement::default(), "not even once it leaves the panel");
    }

    #[test]
    fn snap_turns_are_exact_and_one_a_push() {
        let mut l = Locomotion::new(Placement::default());
        let place = l.placement().to_world(HEAD.place());
        let push = |turn: f32| Input { turn, ..Default::default() };
        for turn in [0.5, 0.9, 1.0, 0.6, 0.8] {
            step(&mut l, &push(turn));
        }
        assert_eq!(l.placement().yaw, -30f64.to_radians(), "to the right, once");
        assert!((l.placement().to_world(HEAD.place()) - place).length() < 1e-12);
        step(&mut l, &push(0.0));
        step(&mut l, &push(-1.0));
        assert!(l.placement().yaw.abs() < 1e-15);
        assert_eq!(l.vignette(), 0.0, "a snap turn needs no vignette");
        let comfort = Comfort { snap_degrees: 0.0, ..Default::default() };
        l.update(&push(1.0), [false; 2], &HEAD, &comfort, 0.1);
        assert!((l.placement().yaw + 9f64.to_radians()).abs() < 1e-12, "smooth: 90° a second");
        assert!(l.vignette() > 0.0);
    }

    #[test]
    fn walking_follows_the_head_and_the_scale() {
        let mut l = Locomotion::new(Placement { scale: 2.0, ..Default::default() });
        let left = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2).to_array().map(|v| v as f32);
        let head = Pose { orientation: left, ..HEAD };
        let comfort = Comfort::default();
        let input = Input { walk: [0.0, 1.0], ..Default::default() };
        l.update(&input, [false; 2], &head, &comfort, 0.1);
        assert!(
            (l.placement().translation - DVec3::new(-0.3, 0.0, 0.0)).length() < 1e-6,
            "{:?}",
            l.placement()
        );
        let input = Input { rise: 1.0, walk: [0.1, -0.1], ..Default::default() };
        l.update(&input, [false; 2], &head, &comfort, 0.1);
        assert!(
            (l.placement().translation - DVec3::new(-0.3, 0.3, 0.0)).length() < 1e-6,
            "{:?}",
            l.placement()
        );
        let input = Input { turn: 0.3, rise: 0.2, ..Default::default() };
        l.update(&input, [false; 2], &head, &comfort, 0.1);
        assert!((l.placement().translation.y - 0.3).abs() < 1e-6, "a stick that turns does not rise");
    }

    #[test]
    fn a_jump_lands_where_the_arc_ends() {
        let mut l =
            Locomotion::new(Placement { translation: DVec3::new(1.0, 0.5, 0.0), ..Default::default() });
        let aim = |orientation: [f32; 4]| Input {
            hands: [
                HandInput::default(),
                HandInput {
                    aim: Some(Pose { orientation, position: [0.0, 1.5, 0.0] }),
                    ..Default::default()
                },
            ],
            teleport: true,
            ..Default::default()
        };
        let ahead = [0.0, 0.0, 0.0, 1.0];
        step(&mut l, &aim(ahead));
        // Level throw from 2 m above the world's floor: t = √(2 · 2 / 9.8), x = 7 t.
        let distance = 7.0 * (4.0f64 / 9.8).sqrt();
        let landing = l.landing().unwrap();
        assert!((landing - DVec3::new(1.0, 0.0, -distance)).length() < 1e-9, "{landing}");
        step(&mut l, &Input::default());
        let feet = l.placement().to_world(DVec3::new(f64::from(0.2f32), 0.0, f64::from(0.1f32)));
        assert!((feet - landing).length() < 1e-9, "{feet}");
        assert_eq!(l.landing(), None);
        // From below the floor there is no landing, and letting go does nothing.
        let mut below =
            Locomotion::new(Placement { translation: DVec3::new(0.0, -3.0, 0.0), ..Default::default() });
        step(&mut below, &aim(ahead));
        assert_eq!(below.landing(), None);
        step(&mut below, &Input::default());
        assert_eq!(below.placement().translation.y, -3.0);
    }

    #[test]
    fn reset_and_recentre() {
        let home = Placement { yaw: 0.5, translation: DVec3::new(4.0, 0.0, 2.0), ..Default::default() };
        let mut l = Locomotion::new(home);
        step(&mut l, &Input { walk: [1.0, 1.0], turn: 1.0, ..Default::default() });
        assert_ne!(l.placement(), &home);
        step(&mut l, &Input { recentre: true, ..Default::default() });
        let head = l.placement().to_world(HEAD.place());
        assert!((head - DVec3::new(4.0, 1.6, 2.0)).length() < 1e-6, "{head}");
        assert!((l.placement().yaw - 0.5).abs() < 1e-12);
        step(&mut l, &Input { walk: [1.0, 1.0], ..Default::default() });
        step(&mut l, &Input { reset: true, ..Default::default() });
        assert_eq!(l.placement(), &home);
    }
}
