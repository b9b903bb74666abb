//! A session: its life, its frames.

use super::actions::{Actions, from_xr, to_xr};
use super::swapchain::EyeSwapchain;
use super::{Runtime, STEREO, spaces};
use crate::bindings::Bindings;
use crate::error::During;
use crate::{EyeImages, FrameTime, Headset, SessionState, Step, XrError};
use ash::vk::{self, Handle as _};
use motes_app::headset::{Eye, EyeFov, Input};
use motes_renderer::Target;
use motes_renderer::gpu::Gpu;
use openxr as xr;
use openxr::sys;
use std::mem::MaybeUninit;
use std::sync::Arc;
use std::time::Duration;

/// How often events are looked at while no frames are wanted.
const IDLE: Duration = Duration::from_millis(10);

/// How a session is set up.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// Size of the eyes' images over the runtime's recommendation, a side.
    pub resolution_scale: f32,
    /// Everything on the other hand.
    pub left_handed: bool,
    /// Changes to the default bindings.
    pub bindings: Bindings,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self { resolution_scale: 1.0, left_handed: false, bindings: Bindings::default() }
    }
}

/// A headset behind a real runtime.
pub struct RuntimeHeadset {
    // In this order they are destroyed: what belongs to the session, the session, the device, the runtime.
    eyes: EyeSwapchain,
    space: xr::Space,
    actions: Actions,
    stream: xr::FrameStream<xr::Vulkan>,
    waiter: xr::FrameWaiter,
    session: xr::Session<xr::Vulkan>,
    gpu: Arc<Gpu>,
    runtime: Runtime,
    events: Box<xr::EventDataBuffer>,
    state: SessionState,
    running: bool,
}

impl RuntimeHeadset {
    /// Creates device, session, images and actions. Frames come from [`Headset::next`] once the runtime wants them.
    ///
    /// # Errors
    /// The runtime's or the driver's.
    pub fn new(runtime: Runtime, options: &SessionOptions) -> Result<Self, XrError> {
        let gpu = runtime.gpu()?;
        let info = xr::vulkan::SessionCreateInfo {
            instance: gpu.instance().handle().as_raw() as _,
            physical_device: gpu.physical().as_raw() as _,
            device: gpu.device().handle().as_raw() as _,
            queue_family_index: gpu.queue_family(),
            queue_index: 0,
        };
        let guard = Box::new(gpu.clone());
        let created = {
            let _queue = gpu.queue();
            // SAFETY: the handles are of the device that the runtime made; the guard keeps it until the session is gone.
            unsafe { runtime.instance.create_session_with_guard::<xr::Vulkan>(runtime.system, &info, guard) }
        };
        let (session, waiter, stream) = created.during("xrCreateSession")?;
        let space = spaces::floor_space(&runtime, &session)?;
        let defaults = Bindings::defaults(options.left_handed);
        let bindings = defaults.clone().with(&options.bindings);
        let actions = Actions::new(&runtime, &session, &bindings, &defaults)?;
        let size = runtime.image_size(options.resolution_scale)?;
        let eyes = EyeSwapchain::new(&runtime, &gpu, &session, size)?;
        Ok(Self {
            eyes,
            space,
            actions,
            stream,
            waiter,
            session,
            gpu,
            runtime,
            events: Box::new(xr::EventDataBuffer::new()),
            state: SessionState::Idle,
            running: false,
        })
    }

    /// The runtime.
    pub fn runtime(&self) -> &Runtime {
        &self.runtime
    }

    /// Where the session is in its life.
    pub fn state(&self) -> SessionState {
        self.state
    }

    fn enter(&mut self, state: SessionState) {
        log::info!("session: {} -> {state}", self.state);
        self.state = state;
    }

    /// Follows all events; says how the session ended, if it did.
    fn follow_events(&mut self) -> Result<Option<SessionState>, XrError> {
        while let Some(event) = self.runtime.instance.poll_event(&mut self.events).during("xrPollEvent")? {
            match event {
                xr::Event::SessionStateChanged(event) => {
                    let state = event.state();
                    if let Some(ended) = self.follow_state(state)? {
                        return Ok(Some(ended));
                    }
                }
                xr::Event::InstanceLossPending(_) => {
                    self.enter(SessionState::LossPending);
                    return Ok(Some(SessionState::LossPending));
                }
                xr::Event::EventsLost(lost) => {
                    log::warn!("{} events of the runtime were lost", lost.lost_event_count());
                }
                xr::Event::ReferenceSpaceChangePending(_) => {
                    log::info!("the user recentred by the runtime's own means");
                }
                xr::Event::InteractionProfileChanged(_) => {
                    let [left, right] = self.actions.profiles(&self.runtime, &self.session);
                    log::info!("controllers: left {left}, right {right}");
                }
                xr::Event::DisplayRefreshRateChangedFB(event) => {
                    log::info!("display: {} Hz", event.to_display_refresh_rate());
                }
                _ => {}
            }
        }
        Ok(None)
    }

    fn follow_state(&mut self, state: xr::SessionState) -> Result<Option<SessionState>, XrError> {
        match state {
            xr::SessionState::IDLE => self.enter(SessionState::Idle),
            xr::SessionState::READY => {
                self.enter(SessionState::Ready);
                self.session.begin(STEREO).during("xrBeginSession")?;
                self.running = true;
            }
            xr::SessionState::SYNCHRONIZED => self.enter(SessionState::Synchronized),
            xr::SessionState::VISIBLE => self.enter(SessionState::Visible),
            xr::SessionState::FOCUSED => self.enter(SessionState::Focused),
            xr::SessionState::STOPPING => {
                self.enter(SessionState::Stopping);
                self.running = false;
                self.session.end().during("xrEndSession")?;
            }
            xr::SessionState::EXITING => {
                self.enter(SessionState::Exiting);
                return Ok(Some(SessionState::Exiting));
            }
            xr::SessionState::LOSS_PENDING => {
                self.enter(SessionState::LossPending);
                return Ok(Some(SessionState::LossPending));
            }
            other => log::warn!("the runtime names a state that is not known: {other:?}"),
        }
        Ok(None)
    }

    /// Both eyes, without the vector that the crate's own call returns: nothing is allocated in a frame.
    fn locate(&self, time: xr::Time) -> Result<(sys::ViewStateFlags, [sys::View; 2]), XrError> {
        let info = sys::ViewLocateInfo {
            ty: sys::ViewLocateInfo::TYPE,
            next: std::ptr::null(),
            view_configuration_type: STEREO,
            display_time: time,
            space: self.space.as_raw(),
        };
        let empty = sys::View {
            ty: sys::View::TYPE,
            next: std::ptr::null_mut(),
            pose: xr::Posef::IDENTITY,
            fov: xr::Fovf::default(),
        };
        let mut views = [empty; 2];
        let mut count = 0;
        let mut state: MaybeUninit<sys::ViewState> = sys::ViewState::out(std::ptr::null_mut());
        // SAFETY: the arrays hold as many as they say; the state is written by a call that succeeds.
        let (result, flags) = unsafe {
            let calls = self.runtime.instance.fp();
            let result = (calls.locate_views)(
                self.session.as_raw(),
                &info,
                state.as_mut_ptr(),
                views.len() as u32,
                &mut count,
                views.as_mut_ptr(),
            );
            let flags = if result.into_raw() >= 0 {
                state.assume_init().view_state_flags
            } else {
                sys::ViewStateFlags::EMPTY
            };
            (result, flags)
        };
        if result.into_raw() < 0 {
            return Err(result).during("xrLocateViews");
        }
        Ok((flags, views))
    }
}

impl Headset for RuntimeHeadset {
    fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    fn images(&self) -> EyeImages {
        EyeImages { size: self.eyes.size, format: self.eyes.format }
    }

    fn next(&mut self) -> Result<Step, XrError> {
        if let Some(ended) = self.follow_events()? {
            return Ok(Step::Ended(ended));
        }
        if !self.running {
            std::thread::sleep(IDLE);
            return Ok(Step::Waiting(self.state));
        }
        let state = self.waiter.wait().during("xrWaitFrame")?;
        {
            let _queue = self.gpu.queue();
            self.stream.begin().during("xrBeginFrame")?;
        }
        Ok(Step::Frame(FrameTime {
            display_time: state.predicted_display_time.as_nanos(),
            period: state.predicted_display_period.as_nanos(),
            should_render: state.should_render,
            focused: self.state == SessionState::Focused,
        }))
    }

    fn input(&mut self, frame: &FrameTime) -> Result<Input, XrError> {
        self.actions.read(&self.session, &self.space, xr::Time::from_nanos(frame.display_time))
    }

    fn eyes(&mut self, frame: &FrameTime) -> Result<Option<[Eye; 2]>, XrError> {
        let (flags, views) = self.locate(xr::Time::from_nanos(frame.display_time))?;
        let valid = sys::ViewStateFlags::POSITION_VALID | sys::ViewStateFlags::ORIENTATION_VALID;
        if !flags.contains(valid) {
            return Ok(None);
        }
        Ok(Some(views.map(|view| {
            let fov = view.fov;
            Eye {
                pose: from_xr(view.pose),
                fov: EyeFov {
                    left: fov.angle_left,
                    right: fov.angle_right,
                    up: fov.angle_up,
                    down: fov.angle_down,
                },
            }
        })))
    }

    fn target(&mut self) -> Result<Target, XrError> {
        self.eyes.acquire()
    }

    fn image(&self) -> Option<vk::Image> {
        self.eyes.current()
    }

    fn end(&mut self, frame: &FrameTime, shown: Option<&[Eye; 2]>) -> Result<(), XrError> {
        self.eyes.release()?;
        let time = xr::Time::from_nanos(frame.display_time);
        let opaque = xr::EnvironmentBlendMode::OPAQUE;
        let Some(shown) = shown else {
            let _queue = self.gpu.queue();
            return self.stream.end(time, opaque, &[]).during("xrEndFrame");
        };
        let [width, height] = self.eyes.size.map(|side| side as i32);
        let rectangle =
            xr::Rect2Di { offset: xr::Offset2Di { x: 0, y: 0 }, extent: xr::Extent2Di { width, height } };
        let view = |i: usize| {
            let Eye { pose, fov } = &shown[i];
            xr::CompositionLayerProjectionView::new()
                .pose(to_xr(pose))
                .fov(xr::Fovf {
                    angle_left: fov.left,
                    angle_right: fov.right,
                    angle_up: fov.up,
                    angle_down: fov.down,
                })
                .sub_image(
                    xr::SwapchainSubImage::new()
                        .swapchain(&self.eyes.swapchain)
                        .image_array_index(i as u32)
                        .image_rect(rectangle),
                )
        };
        let views = [view(0), view(1)];
        let projection = xr::CompositionLayerProjection::new().space(&self.space).views(&views);
        let _queue = self.gpu.queue();
        self.stream.end(time, opaque, &[&projection]).during("xrEndFrame")
    }

    fn request_exit(&mut self) -> Result<(), XrError> {
        if !self.running {
            // Nothing to wait for: a session that is not running is simply let go.
            return Ok(());
        }
        self.session.request_exit().during("xrRequestExitSession")
    }
}
