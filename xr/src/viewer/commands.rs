//! What the user asks for on the panel.

use super::{Shown, Viewer};
use crate::{FrameTime, Headset, XrError};
use motes_app::governor::{Budget, Governor};
use motes_app::headset::menu::{MenuCommand, MenuFacts};
use motes_app::measurement::{Machine, Measurement, SceneRecord};
use motes_app::quality::{Quality, Table};
use motes_renderer::{Expansion, Frame, PRESETS, RenderConfig};
use motes_scenes::settings::{Orientation, Settings};

impl Viewer {
    pub(super) fn leave(&mut self, headset: &mut dyn Headset) -> Result<(), XrError> {
        if !self.leaving {
            log::info!("the user ends the session");
            self.leaving = true;
            headset.request_exit()?;
        }
        Ok(())
    }

    /// Draws the panel where it is shown, and does what is asked for on it.
    pub(super) fn draw_panel(
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
            predicted_ms: Budget::Milliseconds(0.0).cost(self.renderer.last_report(), &self.config),
            detail: self
                .shown
                .as_ref()
                .and_then(|shown| shown.content.detail.as_ref())
                .map(|_| self.detail_target),
            settings: about.map(|about| &about.settings),
            governor: self.governor.as_ref(),
            time: self.playback.as_ref(),
            measuring: self.measurement.as_ref().map(Measurement::progress),
            scenes: &self.offered,
            surroundings: headset.surroundings(),
            heat: self.renderer.gpu().capabilities.independent_blend.then_some(self.heat),
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
            MenuCommand::Heat(heat) => self.heat = heat,
            MenuCommand::Quality(quality) => self.take_quality(quality),
            MenuCommand::Detail(target) => self.detail_target = target,
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
            MenuCommand::Surroundings(shown) => {
                if let Err(error) = headset.show_surroundings(shown) {
                    if error.is_lost() {
                        return Err(error);
                    }
                    self.problem = format!("The surroundings cannot be shown: {error}");
                }
            }
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
    pub(super) fn go_on_measuring(&mut self) {
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

    /// The cheapest way of drawing that was measured to be so close, where the device can draw two views by it. How finely
    /// the scene is stored, and what of it is shown, stay as they are.
    fn take_quality(&mut self, quality: Quality) {
        match Table::built_in().and_then(|table| table.config(quality)) {
            Ok(config) => {
                let RenderConfig { precision, sh_precision, time, background, .. } = self.config;
                self.take(RenderConfig { precision, sh_precision, time, background, ..config });
            }
            Err(error) => self.problem = error.to_string(),
        }
    }

    /// A preset, where the device can draw two views by it.
    fn take_preset(&mut self, preset: usize) {
        let Some(preset) = PRESETS.get(preset) else { return };
        let mut config = (preset.config)();
        if config.expansion == Expansion::Geometry {
            config.expansion = Expansion::Instanced;
            self.problem = "The geometry stage draws one eye only: splats are expanded in instances".into();
        }
        self.take(config);
    }

    fn take(&mut self, mut config: RenderConfig) {
        // The session draws at its own size: nothing is left to bring back to full size.
        config.resolution_scale = 1.0;
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
}
