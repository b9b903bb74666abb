//! Extensions that Motes uses where they are offered.

use openxr as xr;

/// Which optional extensions are in use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs, reason = "each is named as its extension")]
pub struct Optional {
    pub local_floor: bool,
    pub refresh_rate: bool,
    pub hand_interaction: bool,
    pub performance_settings: bool,
    pub layer_settings: bool,
    pub touch_plus: bool,
    pub visibility_mask: bool,
    pub passthrough: bool,
    pub hand_tracking: bool,
}

impl Optional {
    /// Those of the offered extensions that are wanted.
    pub(super) fn choose(offered: &xr::ExtensionSet) -> (xr::ExtensionSet, Self) {
        let mut wanted = xr::ExtensionSet::default();
        let optional = Self {
            local_floor: offered.ext_local_floor,
            refresh_rate: offered.fb_display_refresh_rate,
            hand_interaction: offered.ext_hand_interaction,
            performance_settings: offered.ext_performance_settings,
            layer_settings: offered.fb_composition_layer_settings,
            touch_plus: offered.meta_touch_controller_plus,
            visibility_mask: offered.khr_visibility_mask,
            passthrough: offered.fb_passthrough,
            hand_tracking: offered.ext_hand_tracking,
        };
        wanted.ext_local_floor = optional.local_floor;
        wanted.fb_display_refresh_rate = optional.refresh_rate;
        wanted.ext_hand_interaction = optional.hand_interaction;
        wanted.ext_performance_settings = optional.performance_settings;
        wanted.fb_composition_layer_settings = optional.layer_settings;
        wanted.meta_touch_controller_plus = optional.touch_plus;
        wanted.khr_visibility_mask = optional.visibility_mask;
        wanted.fb_passthrough = optional.passthrough;
        wanted.ext_hand_tracking = optional.hand_tracking;
        (wanted, optional)
    }

    /// One line for every extension that is missing and what follows from it.
    pub fn fallbacks(&self) -> Vec<&'static str> {
        let mut lines = Vec::new();
        let mut check = |there: bool, line| {
            if !there {
                lines.push(line);
            }
        };
        check(self.local_floor, "no XR_EXT_local_floor: the floor is the stage's, or is assumed");
        check(self.refresh_rate, "no XR_FB_display_refresh_rate: the display's rate is not chosen");
        let hands = match (self.hand_interaction, self.hand_tracking) {
            (true, _) => "",
            (false, true) => "no XR_EXT_hand_interaction: pinches are found from the joints of the hands",
            (false, false) => {
                "neither XR_EXT_hand_interaction nor XR_EXT_hand_tracking: hands without controllers do \
                               nothing"
            }
        };
        check(hands.is_empty(), hands);
        check(self.performance_settings, "no XR_EXT_performance_settings: clocks are left to the system");
        check(self.layer_settings, "no XR_FB_composition_layer_settings: the compositor does not sharpen");
        check(self.passthrough, "no XR_FB_passthrough: the surroundings cannot be shown");
        check(self.visibility_mask, "no XR_KHR_visibility_mask: what the lenses' rims hide is drawn too");
        check(self.touch_plus, "no XR_META_touch_controller_plus: such controllers act as Touch");
        lines.push("foveation is not driven, whether XR_FB_foveation is offered or not: the governor lowers other costs");
        lines
    }
}

/// The names of a set's extensions, with commas.
pub(super) fn names(set: &xr::ExtensionSet) -> String {
    let names = set.names();
    let names: Vec<_> =
        names.iter().map(|n| String::from_utf8_lossy(n).trim_end_matches('\0').to_owned()).collect();
    names.join(", ")
}
