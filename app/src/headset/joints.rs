//! Hands without controllers, from where their joints are: for runtimes that track joints and name no gestures.

use super::{Hand, HandInput, Input, Pose};
use glam::DVec3;

/// What is needed of a hand's joints, in the stage; the −z axis of each points towards the fingertips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joints {
    /// The middle of the palm.
    pub palm: Pose,
    /// The index finger's knuckle.
    pub knuckle: Pose,
    /// Tips of thumb and index finger, metres.
    pub tips: [[f32; 3]; 2],
}

/// Tips are pinched from this distance on, metres.
const TOUCH: f64 = 0.015;
/// And let go of from this distance on: in between nothing changes, so that a trembling hand does not click twice.
const APART: f64 = 0.03;

impl Joints {
    /// How far the tips are apart, metres.
    pub fn gap(&self) -> f64 {
        let [thumb, index] = self.tips.map(|tip| DVec3::from_array(tip.map(f64::from)));
        thumb.distance(index)
    }
}

/// Which hands pinch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pinches([bool; 2]);

impl Pinches {
    /// Adds hands without controllers to the input of a frame, as the bindings of hands do: a pinch of the leading hand
    /// clicks and holds the world, one of the other hand is the panel's button. The ray starts at the knuckle and goes
    /// where the palm points, which a pinch hardly moves. Hands with a controller are left alone.
    pub fn add_to(&mut self, input: &mut Input, joints: [Option<Joints>; 2], left_handed: bool) {
        let lead = if left_handed { Hand::Left } else { Hand::Right };
        for hand in Hand::BOTH {
            let i = hand as usize;
            let (Some(joints), HandInput { aim: None, grip: None, .. }) = (joints[i], input.hands[i]) else {
                self.0[i] = false;
                continue;
            };
            let gap = joints.gap();
            // In the positive form: a gap that is not a number pinches nothing.
            self.0[i] = gap <= if self.0[i] { APART } else { TOUCH };
            let is_lead = hand == lead;
            input.hands[i] = HandInput {
                grip: Some(joints.palm),
                aim: Some(Pose { position: joints.knuckle.position, ..joints.palm }),
                grab: self.0[i] && is_lead,
                select: self.0[i] && is_lead,
            };
            input.panel |= self.0[i] && !is_lead;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(gap: f32) -> Option<Joints> {
        let knuckle = Pose { position: [0.0, 1.02, -0.05], ..Pose::default() };
        let palm = Pose { position: [0.0, 1.0, 0.0], ..Pose::default() };
        Some(Joints { palm, knuckle, tips: [[0.0, 1.0, -0.1], [gap, 1.0, -0.1]] })
    }

    #[test]
    fn a_pinch_clicks_once_however_the_hand_trembles() {
        let mut pinches = Pinches::default();
        let mut held = |gap, left_handed| {
            let mut input = Input::default();
            pinches.add_to(&mut input, [None, joints(gap)], left_handed);
            (input.hands[1].select, input.panel)
        };
        let gaps = [0.05, 0.02, 0.014, 0.02, 0.016, 0.029, 0.031, 0.02];
        assert_eq!(gaps.map(|gap| held(gap, false).0), [false, false, true, true, true, true, false, false]);
        assert_eq!(held(f32::NAN, false), (false, false));
        // To the left-handed it is the other hand: the panel's button.
        assert_eq!(held(0.01, true), (false, true));
    }

    #[test]
    fn a_hand_points_from_its_knuckle_unless_it_holds_a_controller() {
        let mut pinches = Pinches::default();
        let mut input = Input::default();
        let held = HandInput { aim: Some(Pose::default()), ..HandInput::default() };
        input.hands[0] = held;
        pinches.add_to(&mut input, [joints(0.0), joints(0.1)], false);
        assert_eq!(input.hands[0], held);
        let HandInput { grip, aim, grab, select } = input.hands[1];
        assert_eq!(grip.map(|g| g.position), Some([0.0, 1.0, 0.0]));
        assert_eq!(aim.map(|a| a.position), Some([0.0, 1.02, -0.05]));
        assert!(!grab && !select && !input.panel);
    }
}
