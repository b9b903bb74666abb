//! The viewer on a flat screen: the scene that is shown, the eye, time, the order of splats. It knows no windows: they
//! hand it motions and commands, and draw the frames that it describes.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;
use motes_renderer::gpu::Gpu;
use motes_renderer::order::{OrderRequest, SortWorker, SplatOrder};
use motes_renderer::plan::{Overrides, Plan};
use motes_renderer::{Expansion, FrameReport, Packing, RenderConfig, SceneOnDevice, Sorter, View};
use motes_scenes::Format;
use motes_scenes::settings::Settings;

use crate::eye::{Eye, EyeMode, EyeMotion};
use crate::framing::Framing;
use crate::governor::Governor;
use crate::loader::{LoadError, LoadRequest, Loaded, Loader, Loading, SceneSource, Storage};
use crate::lod::{Detail, Tuning};
use crate::opened::Opened;
use crate::sequence::{BUDGET, SequenceOnDevice};
use crate::time::{TimeCommand, TimeControl};

/// What a user can ask for by one press.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Fly or orbit.
    SwitchMode,
    /// The data set's next camera.
    NextCamera,
    /// The one before.
    PreviousCamera,
    /// Back to the first view.
    Reset,
    /// Both eyes side by side, or one.
    SwitchStereo,
    /// Something about the time of a moving scene.
    Time(TimeCommand),
    /// Shows or hides the panel.
    SwitchPanel,
    /// The next heat map, or none after the last.
    SwitchHeatMap,
    /// Begins or ends giving splats labels by hand.
    SwitchMarking,
    /// Saves a picture.
    Screenshot,
    /// Ends the program.
    Quit,
}

/// A scene that is shown.
pub struct Stage {
    /// The scene in memory.
    pub opened: Arc<Opened>,
    /// How it stands in the world; may be changed and saved.
    pub settings: Settings,
    /// The scene on the device; of a sequence the first frame.
    pub scene: Arc<SceneOnDevice>,
    /// The frames of a sequence, and the one that is shown.
    pub sequence: Option<(SequenceOnDevice, Option<Arc<SceneOnDevice>>)>,
    /// Its dense part.
    pub framing: Framing,
    /// The data set's camera that was taken last.
    pub camera: Option<usize>,
    /// What it calls for, where it was loaded by plan.
    pub plan: Option<Plan>,
    /// Only a part of it is there, and more is on its way.
    pub partial: bool,
    /// Which level each region of it is drawn at, where it has levels.
    pub detail: Option<Detail>,
    sorting: SortWorker,
}

impl Stage {
    /// Whether time changes it.
    pub fn moves(&self) -> bool {
        self.scene.moving || self.sequence.is_some()
    }

    /// The scene on the device as it is shown now.
    pub fn shown(&self) -> &SceneOnDevice {
        match &self.sequence {
            Some((_, Some(frame))) => frame,
            _ => &self.scene,
        }
    }
}

/// The state of a viewer.
pub struct Viewer {
    /// How frames are drawn; lengths in metres.
    pub config: RenderConfig,
    /// Holds a budget by drawing less exactly than `config` says, where there is one.
    pub governor: Option<Governor>,
    /// Scenes are loaded and drawn by plan, but for what is asked for here.
    pub by_plan: Option<Overrides>,
    /// From where.
    pub eye: Eye,
    /// Both eyes.
    pub stereo: bool,
    /// Distance of the eyes, metres.
    pub eye_distance: f64,
    /// The time of a moving scene.
    pub time: TimeControl,
    /// Whether the panel is shown.
    pub panel: bool,
    /// The last thing that went wrong, or was done.
    pub message: Option<String>,
    /// The scene.
    pub stage: Option<Stage>,
    /// Memory for the frames of a sequence, bytes.
    pub read_ahead: u64,
    /// How levels of detail are chosen.
    pub detail: Tuning,
    /// Files of levels and streamed SOG scenes are read on the way into so many bytes; none: whole.
    pub memory: Option<u64>,
    gpu: Arc<Gpu>,
    /// Time that passed between the last two frames.
    passed: Duration,
    /// Frames since the eye was where the worker's order was made for.
    order_age: u32,
    loading: Option<Loader>,
    /// Loaders that were cancelled and have not ended yet.
    cancelled: Vec<Loader>,
}

/// The angle of view until a data set's camera says another.
const VERTICAL_FOV: f64 = 60.0 * std::f64::consts::PI / 180.0;

impl Viewer {
    /// A viewer that shows nothing yet.
    pub fn new(gpu: &Arc<Gpu>, config: RenderConfig) -> Self {
        let framing = Framing { center: DVec3::ZERO, radius: 1.0, up: DVec3::NEG_Y };
        Self {
            config,
            governor: None,
            by_plan: None,
            eye: Eye::of(&framing, EyeMode::Orbit, VERTICAL_FOV),
            stereo: false,
            eye_distance: 0.063,
            time: TimeControl::default(),
            panel: true,
            message: None,
            stage: None,
            read_ahead: BUDGET,
            detail: Tuning::default(),
            memory: None,
            gpu: gpu.clone(),
            passed: Duration::ZERO,
            order_age: 0,
            loading: None,
            cancelled: Vec::new(),
        }
    }

    /// Begins to open scenes; what is being loaded already is dropped. The scene on show stays until the new one is
    /// there.
    pub fn open(&mut self, paths: Vec<PathBuf>) {
        let storage =
            self.by_plan.map_or_else(|| Storage::As(Packing::of_config(&self.config)), Storage::Planned);
        // What is on show stays a part: the rest of it is cancelled.
        if let Some(stage) = &mut self.stage {
            stage.partial = false;
        }
        let source = match (self.memory, paths.as_slice()) {
            (Some(bytes), [path])
                if Format::detect(path).is_ok_and(|f| matches!(f, Format::Levels | Format::StreamedSog)) =>
            {
                SceneSource::Within(path.clone(), bytes)
            }
            _ => SceneSource::Files(paths),
        };
        self.load(source, storage);
    }

    fn load(&mut self, source: SceneSource, storage: Storage) {
        // The window lists no scenes, and keeps no small pictures of them.
        let loader = Loader::start(&self.gpu, LoadRequest { source, storage, thumbnails: None });
        if let Some(before) = self.loading.take() {
            before.cancel();
            self.cancelled.push(before);
        }
        match loader {
            Ok(loader) => self.loading = Some(loader),
            Err(error) => self.message = Some(error.to_string()),
        }
    }

    /// Whether frames change by themselves: a scene is on its way, time goes on, an order is being made, a budget is not held
    /// yet. (What a still picture takes in frames, the renderer knows: `Renderer::lacks`.)
    pub fn is_busy(&self) -> bool {
        let Some(stage) = &self.stage else { return self.loading.is_some() };
        self.loading.is_some()
            || stage.moves() && self.time.playing()
            || stage.sorting.is_sorting()
            || stage.detail.as_ref().is_some_and(Detail::is_busy)
            || self.governor.as_ref().is_some_and(|g| !g.is_at_rest())
    }

    /// How far loading is, while it goes on.
    pub fn loading(&self) -> Option<Loading> {
        self.loading.as_ref().map(Loader::progress)
    }

    /// Goes on by `seconds`: takes a scene that is there, moves the eye, lets time go. Returns the scene that was
    /// replaced: it may go once no frame uses it any more.
    pub fn advance(&mut self, seconds: f64, motion: &EyeMotion) -> Option<Stage> {
        self.cancelled.retain_mut(|loader| loader.poll().is_none());
        let mut replaced = None;
        if let Some(result) = self.loading.as_mut().and_then(Loader::poll) {
            if !matches!(result, Ok(Loaded { whole: false, .. })) {
                self.loading = None;
            }
            match result.and_then(|loaded| self.show(loaded)) {
                Ok(before) => replaced = before,
                Err(error) => self.message = Some(error.to_string()),
            }
        }
        self.repack();
        self.eye.move_by(motion);
        self.passed = Duration::try_from_secs_f64(seconds).unwrap_or_default();
        if self.stage.as_ref().is_some_and(Stage::moves) {
            if self.config.time != self.time.time() {
                // It was set by another way: a preset, a camera, the panel.
                self.time.scrub(self.config.time.into());
            }
            self.config.time = self.time.advance(self.passed);
        }
        if let Some(Stage { sequence: Some((sequence, shown)), .. }) = &mut self.stage {
            *shown = sequence.show(&self.time).map(|(_, frame)| frame).or(shown.take());
        }
        replaced
    }

    fn show(&mut self, loaded: Loaded) -> Result<Option<Stage>, LoadError> {
        let Loaded { opened, scene, framing, plan, detail, whole } = loaded;
        let repacked = self.stage.as_ref().is_some_and(|s| Arc::ptr_eq(&s.opened, &opened));
        let sorting =
            SortWorker::new(scene.positions.clone()).map_err(|e| LoadError::Thread(e.to_string()))?;
        let sequence = if opened.frames.is_empty() {
            None
        } else {
            let sequence = SequenceOnDevice::new(&self.gpu, &opened.frames, scene.packing, self.read_ahead)
                .map_err(|e| LoadError::Thread(e.to_string()))?;
            Some((sequence, None))
        };
        if !repacked {
            self.message = opened.scene.report.warnings.first().cloned();
        }
        let partial = !whole;
        if let Some(plan) = &plan {
            self.config = plan.apply(&self.config);
        }
        if let Some(before) = self.stage.as_ref().filter(|s| repacked || s.partial) {
            // The same scene, or more of it: the eye stays, and what the user changed.
            let framing = Framing { up: before.framing.up, ..framing };
            let (settings, camera) = (before.settings.clone(), before.camera);
            let plan = plan.or_else(|| before.plan.clone());
            let stage =
                Stage { opened, settings, scene, sequence, framing, camera, plan, partial, detail, sorting };
            return Ok(self.stage.replace(stage));
        }
        let settings = opened.settings.clone();
        self.time = sequence.as_ref().map_or_else(TimeControl::default, |(s, _)| s.time_control());
        let camera = None;
        let stage =
            Stage { opened, settings, scene, sequence, framing, camera, plan, partial, detail, sorting };
        let before = self.stage.replace(stage);
        self.eye = Eye::of(&framing, self.eye.mode, VERTICAL_FOV);
        self.reset();
        Ok(before)
    }

    /// Brings the scene to the device anew where the configuration asks for another packing.
    fn repack(&mut self) {
        let Some(stage) = &self.stage else { return };
        let wanted = Packing::of_config(&self.config);
        let most = stage.opened.scene.splats.sh_degree;
        let wanted = Packing { sh_degree: wanted.sh_degree.min(most), ..wanted };
        let stored = stage.scene.packing;
        // A lower degree is evaluated from what is stored.
        let fits = wanted.precision == stored.precision
            && wanted.sh_precision == stored.sh_precision
            && wanted.sh_degree <= stored.sh_degree;
        if !fits && self.loading.is_none() {
            match (&stage.opened.path, stage.detail.as_ref().and_then(Detail::memory)) {
                // What is read on the way is read anew.
                (Some(path), Some(_)) => self.open(vec![path.clone()]),
                _ => self.load(SceneSource::Memory(stage.opened.clone()), Storage::As(wanted)),
            }
        }
    }

    /// Back to the first view: the settings', the first camera's, or one that shows the dense part.
    pub fn reset(&mut self) {
        let Some(stage) = &mut self.stage else { return };
        stage.camera = None;
        self.eye = Eye::of(&stage.framing, self.eye.mode, VERTICAL_FOV);
        if let Some(saved) = &stage.settings.first_view {
            self.eye.take(&crate::opened::saved_view(saved, VERTICAL_FOV, [1600, 900]));
        } else if !stage.opened.cameras.is_empty() {
            self.take_camera(0);
        }
    }

    /// Puts the eye where a camera of the data set stood.
    pub fn take_camera(&mut self, index: usize) {
        let Some(stage) = &mut self.stage else { return };
        let Some(camera) = stage.opened.cameras.get(index) else { return };
        stage.camera = Some(index);
        let view = View::from_camera(camera);
        self.eye.take(&view);
        // The point to go round: what lies ahead of the camera at the depth of the scene's middle.
        let depth = view.to_eye(stage.framing.center).z;
        self.eye.set_distance(if depth > 0.0 { depth } else { stage.framing.radius });
        if let Some(time) = camera.time {
            self.config.time = time as f32;
        }
    }

    /// Does what was asked for. Heat maps, screenshots and quitting are the caller's.
    pub fn obey(&mut self, command: Command) {
        match command {
            Command::SwitchMode => {
                self.eye.mode = if self.eye.mode == EyeMode::Fly { EyeMode::Orbit } else { EyeMode::Fly };
            }
            Command::NextCamera | Command::PreviousCamera => {
                let Some(stage) = &self.stage else { return };
                let count = stage.opened.cameras.len();
                if count == 0 {
                    self.message = Some("there is no camera file beside the scene".into());
                    return;
                }
                let index = match (stage.camera, command) {
                    (Some(i), Command::NextCamera) => (i + 1) % count,
                    (Some(i), _) => (i + count - 1) % count,
                    (None, _) => 0,
                };
                self.take_camera(index);
            }
            Command::Reset => self.reset(),
            Command::SwitchStereo => self.stereo = !self.stereo,
            Command::Time(command) => {
                self.time.obey(command);
                self.config.time = self.time.time();
            }
            Command::SwitchPanel => self.panel = !self.panel,
            Command::SwitchHeatMap | Command::SwitchMarking | Command::Screenshot | Command::Quit => {}
        }
    }

    /// Takes the settings over after they were changed in the panel: the eye stays, what is up changes.
    pub fn settings_changed(&mut self) {
        let Some(stage) = &mut self.stage else { return };
        let view = self.eye.view([1600, 900]);
        stage.framing = Framing::of(&stage.opened.scene.splats, &stage.settings);
        self.eye = Eye::of(&stage.framing, self.eye.mode, self.eye.vertical_fov);
        self.eye.take(&view);
        self.eye.set_distance((stage.framing.center - view.eye).length());
    }

    /// A length to move by in a second, scene units.
    pub fn pace(&self) -> f64 {
        self.stage.as_ref().map_or(1.0, |s| 0.5 * s.framing.radius)
    }

    /// The views of a frame in an image of this size: one, or two side by side of half the width each.
    pub fn views(&self, size: [u32; 2]) -> Vec<View> {
        if !self.stereo {
            return vec![self.eye.view(size)];
        }
        let scale = self.stage.as_ref().map_or(1.0, |s| s.settings.scale);
        eyes(&self.eye.view([(size[0] / 2).max(1), size[1]]), self.eye_distance / scale).to_vec()
    }

    /// The configuration for the renderer: by the governor's step, lengths in scene units.
    pub fn frame_config(&self) -> RenderConfig {
        let scale = self.stage.as_ref().map_or(1.0, |s| s.settings.scale);
        let config = self.governor.as_ref().map_or_else(|| self.config.clone(), |g| g.apply(&self.config));
        let mut config = in_scene_units(&config, scale);
        if config.sorter == Sorter::Cpu && self.stage.as_ref().is_some_and(|s| s.sequence.is_some()) {
            // Each frame is a scene of its own: its order is made where it is drawn.
            config.sorter = Sorter::Gpu;
        }
        config
    }

    /// How many frames ago the eye was where the order of splats was made for; 0: it fits, or the device made it.
    pub fn order_age(&self) -> u32 {
        self.order_age
    }

    /// Takes what a frame took that was drawn by [`Viewer::frame_config`].
    pub fn govern(&mut self, report: &FrameReport) {
        if let Some(governor) = &mut self.governor {
            governor.observe(report, &self.config);
        }
    }

    /// The scene and the newest order of its splats, at the levels of detail that these views call for; asks for the order
    /// that they want. Before the first order is there, it is waited for.
    pub fn frame(&mut self, views: &[View], config: &RenderConfig) -> Option<(&SceneOnDevice, &SplatOrder)> {
        let ease = self.governor.as_ref().map_or(0.0, Governor::detail_ease);
        let stage = self.stage.as_mut()?;
        if let Some(detail) = &mut stage.detail {
            detail.advance(views, self.passed.as_secs_f64(), ease, self.detail);
        }
        if config.sorter == Sorter::Cpu {
            let request = OrderRequest::new(views, config).of_parts(&stage.scene.positions);
            stage.sorting.set_interval(config.sort_interval);
            if stage.sorting.newest().0.made_for.is_none() {
                stage.sorting.wait_for(request);
            }
            let fits = stage.sorting.newest().0.made_for.is_some_and(|made| made.center == request.center);
            self.order_age = if fits { 0 } else { self.order_age.saturating_add(1) };
            // It is there for the next frame: made for the time that it will be then.
            let time = if stage.scene.moving { self.time.predict(self.passed) } else { request.time };
            stage.sorting.request(OrderRequest { time, ..request });
        } else {
            self.order_age = 0;
        }
        let Stage { scene, sequence, sorting, .. } = stage;
        let (order, _) = sorting.newest();
        let scene = match sequence {
            Some((_, Some(frame))) => &**frame,
            _ => &**scene,
        };
        Some((scene, order))
    }
}

/// The two eyes of a viewer at a view: parallel, `distance` apart along the view's horizontal (scene units).
pub fn eyes(view: &View, distance: f64) -> [View; 2] {
    let right = view.rotation.row(0);
    [-0.5, 0.5].map(|side| View { eye: view.eye + right * (side * distance), ..*view })
}

/// A configuration whose lengths are in scene units, of `scale` metres each: what the renderer is given.
pub fn in_scene_units(config: &RenderConfig, scale: f64) -> RenderConfig {
    let length = |metres: f32| (f64::from(metres) / scale) as f32;
    RenderConfig { near: length(config.near), near_fade: length(config.near_fade), ..config.clone() }
}

/// Frame times of the last moments, and what the newest frame took.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// The newest finished frame.
    pub report: FrameReport,
    /// What the frame that was asked for last expands its splats by, which need not be what is chosen: a device may draw
    /// faster otherwise. None before the first.
    pub expansion: Option<Expansion>,
    /// Seconds from frame to frame, oldest first; at most [`Figures::KEPT`].
    pub frames: std::collections::VecDeque<f64>,
}

impl Figures {
    /// Frames that the median is of.
    pub const KEPT: usize = 60;

    /// Takes a frame: seconds since the one before, where it followed without a pause, and what a finished one took.
    pub fn add(&mut self, seconds: Option<f64>, report: &FrameReport) {
        self.frames.extend(seconds);
        if self.frames.len() > Self::KEPT {
            self.frames.pop_front();
        }
        self.report.clone_from(report);
    }

    /// Median of the seconds from frame to frame, which one that made pipelines does not move; 0 before the first.
    pub fn seconds(&self) -> f64 {
        let mut frames: Vec<f64> = self.frames.iter().copied().collect();
        frames.sort_by(f64::total_cmp);
        frames.get(frames.len() / 2).copied().unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use motes_renderer::Fov;

    #[test]
    fn eyes_stand_left_and_right() {
        let fov = Fov::vertical(1.0, [64, 64]);
        let view = View { rotation: DMat3::IDENTITY, eye: DVec3::ZERO, fov, size: [64, 64] };
        let [left, right] = eyes(&view, 0.06);
        assert!(
            (left.to_eye(DVec3::Z).x - 0.03).abs() < 1e-12,
            "a thing ahead lies to the right of the left eye"
        );
        assert!(((right.eye - left.eye).length() - 0.06).abs() < 1e-12);
    }

    #[test]
    fn a_frame_takes_what_most_of_the_last_ones_took() {
        let mut figures = Figures::default();
        let mut add = |seconds, times| {
            (0..times).for_each(|_| figures.add(seconds, &FrameReport::default()));
            (figures.seconds(), figures.frames.len())
        };
        assert_eq!(add(Some(3.0), 1), (3.0, 1));
        assert_eq!(add(Some(0.3), 4), (0.3, 5), "one slow frame moves nothing");
        assert_eq!(add(None, 9), (0.3, 5), "a pause is no frame's time");
        assert_eq!(add(Some(0.1), 1000), (0.1, Figures::KEPT));
        assert_eq!(add(None, 9), (0.1, Figures::KEPT));
    }

    #[test]
    fn lengths_are_scaled_to_the_scene() {
        let config = RenderConfig { near: 0.2, near_fade: 0.1, ..Default::default() };
        let scaled = in_scene_units(&config, 2.0);
        assert_eq!((scaled.near, scaled.near_fade), (0.1, 0.05));
        assert_eq!(RenderConfig { near: 0.2, near_fade: 0.1, ..scaled }, config);
    }
}
