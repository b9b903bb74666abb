//! The panel: every choice of the render configuration, the figures of a frame, the scene's settings. Egui alone, so
//! that a window shows it, and a headset.

use egui::{CollapsingHeader, ComboBox, DragValue, Ui};
use motes_renderer::{CHOICES, Choice, Kind, PRESETS, RenderConfig, SceneOnDevice};
use motes_scenes::settings::{Axis, Orientation};

use crate::eye::EyeMode;
use crate::governor::{Budget, Governor, LADDER};
use crate::time::{Repeat, TimeCommand, TimeControl};
use crate::viewer::{Command, Figures, Stage, Viewer};

/// Draws the panel's content; returns what was asked for.
pub fn show(ui: &mut Ui, viewer: &mut Viewer, figures: &Figures, device: &str) -> Vec<Command> {
    let mut commands = Vec::new();
    egui::ScrollArea::vertical().show(ui, |ui| {
        head(ui, viewer, &mut commands);
        let shown = viewer.stage.as_ref().map(Stage::shown);
        figures_table(ui, shown, viewer.order_age(), figures, device);
        CollapsingHeader::new("View").default_open(true).show(ui, |ui| view(ui, viewer, &mut commands));
        CollapsingHeader::new("Overdraw budget")
            .default_open(true)
            .show(ui, |ui| budget(ui, &mut viewer.governor));
        if viewer.stage.as_ref().is_some_and(|s| s.detail.is_some()) {
            CollapsingHeader::new("Level of detail").default_open(true).show(ui, |ui| detail(ui, viewer));
        }
        if viewer.stage.is_some() {
            CollapsingHeader::new("Scene").show(ui, |ui| scene(ui, viewer));
        }
        if let Some(plan) = viewer.stage.as_ref().and_then(|s| s.plan.as_ref()) {
            CollapsingHeader::new("Plan").show(ui, |ui| {
                for d in &plan.decisions {
                    let (name, on) = (d.topic.name(), if d.on { "on" } else { "off" });
                    ui.label(format!("{name} {on}: {}", d.choice)).on_hover_text(&d.reason);
                }
                ui.label(format!("{} bytes a splat", plan.bytes_per_splat()));
            });
        }
        CollapsingHeader::new("Rendering")
            .default_open(true)
            .show(ui, |ui| rendering(ui, &mut viewer.config));
    });
    commands
}

fn head(ui: &mut Ui, viewer: &mut Viewer, commands: &mut Vec<Command>) {
    let name = viewer.stage.as_ref().map_or("no scene", |s| s.opened.name.as_str());
    ui.horizontal(|ui| {
        ui.heading(name);
        if ui.button("Quit").clicked() {
            commands.push(Command::Quit);
        }
    });
    if let Some(loading) = viewer.loading() {
        ui.add(egui::ProgressBar::new(loading.fraction).text(loading.what));
    }
    if let Some(message) = viewer.message.clone() {
        ui.horizontal_wrapped(|ui| {
            ui.colored_label(ui.visuals().warn_fg_color, message);
            if ui.small_button("×").clicked() {
                viewer.message = None;
            }
        });
    }
}

fn figures_table(
    ui: &mut Ui,
    scene: Option<&SceneOnDevice>,
    order_age: u32,
    figures: &Figures,
    device: &str,
) {
    let report = &figures.report;
    let seconds = figures.seconds();
    let rate = if seconds > 0.0 { 1.0 / seconds } else { 0.0 };
    let (splats, bytes) = scene.map_or((0, 0), |s| (s.splats, s.bytes()));
    egui::Grid::new("figures").num_columns(2).show(ui, |ui| {
        let mut row = |name: &str, value: String| {
            ui.label(name);
            ui.monospace(value);
            ui.end_row();
        };
        row("frame", format!("{:.1} ms, {rate:.1} a second", 1e3 * seconds));
        row("on the device", format!("{:.1} ms", report.device_ns() / 1e6));
        row("  prepare, draw", format!("{:.1}, {:.1} ms", report.prepare_ns / 1e6, report.draw_ns / 1e6));
        row("splats", format!("{} of {splats}", report.visible));
        row("drawn by", figures.expansion.map_or_else(|| "nothing yet".to_owned(), |e| e.to_string()));
        row("fragments", format!("{:.2} M, {:.1} a pixel", report.fragments as f64 / 1e6, report.layers()));
        row(
            "order",
            match order_age {
                0 => "of this place".to_owned(),
                age => format!("{age} frames old"),
            },
        );
        row("scene", format!("{:.1} MB", bytes as f64 / 1e6));
        row("device", device.to_owned());
    });
}

fn view(ui: &mut Ui, viewer: &mut Viewer, commands: &mut Vec<Command>) {
    ui.horizontal(|ui| {
        ui.selectable_value(&mut viewer.eye.mode, EyeMode::Fly, "fly");
        ui.selectable_value(&mut viewer.eye.mode, EyeMode::Orbit, "orbit");
        ui.checkbox(&mut viewer.stereo, "stereo");
        if viewer.stereo {
            ui.add(DragValue::new(&mut viewer.eye_distance).range(0.0..=0.2).speed(0.001).suffix(" m"));
        }
    });
    ui.horizontal(|ui| {
        if ui.button("reset").clicked() {
            commands.push(Command::Reset);
        }
        if ui.button("picture").clicked() {
            commands.push(Command::Screenshot);
        }
        if ui.button("heat map").on_hover_text("the next, or none after the last (H)").clicked() {
            commands.push(Command::SwitchHeatMap);
        }
        if ui.button("label").on_hover_text("splats by hand, with a brush or a box (B)").clicked() {
            commands.push(Command::SwitchMarking);
        }
        let mut degrees = viewer.eye.vertical_fov.to_degrees();
        if ui.add(DragValue::new(&mut degrees).range(10.0..=150.0).suffix("°")).changed() {
            viewer.eye.vertical_fov = degrees.to_radians();
        }
    });
    let Some(stage) = &viewer.stage else { return };
    if stage.moves() {
        time(ui, &mut viewer.time, &mut viewer.config.time);
    }
    let opened = stage.opened.clone();
    if !opened.cameras.is_empty() {
        let chosen = stage.camera.and_then(|i| opened.cameras.get(i)).map_or("camera", |c| c.name.as_str());
        let mut taken = None;
        ComboBox::from_id_salt("camera").selected_text(chosen).show_ui(ui, |ui| {
            for (i, camera) in opened.cameras.iter().enumerate() {
                if ui.selectable_label(stage.camera == Some(i), &camera.name).clicked() {
                    taken = Some(i);
                }
            }
        });
        if let Some(i) = taken {
            viewer.take_camera(i);
        }
    }
}

fn detail(ui: &mut Ui, viewer: &mut Viewer) {
    let target = egui::Slider::new(&mut viewer.detail.target, 0.5..=1.0).max_decimals(3);
    ui.add(target.text("SSIM to keep")).on_hover_text("Share of the finest level's, by the file's fit");
    let Some(stage) = &viewer.stage else { return };
    let Some(detail) = &stage.detail else { return };
    let regions: Vec<_> = detail.regions().iter().map(usize::to_string).collect();
    ui.label(format!("regions at each level, the finest first: {}", regions.join(", ")));
    let drawn = stage.scene.positions.parts().map_or(0, |p| p.splats());
    ui.label(format!("{drawn} splats sorted and projected"));
    if let Some(memory) = detail.memory() {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        ui.label(format!("{:.1} of {:.1} MiB in memory", mib(memory.resident), mib(memory.budget)));
    }
}

fn time(ui: &mut Ui, control: &mut TimeControl, shown: &mut f32) {
    ui.horizontal(|ui| {
        if ui.button(if control.playing() { "pause" } else { "play" }).clicked() {
            control.toggle();
        }
        if ui.add(egui::Slider::new(shown, 0.0..=1.0).max_decimals(3)).changed() {
            control.pause();
            control.scrub((*shown).into());
        }
        for (step, name) in [(-1, "−"), (1, "+")] {
            if ui.button(name).on_hover_text("one frame").clicked() {
                control.step(step);
            }
        }
    });
    ui.horizontal(|ui| {
        let mut speed = control.speed();
        if ui.add(DragValue::new(&mut speed).speed(0.02).prefix("speed ")).changed() {
            control.set_speed(speed);
        }
        if ui.button("backwards").clicked() {
            control.obey(TimeCommand::Reverse);
        }
        for (repeat, name) in Repeat::ALL {
            if ui.selectable_label(control.repeat() == repeat, name).clicked() {
                control.set_repeat(repeat);
            }
        }
    });
    ui.horizontal(|ui| {
        ui.monospace(format!("frame {} of {}", control.frame() + 1, control.frames()));
        let mut whole = control.whole_frames();
        if ui.checkbox(&mut whole, "whole frames only").changed() {
            control.obey(TimeCommand::WholeFrames(whole));
        }
    });
    *shown = control.time();
}

/// The budget, what frames take of it, and which step is in force.
fn budget(ui: &mut Ui, governor: &mut Option<Governor>) {
    ui.horizontal(|ui| {
        let mut held = governor.is_some();
        if ui.checkbox(&mut held, "hold").changed() {
            *governor = held.then(|| Governor::new(Budget::QUEST_3));
        }
        let Some(governor) = governor else { return };
        let mut limit = governor.budget().limit();
        let suffix = format!(" {}", governor.unit());
        let value = DragValue::new(&mut limit).range(0.1..=1000.0).speed(0.1).max_decimals(1).suffix(suffix);
        if ui.add(value).changed() {
            governor.set_budget(match governor.budget() {
                Budget::Layers(_) => Budget::Layers(limit),
                Budget::Milliseconds(_) => Budget::Milliseconds(limit),
            });
        }
    });
    let Some(governor) = governor else { return };
    let step = governor.in_words();
    ui.label(format!("{:.1} taken; step {} of {}: {step}", governor.cost(), governor.level(), LADDER.len()));
    if governor.is_beyond() {
        ui.colored_label(ui.visuals().warn_fg_color, "more than the last step can hold");
    }
}

fn scene(ui: &mut Ui, viewer: &mut Viewer) {
    let Some(Stage { settings, opened, .. }) = &mut viewer.stage else { return };
    let mut changed = false;
    let current = match settings.orientation {
        Orientation::Up(axis) => axis.name().to_owned(),
        Orientation::Rotation(_) => "rotation".to_owned(),
    };
    ComboBox::from_label("up").selected_text(current).show_ui(ui, |ui| {
        for name in ["+x", "-x", "+y", "-y", "+z", "-z"] {
            if let Some(axis) = Axis::from_name(name) {
                let up = Orientation::Up(axis);
                changed |= ui.selectable_value(&mut settings.orientation, up, name).changed();
            }
        }
    });
    let scale = DragValue::new(&mut settings.scale).range(1e-3..=1e3).speed(0.01);
    ui.horizontal(|ui| {
        changed |= ui.add(scale).changed();
        ui.label("metres a unit");
    });
    let mut message = None;
    if let Some(path) = &opened.path
        && ui.button("save beside the scene").clicked()
    {
        message = Some(match settings.save(path) {
            Ok(()) => format!("saved {}", motes_scenes::settings::Settings::path_of(path).display()),
            Err(error) => error.to_string(),
        });
    }
    viewer.message = message.or(viewer.message.take());
    if changed {
        viewer.settings_changed();
    }
}

fn rendering(ui: &mut Ui, config: &mut RenderConfig) {
    ui.horizontal_wrapped(|ui| {
        for preset in PRESETS {
            if ui.button(preset.name).on_hover_text(preset.about).clicked() {
                let time = config.time;
                *config = RenderConfig { time, ..(preset.config)() };
            }
        }
    });
    egui::Grid::new("choices").num_columns(2).show(ui, |ui| {
        for choice in CHOICES {
            ui.label(choice.name).on_hover_text(choice.about);
            choose(ui, choice, config);
            ui.end_row();
        }
    });
}

/// The widget of one choice. What it sets is valid in itself; whether choices fit together the renderer says.
fn choose(ui: &mut Ui, choice: &Choice, config: &mut RenderConfig) {
    let current = choice.get(config);
    let mut wanted = None;
    match choice.kind {
        Kind::Names(names) => {
            ComboBox::from_id_salt(choice.name).selected_text(&current).show_ui(ui, |ui| {
                for (name, about) in names() {
                    if ui.selectable_label(current == name, name).on_hover_text(about).clicked() {
                        wanted = Some(name.to_owned());
                    }
                }
            });
        }
        Kind::Switch => {
            let mut on = current == "true";
            if ui.checkbox(&mut on, "").changed() {
                wanted = Some(on.to_string());
            }
        }
        Kind::Whole(low, high) => {
            let mut value: u32 = current.parse().unwrap_or(low);
            if ui.add(DragValue::new(&mut value).range(low..=high).speed(0.05)).changed() {
                wanted = Some(value.to_string());
            }
        }
        Kind::Number(low, high) | Kind::Magnitude(low, high) => {
            let mut value: f32 = current.parse().unwrap_or(low);
            let speed = match choice.kind {
                Kind::Magnitude(..) if value.is_finite() => (0.01 * value).max(1e-5),
                _ => 0.005,
            };
            if ui.add(DragValue::new(&mut value).range(low..=high).speed(speed).max_decimals(5)).changed() {
                wanted = Some(value.to_string());
            }
        }
        Kind::Colour => {
            let mut colour = config.background;
            if ui.color_edit_button_rgb(&mut colour).changed() {
                wanted = Some(colour.map(|c| c.to_string()).join(","));
            }
        }
    }
    if let Some(value) = wanted
        && let Err(error) = choice.set(config, &value)
    {
        log::warn!("{}: {error}", choice.name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{Context, Shape};
    use motes_renderer::Expansion;

    /// All that the table of figures says.
    fn said(figures: &Figures) -> Vec<String> {
        let context = Context::default();
        // Sizes of a grid's cells are known from the second frame on.
        let mut said = Vec::new();
        for _ in 0..2 {
            let mut output = context.run_ui(egui::RawInput::default(), |ui| {
                figures_table(ui, None, 0, figures, "a device");
            });
            output.textures_delta.clear();
            said = output
                .shapes
                .into_iter()
                .filter_map(|s| match s.shape {
                    Shape::Text(text) => Some(text.galley.text().to_owned()),
                    _ => None,
                })
                .collect();
        }
        said
    }

    #[test]
    fn figures_say_what_draws_not_what_is_chosen() {
        let tiles = said(&Figures { expansion: Some(Expansion::Tiles), ..Figures::default() });
        let row = tiles.iter().position(|t| t == "drawn by");
        assert_eq!(row.and_then(|r| tiles.get(r + 1)).map(String::as_str), Some("tiles"), "{tiles:?}");
        let none = said(&Figures::default());
        assert!(none.iter().any(|t| t == "0.0 ms, 0.0 a second"), "{none:?}");
        assert!(none.iter().any(|t| t == "nothing yet") && !none.iter().any(|t| t == "tiles"), "{none:?}");
    }
}
