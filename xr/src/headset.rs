//! The one interface to a headset: a runtime behind it, or a recorded session.

use crate::{HiddenArea, XrError};
use motes_app::governor::Foveation;
use motes_app::headset::{ARC_DOTS, Eye, Input, Pose};
use motes_renderer::gpu::Gpu;
use motes_renderer::order::OrderRequest;
use motes_renderer::{DepthTarget, Target};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Where a session is in its life (OpenXR 1.1, section 9.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SessionState {
    /// Not ready: the headset is not worn, or another program has it.
    Idle,
    /// The runtime wants the session to begin.
    Ready,
    /// Frames are timed, and none is shown.
    Synchronized,
    /// Frames are shown; input goes to something else, such as the runtime's menu.
    Visible,
    /// Frames are shown, and input is ours.
    Focused,
    /// The runtime wants the session to end.
    Stopping,
    /// The runtime is about to lose the session.
    LossPending,
    /// The user or the runtime wants the program to end.
    Exiting,
}

impl fmt::Display for SessionState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Idle => "idle",
            Self::Ready => "ready",
            Self::Synchronized => "synchronized",
            Self::Visible => "visible",
            Self::Focused => "focused",
            Self::Stopping => "stopping",
            Self::LossPending => "loss pending",
            Self::Exiting => "exiting",
        })
    }
}

/// One frame between [`Headset::next`] and [`Headset::end`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameTime {
    /// When it will be shown, ns in the runtime's time.
    pub display_time: i64,
    /// Time between two frames, ns.
    pub period: i64,
    /// Whether anything that is drawn will be seen.
    pub should_render: bool,
    /// Whether input is ours.
    pub focused: bool,
}

/// What [`Headset::next`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// No frames are wanted now; a little time has passed.
    Waiting(SessionState),
    /// A frame has begun and must be ended.
    Frame(FrameTime),
    /// The session is over.
    Ended(SessionState),
}

/// What is to be shown, how finely and in which format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EyeImages {
    /// Width and height of an eye's image, pixels.
    pub size: [u32; 2],
    /// Format of the image, which has a layer an eye.
    pub format: ash::vk::Format,
}

/// What a quad shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// A dark rim with a clear middle of [`RIM_CLEAR`] of its width.
    Rim,
    /// A ring on the floor: where a jump lands.
    Landing,
    /// The panel, as it was last drawn.
    Panel,
}

/// Quads of a frame, at most: rim, ring and panel, and the dots of an arc. (Runtimes take 16 layers at least.)
pub const MOST_QUADS: usize = 3 + ARC_DOTS;

/// The part of a [`Surface::Rim`]'s width that is clear.
pub const RIM_CLEAR: f32 = 0.25;

/// A picture in space, on a layer of its own over the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quad {
    /// What it shows.
    pub surface: Surface,
    /// Its middle; it faces along its +z.
    pub pose: Pose,
    /// Width and height, metres.
    pub size: [f32; 2],
    /// The pose is measured from the head, which it follows, instead of in the stage.
    pub follows_head: bool,
}

/// A headset: frames to fill, eyes to see through, hands.
///
/// For each frame: [`next`](Self::next), [`input`](Self::input), then, where something is drawn,
/// [`eyes`](Self::eyes) as late as possible, [`target`](Self::target), drawing and submitting, and in any case
/// [`end`](Self::end).
pub trait Headset {
    /// The device that draws.
    fn gpu(&self) -> &Arc<Gpu>;

    /// What is to be drawn.
    fn images(&self) -> EyeImages;

    /// Follows the session's life, and waits until it is time for the next frame: this is where the thread sleeps.
    ///
    /// # Errors
    /// The runtime was lost.
    fn next(&mut self) -> Result<Step, XrError>;

    /// Hands and buttons at the moment the frame is shown.
    ///
    /// # Errors
    /// The runtime was lost.
    fn input(&mut self, frame: &FrameTime) -> Result<Input, XrError>;

    /// Both eyes at the moment the frame is shown, left first, in the stage; none while the head is not tracked.
    ///
    /// # Errors
    /// The runtime was lost.
    fn eyes(&mut self, frame: &FrameTime) -> Result<Option<[Eye; 2]>, XrError>;

    /// What nobody sees of the eyes' images, where that has become known or has changed since it was last asked.
    ///
    /// # Errors
    /// The runtime was lost.
    fn hidden(&mut self) -> Result<Option<HiddenArea>, XrError> {
        Ok(None)
    }

    /// Which order of splats the frame is drawn in, given the newest that there is. A recorded session answers with
    /// the one that was used then.
    ///
    /// # Errors
    /// A recorded session has no more.
    fn order(&mut self, newest: OrderRequest) -> Result<OrderRequest, XrError> {
        Ok(newest)
    }

    /// The image to draw the frame into; waits until the compositor has let go of it.
    ///
    /// # Errors
    /// The runtime was lost.
    fn target(&mut self) -> Result<Target, XrError>;

    /// Whether the compositor wants to know how far away pixels are.
    fn takes_depth(&self) -> bool {
        false
    }

    /// The depth image that goes with [`target`](Self::target); none where [nobody wants it](Self::takes_depth). It is shown
    /// with this frame, where the eyes are. `near`: what depth value 1 stands for, metres of the stage.
    ///
    /// # Errors
    /// The runtime was lost.
    fn depth(&mut self, _near: f32) -> Result<Option<DepthTarget>, XrError> {
        Ok(None)
    }

    /// The panel's image to draw into, of [`MENU_SIZE`](motes_app::headset::menu::MENU_SIZE); none where nobody would see
    /// it. It is shown from the end of the frame on.
    ///
    /// # Errors
    /// The runtime was lost.
    fn panel(&mut self) -> Result<Option<Target>, XrError>;

    /// The image behind [`target`](Self::target), for who wants to copy it; it is a copy's source only where that was
    /// asked for. None where no image is being drawn into.
    fn image(&self) -> Option<ash::vk::Image>;

    /// Whether the surroundings are seen where the scene is empty; none where this headset cannot show them.
    fn surroundings(&self) -> Option<bool> {
        None
    }

    /// Shows the surroundings where the scene is empty, or no longer: the background is transparent then.
    ///
    /// # Errors
    /// The runtime refuses.
    fn show_surroundings(&mut self, _shown: bool) -> Result<(), XrError> {
        Ok(())
    }

    /// How coarse the rims of the images are drawn; none where this headset does not let it be set.
    fn foveation(&self) -> Option<Foveation> {
        None
    }

    /// Draws the rims so, from the next image on.
    ///
    /// # Errors
    /// The runtime refuses.
    fn foveate(&mut self, _level: Foveation) -> Result<(), XrError> {
        Ok(())
    }

    /// Ends the frame. `shown` are the eyes that the image was drawn for; without them no scene is shown. Quads, at most
    /// [`MOST_QUADS`], lie over it in their order.
    ///
    /// # Errors
    /// The runtime was lost.
    fn end(&mut self, frame: &FrameTime, shown: Option<&[Eye; 2]>, quads: &[Quad]) -> Result<(), XrError>;

    /// Asks for the session to end; [`Headset::next`] says when it did. `false` where none is running, so that nothing
    /// has to be waited for.
    ///
    /// # Errors
    /// The runtime was lost.
    fn request_exit(&mut self) -> Result<bool, XrError>;
}
