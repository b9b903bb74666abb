//! The panel in the headset: where it hangs, what the hands point at on it, what they click.

use super::{Comfort, Hand, Input, Pose};
use glam::{DQuat, DVec3};

/// How far in front of the head it appears, and how much lower than the eyes, metres: text of 12 mm is read easily
/// at a metre.
const DISTANCE: f64 = 1.0;
const DROP: f64 = 0.12;
/// Width and height, metres.
pub const PANEL_SIZE: [f64; 2] = [0.72, 0.9];
/// The panel button, held as long, ends the session.
const EXIT_SECONDS: f64 = 1.5;

/// What happened at the panel in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PanelEvents {
    /// Where the pointer is: from the upper left corner, `0 ..= 1`.
    pub pointer: Option<[f32; 2]>,
    /// The click began.
    pub pressed: bool,
    /// The click ended.
    pub released: bool,
    /// It was just shown or hidden.
    pub toggled: bool,
    /// The button was held until the end: exit.
    pub exit: bool,
}

/// The panel's state.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Panel {
    shown: bool,
    pose: Pose,
    hovered: [Option<[f32; 2]>; 2],
    /// The hand whose click is going on.
    clicking: Option<Hand>,
    lead: Option<Hand>,
    previous: Input,
    held_seconds: f64,
}

impl Panel {
    /// Shows it in front of the head, where it is not shown yet.
    pub fn open(&mut self, head: &Pose) {
        if !self.shown {
            self.shown = true;
            self.pose = in_front_of(head);
        }
    }

    /// Whether it is shown.
    pub fn shown(&self) -> bool {
        self.shown
    }

    /// Its middle, in the stage; it faces along +z.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Which hands point at it or click on it, and do nothing else meanwhile.
    pub fn busy(&self) -> [bool; 2] {
        Hand::BOTH.map(|hand| self.hovered[hand as usize].is_some() || self.clicking == Some(hand))
    }

    /// Follows one frame of input; `dt` in seconds.
    pub fn update(&mut self, input: &Input, head: &Pose, comfort: &Comfort, dt: f64) -> PanelEvents {
        let mut events = PanelEvents::default();
        if input.panel && !self.previous.panel {
            self.shown = !self.shown;
            events.toggled = true;
            if self.shown {
                self.pose = in_front_of(head);
            }
        }
        self.held_seconds = if input.panel { self.held_seconds + dt } else { 0.0 };
        events.exit = input.exit && !self.previous.exit || self.held_seconds >= EXIT_SECONDS;
        self.hovered = Hand::BOTH
            .map(|hand| input.hand(hand).aim.filter(|_| self.shown).and_then(|aim| self.meets(&aim)));
        let lead = self.lead.unwrap_or(if comfort.left_handed { Hand::Left } else { Hand::Right });
        let select = |input: &Input, hand: Hand| input.hand(hand).select;
        if let Some(hand) = self.clicking {
            if !select(input, hand) || !self.shown {
                self.clicking = None;
                events.released = true;
            }
            events.pointer = self.hovered[hand as usize];
        } else {
            let begins = |hand: &Hand| {
                self.hovered[*hand as usize].is_some()
                    && select(input, *hand)
                    && !select(&self.previous, *hand)
            };
            if let Some(hand) = [lead, lead.other()].into_iter().find(begins) {
                self.clicking = Some(hand);
                self.lead = Some(hand);
                events.pressed = true;
                events.pointer = self.hovered[hand as usize];
            } else {
                events.pointer = self.hovered[lead as usize].or(self.hovered[lead.other() as usize]);
            }
        }
        self.previous = *input;
        events
    }

    /// Where a ray meets the panel's front: from its upper left corner, `0 ..= 1`.
    fn meets(&self, aim: &Pose) -> Option<[f32; 2]> {
        let back = self.pose.rotation().conjugate();
        let start = back * (aim.place() - self.pose.place());
        let along = back * aim.forward();
        // From the front only: the ray goes against +z.
        if !(start.z > 0.0 && along.z < 0.0) {
            return None;
        }
        let hit = start - along * (start.z / along.z);
        let [u, v] = [0.5 + hit.x / PANEL_SIZE[0], 0.5 - hit.y / PANEL_SIZE[1]];
        let inside = |t: f64| (0.0..=1.0).contains(&t);
        (inside(u) && inside(v)).then_some([u as f32, v as f32])
    }
}

/// Upright in front of the head, facing it.
fn in_front_of(head: &Pose) -> Pose {
    let turn = DQuat::from_rotation_y(super::placement::yaw_of(head.forward()));
    let place = head.place() + turn * DVec3::new(0.0, -DROP, -DISTANCE);
    Pose { orientation: turn.to_array().map(|v| v as f32), position: place.to_array().map(|v| v as f32) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::headset::HandInput;

    const HEAD: Pose = Pose { orientation: [0.0, 0.0, 0.0, 1.0], position: [0.0, 1.62, 0.0] };

    /// The right hand points straight ahead from a place.
    fn pointing(place: [f32; 3], select: bool) -> Input {
        let aim = Some(Pose { position: place, ..Pose::default() });
        Input {
            hands: [HandInput::default(), HandInput { aim, select, ..Default::default() }],
            ..Default::default()
        }
    }

    fn opened() -> Panel {
        let mut panel = Panel::default();
        let comfort = Comfort::default();
        assert!(panel.update(&Input { panel: true, ..Default::default() }, &HEAD, &comfort, 0.01).toggled);
        panel.update(&Input::default(), &HEAD, &comfort, 0.01);
        panel
    }

    #[test]
    fn it_comes_to_the_user_and_goes() {
        let mut panel = opened();
        assert!(panel.shown());
        assert_eq!(panel.pose().position, [0.0, 1.5, -1.0]);
        panel.update(&Input { panel: true, ..Default::default() }, &HEAD, &Comfort::default(), 0.01);
        assert!(!panel.shown());
        let events = panel.update(&pointing([0.0, 1.5, 0.0], true), &HEAD, &Comfort::default(), 0.01);
        assert_eq!(events, PanelEvents::default(), "what is hidden is not clicked");
    }

    #[test]
    fn a_click_is_where_the_ray_meets_it() {
        let mut panel = opened();
        let comfort = Comfort::default();
        let at = |x: f32, y: f32, select| pointing([x, y, 0.2], select);
        let events = panel.update(&at(0.18, 1.5 + 0.225, false), &HEAD, &comfort, 0.01);
        let [u, v] = events.pointer.unwrap();
        assert!((u - 0.75).abs() < 1e-6 && (v - 0.25).abs() < 1e-6, "{u} {v}");
        assert!(panel.busy()[1] && !events.pressed);
        let events = panel.update(&at(0.18, 1.5, true), &HEAD, &comfort, 0.01);
        assert!(events.pressed && !events.released);
        let events = panel.update(&at(0.5, 1.5, true), &HEAD, &comfort, 0.01);
        assert_eq!((events.pointer, events.pressed, events.released), (None, false, false));
        assert!(panel.busy()[1], "a drag beyond the rim is still the panel's");
        let events = panel.update(&at(0.0, 1.5, false), &HEAD, &comfort, 0.01);
        assert!(events.released && events.pointer.is_some());
        // Pressed outside, then moved onto it: no click.
        panel.update(&at(0.5, 1.5, true), &HEAD, &comfort, 0.01);
        assert!(!panel.update(&at(0.0, 1.5, true), &HEAD, &comfort, 0.01).pressed);
        // From behind there is nothing to click.
        assert_eq!(panel.update(&pointing([0.0, 1.5, -2.0], false), &HEAD, &comfort, 0.01).pointer, None);
    }

    #[test]
    fn the_button_held_long_is_exit() {
        let mut panel = opened();
        let held = Input { panel: true, ..Default::default() };
        let comfort = Comfort::default();
        let frames = (0..20).take_while(|_| !panel.update(&held, &HEAD, &comfort, 0.1).exit).count();
        assert_eq!(frames, 14, "1.5 s at ten frames a second");
        assert!(opened().update(&Input { exit: true, ..Default::default() }, &HEAD, &comfort, 0.1).exit);
    }
}
