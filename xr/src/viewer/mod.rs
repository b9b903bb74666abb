//! A scene in a headset: what happens in each frame.

mod commands;
mod overlay;
mod times;

pub use times::FrameTimes;

use crate::panel_screen::PanelScreen;
use crate::{Content, FirstView, FrameTime, Headset, HiddenArea, Readback, SessionState, Step, XrError};
use motes_app::governor::{Foveation, Governor};
use motes_app::headset::menu::HOTTEST_LAYERS;
use motes_app::headset::{
    Comfort, Eye, EyeFov, Input, Listed, Locomotion, Offered, Panel, PanelEvents, Placement, Pose,
};
use motes_app::lod::Tuning;
use motes_app::measurement::Measurement;
use motes_app::time::TimeControl;
use motes_renderer::order::{OrderRequest, SortWorker};
use motes_renderer::pipeline_cache::Kept;
use motes_renderer::{
    DrawRequest, FrameReport, Picture, RenderConfig, Renderer, Sorter, Stereo, Traffic, View,
};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use times::Clock;

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
    /// Holds a budget by drawing less exactly than `config` says, where there is one.
    pub governor: Option<Governor>,
    /// Comfort options.
    pub comfort: Comfort,
    /// The time of a moving scene, playing from `config.time` once it is shown; without it that stands still.
    pub playback: Option<TimeControl>,
    /// Layers are shown as colours where frames have any.
    pub heat: bool,
    /// SSIM that levels of detail keep, as a share of the finest level's.
    pub detail_target: f64,
    /// Where measurements are written; nowhere: none are made.
    pub measurements: Option<PathBuf>,
    measurement: Option<Measurement>,
    /// What nobody sees of the images, and the fields of view for which the renderer knows it.
    hidden: HiddenArea,
    hidden_for: Option<[EyeFov; 2]>,
    /// The order that was asked for last.
    requested: Option<OrderRequest>,
    head: Pose,
    last_time: Option<i64>,
    events: PanelEvents,
    readback: Option<Readback>,
    pictures: Option<[Picture; 2]>,
    frames: u64,
    times: FrameTimes,
    leaving: bool,
    screen: PanelScreen,
    loading: Option<f32>,
    problem: String,
    /// Scenes that the panel offers.
    offered: Vec<Listed>,
    /// The one that the user chose.
    chosen: Option<usize>,
    last: Option<LastFrame>,
    /// That frames do not know their depth was said.
    depth_missed: bool,
}

impl Viewer {
    /// For a headset's device.
    ///
    /// # Errors
    /// The driver's.
    pub fn new(headset: &dyn Headset, config: RenderConfig, comfort: Comfort) -> Result<Self, XrError> {
        let mut renderer = Renderer::new(headset.gpu())?;
        renderer.average_samples(true);
        Ok(Self {
            renderer,
            shown: None,
            locomotion: None,
            panel: Panel::default(),
            config,
            governor: None,
            comfort,
            playback: None,
            heat: false,
            detail_target: Tuning::default().target,
            measurements: None,
            measurement: None,
            hidden: HiddenArea::default(),
            hidden_for: None,
            requested: None,
            head: Pose::default(),
            last_time: None,
            events: PanelEvents::default(),
            readback: None,
            pictures: None,
            frames: 0,
            times: FrameTimes::default(),
            leaving: false,
            screen: PanelScreen::new(),
            loading: None,
            problem: String::new(),
            offered: Vec::new(),
            chosen: None,
            last: None,
            depth_missed: false,
        })
    }

    /// Makes pipelines from those kept in a folder, and keeps them there when the viewer goes.
    ///
    /// # Errors
    /// The driver's. What is wrong with the folder or a file in it is announced, and never an error.
    pub fn keep_pipelines(&mut self, folder: &Path) -> Result<Kept, XrError> {
        Ok(self.renderer.keep_pipelines(folder)?)
    }

    /// Shows a scene from its first view on. The one before goes once the device is done with it.
    ///
    /// # Errors
    /// The system gives no thread for sorting, or the device was lost.
    pub fn show(&mut self, content: Content) -> Result<(), XrError> {
        self.playback = match &content.sequence {
            Some(sequence) => Some(sequence.time_control()),
            None => content.scene.moving.then(TimeControl::default),
        };
        if let Some(playback) = &mut self.playback {
            playback.scrub(self.config.time.into());
        }
        self.locomotion = None;
        self.replace(content)
    }

    /// Shows more of the scene of which a part is shown: the user stays where they are, what they corrected stays too,
    /// and time goes on.
    ///
    /// # Errors
    /// As [`Viewer::show`].
    pub fn refine(&mut self, mut content: Content) -> Result<(), XrError> {
        let Some(Shown { content: part, .. }) = &mut self.shown else { return self.show(content) };
        if let (Some(about), Some(before)) = (&mut content.about, part.about.take()) {
            about.settings = before.settings;
            content.scene_to_world = about.settings.scene_to_world();
        }
        self.replace(content)
    }

    fn replace(&mut self, content: Content) -> Result<(), XrError> {
        self.renderer.gpu().wait_idle()?;
        let sorter = SortWorker::new(content.scene.positions.clone()).map_err(XrError::Thread)?;
        self.shown = Some(Shown { content, sorter });
        self.requested = None;
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

    /// How much of a scene is loaded, while one is: the panel tells, and comes by itself where no scene is shown yet.
    pub fn set_loading(&mut self, part: Option<f32>) {
        self.loading = part;
    }

    /// Tells the user what did not work; the panel comes by itself.
    pub fn tell(&mut self, problem: String) {
        self.problem = problem;
        self.panel.open(&self.head);
    }

    /// Scenes that the panel offers.
    pub fn offer(&mut self, scenes: &[Offered]) {
        self.offered = Listed::on(self.screen.context(), scenes);
    }

    /// The scene among the offered ones that the user chose, once.
    pub fn chosen(&mut self) -> Option<usize> {
        self.chosen.take()
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

    /// Where the processor's time went in the last drawn frame.
    pub fn times(&self) -> &FrameTimes {
        &self.times
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
            Step::Waiting(_) => {
                // The system may end the program at any time now: what was made is kept.
                self.renderer.save_pipelines();
                Ok(None)
            }
            Step::Ended(state) => Ok(Some(state)),
            Step::Frame(frame) => {
                self.frame(headset, &frame)?;
                Ok(None)
            }
        }
    }

    fn frame(&mut self, headset: &mut dyn Headset, frame: &FrameTime) -> Result<(), XrError> {
        let begun = Instant::now();
        let mut clock = Clock::start();
        let mut times = FrameTimes::default();
        self.go_on_measuring();
        let input = headset.input(frame)?;
        self.act(frame, &input);
        if self.events.exit {
            self.leave(headset)?;
        }
        if !frame.should_render {
            return headset.end(frame, None, &[]);
        }
        times.act = clock.lap();
        // Waits for the frame before the last; poses are located after it.
        let commands = self.renderer.begin()?;
        let mut foveation = Foveation::None;
        if let (Some(governor), None) = (&mut self.governor, &self.measurement) {
            governor.offer_foveation(headset.foveation().is_some());
            governor.observe(self.renderer.last_report(), &self.config);
            foveation = governor.foveation();
        }
        if headset.foveation().is_some_and(|now| now != foveation) {
            headset.foveate(foveation)?;
        }
        times.wait = clock.lap();
        self.draw_panel(headset, &commands, frame)?;
        let quads = self.quads();
        let quads = &quads.0[..quads.1];
        times.panel = clock.lap();
        let eyes = headset.eyes(frame)?;
        let (Some(eyes), Some(Shown { content, sorter })) = (eyes, &mut self.shown) else {
            if let Some(eyes) = eyes {
                self.head = Pose::between(&eyes[0].pose, &eyes[1].pose);
                if self.loading.is_some() {
                    self.panel.open(&self.head);
                }
            }
            self.renderer.submit(commands, &[], &[])?;
            return headset.end(frame, None, quads);
        };
        self.head = Pose::between(&eyes[0].pose, &eyes[1].pose);
        let locomotion = self.locomotion.get_or_insert_with(|| {
            let FirstView { place, forward, floor_known } = content.first_view;
            Locomotion::new(Placement::looking_from(place, forward, &self.head, floor_known))
        });
        let placement = *locomotion.placement();
        let size = headset.images().size;
        let views: [View; 2] = eyes.each_ref().map(|eye| placement.view(eye, &content.scene_to_world, size));
        let units = placement.scene_units(&content.scene_to_world) as f32;
        let measured = self.measurement.as_ref().and_then(Measurement::config).cloned();
        let measures = measured.is_some();
        let governed = |g: &Governor| g.apply(&self.config);
        let mut config =
            measured.or_else(|| self.governor.as_ref().map(governed)).unwrap_or_else(|| self.config.clone());
        if headset.surroundings() == Some(true) {
            // What is seen through adds nothing of its own.
            config.background = [0.0; 3];
        }
        let near = config.near;
        config.near *= units;
        config.near_fade *= units;
        let since = self.last.as_ref().map_or(0, |last| frame.display_time - last.time.display_time);
        let since = Duration::from_nanos(since.max(0) as u64);
        if let Some(playback) = &mut self.playback {
            config.time = playback.advance(if measures { Duration::ZERO } else { since });
        }
        if let Some(detail) = &mut content.detail {
            let ease = self.governor.as_ref().map_or(0.0, Governor::detail_ease);
            let tuning = Tuning { target: self.detail_target, ..Tuning::default() };
            detail.advance(&views, since.as_secs_f64(), ease, tuning);
        }
        let frame_of_sequence = match (&mut content.sequence, &self.playback) {
            (Some(sequence), Some(playback)) => {
                // Each frame is a scene of its own: its order is made where it is drawn.
                config.sorter = Sorter::Gpu;
                sequence.show(playback).map(|(_, scene)| scene)
            }
            _ => None,
        };
        sorter.set_interval(config.sort_interval);
        let wanted = OrderRequest::new(&views, &config).of_parts(&content.scene.positions);
        if let Some(hidden) = headset.hidden()? {
            self.hidden = hidden;
            self.hidden_for = None;
        }
        let fovs = eyes.each_ref().map(|eye| eye.fov);
        let stays_empty = self.hidden.is_empty() && self.hidden_for.is_some();
        if self.hidden_for != Some(fovs) && !stays_empty {
            let [left, right] = self.hidden.on_images(&eyes);
            self.renderer.hide([&left, &right])?;
            self.hidden_for = Some(fovs);
        }
        times.locate = clock.lap();
        let mut newest = sorter.newest().0.made_for.unwrap_or(wanted);
        // While the scene moves, no order is older than the one that was asked for in the frame before.
        if let (Some(requested), true) = (self.requested, content.scene.moving && config.sort_interval == 1) {
            newest = requested;
        }
        let on_processor = config.sorter == Sorter::Cpu;
        let used = headset.order(newest)?;
        let order = if on_processor { sorter.wait_for(used) } else { sorter.newest().0 };
        times.order = clock.lap();
        let mut target = headset.target()?;
        let heat = self.heat && config.sorter != Sorter::Stochastic;
        self.renderer.show_layers(heat.then_some(HOTTEST_LAYERS))?;
        // Colours that stand for layers are shifted by nothing.
        if headset.takes_depth() && !heat {
            let missed = !config.knows_depth();
            if missed && !self.depth_missed {
                log::warn!(
                    "the compositor is not told how far away pixels are: frames that are drawn so do not know it"
                );
            }
            self.depth_missed = missed;
            target.depth = if missed { None } else { headset.depth(near)? };
        }
        times.image = clock.lap();
        let stereo = if self.renderer.gpu().capabilities.multiview && !config.sort_per_eye {
            Stereo::Multiview
        } else {
            Stereo::TwoPass
        };
        let scene = frame_of_sequence.as_deref().unwrap_or(&content.scene);
        let request = DrawRequest { scene, order, views: &views, config: &config, target: &target, stereo };
        self.renderer.draw(&commands, &request)?;
        if let (Some(readback), Some(image)) = (&self.readback, headset.image()) {
            readback.record(commands.commands(), image);
            self.renderer.finish(commands)?;
            self.pictures = Some(readback.pictures());
        } else {
            self.renderer.submit(commands, &[], &[])?;
        }
        times.draw = clock.lap();
        if let Some(measurement) = &mut self.measurement {
            let report = self.renderer.last_report();
            let wall_ms = begun.elapsed().as_secs_f64() * 1e3;
            measurement.drawn(report, Traffic::of(scene, &config, report), wall_ms);
        }
        headset.end(frame, Some(&eyes), quads)?;
        // The next order is made while the device blends this frame.
        // For the time that it will be then.
        let next = Duration::from_nanos(frame.period.max(0) as u64);
        let time = self.playback.as_ref().map_or(wanted.time, |p| p.predict(next));
        let request = OrderRequest { time, ..wanted };
        if on_processor {
            sorter.request(request);
        }
        self.requested = on_processor.then_some(request);
        times.end = clock.lap();
        self.times = times;
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
