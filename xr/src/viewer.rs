//! A scene in a headset: what happens in each frame.

use crate::panel_screen::PanelScreen;
use crate::{
    Content, FirstView, FrameTime, Headset, MOST_QUADS, Quad, RIM_CLEAR, Readback, SessionState, Step,
    Surface, XrError,
};
use motes_app::governor::Governor;
use motes_app::headset::menu::{MenuCommand, MenuFacts};
use motes_app::headset::{Comfort, Eye, Input, Locomotion, PANEL_SIZE, Panel, PanelEvents, Placement, Pose};
use motes_app::measurement::{Machine, Measurement, SceneRecord};
use motes_app::time::TimeControl;
use motes_renderer::order::{OrderRequest, SortWorker};
use motes_renderer::pipeline_cache::Kept;
use motes_renderer::{
    DrawRequest, Expansion, Frame, FrameReport, PRESETS, Picture, RenderConfig, Renderer, Sorter, Stereo,
    Traffic, View,
};
use motes_scenes::settings::{Orientation, Settings};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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

/// Where the processor's time went in the last drawn frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameTimes {
    /// Reading input and acting on it.
    pub act: Duration,
    /// Waiting for the device to be done with the frame before the last.
    pub wait: Duration,
    /// Drawing the panel, where it is shown.
    pub panel: Duration,
    /// Locating the eyes and computing their views.
    pub locate: Duration,
    /// Taking the order of splats; the first one is waited for.
    pub order: Duration,
    /// Acquiring the image, and waiting for the compositor to let go of it.
    pub image: Duration,
    /// Recording and submitting the drawing.
    pub draw: Duration,
    /// Ending the frame.
    pub end: Duration,
}

impl FrameTimes {
    /// The frame loop's own: everything but waiting and drawing.
    pub fn own(&self) -> Duration {
        self.act + self.locate + self.order + self.end
    }
}

/// Time since the last look.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        now.duration_since(std::mem::replace(&mut self.0, now))
    }
}

/// Turns a quad's front, +z, upwards.
const FACING_UP: [f32; 4] = [-std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2];
/// Width of the ring that shows where a jump lands, metres.
const LANDING_WIDTH: f32 = 0.6;
/// How far in front of the eyes the dark rim is, metres.
const RIM_DISTANCE: f32 = 0.5;
/// What the rim leaves clear, degrees from the middle: at no strength, and at full.
const RIM_ANGLES: [f32; 2] = [60.0, 22.0];

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
    /// Where measurements are written; nowhere: none are made.
    pub measurements: Option<PathBuf>,
    measurement: Option<Measurement>,
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
    /// Names of scenes that the panel offers.
    offered: Vec<String>,
    /// The one that the user chose.
    chosen: Option<usize>,
    last: Option<LastFrame>,
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
            measurements: None,
            measurement: None,
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
        self.renderer.gpu().wait_idle()?;
        let sorter = SortWorker::new(content.scene.positions.clone()).map_err(XrError::Thread)?;
        self.playback = match &content.sequence {
            Some(sequence) => Some(sequence.time_control()),
            None => content.scene.moving.then(TimeControl::default),
        };
        if let Some(playback) = &mut self.playback {
            playback.scrub(self.config.time.into());
        }
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

    /// How much of a scene is loaded, while one is: the panel tells, and comes by itself where no scene is shown yet.
    pub fn set_loading(&mut self, part: Option<f32>) {
        self.loading = part;
    }

    /// Tells the user what did not work; the panel comes by itself.
    pub fn tell(&mut self, problem: String) {
        self.problem = problem;
        self.panel.open(&self.head);
    }

    /// Names of scenes that the panel offers.
    pub fn offer(&mut self, scenes: Vec<String>) {
        self.offered = scenes;
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
        if let (Some(governor), None) = (&mut self.governor, &self.measurement) {
            governor.observe(self.renderer.last_report(), &self.config);
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
        config.near *= units;
        config.near_fade *= units;
        if let Some(playback) = &mut self.playback {
            let since = self.last.as_ref().map_or(0, |last| frame.display_time - last.time.display_time);
            let passed = if measures { 0 } else { since.max(0) as u64 };
            config.time = playback.advance(Duration::from_nanos(passed));
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
        let wanted = OrderRequest::new(&views, &config);
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
        let target = headset.target()?;
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

    fn leave(&mut self, headset: &mut dyn Headset) -> Result<(), XrError> {
        if !self.leaving {
            log::info!("the user ends the session");
            self.leaving = true;
            headset.request_exit()?;
        }
        Ok(())
    }

    /// Draws the panel where it is shown, and does what is asked for on it.
    fn draw_panel(
        &mut self,
        headset: &mut dyn Headset,
        commands: &Frame,
        frame: &FrameTime,
    ) -> Result<(), XrError> {
        if !self.panel.shown() {
            return Ok(());
        }
        let about = self.shown.as_ref().and_then(|shown| shown.content.about.as_ref());
        let facts = MenuFacts {
            scene: about.map_or("", |about| about.name.as_str()),
            splats: self.shown.as_ref().map_or(0, |shown| shown.content.scene.splats),
            loading: self.loading,
            frame_seconds: frame.period as f64 / 1e9,
            report: self.renderer.last_report().clone(),
            settings: about.map(|about| &about.settings),
            governor: self.governor.as_ref(),
            time: self.playback.as_ref(),
            measuring: self.measurement.as_ref().map(Measurement::progress),
            scenes: &self.offered,
            problem: &self.problem,
        };
        let seconds = frame.display_time as f64 / 1e9;
        let (events, comfort) = (&self.events, &self.comfort);
        let asked = self.screen.draw(headset, commands.commands(), events, &facts, comfort, seconds)?;
        for command in asked {
            self.obey(headset, command)?;
        }
        Ok(())
    }

    fn obey(&mut self, headset: &mut dyn Headset, command: MenuCommand) -> Result<(), XrError> {
        self.problem.clear();
        match command {
            MenuCommand::Exit => self.leave(headset)?,
            MenuCommand::Recentre => {
                if let Some(locomotion) = &mut self.locomotion {
                    locomotion.recentre(&self.head);
                }
            }
            MenuCommand::Reset => {
                if let Some(locomotion) = &mut self.locomotion {
                    locomotion.reset();
                }
            }
            MenuCommand::Preset(i) => self.take_preset(i),
            MenuCommand::Comfort(comfort) => self.comfort = comfort,
            MenuCommand::Budget(budget) => match (budget, &mut self.governor) {
                (Some(budget), Some(governor)) => governor.set_budget(budget),
                (budget, governor) => *governor = budget.map(Governor::new),
            },
            MenuCommand::Up(axis) => self.change(|settings| settings.orientation = Orientation::Up(axis)),
            MenuCommand::Scale(scale) => self.change(|settings| settings.scale = scale.clamp(1e-6, 1e6)),
            MenuCommand::Save => self.save(),
            MenuCommand::Open(scene) => self.chosen = Some(scene),
            MenuCommand::Measure => self.measure(),
            MenuCommand::Time(command) => {
                if let Some(playback) = &mut self.playback {
                    playback.obey(command);
                }
            }
        }
        Ok(())
    }

    /// Begins to measure the device on the scene that is shown, configuration by configuration; what is measured goes into
    /// a folder of its own in [`Viewer::measurements`].
    pub fn measure(&mut self) {
        let Some(Shown { content, .. }) = &self.shown else { return };
        if self.measurements.is_none() {
            self.problem = "There is no folder for measurements".into();
            return;
        }
        let scene = SceneRecord {
            scene: content.about.as_ref().map_or_else(|| "a scene".to_owned(), |about| about.name.clone()),
            splats: content.scene.splats,
            sh_degree: content.scene.packing.sh_degree,
            moving: content.scene.moving,
            only: None,
        };
        let machine = Machine::here(&self.renderer.gpu().capabilities);
        match Measurement::new(machine, scene, &self.config) {
            Ok(measurement) => self.measurement = Some(measurement),
            Err(problem) => self.problem = problem,
        }
    }

    /// Passes over what the device cannot draw, and writes down what is finished.
    fn go_on_measuring(&mut self) {
        let Some(measurement) = &mut self.measurement else { return };
        let capabilities = &self.renderer.gpu().capabilities;
        while let Some(Err(error)) = measurement.config().map(|config| config.check(2, capabilities)) {
            measurement.refused(error.to_string());
        }
        if measurement.config().is_some() {
            return;
        }
        let folder = self.measurements.as_deref();
        self.problem = match folder.map(|folder| measurement.save(folder)) {
            Some(Ok(written)) => format!("Measured: {}", written.display()),
            Some(Err(error)) => format!("The measurement cannot be written: {error}"),
            None => String::new(),
        };
        log::info!("{}", self.problem);
        self.measurement = None;
    }

    /// Whether a measurement goes on.
    pub fn measuring(&self) -> bool {
        self.measurement.is_some()
    }

    /// A preset, where the device can draw two views by it.
    fn take_preset(&mut self, preset: usize) {
        let Some(preset) = PRESETS.get(preset) else { return };
        let mut config = (preset.config)();
        if config.expansion == Expansion::Geometry {
            config.expansion = Expansion::Instanced;
            self.problem = "The geometry stage draws one eye only: splats are expanded in instances".into();
        }
        match config.check(2, &self.renderer.gpu().capabilities) {
            Ok(()) => self.config = config,
            Err(error) => self.problem = error.to_string(),
        }
    }

    /// Corrects how the scene stands in the world. The user stays where the first view is.
    fn change(&mut self, change: impl FnOnce(&mut Settings)) {
        let Some(Shown { content, .. }) = &mut self.shown else { return };
        let Some(about) = &mut content.about else { return };
        let before = content.scene_to_world.inverse();
        change(&mut about.settings);
        content.scene_to_world = about.settings.scene_to_world();
        let moved = content.scene_to_world * before;
        let view = &mut content.first_view;
        view.place = moved.transform_point3(view.place);
        view.forward = moved.transform_vector3(view.forward);
        self.locomotion = None;
    }

    fn save(&mut self) {
        let about = self.shown.as_ref().and_then(|shown| shown.content.about.as_ref());
        let Some(about) = about else { return };
        let result = match &about.path {
            Some(path) => about.settings.save(path).map_err(|error| error.to_string()),
            None => Err("The sample's settings cannot be changed".to_owned()),
        };
        match result {
            Ok(()) => log::info!("the settings of {} are saved", about.name),
            Err(problem) => self.problem = problem,
        }
    }

    /// What lies over the scene: the ring of a landing place, and the dark rim.
    fn quads(&self) -> ([Quad; MOST_QUADS], usize) {
        let nothing =
            Quad { surface: Surface::Rim, pose: Pose::default(), size: [0.0; 2], follows_head: true };
        let (mut quads, mut count) = ([nothing; MOST_QUADS], 0);
        if let Some(locomotion) = &self.locomotion {
            if let Some(landing) = locomotion.landing() {
                let place = locomotion.placement().to_stage(landing);
                quads[count] = Quad {
                    surface: Surface::Landing,
                    pose: Pose { orientation: FACING_UP, position: place.to_array().map(|v| v as f32) },
                    size: [LANDING_WIDTH; 2],
                    follows_head: false,
                };
                count += 1;
            }
            let rim = locomotion.vignette() as f32;
            if rim > 0.01 {
                let [widest, narrowest] = RIM_ANGLES;
                let clear = (widest + (narrowest - widest) * rim).to_radians();
                let width = 2.0 * RIM_DISTANCE * clear.tan() / RIM_CLEAR;
                let position = [0.0, 0.0, -RIM_DISTANCE];
                quads[count] = Quad {
                    surface: Surface::Rim,
                    pose: Pose { position, ..Pose::default() },
                    size: [width; 2],
                    follows_head: true,
                };
                count += 1;
            }
        }
        // On top: neither rim nor ring covers it.
        if self.panel.shown() && self.screen.has_picture() {
            let size = PANEL_SIZE.map(|side| side as f32);
            let pose = *self.panel.pose();
            quads[count] = Quad { surface: Surface::Panel, pose, size, follows_head: false };
            count += 1;
        }
        (quads, count)
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
