//! Keys, mouse and gamepad, as motions of the eye and commands.

use std::collections::HashSet;

use glam::DVec3;
use motes_app::eye::EyeMotion;
use motes_app::time::TimeCommand;
use motes_app::viewer::Command;
use winit::event::{ElementState, MouseButton, MouseScrollDelta};
use winit::keyboard::KeyCode;

/// What keys do, for the help and the README.
pub const KEYS: &str = "\
W A S D, Q E    move, down and up (Shift: faster)
arrows          turn
mouse           drag left: turn; drag right: move; wheel: nearer and farther
M               fly or orbit
C, Shift+C      next camera of the data set, the one before
Home            first view
V               both eyes side by side
Space           stop or continue time
, .             a frame back or on (Shift: a tenth of the scene)
[ ]             half or twice the speed
R, L            time backwards; at the ends loop, turn round or stop
H               heat maps of what is seen, one after another: layers, hidden layers, error, …
B               label by hand: the left button marks with a brush or a box (B again: ends it)
P               save a picture
Tab             show or hide the panel
Esc             quit
gamepad         sticks move and turn, triggers down and up, A fly or orbit, B first view,
                X picture, Y next camera, Start panel; cross: time stops or continues (up),
                backwards (down), a frame back or on (left, right)";

/// What is pressed.
#[derive(Debug, Default)]
pub struct Input {
    keys: HashSet<KeyCode>,
    left: bool,
    right: bool,
    /// Pixels that the mouse went with a button pressed.
    drag: [f64; 2],
    shove: [f64; 2],
    wheel: f64,
    cursor: Option<[f64; 2]>,
}

/// Radians a pixel.
const DRAG: f64 = 0.004;
/// Radians a second, by keys and sticks.
const TURN: f64 = 1.5;

impl Input {
    /// A key goes down or up; a command where it stands for one.
    pub fn key(&mut self, code: KeyCode, state: ElementState, repeat: bool) -> Option<Command> {
        if state == ElementState::Released {
            self.keys.remove(&code);
            return None;
        }
        self.keys.insert(code);
        // Frames go on as long as their key is held.
        if repeat && !matches!(code, KeyCode::Comma | KeyCode::Period) {
            return None;
        }
        Some(match code {
            KeyCode::KeyM => Command::SwitchMode,
            KeyCode::KeyC if self.shift() => Command::PreviousCamera,
            KeyCode::KeyC => Command::NextCamera,
            KeyCode::Home => Command::Reset,
            KeyCode::KeyV => Command::SwitchStereo,
            KeyCode::Space => Command::Time(TimeCommand::Toggle),
            KeyCode::Comma if self.shift() => Command::Time(TimeCommand::Jump(-0.1)),
            KeyCode::Comma => Command::Time(TimeCommand::Step(-1)),
            KeyCode::Period if self.shift() => Command::Time(TimeCommand::Jump(0.1)),
            KeyCode::Period => Command::Time(TimeCommand::Step(1)),
            KeyCode::BracketLeft => Command::Time(TimeCommand::Slower),
            KeyCode::BracketRight => Command::Time(TimeCommand::Faster),
            KeyCode::KeyR => Command::Time(TimeCommand::Reverse),
            KeyCode::KeyL => Command::Time(TimeCommand::NextRepeat),
            KeyCode::KeyH => Command::SwitchHeatMap,
            KeyCode::KeyB => Command::SwitchMarking,
            KeyCode::KeyP => Command::Screenshot,
            KeyCode::Tab => Command::SwitchPanel,
            KeyCode::Escape => Command::Quit,
            _ => return None,
        })
    }

    /// A mouse button goes down or up.
    pub fn button(&mut self, button: MouseButton, state: ElementState) {
        let down = state == ElementState::Pressed;
        match button {
            MouseButton::Left => self.left = down,
            MouseButton::Right | MouseButton::Middle => self.right = down,
            _ => {}
        }
    }

    /// The cursor is somewhere else, pixels.
    pub fn cursor(&mut self, to: [f64; 2]) {
        if let Some(from) = self.cursor.replace(to) {
            let by = [to[0] - from[0], to[1] - from[1]];
            let sum = if self.left { &mut self.drag } else { &mut self.shove };
            if self.left || self.right {
                *sum = [sum[0] + by[0], sum[1] + by[1]];
            }
        }
    }

    /// Where the cursor is, pixels; none before it was anywhere.
    pub fn place(&self) -> Option<[f64; 2]> {
        self.cursor
    }

    /// The wheel turns; a line, or some 40 pixels, is one step.
    pub fn wheel(&mut self, delta: MouseScrollDelta) {
        self.wheel += match delta {
            MouseScrollDelta::LineDelta(_, y) => f64::from(y),
            MouseScrollDelta::PixelDelta(p) => p.y / 40.0,
        };
    }

    /// The window is no longer in front: nothing is pressed any more.
    pub fn release(&mut self) {
        *self = Self::default();
    }

    fn shift(&self) -> bool {
        self.keys.contains(&KeyCode::ShiftLeft) || self.keys.contains(&KeyCode::ShiftRight)
    }

    /// The motion of a frame of so many seconds, at a pace in scene units a second. `pixels`: the window's height.
    pub fn motion(&mut self, pace: f64, seconds: f64, pixels: f64, pad: &Sticks) -> EyeMotion {
        let axis = |more: KeyCode, less: KeyCode| {
            f64::from(u8::from(self.keys.contains(&more))) - f64::from(u8::from(self.keys.contains(&less)))
        };
        let keys = DVec3::new(
            axis(KeyCode::KeyD, KeyCode::KeyA),
            axis(KeyCode::KeyQ, KeyCode::KeyE),
            axis(KeyCode::KeyW, KeyCode::KeyS),
        );
        let turn = axis(KeyCode::ArrowRight, KeyCode::ArrowLeft) + pad.turn[0];
        let lift = axis(KeyCode::ArrowUp, KeyCode::ArrowDown) + pad.turn[1];
        let faster = if self.shift() { 4.0 } else { 1.0 };
        let [dx, dy] = std::mem::take(&mut self.drag).map(|d| d * DRAG);
        let [sx, sy] = std::mem::take(&mut self.shove).map(|d| d * 3.0 * pace / pixels.max(1.0));
        let wheel = std::mem::take(&mut self.wheel) * 0.2 * pace;
        // The eye turns with the mouse; going round a point, the near side of the scene follows it.

        EyeMotion {
            shift: (keys + pad.shift) * (pace * faster * seconds) + DVec3::new(-sx, -sy, wheel),
            turn: turn * TURN * seconds + dx,
            lift: lift * TURN * seconds - dy,
        }
    }
}

/// A gamepad's sticks and triggers, `-1 ..= 1`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sticks {
    /// Right, down, forward.
    pub shift: DVec3,
    /// Right, up.
    pub turn: [f64; 2],
}

/// Every gamepad that is plugged in.
pub struct Gamepads {
    gilrs: Option<gilrs::Gilrs>,
    /// Commands that no frame has taken yet.
    waiting: Vec<Command>,
}

impl Gamepads {
    /// Looks for gamepads; without a system service for them there are none, which the log says.
    pub fn new() -> Self {
        let gilrs = gilrs::Gilrs::new().inspect_err(|error| log::info!("no gamepads: {error}")).ok();
        Self { gilrs, waiting: Vec::new() }
    }

    /// Whether a stick or a trigger is away from its rest.
    pub fn is_moved(&mut self) -> bool {
        let (sticks, commands) = self.poll();
        self.waiting.extend(commands);
        sticks != Sticks::default() || !self.waiting.is_empty()
    }

    /// What is pressed now, and the commands of what was pressed since.
    pub fn poll(&mut self) -> (Sticks, Vec<Command>) {
        let mut commands = std::mem::take(&mut self.waiting);
        let Some(gilrs) = &mut self.gilrs else { return (Sticks::default(), commands) };
        while let Some(event) = gilrs.next_event() {
            if let gilrs::EventType::ButtonPressed(button, _) = event.event {
                commands.extend(match button {
                    gilrs::Button::South => Some(Command::SwitchMode),
                    gilrs::Button::East => Some(Command::Reset),
                    gilrs::Button::West => Some(Command::Screenshot),
                    gilrs::Button::North => Some(Command::NextCamera),
                    gilrs::Button::Start => Some(Command::SwitchPanel),
                    gilrs::Button::DPadUp => Some(Command::Time(TimeCommand::Toggle)),
                    gilrs::Button::DPadDown => Some(Command::Time(TimeCommand::Reverse)),
                    gilrs::Button::DPadLeft => Some(Command::Time(TimeCommand::Step(-1))),
                    gilrs::Button::DPadRight => Some(Command::Time(TimeCommand::Step(1))),
                    _ => None,
                });
            }
        }
        let mut sticks = Sticks::default();
        for (_, pad) in gilrs.gamepads() {
            // A stick at rest is not quite in the middle.
            let value = |axis| f64::from(pad.value(axis));
            let axis = |axis| if value(axis).abs() > 0.15 { value(axis) } else { 0.0 };
            let trigger = |button| pad.button_data(button).map_or(0.0, |d| f64::from(d.value()));
            let down = trigger(gilrs::Button::LeftTrigger2) - trigger(gilrs::Button::RightTrigger2);
            sticks.shift += DVec3::new(axis(gilrs::Axis::LeftStickX), down, axis(gilrs::Axis::LeftStickY));
            sticks.turn[0] += axis(gilrs::Axis::RightStickX);
            sticks.turn[1] += axis(gilrs::Axis::RightStickY);
        }
        (sticks, commands)
    }
}

impl Default for Gamepads {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_move_while_they_are_down() {
        let mut input = Input::default();
        let motion = |input: &mut Input| input.motion(2.0, 0.5, 900.0, &Sticks::default());
        assert!(motion(&mut input).is_none());
        assert_eq!(input.key(KeyCode::KeyW, ElementState::Pressed, false), None);
        assert_eq!(motion(&mut input).shift, DVec3::new(0.0, 0.0, 1.0));
        input.key(KeyCode::ShiftLeft, ElementState::Pressed, false);
        assert_eq!(motion(&mut input).shift, DVec3::new(0.0, 0.0, 4.0));
        input.key(KeyCode::KeyW, ElementState::Released, false);
        assert!(motion(&mut input).is_none());
        assert_eq!(input.key(KeyCode::KeyC, ElementState::Pressed, false), Some(Command::PreviousCamera));
        input.key(KeyCode::ShiftLeft, ElementState::Released, false);
        assert_eq!(input.key(KeyCode::KeyC, ElementState::Pressed, false), Some(Command::NextCamera));
        assert_eq!(input.key(KeyCode::KeyC, ElementState::Pressed, true), None, "a held key is pressed once");
        let step = Some(Command::Time(TimeCommand::Step(1)));
        assert_eq!(input.key(KeyCode::Period, ElementState::Pressed, false), step);
        assert_eq!(input.key(KeyCode::Period, ElementState::Pressed, true), step, "frames go on");
    }

    #[test]
    fn the_mouse_turns_by_what_it_went_with_its_button_down() {
        let mut input = Input::default();
        let motion = |input: &mut Input| input.motion(2.0, 0.5, 900.0, &Sticks::default());
        input.cursor([10.0, 10.0]);
        input.cursor([60.0, 10.0]);
        assert!(motion(&mut input).is_none());
        input.button(MouseButton::Left, ElementState::Pressed);
        input.cursor([110.0, 10.0]);
        assert!((motion(&mut input).turn - 50.0 * DRAG).abs() < 1e-12);
        assert!(motion(&mut input).is_none(), "once");
        input.cursor([110.0, 20.0]);
        input.release();
        assert!(motion(&mut input).is_none(), "not in front");
    }
}
