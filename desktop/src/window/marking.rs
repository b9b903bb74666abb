//! Labels by hand in the window: with the left button, a brush or a box over the picture; a list of classes beside it.

use std::sync::Arc;
use std::thread::JoinHandle;

use egui::{Color32, Pos2, Rect, Stroke as Pen, StrokeKind, Ui};
use motes_app::opened::Opened;
use motes_app::viewer::Viewer;
use motes_renderer::reference::{ReferenceError, ReferenceOptions};
use motes_scenes::labels::Class;

use crate::marking::{Marking, Stroke, Tool, splats_of};

/// Longest side of the picture that says what a stroke is meant for, pixels: the reference, on the processor, makes it.
const LONGEST: u32 = 320;

/// Which splats a stroke is meant for, once a thread has found them.
type Job = JoinHandle<Result<Vec<u32>, ReferenceError>>;

/// Marking in the window.
pub struct Markers {
    on: bool,
    /// The scene, and its labels as they are now.
    marking: Option<(Arc<Opened>, Marking)>,
    class: u16,
    tool: Tool,
    radius: f64,
    /// Where the button is held down, pixels of the window.
    held: Option<Vec<[f64; 2]>>,
    /// A stroke that no thread looks at yet.
    stroke: Option<Vec<[f64; 2]>>,
    job: Option<(u16, Job)>,
}

impl Default for Markers {
    fn default() -> Self {
        Self {
            on: false,
            marking: None,
            class: 1,
            tool: Tool::Brush,
            radius: 0.04,
            held: None,
            stroke: None,
            job: None,
        }
    }
}

impl Markers {
    /// Begins or ends marking; returns what speaks against it.
    pub fn switch(&mut self, viewer: &Viewer) -> Option<String> {
        self.held = None;
        if std::mem::take(&mut self.on) {
            return None;
        }
        let Some(stage) = &viewer.stage else { return Some("there is no scene to label yet".into()) };
        let opened = &stage.opened;
        let why = match &opened.path {
            None => "the sample cannot be labelled: there is no file to keep labels beside",
            Some(_) if stage.partial => "a scene can be labelled when all of it is there",
            Some(_) if stage.detail.is_some() => {
                "levels have the classes that they were built with: label the scene first"
            }
            Some(_) if stage.sequence.is_some() || opened.scene.sources.len() > 1 => {
                "labels are kept beside one scene: open it alone"
            }
            Some(path) => {
                if self.marking.as_ref().is_none_or(|(of, _)| !Arc::ptr_eq(of, opened)) {
                    let mut marking = Marking::of(&opened.scene.splats, &opened.classes, path);
                    if marking.classes().is_empty() {
                        self.class = marking.add_class();
                    }
                    self.marking = Some((opened.clone(), marking));
                }
                self.on = true;
                return None;
            }
        };
        Some(why.into())
    }

    /// Whether the left button marks.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Whether a stroke is being looked at.
    pub fn is_busy(&self) -> bool {
        self.job.is_some() || self.stroke.is_some()
    }

    /// The labels as they are now, and the classes, while marking.
    pub fn labels(&self) -> Option<(Arc<Vec<u16>>, Vec<Class>)> {
        let (_, marking) = self.marking.as_ref().filter(|_| self.on)?;
        Some((marking.ids().clone(), marking.classes().to_vec()))
    }

    /// The left button goes down, at a place in the window, or up.
    pub fn button(&mut self, down: bool, at: Option<[f64; 2]>) {
        match (down, at) {
            (true, Some(at)) => self.held = Some(vec![at]),
            (true, None) => {}
            // The one before is still being looked at: both are.
            (false, _) => {
                if let Some(stroke) = self.held.take() {
                    self.stroke = Some(stroke);
                }
            }
        }
    }

    /// The cursor is somewhere else.
    pub fn cursor(&mut self, at: [f64; 2]) {
        if let Some(points) = &mut self.held {
            points.push(at);
        }
    }

    /// Takes what a stroke was meant for, and begins to look at the next. `size`: the window's, pixels.
    pub fn update(&mut self, viewer: &mut Viewer, size: [u32; 2]) {
        if let Some((class, job)) = self.job.take_if(|(_, job)| job.is_finished())
            && let Some((_, marking)) = &mut self.marking
        {
            viewer.message = Some(match job.join() {
                Ok(Ok(splats)) => format!("{} splats labelled", marking.give(&splats, class)),
                Ok(Err(error)) => error.to_string(),
                Err(_) => "the stroke's thread ended early".into(),
            });
        }
        let current = viewer.stage.as_ref().map(|s| &s.opened);
        if self.on && !current.zip(self.marking.as_ref()).is_some_and(|(now, (of, _))| Arc::ptr_eq(now, of)) {
            self.on = false;
            viewer.message = Some("another scene is shown: marking has ended".into());
        }
        if !self.on || self.job.is_some() {
            return;
        }
        let (Some(points), Some((opened, _))) = (self.stroke.take(), &self.marking) else { return };
        if viewer.stereo {
            viewer.message = Some("one eye marks: leave the view of both (V)".into());
            return;
        }
        let share = |p: &[f64; 2]| [p[0] / f64::from(size[0].max(1)), p[1] / f64::from(size[1].max(1))];
        let stroke =
            Stroke { tool: self.tool, radius: self.radius, points: points.iter().map(share).collect() };
        let longest = size[0].max(size[1]).max(1);
        let small = size.map(|s| (s * LONGEST.min(longest) / longest).max(1));
        let Some(view) = viewer.views(small).first().copied() else { return };
        let options =
            ReferenceOptions { stop_below: 1e-4, ..ReferenceOptions::of_config(&viewer.frame_config()) };
        let opened = opened.clone();
        let look = move || splats_of(&opened.scene.splats, &view, &stroke, &options);
        match std::thread::Builder::new().name("marking".into()).spawn(look) {
            Ok(job) => self.job = Some((self.class, job)),
            Err(error) => viewer.message = Some(format!("no thread for the stroke: {error}")),
        }
    }

    /// Draws the stroke, and the list of classes with what can be done.
    pub fn show(&mut self, ui: &Ui, viewer: &mut Viewer, pixels_per_point: f32) {
        let Some((_, marking)) = self.marking.as_mut().filter(|_| self.on) else { return };
        let chosen = marking.classes().iter().find(|c| c.id == self.class);
        let [r, g, b] = chosen.map_or([96; 3], |c| c.colour);
        let colour = Color32::from_rgb(r, g, b);
        let place = |p: &[f64; 2]| Pos2::new(p[0] as f32, p[1] as f32) / pixels_per_point;
        let painter = ui.ctx().layer_painter(egui::LayerId::background());
        if let Some(points) = self.held.as_ref().or(self.stroke.as_ref()) {
            match (self.tool, points.first(), points.last()) {
                (Tool::Box, Some(first), Some(last)) => {
                    let area = Rect::from_two_pos(place(first), place(last));
                    painter.rect_stroke(area, 0.0, Pen::new(2.0, colour), StrokeKind::Middle);
                }
                _ => {
                    let width = 2.0 * self.radius as f32 * ui.ctx().content_rect().height();
                    let pen = Pen::new(width, colour.gamma_multiply(0.5));
                    painter.add(egui::Shape::line(points.iter().map(place).collect(), pen));
                }
            }
        }
        egui::Window::new("Labels").default_pos([12.0, 60.0]).resizable(false).show(ui.ctx(), |ui| {
            ui.horizontal(|ui| {
                ui.selectable_value(&mut self.tool, Tool::Brush, "brush");
                ui.selectable_value(&mut self.tool, Tool::Box, "box");
            });
            ui.add(egui::Slider::new(&mut self.radius, 0.005..=0.3).logarithmic(true).text("brush"));
            ui.selectable_value(&mut self.class, 0, "none");
            for class in marking.classes() {
                let [r, g, b] = class.colour;
                ui.horizontal(|ui| {
                    ui.colored_label(Color32::from_rgb(r, g, b), "■");
                    ui.selectable_value(&mut self.class, class.id, &class.name);
                });
            }
            ui.horizontal(|ui| {
                if ui.button("new class").clicked() {
                    self.class = marking.add_class();
                }
                if ui.add_enabled(marking.can_undo(), egui::Button::new("undo")).clicked() {
                    marking.undo();
                }
                if ui.add_enabled(!marking.is_saved(), egui::Button::new("save")).clicked() {
                    viewer.message = Some(match marking.save() {
                        Ok(file) => format!("saved {}", file.display()),
                        Err(error) => error.to_string(),
                    });
                }
            });
            if let Some(message) = &viewer.message {
                ui.label(message);
            }
        });
    }
}
