//! Rims that are drawn more coarsely than the middle (`XR_FB_foveation`, with `XR_FB_foveation_configuration`,
//! `XR_FB_foveation_vulkan` and `XR_FB_swapchain_update_state`): the runtime keeps a fragment density map beside each of the
//! eyes' images, and fills it for the level that is set.
//!
//! No runtime that runs without a headset offers it, and no driver on the processor has such maps: the calls are tested
//! against a table of functions that stands in for a runtime's; what a device makes of them is not.

use crate::XrError;
use crate::error::During;
use motes_app::governor::Foveation as Level;
use openxr as xr;
use openxr::sys;
use openxr::sys::Handle as _;

/// The runtime's functions.
#[derive(Clone, Copy)]
pub(super) struct Calls {
    create_profile: sys::pfn::CreateFoveationProfileFB,
    destroy_profile: sys::pfn::DestroyFoveationProfileFB,
    update_swapchain: sys::pfn::UpdateSwapchainFB,
}

impl Calls {
    /// None where the extensions are not in use.
    pub fn of(instance: &xr::Instance) -> Option<Self> {
        let profiles = instance.exts().fb_foveation.as_ref()?;
        let state = instance.exts().fb_swapchain_update_state.as_ref()?;
        Some(Self {
            create_profile: profiles.create_foveation_profile,
            destroy_profile: profiles.destroy_foveation_profile,
            update_swapchain: state.update_swapchain,
        })
    }
}

/// The levels of a swapchain, and the one in force.
pub(super) struct Foveation {
    calls: Calls,
    swapchain: sys::Swapchain,
    /// One a level, in their order; as many as were made.
    profiles: Vec<sys::FoveationProfileFB>,
    level: Level,
}

impl Foveation {
    /// Makes a profile a level, and sets none.
    ///
    /// # Safety
    /// Session and swapchain are alive, the swapchain is the session's and was made for foveation, and what is returned goes
    /// before both.
    pub unsafe fn new(
        calls: Calls,
        session: sys::Session,
        swapchain: sys::Swapchain,
    ) -> Result<Self, XrError> {
        let mut made = Self { calls, swapchain, profiles: Vec::new(), level: Level::None };
        for level in Level::ALL {
            let mut of_level = sys::FoveationLevelProfileCreateInfoFB {
                ty: sys::FoveationLevelProfileCreateInfoFB::TYPE,
                next: std::ptr::null_mut(),
                level: match level {
                    Level::None => sys::FoveationLevelFB::NONE,
                    Level::Low => sys::FoveationLevelFB::LOW,
                    Level::Medium => sys::FoveationLevelFB::MEDIUM,
                    Level::High => sys::FoveationLevelFB::HIGH,
                },
                vertical_offset: 0.0,
                // The governor decides, not the runtime.
                dynamic: sys::FoveationDynamicFB::DISABLED,
            };
            let info = sys::FoveationProfileCreateInfoFB {
                ty: sys::FoveationProfileCreateInfoFB::TYPE,
                next: (&raw mut of_level).cast(),
            };
            let mut profile = sys::FoveationProfileFB::NULL;
            // SAFETY: as the caller says; the structures live until the call returns.
            let result = unsafe { (calls.create_profile)(session, &info, &mut profile) };
            if result.into_raw() < 0 {
                return Err(result).during("xrCreateFoveationProfileFB");
            }
            made.profiles.push(profile);
        }
        made.update()?;
        Ok(made)
    }

    /// The level in force.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Sets a level, from the next image on.
    pub fn set(&mut self, level: Level) -> Result<(), XrError> {
        if self.level != level {
            self.level = level;
            self.update()?;
        }
        Ok(())
    }

    fn update(&self) -> Result<(), XrError> {
        let state = sys::SwapchainStateFoveationFB {
            ty: sys::SwapchainStateFoveationFB::TYPE,
            next: std::ptr::null_mut(),
            flags: sys::SwapchainStateFoveationFlagsFB::EMPTY,
            profile: self.profiles[self.level as usize],
        };
        // SAFETY: the swapchain is alive, as the caller of `new` promises; the state begins with the base's fields.
        let result = unsafe { (self.calls.update_swapchain)(self.swapchain, (&raw const state).cast()) };
        if result.into_raw() < 0 {
            return Err(result).during("xrUpdateSwapchainFB");
        }
        Ok(())
    }
}

impl Drop for Foveation {
    fn drop(&mut self) {
        for profile in self.profiles.drain(..) {
            // SAFETY: made by this, and destroyed once; the session is alive, as the caller of `new` promises.
            unsafe { (self.calls.destroy_profile)(profile) };
        }
    }
}

/// Makes a swapchain with fragment density maps.
///
/// # Safety
/// The session is alive.
pub(super) unsafe fn create_swapchain(
    create: sys::pfn::CreateSwapchain,
    session: sys::Session,
    mut info: sys::SwapchainCreateInfo,
) -> Result<sys::Swapchain, sys::Result> {
    let mut foveated = sys::SwapchainCreateInfoFoveationFB {
        ty: sys::SwapchainCreateInfoFoveationFB::TYPE,
        next: std::ptr::null_mut(),
        flags: sys::SwapchainCreateFoveationFlagsFB::FRAGMENT_DENSITY_MAP,
    };
    info.next = (&raw mut foveated).cast();
    let mut made = sys::Swapchain::NULL;
    // SAFETY: as the caller says; the structures live until the call returns.
    let result = unsafe { create(session, &info, &mut made) };
    if result.into_raw() < 0 { Err(result) } else { Ok(made) }
}

/// The images of such a swapchain, each with its density map: Vulkan's handles.
///
/// # Safety
/// The swapchain is alive and was made by [`create_swapchain`].
pub(super) unsafe fn images(
    enumerate: sys::pfn::EnumerateSwapchainImages,
    swapchain: sys::Swapchain,
) -> Result<Vec<[u64; 2]>, sys::Result> {
    let mut count = 0;
    // SAFETY: as the caller says; a count alone is asked for.
    let result = unsafe { enumerate(swapchain, 0, &mut count, std::ptr::null_mut()) };
    if result.into_raw() < 0 {
        return Err(result);
    }
    let map = sys::SwapchainImageFoveationVulkanFB {
        ty: sys::SwapchainImageFoveationVulkanFB::TYPE,
        next: std::ptr::null_mut(),
        image: 0,
        width: 0,
        height: 0,
    };
    let mut maps = vec![map; count as usize];
    let mut images: Vec<_> = maps
        .iter_mut()
        .map(|map| sys::SwapchainImageVulkanKHR {
            ty: sys::SwapchainImageVulkanKHR::TYPE,
            next: std::ptr::from_mut(map).cast(),
            image: 0,
        })
        .collect();
    // SAFETY: the arrays hold as many as they say; `maps` is not touched while the call writes through `images`.
    let result = unsafe { enumerate(swapchain, count, &mut count, images.as_mut_ptr().cast()) };
    if result.into_raw() < 0 {
        return Err(result);
    }
    Ok(images.iter().zip(&maps).take(count as usize).map(|(image, map)| [image.image, map.image]).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use std::cell::RefCell;

    /// What a runtime that is none was asked for.
    #[derive(Debug, PartialEq)]
    enum Asked {
        Create { session: u64, level: i32, dynamic: i32 },
        Destroy(u64),
        Update { swapchain: u64, profile: u64 },
        Swapchain { flags: u64, width: u32 },
    }

    thread_local! {
        static ASKED: RefCell<Vec<Asked>> = const { RefCell::new(Vec::new()) };
        /// Profiles that are made before one is refused.
        static ROOM: RefCell<u32> = const { RefCell::new(u32::MAX) };
    }

    fn ask(what: Asked) {
        ASKED.with_borrow_mut(|asked| asked.push(what));
    }

    fn asked() -> Vec<Asked> {
        ASKED.take()
    }

    unsafe extern "system" fn create_profile(
        session: sys::Session,
        info: *const sys::FoveationProfileCreateInfoFB,
        profile: *mut sys::FoveationProfileFB,
    ) -> sys::Result {
        if ROOM.with_borrow_mut(|room| std::mem::replace(room, room.saturating_sub(1))) == 0 {
            return sys::Result::ERROR_LIMIT_REACHED;
        }
        // SAFETY: the caller passes complete structures.
        unsafe {
            assert_eq!((*info).ty, sys::FoveationProfileCreateInfoFB::TYPE);
            let level = (*info).next.cast::<sys::FoveationLevelProfileCreateInfoFB>();
            assert_eq!((*level).ty, sys::FoveationLevelProfileCreateInfoFB::TYPE);
            assert!((*level).next.is_null() && (*level).vertical_offset == 0.0);
            let (of, dynamic) = ((*level).level.into_raw(), (*level).dynamic.into_raw());
            ask(Asked::Create { session: session.into_raw(), level: of, dynamic });
            *profile = sys::FoveationProfileFB::from_raw(100 + of as u64);
        }
        sys::Result::SUCCESS
    }

    unsafe extern "system" fn destroy_profile(profile: sys::FoveationProfileFB) -> sys::Result {
        ask(Asked::Destroy(profile.into_raw()));
        sys::Result::SUCCESS
    }

    unsafe extern "system" fn update_swapchain(
        swapchain: sys::Swapchain,
        state: *const sys::SwapchainStateBaseHeaderFB,
    ) -> sys::Result {
        // SAFETY: the caller passes a state of foveation.
        unsafe {
            assert_eq!((*state).ty, sys::SwapchainStateFoveationFB::TYPE);
            let state = state.cast::<sys::SwapchainStateFoveationFB>();
            ask(Asked::Update { swapchain: swapchain.into_raw(), profile: (*state).profile.into_raw() });
        }
        sys::Result::SUCCESS
    }

    unsafe extern "system" fn new_swapchain(
        _: sys::Session,
        info: *const sys::SwapchainCreateInfo,
        swapchain: *mut sys::Swapchain,
    ) -> sys::Result {
        // SAFETY: the caller passes complete structures.
        unsafe {
            let foveated = (*info).next.cast::<sys::SwapchainCreateInfoFoveationFB>();
            assert_eq!((*foveated).ty, sys::SwapchainCreateInfoFoveationFB::TYPE);
            ask(Asked::Swapchain { flags: (*foveated).flags.into_raw(), width: (*info).width });
            *swapchain = sys::Swapchain::from_raw(9);
        }
        sys::Result::SUCCESS
    }

    unsafe extern "system" fn list_images(
        _: sys::Swapchain,
        room: u32,
        count: *mut u32,
        images: *mut sys::SwapchainImageBaseHeader,
    ) -> sys::Result {
        // SAFETY: the caller passes room for as many images of Vulkan as it says.
        unsafe {
            *count = 3;
            for i in 0..room {
                let image = images.cast::<sys::SwapchainImageVulkanKHR>().add(i as usize);
                assert_eq!((*image).ty, sys::SwapchainImageVulkanKHR::TYPE);
                (*image).image = 10 + u64::from(i);
                let map = (*image).next.cast::<sys::SwapchainImageFoveationVulkanFB>();
                assert_eq!((*map).ty, sys::SwapchainImageFoveationVulkanFB::TYPE);
                (*map).image = 20 + u64::from(i);
            }
        }
        sys::Result::SUCCESS
    }

    const CALLS: Calls = Calls { create_profile, destroy_profile, update_swapchain };

    fn foveation() -> Result<Foveation, XrError> {
        // SAFETY: the functions above take any handle.
        unsafe { Foveation::new(CALLS, sys::Session::from_raw(5), sys::Swapchain::from_raw(6)) }
    }

    #[test]
    fn levels_are_profiles_of_the_runtime_and_a_change_is_one_call() {
        let mut foveation = foveation().unwrap();
        let create = |level| Asked::Create { session: 5, level, dynamic: 0 };
        let update = |level: u64| Asked::Update { swapchain: 6, profile: 100 + level };
        assert_eq!(asked(), [create(0), create(1), create(2), create(3), update(0)]);
        foveation.set(Level::None).unwrap();
        assert_eq!(asked(), [], "nothing changes");
        foveation.set(Level::High).unwrap();
        foveation.set(Level::Low).unwrap();
        assert_eq!((asked(), foveation.level()), (vec![update(3), update(1)], Level::Low));
        drop(foveation);
        assert_eq!(asked(), [100, 101, 102, 103].map(Asked::Destroy));
    }

    #[test]
    fn a_runtime_that_refuses_a_profile_leaves_none_behind() {
        ROOM.set(2);
        let error = foveation().err().unwrap().to_string();
        assert!(error.contains("xrCreateFoveationProfileFB"), "{error}");
        let asked = asked();
        assert_eq!(asked[2..], [Asked::Destroy(100), Asked::Destroy(101)], "{asked:?}");
    }

    #[test]
    fn a_swapchain_asks_for_density_maps_and_gets_one_an_image() {
        let info = sys::SwapchainCreateInfo {
            ty: sys::SwapchainCreateInfo::TYPE,
            next: std::ptr::null(),
            create_flags: xr::SwapchainCreateFlags::EMPTY,
            usage_flags: xr::SwapchainUsageFlags::COLOR_ATTACHMENT,
            format: 43,
            sample_count: 1,
            width: 320,
            height: 240,
            face_count: 1,
            array_size: 2,
            mip_count: 1,
        };
        // SAFETY: the functions above take any handle.
        let swapchain = unsafe { create_swapchain(new_swapchain, sys::Session::from_raw(5), info) }.unwrap();
        let flags = sys::SwapchainCreateFoveationFlagsFB::FRAGMENT_DENSITY_MAP.into_raw();
        assert_eq!((swapchain.into_raw(), asked()), (9, vec![Asked::Swapchain { flags, width: 320 }]));
        // SAFETY: as above.
        let images = unsafe { images(list_images, swapchain) }.unwrap();
        assert_eq!(images, [[10, 20], [11, 21], [12, 22]]);
    }
}
