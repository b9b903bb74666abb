//! Extensions that Motes uses where they are offered.

use super::RuntimeOptions;
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
    pub depth_layer: bool,
    pub foveation: bool,
}

impl Optional {
    /// Those of the offered extensions that are wanted.
    pub(super) fn choose(offered: &xr::ExtensionSet, options: &RuntimeOptions) -> (xr::ExtensionSet, Self) {
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
            depth_layer: offered.khr_composition_layer_depth,
            foveation: offered.fb_foveation
                && offered.fb_foveation_configuration
                && offered.fb_foveation_vulkan
                && offered.fb_swapchain_update_state,
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
        // A compositor may do more for a program that says it has depth: only for one that gives it.
        wanted.khr_composition_layer_depth = optional.depth_layer && options.depth_layer;
        let foveation = optional.foveation && options.foveation;
        wanted.fb_foveation = foveation;
        wanted.fb_foveation_configuration = foveation;
        wanted.fb_foveation_vulkan = foveation;
        wanted.fb_swapchain_update_state = foveation;
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
        check(
            self.depth_layer,
            "no XR_KHR_composition_layer_depth: the compositor is not told how far away pixels are",
        );
        check(self.touch_plus, "no XR_META_touch_controller_plus: such controllers act as Touch");
        check(
            self.foveation,
            "no XR_FB_foveation (_configuration, _vulkan) or no XR_FB_swapchain_update_state: the governor saves by other \
             means than coarser rims",
        );
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_asked_for_is_not_turned_on_and_what_is_missing_is_said() {
        let mut offered = xr::ExtensionSet::default();
        offered.khr_composition_layer_depth = true;
        offered.fb_foveation = true;
        offered.fb_foveation_configuration = true;
        offered.fb_foveation_vulkan = true;
        let options = RuntimeOptions { depth_layer: true, foveation: true, ..Default::default() };
        let (wanted, optional) = Optional::choose(&offered, &options);
        assert!(wanted.khr_composition_layer_depth && optional.depth_layer);
        // Three of four extensions are of no use.
        assert!(!wanted.fb_foveation && !optional.foveation);
        assert!(optional.fallbacks().iter().any(|line| line.contains("XR_FB_foveation")));
        offered.fb_swapchain_update_state = true;
        let (wanted, optional) = Optional::choose(&offered, &options);
        assert!(wanted.fb_foveation && wanted.fb_swapchain_update_state && wanted.fb_foveation_vulkan);
        assert!(!optional.fallbacks().iter().any(|line| line.contains("XR_FB_foveation")));
        let (wanted, _) = Optional::choose(&offered, &RuntimeOptions::default());
        assert!(!wanted.khr_composition_layer_depth && !wanted.fb_foveation);
        let (_, none) = Optional::choose(&xr::ExtensionSet::default(), &options);
        assert!(none.fallbacks().iter().any(|line| line.contains("XR_KHR_composition_layer_depth")));
    }
}
