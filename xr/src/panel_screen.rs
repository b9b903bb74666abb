//! The panel's picture: egui on a quad layer, which the compositor shows as sharp as it is.

use crate::{Headset, XrError};
use ash::vk;
use egui::{Context, Pos2};
use motes_app::headset::menu::{self, MenuCommand, MenuFacts, PIXELS_PER_POINT};
use motes_app::headset::{Comfort, PanelEvents};
use motes_app::painter::{Before, Painter};

/// How old the picture may get while nobody points at the panel, seconds: its figures change.
const OLDEST: f64 = 0.2;

/// Frames under way at once, as the renderer's.
const FRAMES: usize = 2;

/// Draws the panel.
pub(crate) struct PanelScreen {
    context: Context,
    painter: Option<Painter>,
    pointer: Option<Pos2>,
    drawn: Option<f64>,
}

impl PanelScreen {
    pub fn new() -> Self {
        Self { context: menu::context(), painter: None, pointer: None, drawn: None }
    }

    /// The panel's own context, which holds its textures.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Whether a picture was drawn, so that there is something to show.
    pub fn has_picture(&self) -> bool {
        self.drawn.is_some()
    }

    /// Records the drawing of a new picture, where one is due; returns what the user asked for. `seconds` is the
    /// session's time.
    pub fn draw(
        &mut self,
        headset: &mut dyn Headset,
        commands: vk::CommandBuffer,
        events: &PanelEvents,
        facts: &MenuFacts<'_>,
        comfort: &Comfort,
        seconds: f64,
    ) -> Result<Vec<MenuCommand>, XrError> {
        let touched = events.pointer.is_some() || self.pointer.is_some() || events.pressed || events.released;
        let old = self.drawn.is_none_or(|drawn| (seconds - drawn).abs() >= OLDEST);
        if !touched && !old {
            return Ok(Vec::new());
        }
        let Some(target) = headset.panel()? else { return Ok(Vec::new()) };
        if self.painter.is_none() {
            let gpu = headset.gpu();
            self.painter = Some(Painter::new(gpu, target.format, Before::Nothing, target.layout, FRAMES)?);
        }
        let Some(painter) = &mut self.painter else { return Ok(Vec::new()) };
        let (input, pointer) = menu::input(events, seconds, self.pointer);
        self.pointer = pointer;
        let mut asked = Vec::new();
        let output = self.context.run_ui(input, |ui| {
            egui::CentralPanel::default().show(ui, |ui| asked = menu::show(ui, facts, comfort));
        });
        let shapes = self.context.tessellate(output.shapes, PIXELS_PER_POINT);
        painter.update(output.textures_delta)?;
        painter.draw(commands, target.all, target.size, PIXELS_PER_POINT, &shapes)?;
        self.drawn = Some(seconds);
        Ok(asked)
    }
}
