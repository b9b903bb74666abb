//! A session: its life, its frames.

use super::actions::{Actions, from_xr, to_xr};
use super::depth::{Depth, depth_infos};
use super::foveation::{Calls, Foveation};
use super::hands::Hands;
use super::surfaces::{Surfaces, tune};
use super::surroundings::Surroundings;
use super::swapchain::{Images, Wish};
use super::{Runtime, STEREO, spaces};
use crate::bindings::Bindings;
use crate::error::During;
use crate::{EyeImages, FrameTime, Headset, HiddenArea, MOST_QUADS, Quad, SessionState, Step, XrError};
use ash::vk::{self, Handle as _};
use motes_app::governor::Foveation as Level;
use motes_app::headset::{Eye, EyeFov, Input, Pinches};
use motes_renderer::gpu::Gpu;
use motes_renderer::{DepthTarget, Target};
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
    /// Draws what the lenses' rims hide, too: for those who look at the images by another way.
    pub whole_images: bool,
    /// Frames a second that are asked for, of the display's rates the nearest; what the runtime chooses without.
    pub refresh_rate: Option<f32>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            resolution_scale: 1.0,
            left_handed: false,
            bindings: Bindings::default(),
            whole_images: false,
            refresh_rate: None,
        }
    }
}

/// A headset behind a real runtime.
pub struct RuntimeHeadset {
    // In this order they are destroyed: what belongs to the session, the session, the device, the runtime.
    /// Of the eyes' images.
    foveation: Option<Foveation>,
    eyes: Images,
    depth: Option<Depth>,
    surfaces: Surfaces,
    surroundings: Option<Surroundings>,
    space: xr::Space,
    head: xr::Space,
    actions: Actions,
    hands: Option<Hands>,
    pinches: Pinches,
    left_handed: bool,
    stream: xr::FrameStream<xr::Vulkan>,
    waiter: xr::FrameWaiter,
    session: xr::Session<xr::Vulkan>,
    gpu: Arc<Gpu>,
    runtime: Runtime,
    events: Box<xr::EventDataBuffer>,
    state: SessionState,
    running: bool,
    /// What the rims hide is to be asked for.
    mask_due: bool,
    whole_images: bool,
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
        let foveation = runtime.foveation_calls(&gpu);
        let wish = Wish { size, layers: 2, still: false, foveated: foveation.is_some() };
        let eyes = Images::new(&runtime, &gpu, &session, &wish)?;
        // SAFETY: the swapchain was made for it, and both go after it.
        let foveate = |calls| unsafe { Foveation::new(calls, session.as_raw(), eyes.swapchain.as_raw()) };
        let foveation = foveation.map(foveate).transpose()?;
        let depth = Depth::new(&runtime, &gpu, &session, size)?;
        let surfaces = Surfaces::new(&runtime, &gpu, &session)?;
        let head = session
            .create_reference_space(xr::ReferenceSpaceType::VIEW, xr::Posef::IDENTITY)
            .during("xrCreateReferenceSpace")?;
        tune(&runtime, &session, options.refresh_rate);
        let hands = match runtime.optional().hand_tracking {
            true => Some(Hands::new(&session)?),
            false => None,
        };
        let mask_due = runtime.optional().visibility_mask && !options.whole_images;
        Ok(Self {
            foveation,
            eyes,
            depth,
            surfaces,
            surroundings: None,
            space,
            head,
            actions,
            hands,
            pinches: Pinches::default(),
            left_handed: options.left_handed,
            stream,
            waiter,
            session,
            gpu,
            runtime,
            events: Box::new(xr::EventDataBuffer::new()),
            state: SessionState::Idle,
            running: false,
            mask_due,
            whole_images: options.whole_images,
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
                xr::Event::VisibilityMaskChangedKHR(_) => {
                    log::info!("what the lenses' rims hide has changed");
                    self.mask_due = !self.whole_images;
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
        let time = xr::Time::from_nanos(frame.display_time);
        let mut input = self.actions.read(&self.session, &self.space, time)?;
        if let (Some(hands), true) = (&self.hands, frame.focused) {
            let joints = hands.locate(&self.space, time)?;
            self.pinches.add_to(&mut input, joints, self.left_handed);
        }
        Ok(input)
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

    fn hidden(&mut self) -> Result<Option<HiddenArea>, XrError> {
        if !std::mem::take(&mut self.mask_due) {
            return Ok(None);
        }
        let kind = xr::VisibilityMaskTypeKHR::HIDDEN_TRIANGLE_MESH;
        let mesh = |eye| {
            let mesh = self.session.get_visibility_mask_khr(STEREO, eye, kind);
            mesh.during("xrGetVisibilityMaskKHR").map(|mesh| {
                let corners: Vec<[f32; 2]> = mesh.vertices.iter().map(|v| [v.x, v.y]).collect();
                (corners, mesh.indices)
            })
        };
        let [left, right] = [mesh(0)?, mesh(1)?];
        let area = HiddenArea::of_meshes([(&left.0, &left.1), (&right.0, &right.1)]);
        let triangles = area.0.each_ref().map(|corners| corners.len() / 3);
        log::info!("hidden by the lenses' rims: {triangles:?} triangles");
        Ok(Some(area))
    }

    fn target(&mut self) -> Result<Target, XrError> {
        let background_alpha = if self.surroundings.is_some() { 0.0 } else { 1.0 };
        Ok(Target { background_alpha, ..self.eyes.acquire()? })
    }

    fn takes_depth(&self) -> bool {
        self.depth.is_some()
    }

    fn depth(&mut self, near: f32) -> Result<Option<DepthTarget>, XrError> {
        self.depth.as_mut().map(|depth| depth.acquire(near)).transpose()
    }

    fn foveation(&self) -> Option<Level> {
        self.foveation.as_ref().map(Foveation::level)
    }

    fn foveate(&mut self, level: Level) -> Result<(), XrError> {
        self.foveation.as_mut().map_or(Ok(()), |foveation| foveation.set(level))
    }

    fn surroundings(&self) -> Option<bool> {
        self.runtime.optional().passthrough.then_some(self.surroundings.is_some())
    }

    fn show_surroundings(&mut self, shown: bool) -> Result<(), XrError> {
        self.surroundings = None;
        if shown && self.runtime.optional().passthrough {
            self.surroundings = Some(Surroundings::new(&self.session)?);
        }
        Ok(())
    }

    fn panel(&mut self) -> Result<Option<Target>, XrError> {
        self.surfaces.panel().acquire().map(Some)
    }

    fn image(&self) -> Option<vk::Image> {
        self.eyes.current()
    }

    fn end(&mut self, frame: &FrameTime, shown: Option<&[Eye; 2]>, quads: &[Quad]) -> Result<(), XrError> {
        self.eyes.release()?;
        let near = self.depth.as_mut().map(Depth::release).transpose()?.flatten();
        self.surfaces.panel().release()?;
        let time = xr::Time::from_nanos(frame.display_time);
        let depths = match (&self.depth, near) {
            (Some(depth), Some(near)) => Some(depth_infos(depth.images(), near)),
            _ => None,
        };
        let mut projected = shown.map(|eyes| [0, 1].map(|i| projection_view(&self.eyes, &eyes[i], i as u32)));
        if let (Some(views), Some(depths)) = (&mut projected, &depths) {
            for (view, depth) in views.iter_mut().zip(depths) {
                let mut raw = *view.as_raw();
                raw.next = std::ptr::from_ref(depth).cast();
                // SAFETY: the depth's description lives until the frame is ended below.
                *view = unsafe { xr::CompositionLayerProjectionView::from_raw(raw) };
            }
        }
        let mut projection = xr::CompositionLayerProjection::new().space(&self.space);
        let settings = sharpening();
        let behind = self.surroundings.as_ref().map(Surroundings::layer);
        if behind.is_some() {
            // Colours are premultiplied, as this flag takes them to be.
            projection = projection.layer_flags(xr::CompositionLayerFlags::BLEND_TEXTURE_SOURCE_ALPHA);
        }
        if let Some(views) = &projected {
            projection = projection.views(views);
            if self.runtime.optional().layer_settings {
                let mut raw = projection.into_raw();
                raw.next = std::ptr::from_ref(&settings).cast();
                // SAFETY: views and settings live until the frame is ended below.
                projection = unsafe { xr::CompositionLayerProjection::from_raw(raw) };
            }
        }
        let mut pictures: [_; MOST_QUADS] = std::array::from_fn(|_| xr::CompositionLayerQuad::new());
        let mut layers: [&xr::CompositionLayerBase<'_, xr::Vulkan>; 2 + MOST_QUADS] =
            std::array::from_fn(|_| &*projection);
        let mut count = 0;
        if let Some(behind) = behind {
            layers[0] = behind;
            count = 1;
        }
        count += usize::from(projected.is_some());
        for (picture, quad) in pictures.iter_mut().zip(quads) {
            let space = if quad.follows_head { &self.head } else { &self.space };
            *picture = quad_layer(self.surfaces.swapchain(quad.surface), space, quad);
        }
        for picture in pictures.iter().take(quads.len()) {
            layers[count] = picture;
            count += 1;
        }
        let _queue = self.gpu.queue();
        let opaque = xr::EnvironmentBlendMode::OPAQUE;
        self.stream.end(time, opaque, &layers[..count]).during("xrEndFrame")
    }

    fn request_exit(&mut self) -> Result<bool, XrError> {
        if self.running {
            self.session.request_exit().during("xrRequestExitSession")?;
        }
        Ok(self.running)
    }
}

impl Runtime {
    /// The functions that set foveation; none where nobody asked for it, or runtime or device lack it.
    fn foveation_calls(&self, gpu: &Gpu) -> Option<Calls> {
        let calls = Calls::of(&self.instance)?;
        if !gpu.capabilities.density_map {
            log::warn!(
                "{} has no VK_EXT_fragment_density_map for plain images: rims are drawn as finely as the middle",
                gpu.capabilities.device
            );
            return None;
        }
        Some(calls)
    }
}

fn projection_view<'a>(
    images: &'a Images,
    eye: &Eye,
    layer: u32,
) -> xr::CompositionLayerProjectionView<'a, xr::Vulkan> {
    let fov = &eye.fov;
    xr::CompositionLayerProjectionView::new()
        .pose(to_xr(&eye.pose))
        .fov(xr::Fovf {
            angle_left: fov.left,
            angle_right: fov.right,
            angle_up: fov.up,
            angle_down: fov.down,
        })
        .sub_image(part(images, layer))
}

fn quad_layer<'a>(
    images: &'a Images,
    space: &'a xr::Space,
    quad: &Quad,
) -> xr::CompositionLayerQuad<'a, xr::Vulkan> {
    let [width, height] = quad.size;
    xr::CompositionLayerQuad::new()
        .layer_flags(xr::CompositionLayerFlags::BLEND_TEXTURE_SOURCE_ALPHA)
        .space(space)
        .eye_visibility(xr::EyeVisibility::BOTH)
        .sub_image(part(images, 0))
        .pose(to_xr(&quad.pose))
        .size(xr::Extent2Df { width, height })
}

/// A layer of a swapchain, all of it.
pub(super) fn part(images: &Images, layer: u32) -> xr::SwapchainSubImage<'_, xr::Vulkan> {
    let [width, height] = images.size.map(|side| side as i32);
    let offset = xr::Offset2Di { x: 0, y: 0 };
    xr::SwapchainSubImage::new()
        .swapchain(&images.swapchain)
        .image_array_index(layer)
        .image_rect(xr::Rect2Di { offset, extent: xr::Extent2Di { width, height } })
}

/// The compositor sharpens and filters what it resamples.
fn sharpening() -> sys::CompositionLayerSettingsFB {
    sys::CompositionLayerSettingsFB {
        ty: sys::CompositionLayerSettingsFB::TYPE,
        next: std::ptr::null(),
        layer_flags: sys::CompositionLayerSettingsFlagsFB::NORMAL_SHARPENING
            | sys::CompositionLayerSettingsFlagsFB::NORMAL_SUPER_SAMPLING,
    }
}
