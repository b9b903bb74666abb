//! Input: one action set, bound as the settings say.

use super::Runtime;
use crate::XrError;
use crate::bindings::{Action, Bindings, HANDS, TOUCH_PLUS};
use crate::error::During;
use motes_app::headset::{Hand, HandInput, Input, Pose};
use openxr as xr;

/// The actions of a session, and the spaces of both hands.
pub(super) struct Actions {
    set: xr::ActionSet,
    hands: [xr::Path; 2],
    grips: [xr::Space; 2],
    aims: [xr::Space; 2],
    grab: xr::Action<bool>,
    select: xr::Action<bool>,
    walk: xr::Action<xr::Vector2f>,
    look: xr::Action<xr::Vector2f>,
    buttons: [xr::Action<bool>; 5],
}

impl Actions {
    /// Creates, binds and attaches.
    pub fn new(
        runtime: &Runtime,
        session: &xr::Session<xr::Vulkan>,
        bindings: &Bindings,
        defaults: &Bindings,
    ) -> Result<Self, XrError> {
        let instance = &runtime.instance;
        let set = instance.create_action_set("motes", "Motes", 0).during("xrCreateActionSet")?;
        let path = |name: &str| instance.string_to_path(name).during("xrStringToPath");
        let hands = [path(xr::USER_HAND_LEFT)?, path(xr::USER_HAND_RIGHT)?];
        let grip = create::<xr::Posef>(&set, Action::Grip, &hands)?;
        let aim = create::<xr::Posef>(&set, Action::Aim, &hands)?;
        let grab = create::<bool>(&set, Action::Grab, &hands)?;
        let select = create::<bool>(&set, Action::Select, &hands)?;
        let walk = create::<xr::Vector2f>(&set, Action::Walk, &[])?;
        let look = create::<xr::Vector2f>(&set, Action::Look, &[])?;
        let button = |action| create::<bool>(&set, action, &[]);
        let buttons = [
            button(Action::Teleport)?,
            button(Action::Panel)?,
            button(Action::Recentre)?,
            button(Action::Reset)?,
            button(Action::Exit)?,
        ];
        let binding = |action: Action, control: xr::Path| match action {
            Action::Grip => xr::Binding::new(&grip, control),
            Action::Aim => xr::Binding::new(&aim, control),
            Action::Grab => xr::Binding::new(&grab, control),
            Action::Select => xr::Binding::new(&select, control),
            Action::Walk => xr::Binding::new(&walk, control),
            Action::Look => xr::Binding::new(&look, control),
            Action::Teleport => xr::Binding::new(&buttons[0], control),
            Action::Panel => xr::Binding::new(&buttons[1], control),
            Action::Recentre => xr::Binding::new(&buttons[2], control),
            Action::Reset => xr::Binding::new(&buttons[3], control),
            Action::Exit => xr::Binding::new(&buttons[4], control),
        };
        for (profile, actions) in &bindings.0 {
            let offered = match profile.as_str() {
                TOUCH_PLUS => runtime.optional().touch_plus,
                HANDS => runtime.optional().hand_interaction,
                _ => true,
            };
            if !offered {
                continue;
            }
            let suggest = |actions: &crate::bindings::Profile| -> Result<(), XrError> {
                let mut list = Vec::new();
                for (action, controls) in actions {
                    for control in controls {
                        list.push(binding(*action, path(control)?));
                    }
                }
                instance
                    .suggest_interaction_profile_bindings(path(profile)?, &list)
                    .during("xrSuggestInteractionProfileBindings")
            };
            let Err(problem) = suggest(actions) else { continue };
            match defaults.0.get(profile) {
                Some(default) if default != actions => {
                    log::warn!("bindings of {profile}: {problem}. The defaults are used");
                    if let Err(problem) = suggest(default) {
                        log::warn!("bindings of {profile}: {problem}. Such controllers do nothing");
                    }
                }
                _ => log::warn!("bindings of {profile}: {problem}. Such controllers do nothing"),
            }
        }
        session.attach_action_sets(&[&set]).during("xrAttachSessionActionSets")?;
        let space = |action: &xr::Action<xr::Posef>, hand: xr::Path| {
            action.create_space(session, hand, xr::Posef::IDENTITY).during("xrCreateActionSpace")
        };
        let grips = [space(&grip, hands[0])?, space(&grip, hands[1])?];
        let aims = [space(&aim, hands[0])?, space(&aim, hands[1])?];
        Ok(Self { set, hands, grips, aims, grab, select, walk, look, buttons })
    }

    /// Reads everything at the moment the frame is shown.
    pub fn read(
        &self,
        session: &xr::Session<xr::Vulkan>,
        space: &xr::Space,
        time: xr::Time,
    ) -> Result<Input, XrError> {
        // Not being focused is no error: everything is inactive then.
        session.sync_actions(&[xr::ActiveActionSet::new(&self.set)]).during("xrSyncActions")?;
        let none = xr::Path::NULL;
        let held = |action: &xr::Action<bool>, hand: xr::Path| -> Result<bool, XrError> {
            let state = action.state(session, hand).during("xrGetActionStateBoolean")?;
            Ok(state.is_active && state.current_state)
        };
        let stick = |action: &xr::Action<xr::Vector2f>| -> Result<[f32; 2], XrError> {
            let state = action.state(session, none).during("xrGetActionStateVector2f")?;
            Ok(if state.is_active { [state.current_state.x, state.current_state.y] } else { [0.0; 2] })
        };
        let pose = |of: &xr::Space| -> Result<Option<Pose>, XrError> {
            let found = of.locate(space, time).during("xrLocateSpace")?;
            let valid = xr::SpaceLocationFlags::POSITION_VALID | xr::SpaceLocationFlags::ORIENTATION_VALID;
            Ok(found.location_flags.contains(valid).then(|| from_xr(found.pose)))
        };
        let mut hands = [HandInput::default(); 2];
        for hand in Hand::BOTH {
            let i = hand as usize;
            hands[i] = HandInput {
                grip: pose(&self.grips[i])?,
                aim: pose(&self.aims[i])?,
                grab: held(&self.grab, self.hands[i])?,
                select: held(&self.select, self.hands[i])?,
            };
        }
        let look = stick(&self.look)?;
        let [teleport, panel, recentre, reset, exit] = &self.buttons;
        let input = Input {
            hands,
            walk: stick(&self.walk)?,
            turn: look[0],
            rise: look[1],
            teleport: held(teleport, none)?,
            panel: held(panel, none)?,
            recentre: held(recentre, none)?,
            reset: held(reset, none)?,
            exit: held(exit, none)?,
        };
        Ok(input.sanitised())
    }

    /// The controllers that are in use now, for the log.
    pub fn profiles(&self, runtime: &Runtime, session: &xr::Session<xr::Vulkan>) -> [String; 2] {
        self.hands.map(|hand| {
            session
                .current_interaction_profile(hand)
                .ok()
                .filter(|profile| *profile != xr::Path::NULL)
                .and_then(|profile| runtime.instance.path_to_string(profile).ok())
                .unwrap_or_else(|| "none".into())
        })
    }
}

fn create<T: xr::ActionTy>(
    set: &xr::ActionSet,
    action: Action,
    hands: &[xr::Path],
) -> Result<xr::Action<T>, XrError> {
    set.create_action::<T>(action.name(), action.title(), hands).during("xrCreateAction")
}

/// A runtime's pose, bit for bit.
pub(super) fn from_xr(pose: xr::Posef) -> Pose {
    let (q, p) = (pose.orientation, pose.position);
    Pose { orientation: [q.x, q.y, q.z, q.w], position: [p.x, p.y, p.z] }
}

/// The same pose in the runtime's words.
pub(super) fn to_xr(pose: &Pose) -> xr::Posef {
    let ([x, y, z, w], [px, py, pz]) = (pose.orientation, pose.position);
    xr::Posef { orientation: xr::Quaternionf { x, y, z, w }, position: xr::Vector3f { x: px, y: py, z: pz } }
}
