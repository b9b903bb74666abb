//! Heat maps in the window: made from where the eye rests, on a thread of their own, and laid over the picture until it
//! moves on.

use std::sync::Arc;
use std::thread::JoinHandle;

use clap::ValueEnum;
use egui::{Color32, ColorImage, Pos2, Rect, TextureHandle, TextureOptions, Ui};
use motes_app::lod::Tuning;
use motes_app::opened::Opened;
use motes_app::viewer::Viewer;
use motes_renderer::{RenderConfig, View};
use motes_scenes::Splats;
use motes_scenes::labels::Class;

use super::screen::Screen;
use crate::error::CommandError;
use crate::heat::{Given, Heat};
use crate::measure::Picture;
use crate::studio::side_by_side;

/// Longest side of a map of one eye, pixels: the reference, on the processor, makes it.
const LONGEST: u32 = 480;
/// Steps of the legend's colours.
const LEGEND: usize = 48;

/// What a map was, or is to be, made of.
#[derive(Clone)]
struct Request {
    heat: Heat,
    opened: Arc<Opened>,
    views: Vec<View>,
    config: RenderConfig,
    detail: Tuning,
    /// Labels that are being changed, instead of the scene's.
    labels: Option<NewLabels>,
}

type NewLabels = (Arc<Vec<u16>>, Vec<Class>);

impl PartialEq for Request {
    fn eq(&self, other: &Self) -> bool {
        self.heat == other.heat
            && Arc::ptr_eq(&self.opened, &other.opened)
            && self.views == other.views
            && self.config == other.config
            && self.detail == other.detail
            && match (&self.labels, &other.labels) {
                (Some(a), Some(b)) => Arc::ptr_eq(&a.0, &b.0) && a.1 == b.1,
                (a, b) => a.is_none() && b.is_none(),
            }
    }
}

type Job = JoinHandle<Result<Picture, CommandError>>;

/// The heat map over the window's picture.
#[derive(Default)]
pub struct HeatMap {
    chosen: Option<Heat>,
    /// What the frame before would have asked for: a map is made once two frames agree.
    last: Option<Request>,
    job: Option<(Request, Job)>,
    made: Option<(Request, Result<TextureHandle, String>)>,
}

impl HeatMap {
    /// The next kind, or none after the last.
    pub fn switch(&mut self) {
        let kinds = Heat::value_variants();
        let next = self.chosen.map_or(0, |heat| kinds.iter().position(|k| *k == heat).map_or(0, |i| i + 1));
        self.chosen = kinds.get(next).copied();
    }

    /// Shows labels while they are changed, and nothing after.
    pub fn show_labels(&mut self, on: bool) {
        self.chosen = on.then_some(Heat::Labels);
    }

    /// Whether a map is on its way.
    pub fn is_busy(&self) -> bool {
        self.job.is_some() || self.chosen.is_some() && self.last.as_ref() != self.made.as_ref().map(|m| &m.0)
    }

    /// Takes a map that is done, and begins one where the eye rests; of these labels, where they are being changed.
    pub fn update(
        &mut self,
        context: &egui::Context,
        viewer: &mut Viewer,
        screen: &mut Screen,
        labels: Option<NewLabels>,
    ) {
        if let Some((request, job)) = self.job.take_if(|(_, job)| job.is_finished()) {
            let picture =
                job.join().unwrap_or_else(|_| Err(CommandError::Failed("the map's thread ended".into())));
            let texture = picture.map_err(|e| e.to_string()).map(|picture| {
                let size = picture.size().map(|s| s as usize);
                let image = ColorImage::from_rgb(size, &picture.to_rgb8());
                context.load_texture("heat map", image, TextureOptions::LINEAR)
            });
            self.made = Some((request, texture));
        }
        let wanted = self.wanted(viewer, screen.size(), labels);
        let rests = wanted.is_some() && wanted == self.last;
        self.last = wanted;
        let Some(request) = self.last.clone().filter(|_| rests && self.job.is_none()) else { return };
        if self.made.as_ref().is_some_and(|(made, _)| *made == request) {
            return;
        }
        // An error is one of what the device draws: the same view, drawn for it.
        let drawn = match request.heat {
            Heat::Error => screen.pictures(viewer, &request.views),
            _ => Ok(Vec::new()),
        };
        let job = request.clone();
        let job = std::thread::Builder::new().name("heat map".into()).spawn(move || {
            let Request { heat, opened, views, config, detail, labels } = job;
            if let Some((ids, classes)) = labels {
                let splats = Splats { labels: Some(ids.to_vec()), ..opened.scene.splats.clone() };
                let scene = (&splats, Given::default());
                return side_by_side(&heat.pictures(scene, &classes, &views, &config, &drawn?)?);
            }
            let Some(levels) = &opened.levels else {
                let scene = (&opened.scene.splats, Given::default());
                return side_by_side(&heat.pictures(scene, &opened.classes, &views, &config, &drawn?)?);
            };
            let mut choice = levels.choice(detail);
            choice.settle(&views);
            let parts = levels.parts(choice.shares());
            let given = Given { fineness: Some(levels.fineness(&parts)), ..Given::default() };
            let scene = (&levels.drawn(&parts), given);
            side_by_side(&heat.pictures(scene, &opened.classes, &views, &config, &drawn?)?)
        });
        match job {
            Ok(job) => self.job = Some((request, job)),
            Err(error) => self.made = Some((request, Err(format!("no thread for the map: {error}")))),
        }
    }

    fn wanted(&self, viewer: &Viewer, size: [u32; 2], labels: Option<NewLabels>) -> Option<Request> {
        let (heat, stage) = (self.chosen?, viewer.stage.as_ref()?);
        let longest = size[0].max(size[1]).max(1);
        let size = size.map(|s| (s * LONGEST.min(longest) / longest).max(1));
        let config = viewer.frame_config();
        Some(Request {
            heat,
            opened: stage.opened.clone(),
            views: viewer.views(size),
            config,
            detail: viewer.detail,
            labels: labels.filter(|_| heat == Heat::Labels),
        })
    }

    /// Lays the map over the whole window, where it is of what is seen, and says what its colours mean.
    pub fn show(&self, ui: &Ui) {
        let Some(heat) = self.chosen else { return };
        let screen = ui.ctx().content_rect();
        let painter = ui.ctx().layer_painter(egui::LayerId::background());
        let current = self.made.as_ref().filter(|(request, _)| Some(request) == self.last.as_ref());
        let note = match current {
            Some((_, Ok(texture))) => {
                let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
                painter.image(texture.id(), screen, whole, Color32::WHITE);
                String::new()
            }
            Some((_, Err(why))) => format!(": {why}"),
            None => " (being made)".into(),
        };
        let help = heat.to_possible_value().and_then(|v| v.get_help().map(ToString::to_string));
        egui::Area::new("heat map's legend".into()).fixed_pos([12.0, 12.0]).interactable(false).show(
            ui.ctx(),
            |ui| {
                egui::Frame::popup(ui.style()).show(ui, |ui| {
                    ui.label(format!("{}{note}", help.unwrap_or_default()));
                    if let Some(map) = heat.colours() {
                        let (strip, _) = ui
                            .allocate_exact_size(egui::vec2(6.0 * LEGEND as f32, 10.0), egui::Sense::hover());
                        for i in 0..LEGEND {
                            let [r, g, b] = map.colour(i as f64 / (LEGEND - 1) as f64);
                            let corner = strip.min + egui::vec2(6.0 * i as f32, 0.0);
                            let step = Rect::from_min_size(corner, egui::vec2(6.0, 10.0));
                            ui.painter().rect_filled(step, 0.0, Color32::from_rgb(r, g, b));
                        }
                    }
                });
            },
        );
    }
}
