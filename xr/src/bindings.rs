//! Which button does what: data, so that a settings file can change it.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What can be bound, and to what kind of control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Action {
    /// Pose of the hand's grip.
    Grip,
    /// Pose of the hand's ray.
    Aim,
    /// Button: holds the world.
    Grab,
    /// Button: clicks on what the ray meets.
    Select,
    /// Stick: walks.
    Walk,
    /// Stick: turns and rises.
    Look,
    /// Button: aims a jump, and jumps when let go.
    Teleport,
    /// Button: shows or hides the panel; held for a while, it ends the session.
    Panel,
    /// Button: puts the user back to the stage's middle.
    Recentre,
    /// Button: puts the world back as it was at first.
    Reset,
    /// Button: ends the session.
    Exit,
}

impl Action {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Grip,
        Self::Aim,
        Self::Grab,
        Self::Select,
        Self::Walk,
        Self::Look,
        Self::Teleport,
        Self::Panel,
        Self::Recentre,
        Self::Reset,
        Self::Exit,
    ];

    /// Its name, as in the settings file and in OpenXR.
    pub fn name(self) -> &'static str {
        match self {
            Self::Grip => "grip",
            Self::Aim => "aim",
            Self::Grab => "grab",
            Self::Select => "select",
            Self::Walk => "walk",
            Self::Look => "look",
            Self::Teleport => "teleport",
            Self::Panel => "panel",
            Self::Recentre => "recentre",
            Self::Reset => "reset",
            Self::Exit => "exit",
        }
    }

    /// What a runtime's own binding menu calls it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Grip => "Hand",
            Self::Aim => "Pointer",
            Self::Grab => "Hold the world",
            Self::Select => "Click",
            Self::Walk => "Walk",
            Self::Look => "Turn and rise",
            Self::Teleport => "Jump to where the arc ends",
            Self::Panel => "Panel",
            Self::Recentre => "Recentre",
            Self::Reset => "Reset the world",
            Self::Exit => "Exit",
        }
    }
}

/// The paths of one kind of controller: from actions to controls, such as `/user/hand/left/input/x/click`.
pub type Profile = BTreeMap<Action, Vec<String>>;

/// Bindings of every kind of controller, by its interaction profile, such as
/// `/interaction_profiles/oculus/touch_controller`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Bindings(pub BTreeMap<String, Profile>);

/// Meta's Touch controllers.
pub const TOUCH: &str = "/interaction_profiles/oculus/touch_controller";
/// Those of Quest 3 and 3S.
pub const TOUCH_PLUS: &str = "/interaction_profiles/meta/touch_controller_plus";
/// Valve's Index controllers.
pub const INDEX: &str = "/interaction_profiles/valve/index_controller";
/// What every runtime knows: a button and a menu button.
pub const SIMPLE: &str = "/interaction_profiles/khr/simple_controller";
/// Hands without controllers.
pub const HANDS: &str = "/interaction_profiles/ext/hand_interaction_ext";

impl Bindings {
    /// What is bound unless the settings say otherwise. A left-handed user walks with the right stick and finds the
    /// buttons of either hand on the other.
    pub fn defaults(left_handed: bool) -> Self {
        let (main, other) = if left_handed { ("left", "right") } else { ("right", "left") };
        let both = |control: &str| {
            ["left", "right"].map(|hand| format!("/user/hand/{hand}/input/{control}")).to_vec()
        };
        let one = |hand: &str, control: &str| vec![format!("/user/hand/{hand}/input/{control}")];
        let poses = |profile: &mut Profile| {
            profile.insert(Action::Grip, both("grip/pose"));
            profile.insert(Action::Aim, both("aim/pose"));
        };
        let sticks = |profile: &mut Profile, buttons: [[&str; 2]; 2]| {
            poses(profile);
            profile.insert(Action::Grab, both("squeeze/value"));
            profile.insert(Action::Select, both("trigger/value"));
            profile.insert(Action::Walk, one(other, "thumbstick"));
            profile.insert(Action::Look, one(main, "thumbstick"));
            let [of_main, of_other] = buttons;
            profile.insert(Action::Teleport, one(main, of_main[0]));
            profile.insert(Action::Reset, one(main, of_main[1]));
            profile.insert(Action::Panel, one(other, of_other[0]));
            profile.insert(Action::Recentre, one(other, of_other[1]));
        };
        let mut touch = Profile::new();
        let (right, left) = (["a/click", "b/click"], ["x/click", "y/click"]);
        sticks(&mut touch, if left_handed { [left, right] } else { [right, left] });
        if let Some(panel) = touch.get_mut(&Action::Panel) {
            panel.push("/user/hand/left/input/menu/click".into());
        }
        let mut index = Profile::new();
        sticks(&mut index, [["a/click", "b/click"]; 2]);
        let mut simple = Profile::new();
        poses(&mut simple);
        simple.insert(Action::Grab, both("select/click"));
        simple.insert(Action::Select, both("select/click"));
        simple.insert(Action::Panel, one(other, "menu/click"));
        simple.insert(Action::Teleport, one(main, "menu/click"));
        let mut hands = Profile::new();
        poses(&mut hands);
        let mut grab = both("grasp_ext/value");
        grab.extend(one(main, "pinch_ext/value"));
        hands.insert(Action::Grab, grab);
        hands.insert(Action::Select, one(main, "pinch_ext/value"));
        hands.insert(Action::Panel, one(other, "pinch_ext/value"));
        let profiles =
            [(TOUCH, touch.clone()), (TOUCH_PLUS, touch), (INDEX, index), (SIMPLE, simple), (HANDS, hands)];
        Self(profiles.into_iter().map(|(path, profile)| (path.to_owned(), profile)).collect())
    }

    /// These, with what another says of a profile's actions in their place. An empty list unbinds an action.
    pub fn with(mut self, changes: &Self) -> Self {
        for (path, profile) in &changes.0 {
            let into = self.0.entry(path.clone()).or_default();
            for (action, controls) in profile {
                into.insert(*action, controls.clone());
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_replace_what_they_name_and_nothing_else() {
        let text = r#"{"/interaction_profiles/oculus/touch_controller":
            {"exit": ["/user/hand/right/input/thumbstick/click"], "reset": []}}"#;
        let changes: Bindings = serde_json::from_str(text).unwrap();
        let defaults = Bindings::defaults(false);
        let bound = defaults.clone().with(&changes);
        let touch = &bound.0[TOUCH];
        assert_eq!(touch[&Action::Exit], ["/user/hand/right/input/thumbstick/click"]);
        assert!(touch[&Action::Reset].is_empty());
        assert_eq!(touch[&Action::Walk], ["/user/hand/left/input/thumbstick"]);
        assert_eq!(bound.0[INDEX], defaults.0[INDEX]);
        assert!(serde_json::from_str::<Bindings>(r#"{"/p": {"jump": []}}"#).is_err(), "no such action");
    }

    #[test]
    fn a_left_handed_user_has_everything_on_the_other_hand() {
        let [right, left] = [false, true].map(Bindings::defaults);
        for (path, profile) in &right.0 {
            for (action, controls) in profile {
                if *action == Action::Panel && path.contains("touch") {
                    continue; // the menu button is on the left controller only
                }
                let swapped: Vec<String> = controls
                    .iter()
                    .map(|c| {
                        let swapped = if c.contains("/left/") {
                            c.replace("/left/", "/right/").replace("/x/", "/a/").replace("/y/", "/b/")
                        } else {
                            c.replace("/right/", "/left/")
                        };
                        if path.contains("touch") && swapped.contains("/left/") {
                            swapped.replace("/a/", "/x/").replace("/b/", "/y/")
                        } else {
                            swapped
                        }
                    })
                    .collect();
                let mut found = left.0[path][action].clone();
                let mut wanted = swapped;
                found.sort();
                wanted.sort();
                assert_eq!(found, wanted, "{path} {}", action.name());
            }
        }
    }
}
