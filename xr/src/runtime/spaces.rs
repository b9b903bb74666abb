//! The space that poses are measured in: the floor at y = 0, wherever the runtime knows it.

use super::Runtime;
use crate::XrError;
use crate::error::During;
use openxr as xr;

/// How high the eyes of a standing person are, where the runtime knows no floor, metres.
const EYE_HEIGHT: f32 = 1.6;

/// The best space that the runtime offers: local floor, stage, or local with an assumed floor.
pub(super) fn floor_space(
    runtime: &Runtime,
    session: &xr::Session<xr::Vulkan>,
) -> Result<xr::Space, XrError> {
    let offered = session.enumerate_reference_spaces().during("xrEnumerateReferenceSpaces")?;
    let create = |kind, pose| session.create_reference_space(kind, pose).during("xrCreateReferenceSpace");
    let here = xr::Posef::IDENTITY;
    if runtime.optional().local_floor && offered.contains(&xr::ReferenceSpaceType::LOCAL_FLOOR) {
        log::info!("space: local floor");
        return create(xr::ReferenceSpaceType::LOCAL_FLOOR, here);
    }
    if offered.contains(&xr::ReferenceSpaceType::STAGE) {
        log::warn!(
            "space: stage, since the runtime offers no local floor; recentring goes to the stage's middle"
        );
        return create(xr::ReferenceSpaceType::STAGE, here);
    }
    log::warn!(
        "space: local, since the runtime offers neither local floor nor stage; the floor is assumed {EYE_HEIGHT} m \
         below the head's first place"
    );
    let below = xr::Posef { position: xr::Vector3f { x: 0.0, y: -EYE_HEIGHT, z: 0.0 }, ..here };
    create(xr::ReferenceSpaceType::LOCAL, below)
}
