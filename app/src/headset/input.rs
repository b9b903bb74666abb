//! What the user does with hands and controllers, as actions: which button does what is decided below.

use super::Pose;
use serde::{Deserialize, Serialize};

/// Which hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Hand {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl Hand {
    /// Both, left first.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }
}

/// One hand at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HandInput {
    /// Where the hand holds the world, in the stage; none while it is not tracked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grip: Option<Pose>,
    /// The ray along which it points (−z), in the stage; none while it is not tracked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aim: Option<Pose>,
    /// Holds the world.
    pub grab: bool,
    /// Clicks on what the ray meets.
    pub select: bool,
}

/// All input of one frame. Buttons say what is held now; what was pressed just now is found by who uses them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Input {
    /// Left and right hand.
    pub hands: [HandInput; 2],
    /// Smooth motion: to the right, and ahead, `−1 ..= 1`.
    pub walk: [f32; 2],
    /// Turn to the right, `−1 ..= 1`.
    pub turn: f32,
    /// Smooth motion upwards, `−1 ..= 1`.
    pub rise: f32,
    /// Held: aims the teleport arc; let go: jumps.
    pub teleport: bool,
    /// Shows or hides the panel.
    pub panel: bool,
    /// Puts the user back to where the stage's middle is.
    pub recentre: bool,
    /// Puts the world back as it was at first.
    pub reset: bool,
    /// Ends the session.
    pub exit: bool,
}

impl Input {
    /// One hand.
    pub fn hand(&self, hand: Hand) -> &HandInput {
        &self.hands[hand as usize]
    }

    /// Values that a broken controller might send become harmless: NaN is 0, the rest is `−1 ..= 1`.
    pub fn sanitised(mut self) -> Self {
        let clean = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(-1.0, 1.0) };
        self.walk = self.walk.map(clean);
        self.turn = clean(self.turn);
        self.rise = clean(self.rise);
        self
    }
}
