//! A scene in a headset: what happens in each frame.

use crate::{Content, FirstView, FrameTime, Headset, Readback, SessionState, Step, XrError};
use motes_app::headset::{Comfort, Eye, Input, Locomotion, Panel, PanelEvents, Placement, Pose};
use motes_app::time::TimeControl;
use motes_renderer::order::{OrderRequest, SortWorker};
use motes_renderer::{DrawRequest, FrameReport, Picture, RenderConfig, Renderer, Stereo, View};
use std::time::Duration;

/// What the last drawn frame showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastFrame {
    /// When it was to be shown.
    pub time: FrameTime,
    /// The eyes it was drawn for, in the stage.
    pub eyes: [Eye; 2],
    /// The same in the scene.
    pub views: [View; 2],
    /// The order it would have been drawn in, had sorting taken no time.
    pub wanted: OrderRequest,
    /// The order it was drawn in.
    pub used: OrderRequest,
}

/// A [`Content`] that is shown, with its sorter.
struct Shown {
    content: Content,
    sorter: SortWorker,
}

/// Shows a scene in a headset.
pub struct Viewer {
    renderer: Renderer,
    shown: Option<Shown>,
    locomotion: Option<Locomotion>,
    panel: Panel,
    /// How splats are drawn. `near` and `near_fade` are metres of the stage.
    pub config: RenderConfig,
    /// Comfort options.
    pub comfort: Comfort,
    /// The time of a moving scene; without it `config.time` stands still.
    pub playback: Option<TimeControl>,
    /// The order that was asked for last.
    requested: Option<OrderRequest>,
    head: Pose,
    last_time: Option<i64>,
    events: PanelEvents,
    readback: Option<Readback>,
    pictures: Option<[Picture; 2]>,
    frames: u64,
    last: Option<LastFrame>,
}

impl Viewer {
    /// For a headset's device.
    ///
    /// # Errors
    /// The driver's.
    pub fn new(headset: &dyn Headset, config: RenderConfig, comfort: Comfort) -> Result<Self, XrError> {
        Ok(Self {
            renderer: Renderer::new(headset.gpu())?,
            shown: None,
            locomotion: None,
            panel: Panel::default(),
            config,
            comfort,
            playback: None,
            requested: None,
            head: Pose::default(),
            last_time: None,
            events: PanelEvents::default(),
            readback: None,
            pictures: None,
            frames: 0,
            last: None,
        })
    }

    /// Shows a scene from its first view on. The one before goes once the device is done with it.
    ///
    /// # Errors
    /// The system gives no thread for sorting, or the device was lost.
    pub fn show(&mut self, content: Content) -> Result<(), XrError> {
        self.renderer.gpu().wait_idle()?;
        let sorter = SortWorker::new(content.scene.positions.clone()).map_err(XrError::Thread)?;
        self.shown = Some(Shown { content, sorter });
        self.requested = None;
        self.locomotion = None;
        Ok(())
    }

    /// Where the stage stands in the world; none before the head was first seen.
    pub fn placement(&self) -> Option<&Placement> {
        self.locomotion.as_ref().map(Locomotion::placement)
    }

    /// Locomotion's state; none before the head was first seen.
    pub fn locomotion(&self) -> Option<&Locomotion> {
        self.locomotion.as_ref()
    }

    /// The panel's state.
    pub fn panel(&self) -> &Panel {
        &self.panel
    }

    /// What happened at the panel in the last frame.
    pub fn panel_events(&self) -> &PanelEvents {
        &self.events
    }

    /// The head in the last drawn frame, in the stage.
    pub fn head(&self) -> &Pose {
        &self.head
    }

    /// What the last drawn frame showed.
    pub fn last_frame(&self) -> Option<&LastFrame> {
        self.last.as_ref()
    }

    /// Frames drawn so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// What the newest finished frame took.
    pub fn report(&self) -> &FrameReport {
        self.renderer.last_report()
    }

    /// Copies the eyes' images of every frame from now on, or no longer. Each such frame is waited for.
    ///
    /// # Errors
    /// Out of memory.
    pub fn read_back(&mut self, headset: &dyn Headset, wanted: bool) -> Result<(), XrError> {
        self.readback = if wanted { Some(Readback::new(headset.gpu(), headset.images())?) } else { None };
        Ok(())
    }

    /// What the eyes saw in the newest frame that was copied.
    pub fn pictures(&mut self) -> Option<[Picture; 2]> {
        self.pictures.take()
    }

    /// One step of the session's life, a frame if one is due. Says how the session ended, once it did.
    ///
    /// # Errors
    /// The runtime or the device was lost, or a choice that the device does not allow.
    pub fn step(&mut self, headset: &mut dyn Headset) -> Result<Option<SessionState>, XrError> {
        match headset.next()? {
            Step::Waiting(_) => Ok(None),
            Step::Ended(state) => Ok(Some(state)),
            Step::Frame(frame) => {
                self.frame(headset, &frame)?;
                Ok(None)
            }
        }
    }

    fn frame(&mut self, headset: &mut dyn Headset, frame: &FrameTime) -> Result<(), XrError> {
        let input = headset.input(frame)?;
        self.act(frame, &input);
        if self.events.exit {
            log::info!("the user ends the session");
            headset.request_exit()?;
        }
        if !frame.should_render || self.shown.is_none() {
            return headset.end(frame, None);
        }
        // Waits for the frame before the last; poses are located after it.
        let commands = self.renderer.begin()?;
        let Some(eyes) = headset.eyes(frame)? else {
            self.renderer.submit(commands, &[], &[])?;
            return headset.end(frame, None);
        };
        let Some(Shown { content, sorter }) = &mut self.shown else { return headset.end(frame, None) };
        self.head = Pose::between(&eyes[0].pose, &eyes[1].pose);
        let locomotion = self.locomotion.get_or_insert_with(|| {
            let FirstView { place, forward, floor_known } = content.first_view;
            Locomotion::new(Placement::looking_from(place, forward, &self.head, floor_known))
        });
        let placement = *locomotion.placement();
        let size = headset.images().size;
        let views: [View; 2] = eyes.each_ref().map(|eye| placement.view(eye, &content.scene_to_world, size));
        let units = placement.scene_units(&content.scene_to_world) as f32;
        let mut config = self.config.clone();
        config.near *= units;
        config.near_fade *= units;
        if let Some(playback) = &mut self.playback {
            let since = self.last.as_ref().map_or(0, |last| frame.display_time - last.time.display_time);
            config.time = playback.advance(Duration::from_nanos(since.max(0) as u64));
        }
        sorter.set_interval(config.sort_interval);
        let wanted = OrderRequest::new(&views, &config);
        let mut newest = sorter.newest().0.made_for.unwrap_or(wanted);
        // While the scene moves, no order is older than the one that was asked for in the frame before.
        if let (Some(requested), true) = (self.requested, content.scene.moving && config.sort_interval == 1) {
            newest = requested;
        }
        let used = headset.order(newest)?;
        let order = sorter.wait_for(used);
        let target = headset.target()?;
        let stereo = if self.renderer.gpu().capabilities.multiview && !config.sort_per_eye {
            Stereo::Multiview
        } else {
            Stereo::TwoPass
        };
        let scene = &content.scene;
        let request = DrawRequest { scene, order, views: &views, config: &config, target: &target, stereo };
        self.renderer.draw(&commands, &request)?;
        if let (Some(readback), Some(image)) = (&self.readback, headset.image()) {
            readback.record(commands.commands(), image);
            self.renderer.finish(commands)?;
            self.pictures = Some(readback.pictures());
        } else {
            self.renderer.submit(commands, &[], &[])?;
        }
        headset.end(frame, Some(&eyes))?;
        // The next order is made while the device blends this frame.
        if let Some(Shown { sorter, .. }) = &mut self.shown {
            // For the time that it will be then.
            let next = Duration::from_nanos(frame.period.max(0) as u64);
            let time = self.playback.as_ref().map_or(wanted.time, |p| p.predict(next));
            let request = OrderRequest { time, ..wanted };
            sorter.request(request);
            self.requested = Some(request);
        }
        self.frames += 1;
        self.last = Some(LastFrame { time: *frame, eyes, views, wanted, used });
        Ok(())
    }

    /// What the user does: the panel first, then locomotion with the hands that are free.
    fn act(&mut self, frame: &FrameTime, input: &Input) {
        let elapsed = self.last_time.map_or(0, |last| frame.display_time.saturating_sub(last));
        // After a pause, such as a headset taken off, nothing jumps.
        let dt = (elapsed as f64 / 1e9).clamp(0.0, 0.1);
        self.last_time = Some(frame.display_time);
        self.events = self.panel.update(input, &self.head, &self.comfort, dt);
        if let Some(locomotion) = &mut self.locomotion {
            locomotion.update(input, self.panel.busy(), &self.head, &self.comfort, dt);
        }
    }
}
