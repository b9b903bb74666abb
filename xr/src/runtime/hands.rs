//! Where the joints of the hands are (`XR_EXT_hand_tracking`).

use super::actions::from_xr;
use crate::XrError;
use crate::error::During;
use motes_app::headset::Joints;
use openxr as xr;

/// Trackers of both hands, left first.
pub(super) struct Hands([xr::HandTracker; 2]);

impl Hands {
    /// Begins to track.
    ///
    /// # Errors
    /// The runtime refuses.
    pub fn new(session: &xr::Session<xr::Vulkan>) -> Result<Self, XrError> {
        let tracker = |hand| session.create_hand_tracker(hand).during("xrCreateHandTrackerEXT");
        Ok(Self([tracker(xr::Hand::LEFT)?, tracker(xr::Hand::RIGHT)?]))
    }

    /// The joints of each hand that is seen.
    pub fn locate(&self, space: &xr::Space, time: xr::Time) -> Result<[Option<Joints>; 2], XrError> {
        let mut found = [None; 2];
        for (found, tracker) in found.iter_mut().zip(&self.0) {
            let joints = space.locate_hand_joints(tracker, time).during("xrLocateHandJointsEXT")?;
            *found = joints.and_then(|joints| needed(&joints));
        }
        Ok(found)
    }
}

/// What is needed of a hand, where all of it is known.
fn needed(joints: &xr::HandJointLocations) -> Option<Joints> {
    let known = xr::SpaceLocationFlags::POSITION_VALID | xr::SpaceLocationFlags::ORIENTATION_VALID;
    let at = |joint: xr::HandJoint| {
        let location = joints.get(joint.into_raw() as usize)?;
        location.location_flags.contains(known).then(|| from_xr(location.pose))
    };
    Some(Joints {
        palm: at(xr::HandJoint::PALM)?,
        knuckle: at(xr::HandJoint::INDEX_PROXIMAL)?,
        tips: [at(xr::HandJoint::THUMB_TIP)?.position, at(xr::HandJoint::INDEX_TIP)?.position],
    })
}
