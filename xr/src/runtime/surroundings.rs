//! The surroundings as the headset's cameras see them (`XR_FB_passthrough`).
//!
//! No runtime that runs without a headset offers it: that it is absent is tested, and what is drawn for it; showing it
//! is not.

use crate::XrError;
use crate::error::During;
use openxr as xr;
use openxr::sys;
use openxr::sys::Handle as _;

/// The cameras' picture, shown for as long as this lives.
pub(super) struct Surroundings {
    // In this order they go.
    raw: sys::CompositionLayerPassthroughFB,
    _layer: xr::PassthroughLayerFB,
    _feature: xr::Passthrough,
}

impl Surroundings {
    /// Turns it on.
    ///
    /// # Errors
    /// This headset does not have it, or the user has forbidden it.
    pub fn new(session: &xr::Session<xr::Vulkan>) -> Result<Self, XrError> {
        let running = xr::PassthroughFlagsFB::IS_RUNNING_AT_CREATION;
        let feature = session.create_passthrough(running).during("xrCreatePassthroughFB")?;
        let purpose = xr::PassthroughLayerPurposeFB::RECONSTRUCTION;
        let layer = session
            .create_passthrough_layer(&feature, running, purpose)
            .during("xrCreatePassthroughLayerFB")?;
        let raw = sys::CompositionLayerPassthroughFB {
            ty: sys::CompositionLayerPassthroughFB::TYPE,
            next: std::ptr::null(),
            flags: xr::CompositionLayerFlags::BLEND_TEXTURE_SOURCE_ALPHA,
            space: sys::Space::NULL,
            layer_handle: layer.as_raw(),
        };
        Ok(Self { raw, _layer: layer, _feature: feature })
    }

    /// The layer behind all others.
    pub fn layer(&self) -> &xr::CompositionLayerBase<'_, xr::Vulkan> {
        // SAFETY: every layer begins with the base's fields, and the base is nothing but them; the handle lives as long.
        unsafe { &*(&raw const self.raw).cast() }
    }
}
