//! The scenes that can be opened, and the panel's page with their pictures.

use super::menu::MenuCommand;
use crate::thumbnail::{SIZE, Thumbnail};
use egui::{Button, ColorImage, Context, Grid, Image, Label, ScrollArea, TextureHandle, TextureOptions, Ui};
use std::sync::Arc;

/// A scene that can be opened.
#[derive(Clone, Debug, PartialEq)]
pub struct Offered {
    /// Its name.
    pub name: String,
    /// What it looks like, where that is known: from the first time on that it was opened.
    pub picture: Option<Arc<Thumbnail>>,
}

/// A scene on the panel: its name, and its picture among the panel's textures.
#[derive(Clone)]
pub struct Listed {
    /// Its name.
    pub name: String,
    /// Its picture.
    pub picture: Option<TextureHandle>,
}

impl std::fmt::Debug for Listed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?} ({} picture)", self.name, if self.picture.is_some() { "with a" } else { "no" })
    }
}

impl Listed {
    /// Brings scenes to a panel.
    pub fn on(context: &Context, offered: &[Offered]) -> Vec<Self> {
        let texture = |scene: &Offered| {
            scene.picture.as_ref().map(|picture| {
                let image = ColorImage::from_rgb(picture.size().map(|side| side as usize), picture.rgb());
                context.load_texture(&scene.name, image, TextureOptions::LINEAR)
            })
        };
        offered.iter().map(|scene| Self { name: scene.name.clone(), picture: texture(scene) }).collect()
    }
}

/// Pictures side by side.
const COLUMNS: usize = 3;
/// Width of a picture on the panel, points: with padding and spaces, as many as there are columns fit its 480.
const WIDTH: f32 = 122.0;

/// Lays the page out; a click opens a scene.
pub(super) fn show(ui: &mut Ui, scenes: &[Listed], shown: &str, commands: &mut Vec<MenuCommand>) {
    let size = egui::vec2(WIDTH, WIDTH * SIZE[1] as f32 / SIZE[0] as f32);
    let padded = size + 2.0 * ui.spacing().button_padding;
    ScrollArea::vertical().show(ui, |ui| {
        Grid::new("scenes").num_columns(COLUMNS).show(ui, |ui| {
            for (i, scene) in scenes.iter().enumerate() {
                ui.vertical(|ui| {
                    ui.set_max_width(padded.x);
                    let button = match &scene.picture {
                        Some(picture) => Button::image(Image::new((picture.id(), size))),
                        None => Button::new("not opened yet").min_size(padded),
                    };
                    if ui.add(button.selected(scene.name == shown)).clicked() {
                        commands.push(MenuCommand::Open(i));
                    }
                    ui.add(Label::new(&scene.name).truncate());
                });
                if i % COLUMNS == COLUMNS - 1 {
                    ui.end_row();
                }
            }
        });
    });
}
