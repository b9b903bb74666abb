//! What stands on the panel in the headset: figures, quality, comfort, the scene's place in the world, exit.

use super::shelf::{self, Listed};
use super::{Comfort, PanelEvents};
use crate::governor::{Budget, Governor, LADDER};
use crate::quality::Quality;
use crate::time::{Repeat, TimeCommand, TimeControl};
use egui::{Button, Context, Event, PointerButton, Pos2, RawInput, Rect, RichText, Ui, vec2};
use motes_renderer::{FrameReport, PRESETS};
use motes_scenes::settings::{Axis, Orientation, Settings};

/// Size of the panel's picture, pixels: 0.75 mm a pixel, so that text of 16 points is 24 mm high at two pixels a point.
pub const MENU_SIZE: [u32; 2] = [960, 1200];
/// Pixels of the picture in a point of egui's.
pub const PIXELS_PER_POINT: f32 = 2.0;

/// Budgets to choose from.
const BUDGETS: [Option<Budget>; 5] = [
    None,
    Some(Budget::Layers(30.0)),
    Some(Budget::QUEST_3),
    Some(Budget::Layers(12.0)),
    Some(Budget::Layers(8.0)),
];

/// Layers a pixel that are shown as the hottest colour.
pub const HOTTEST_LAYERS: f32 = 48.0;
const LEGEND: &str = "as colours: black 0, blue 8, cyan 16, green 24, yellow 32, red 40, white 48 and more";

/// Qualities to choose from.
const QUALITIES: [Quality; 3] = [Quality::Exact, Quality::Balanced, Quality::Fast];

/// What levels of detail may keep, SSIM.
const DETAILS: [(&str, f64); 4] = [("finest", 1.0), ("fine", 0.985), ("medium", 0.97), ("coarse", 0.94)];

/// What the user wants, read off the panel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MenuCommand {
    /// End the session.
    Exit,
    /// Back to the first place.
    Recentre,
    /// The world as it was at first.
    Reset,
    /// As cheaply as this allows, by measured fronts.
    Quality(Quality),
    /// A preset of the renderer, by its place in [`PRESETS`].
    Preset(usize),
    /// SSIM that the levels of detail keep.
    Detail(f64),
    /// Show layers as colours, or the scene again.
    Heat(bool),
    /// Other comfort options.
    Comfort(Comfort),
    /// Hold this budget, or none.
    Budget(Option<Budget>),
    /// This axis of the scene is up.
    Up(Axis),
    /// Metres in a unit of the scene.
    Scale(f64),
    /// Write the scene's settings beside it.
    Save,
    /// Something about the time of a moving scene.
    Time(TimeCommand),
    /// Another scene, by its place among those that are offered.
    Open(usize),
    /// Measure the device on the scene that is shown.
    Measure,
    /// Show the surroundings where the scene is empty, or no longer.
    Surroundings(bool),
}

/// What the panel tells.
#[derive(Clone, Debug, Default)]
pub struct MenuFacts<'a> {
    /// The scene's name.
    pub scene: &'a str,
    /// Its splats.
    pub splats: u32,
    /// How much is loaded, while it is.
    pub loading: Option<f32>,
    /// Time between two frames, seconds.
    pub frame_seconds: f64,
    /// What the last frame took on the device.
    pub report: FrameReport,
    /// What it is predicted to take on a Quest 3, ms, where that is known.
    pub predicted_ms: Option<f64>,
    /// SSIM that the levels of detail keep, where the scene has any.
    pub detail: Option<f64>,
    /// How the scene stands in the world, where it is known.
    pub settings: Option<&'a Settings>,
    /// What holds the budget, where there is one.
    pub governor: Option<&'a Governor>,
    /// The time of a moving scene.
    pub time: Option<&'a TimeControl>,
    /// Scenes that can be opened.
    pub scenes: &'a [Listed],
    /// How much of a measurement is done, while one goes on.
    pub measuring: Option<f32>,
    /// Whether the surroundings are seen where the scene is empty; none where they cannot be.
    pub surroundings: Option<bool>,
    /// Whether layers are shown as colours; none where the device cannot count them.
    pub heat: Option<bool>,
    /// What could not be done, or was.
    pub problem: &'a str,
}

/// egui's input from what the hands do at the panel.
pub fn input(events: &PanelEvents, seconds: f64, before: Option<Pos2>) -> (RawInput, Option<Pos2>) {
    let size = vec2(MENU_SIZE[0] as f32, MENU_SIZE[1] as f32) / PIXELS_PER_POINT;
    let mut raw = RawInput {
        screen_rect: Some(Rect::from_min_size(Pos2::ZERO, size)),
        time: Some(seconds),
        ..RawInput::default()
    };
    let pointer = events.pointer.map(|[u, v]| Pos2::new(u * size.x, v * size.y));
    match pointer {
        Some(at) => raw.events.push(Event::PointerMoved(at)),
        None if before.is_some() => raw.events.push(Event::PointerGone),
        None => {}
    }
    let button = |pressed, pos| Event::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::default(),
    };
    if let (true, Some(at)) = (events.pressed, pointer) {
        raw.events.push(button(true, at));
    }
    if let (true, Some(at)) = (events.released, pointer.or(before)) {
        raw.events.push(button(false, at));
    }
    (raw, pointer)
}

/// A context that reads well at a metre.
pub fn context() -> Context {
    let context = Context::default();
    context.set_pixels_per_point(PIXELS_PER_POINT);
    context.all_styles_mut(|style| {
        for font in style.text_styles.values_mut() {
            font.size *= 1.25;
        }
        style.spacing.item_spacing = vec2(8.0, 4.0);
        style.spacing.button_padding = vec2(10.0, 6.0);
    });
    context
}

/// What the panel shows below its head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Page {
    /// The scene that is shown, and how.
    #[default]
    Scene,
    /// Those that can be opened.
    Scenes,
}

fn page(context: &Context) -> Page {
    context.data(|data| data.get_temp(egui::Id::new("page"))).unwrap_or_default()
}

fn turn_to(context: &Context, page: Page) {
    context.data_mut(|data| data.insert_temp(egui::Id::new("page"), page));
}

/// Lays the panel out; returns what was asked for.
pub fn show(ui: &mut Ui, facts: &MenuFacts<'_>, comfort: &Comfort) -> Vec<MenuCommand> {
    let mut commands = Vec::new();
    ui.horizontal(|ui| {
        ui.heading(RichText::new(if facts.scene.is_empty() { "Motes" } else { facts.scene }).strong());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let exit = Button::new(RichText::new("Exit").strong());
            if ui.add(exit).clicked() {
                commands.push(MenuCommand::Exit);
            }
            if ui.button("Reset the world").clicked() {
                commands.push(MenuCommand::Reset);
            }
            if ui.button("Recentre").clicked() {
                commands.push(MenuCommand::Recentre);
            }
        });
    });
    if let Some(part) = facts.loading {
        ui.add(egui::ProgressBar::new(part).text(format!("loading, {:.0} %", part * 100.0)));
    }
    if !facts.problem.is_empty() {
        ui.colored_label(egui::Color32::from_rgb(255, 140, 100), facts.problem);
    }
    ui.separator();
    if !facts.scenes.is_empty() {
        let mut page = page(ui.ctx());
        ui.horizontal(|ui| {
            ui.selectable_value(&mut page, Page::Scene, "This scene");
            ui.selectable_value(&mut page, Page::Scenes, format!("All scenes ({})", facts.scenes.len()));
        });
        turn_to(ui.ctx(), page);
        if page == Page::Scenes {
            shelf::show(ui, facts.scenes, facts.scene, &mut commands);
            if commands.iter().any(|command| matches!(command, MenuCommand::Open(_))) {
                turn_to(ui.ctx(), Page::Scene);
            }
            return commands;
        }
    }
    let r = &facts.report;
    ui.label(format!("{} splats, {} drawn, {:.1} layers a pixel", facts.splats, r.visible, r.layers()));
    let predicted =
        facts.predicted_ms.map_or(String::new(), |ms| format!(", {ms:.1} ms predicted on a Quest 3"));
    ui.label(format!(
        "{:.1} ms a frame ({:.0} Hz), {:.1} ms on the device{predicted}",
        facts.frame_seconds * 1e3,
        1.0 / facts.frame_seconds.max(1e-3),
        r.device_ns() / 1e6
    ));
    if let Some(control) = facts.time {
        ui.separator();
        time(ui, control, &mut commands);
    }
    ui.separator();
    ui.horizontal_wrapped(|ui| {
        ui.label("Quality");
        for quality in QUALITIES {
            let about = quality.limit().map_or("as close as was measured".to_owned(), |limit| {
                format!("the cheapest way whose mean FLIP error was at most {limit} on every measured scene")
            });
            if ui.button(quality.to_string()).on_hover_text(about).clicked() {
                commands.push(MenuCommand::Quality(quality));
            }
        }
        ui.label("or");
        for (i, preset) in PRESETS.iter().enumerate() {
            if ui.button(preset.name).on_hover_text(preset.about).clicked() {
                commands.push(MenuCommand::Preset(i));
            }
        }
    });
    if let Some(held) = facts.detail {
        ui.horizontal_wrapped(|ui| {
            ui.label("Detail");
            for (text, target) in DETAILS {
                if ui.selectable_label(held == target, text).clicked() {
                    commands.push(MenuCommand::Detail(target));
                }
            }
        });
    }
    ui.horizontal_wrapped(|ui| {
        ui.label("Layers a pixel");
        let held = facts.governor.map(Governor::budget);
        let others = held.filter(|budget| !BUDGETS.contains(&Some(*budget))).map(Some);
        for budget in BUDGETS.iter().copied().chain(others) {
            let text = budget.map_or("no limit".to_owned(), |budget| budget.to_string());
            if ui.selectable_label(held == budget, text).clicked() {
                commands.push(MenuCommand::Budget(budget));
            }
        }
        if let Some(governor) = facts.governor {
            let step = governor.in_words();
            let beyond = if governor.is_beyond() { ", not enough" } else { "" };
            let (level, cost) = (governor.level(), governor.cost());
            ui.label(format!("{cost:.1}, step {level} of {}: {step}{beyond}", LADDER.len()));
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.label("Turn by");
        for degrees in [0.0, 15.0, 30.0, 45.0, 90.0] {
            let text = if degrees == 0.0 { "smooth".to_owned() } else { format!("{degrees:.0}°") };
            if ui.selectable_label(comfort.snap_degrees == degrees, text).clicked() {
                commands.push(MenuCommand::Comfort(Comfort { snap_degrees: degrees, ..*comfort }));
            }
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.label("Dark rim");
        for (text, vignette) in [("off", 0.0), ("some", 0.3), ("more", 0.6), ("most", 1.0)] {
            if ui.selectable_label(comfort.vignette == vignette, text).clicked() {
                commands.push(MenuCommand::Comfort(Comfort { vignette, ..*comfort }));
            }
        }
    });
    if let Some(settings) = facts.settings {
        ui.horizontal_wrapped(|ui| {
            ui.label("Up is");
            for name in ["+y", "-y", "+z", "-z", "+x", "-x"] {
                let Some(axis) = Axis::from_name(name) else { continue };
                let chosen = settings.orientation == Orientation::Up(axis);
                if ui.selectable_label(chosen, name).clicked() {
                    commands.push(MenuCommand::Up(axis));
                }
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.label(format!("A unit is {:.3} m", settings.scale));
            for (text, factor) in [("÷ 10", 0.1), ("÷ 1.1", 1.0 / 1.1), ("× 1.1", 1.1), ("× 10", 10.0)] {
                if ui.button(text).clicked() {
                    commands.push(MenuCommand::Scale(settings.scale * factor));
                }
            }
            if ui.button("Save").clicked() {
                commands.push(MenuCommand::Save);
            }
        });
    }
    ui.horizontal(|ui| {
        match facts.measuring {
            None if ui.button("Measure").on_hover_text("this device, on this scene").clicked() => {
                commands.push(MenuCommand::Measure);
            }
            None => {}
            Some(part) => {
                ui.label(format!("measuring, {:.0} %: hold still", part * 100.0));
            }
        }
        if let Some(mut heat) = facts.heat
            && ui.toggle_value(&mut heat, "Layers").on_hover_text(LEGEND).clicked()
        {
            commands.push(MenuCommand::Heat(heat));
        }
        if let Some(mut shown) = facts.surroundings
            && ui.toggle_value(&mut shown, "Surroundings").clicked()
        {
            commands.push(MenuCommand::Surroundings(shown));
        }
    });
    commands
}

fn time(ui: &mut Ui, control: &TimeControl, commands: &mut Vec<MenuCommand>) {
    let mut ask = |command| commands.push(MenuCommand::Time(command));
    ui.horizontal(|ui| {
        if ui.button(if control.playing() { "Pause" } else { "Play" }).clicked() {
            ask(TimeCommand::Toggle);
        }
        for (step, name) in [(-1, "−"), (1, "+")] {
            if ui.button(name).clicked() {
                ask(TimeCommand::Step(step));
            }
        }
        let mut shown = control.time();
        ui.spacing_mut().slider_width = 200.0;
        if ui.add(egui::Slider::new(&mut shown, 0.0..=1.0).max_decimals(2)).changed() {
            ask(TimeCommand::Scrub(shown.into()));
        }
    });
    ui.horizontal(|ui| {
        for (name, command) in [("÷ 2", TimeCommand::Slower), ("× 2", TimeCommand::Faster)] {
            if ui.button(name).clicked() {
                ask(command);
            }
        }
        ui.label(format!("{:+.2}", control.speed()));
        if ui.button("Back").on_hover_text("the other way").clicked() {
            ask(TimeCommand::Reverse);
        }
        for (repeat, name) in Repeat::ALL {
            if ui.selectable_label(control.repeat() == repeat, name).clicked() {
                ask(TimeCommand::Repeat(repeat));
            }
        }
    });
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    /// Runs a frame of the panel with the hands doing something.
    fn frame(context: &Context, events: PanelEvents, at: &mut Option<Pos2>) -> Vec<MenuCommand> {
        let (raw, pointer) = input(&events, 0.0, *at);
        *at = pointer;
        let settings = Settings::default();
        let time = TimeControl::default();
        let governor = Governor::new(Budget::QUEST_3);
        let names = ["garden.ply", "plant", "a scene whose name is far too long for its place", "d", "e"];
        let scenes = &names.map(|name| Listed { name: name.to_owned(), picture: None });
        let facts = MenuFacts {
            scene: "plant",
            settings: Some(&settings),
            governor: Some(&governor),
            detail: Some(0.97),
            predicted_ms: Some(12.3),
            time: Some(&time),
            scenes,
            surroundings: Some(false),
            heat: Some(false),
            problem: "something could not be done",
            ..MenuFacts::default()
        };
        let mut commands = Vec::new();
        let mut bottom = 0.0;
        let mut output = context.run_ui(raw, |ui| {
            commands = show(ui, &facts, &Comfort::default());
            bottom = ui.min_rect().bottom();
        });
        output.textures_delta.clear();
        let height = MENU_SIZE[1] as f32 / PIXELS_PER_POINT;
        assert!(bottom <= height, "the panel is {height} points high, and its content {bottom}");
        commands
    }

    #[test]
    fn everything_fits_and_every_control_of_time_answers() {
        let context = context();
        let mut at = None;
        let mut found = Vec::new();
        let places = (0..48).flat_map(|row| (0..32).map(move |column| (row, column)));
        for shown in [Page::Scene, Page::Scenes] {
            for (row, column) in places.clone() {
                turn_to(&context, shown);
                let place = [(column as f32 + 0.5) / 32.0, (row as f32 + 0.5) / 48.0];
                for (pressed, released) in [(false, false), (true, false), (false, true)] {
                    let events =
                        PanelEvents { pointer: Some(place), pressed, released, ..Default::default() };
                    found.extend(frame(&context, events, &mut at));
                }
            }
        }
        for wanted in [
            MenuCommand::Time(TimeCommand::Toggle),
            MenuCommand::Time(TimeCommand::Step(-1)),
            MenuCommand::Time(TimeCommand::Step(1)),
            MenuCommand::Time(TimeCommand::Faster),
            MenuCommand::Time(TimeCommand::Slower),
            MenuCommand::Time(TimeCommand::Reverse),
            MenuCommand::Time(TimeCommand::Repeat(Repeat::PingPong)),
            MenuCommand::Time(TimeCommand::Repeat(Repeat::Once)),
            MenuCommand::Save,
            MenuCommand::Quality(Quality::Exact),
            MenuCommand::Quality(Quality::Fast),
            MenuCommand::Preset(PRESETS.len() - 1),
            MenuCommand::Detail(1.0),
            MenuCommand::Detail(0.94),
            MenuCommand::Open(0),
            MenuCommand::Open(4),
            MenuCommand::Recentre,
            MenuCommand::Reset,
            MenuCommand::Measure,
            MenuCommand::Surroundings(true),
            MenuCommand::Heat(true),
        ] {
            assert!(found.contains(&wanted), "{wanted:?} cannot be reached");
        }
        let scrubbed = |c: &MenuCommand| matches!(c, MenuCommand::Time(TimeCommand::Scrub(t)) if *t > 0.5);
        assert!(found.iter().any(scrubbed));
        assert_eq!(page(&context), Page::Scenes, "nothing is clicked in the last corner");
    }

    #[test]
    fn a_scene_that_is_chosen_turns_the_page_back() {
        let context = context();
        let mut at = None;
        let mut click = |u: f32, v: f32| {
            let mut found = Vec::new();
            for (pressed, released) in [(false, false), (true, false), (false, true), (false, false)] {
                let events = PanelEvents { pointer: Some([u, v]), pressed, released, ..Default::default() };
                found.extend(frame(&context, events, &mut at));
            }
            found
        };
        // The tab is somewhere below the head.
        let turned = (0..60).map(|i| 0.05 + 0.005 * i as f32).find(|&v| {
            click(0.4, v);
            page(&context) == Page::Scenes
        });
        assert!(turned.is_some(), "the page of scenes cannot be reached");
        let opened = (0..60).map(|i| 0.15 + 0.01 * i as f32).find(|&v| {
            turn_to(&context, Page::Scenes);
            click(0.15, v) == [MenuCommand::Open(0)]
        });
        assert!(opened.is_some() && page(&context) == Page::Scene);
    }

    #[test]
    fn exit_is_in_the_upper_right_corner_and_takes_a_click() {
        let context = context();
        let mut at = None;
        let pointing = |u: f32, v: f32| PanelEvents { pointer: Some([u, v]), ..Default::default() };
        let mut clicks = |u, v| {
            turn_to(&context, Page::Scene);
            let mut found = Vec::new();
            for (pressed, released) in [(false, false), (true, false), (false, true), (false, false)] {
                found.extend(frame(&context, PanelEvents { pressed, released, ..pointing(u, v) }, &mut at));
            }
            found
        };
        let places = (0..100).map(|i| (0.8 + 0.02 * (i % 10) as f32, 0.01 + 0.015 * (i / 10) as f32));
        let exits: Vec<_> = places.filter(|&(u, v)| clicks(u, v) == [MenuCommand::Exit]).collect();
        assert!(!exits.is_empty(), "no exit in the upper right corner");
        let (u, v) = exits[exits.len() / 2];
        assert_eq!(clicks(0.5, 0.99), [], "nothing is there");
        let everywhere = (0..1600).map(|i| (0.025 * (i % 40) as f32, 0.025 * (i / 40) as f32));
        let budgets: Vec<_> = everywhere
            .flat_map(|(u, v)| clicks(u, v))
            .filter_map(|command| if let MenuCommand::Budget(budget) = command { Some(budget) } else { None })
            .collect();
        for budget in BUDGETS {
            assert!(budgets.contains(&budget), "{budget:?} cannot be chosen");
        }
        assert_eq!(frame(&context, pointing(u, v), &mut at), [], "pointing alone does nothing");
    }
}
