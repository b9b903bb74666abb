//! The window: winit's events in, frames out. What the viewer does is in `motes_app`.

mod heat;
mod input;
mod marking;
mod preview;
mod screen;
mod swapchain;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use motes_app::governor::{Budget, Governor};
use motes_app::viewer::{Command, Viewer};
use motes_renderer::RenderConfig;
use motes_renderer::gpu::{Gpu, GpuOptions, Plain};
use motes_renderer::plan::Overrides;
use winit::application::ApplicationHandler;
use winit::event::{ElementState, MouseButton, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::PhysicalKey;
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle, RawDisplayHandle};
use winit::window::{Window, WindowId};

use crate::error::CommandError;
use crate::studio::no_complaints;
use heat::HeatMap;
use input::{Gamepads, Input};
use marking::Markers;
use screen::Screen;

pub use input::KEYS;
pub use preview::preview;

/// How the window is opened.
#[derive(Clone, Debug)]
pub struct WindowOptions {
    /// Scenes to show, merged; the sample where there is none.
    pub scenes: Vec<PathBuf>,
    /// How frames are drawn.
    pub config: RenderConfig,
    /// Whether another expansion may take the default one's place where the device draws with it faster.
    pub suit_device: bool,
    /// Scenes are drawn by plan, but for what is asked for here.
    pub by_plan: Option<Overrides>,
    /// What a frame may take; nothing is held without.
    pub budget: Option<Budget>,
    /// Of a file of levels: SSIM to keep.
    pub lod_target: f64,
    /// A file of levels is read on the way into so many bytes.
    pub lod_memory: Option<u64>,
    /// Both eyes side by side.
    pub stereo: bool,
    /// Whether the panel is shown.
    pub panel: bool,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Where pictures are saved.
    pub pictures: PathBuf,
    /// Part of a device's name.
    pub device: Option<String>,
    /// Whether the validation layer watches.
    pub validation: bool,
    /// Whether frames wait for the screen.
    pub paced: bool,
}

/// Opens the window, and returns when it is closed.
///
/// # Errors
/// There is no display or device, or the device was lost.
pub fn run(options: WindowOptions) -> Result<(), CommandError> {
    let event_loop = event_loop()?;
    event_loop.set_control_flow(ControlFlow::Poll);
    let mut shell = Shell { options, open: None, result: Ok(()) };
    event_loop.run_app(&mut shell).map_err(|e| CommandError::Usage(format!("the window system: {e}")))?;
    if let Some(open) = shell.open.take() {
        let ended = open.close();
        shell.result = shell.result.and(ended);
    }
    shell.result
}

fn event_loop() -> Result<EventLoop<()>, CommandError> {
    match EventLoop::new() {
        Ok(event_loop) if has_display() => Ok(event_loop),
        Ok(_) => Err(no_display("neither DISPLAY nor WAYLAND_DISPLAY is set")),
        Err(error) => Err(no_display(&error.to_string())),
    }
}

/// A device that can show pictures on a display; `device`: part of its name.
fn way(display: RawDisplayHandle, device: Option<String>) -> Result<Plain, CommandError> {
    let extensions = ash_window::enumerate_required_extensions(display).map_err(window_error)?;
    let surface_extensions = extensions
        .iter()
        // SAFETY: the list holds terminated strings that live as long as the program.
        .map(|&name| unsafe { std::ffi::CStr::from_ptr(name) }.to_owned())
        .collect();
    Ok(Plain { surface_extensions, device })
}

fn has_display() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    cfg!(not(target_os = "linux")) || set("DISPLAY") || set("WAYLAND_DISPLAY") || set("WAYLAND_SOCKET")
}

fn no_display(why: &str) -> CommandError {
    CommandError::Usage(format!(
        "there is no display to open a window on ({why}). Pictures need none: motes render SCENE -o picture.png"
    ))
}

/// What lives as long as the event loop.
struct Shell {
    options: WindowOptions,
    open: Option<Open>,
    result: Result<(), CommandError>,
}

/// An open window. Fields go in this order: what is made with the device, the device, the window.
struct Open {
    screen: Screen,
    viewer: Viewer,
    heat: HeatMap,
    markers: Markers,
    gpu: Arc<Gpu>,
    egui: egui_winit::State,
    input: Input,
    gamepads: Gamepads,
    last: Instant,
    /// Frames are drawn until then without a further reason.
    awake: Instant,
    /// Frames that are still drawn once nothing moves any more: the panel's figures are of an earlier frame, and a picture may
    /// be made from several.
    owed: usize,
    /// Whether nothing was drawn for a while before the next frame.
    rested: bool,
    pictures: PathBuf,
    window: Arc<Window>,
}

/// How long frames go on after the last event.
const AWAKE: Duration = Duration::from_millis(500);
/// Frames until the panel's figures are of what is shown: those under way, the one that takes their report, and the one that
/// shows it. A time would not do: the first frame of a scene can take seconds, for which pipelines are made.
const FIGURES_BEHIND: usize = swapchain::FRAMES + 2;
/// How often gamepads and loading are looked at while nothing moves.
const IDLE: Duration = Duration::from_millis(50);

impl ApplicationHandler for Shell {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.open.is_none() {
            match Open::new(event_loop, &self.options) {
                Ok(open) => self.open = Some(open),
                Err(error) => self.end(event_loop, Err(error)),
            }
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(open) = &mut self.open else { return };
        match open.event(&event) {
            Ok(true) => {}
            Ok(false) => self.end(event_loop, Ok(())),
            Err(error) => self.end(event_loop, Err(error)),
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let Some(open) = &mut self.open else { return };
        let now = Instant::now();
        let busy = open.viewer.is_busy() || open.heat.is_busy() || open.markers.is_busy();
        if now < open.awake || busy || open.gamepads.is_moved() {
            open.owed = FIGURES_BEHIND;
            event_loop.set_control_flow(ControlFlow::Poll);
        } else {
            event_loop.set_control_flow(ControlFlow::WaitUntil(now + IDLE));
        }
        // What is only owed is waited for: nobody may ask a window that is hidden to draw.
        if open.owed > 0 {
            open.window.request_redraw();
        } else {
            open.rested = true;
        }
    }
}

impl Shell {
    fn end(&mut self, event_loop: &ActiveEventLoop, result: Result<(), CommandError>) {
        if self.result.is_ok() {
            self.result = result;
        }
        event_loop.exit();
    }
}

fn window_error(what: impl std::fmt::Display) -> CommandError {
    CommandError::Usage(format!("the window system: {what}"))
}

impl Open {
    fn new(event_loop: &ActiveEventLoop, options: &WindowOptions) -> Result<Self, CommandError> {
        let size = winit::dpi::PhysicalSize::new(options.size[0], options.size[1]);
        let attributes = Window::default_attributes().with_title("Motes").with_inner_size(size);
        let window = Arc::new(event_loop.create_window(attributes).map_err(window_error)?);
        let display = window.display_handle().map_err(window_error)?.as_raw();
        let handle = window.window_handle().map_err(window_error)?.as_raw();
        let way = way(display, options.device.clone())?;
        let gpu = Gpu::new(&way, &GpuOptions { validation: options.validation })?;
        let context = egui::Context::default();
        let egui = egui_winit::State::new(
            context,
            egui::ViewportId::ROOT,
            window.as_ref(),
            Some(window.scale_factor() as f32),
            window.theme(),
            Some(gpu.capabilities.max_image_side as usize),
        );
        let mut screen = Screen::new(&gpu, display, handle, window.inner_size().into(), options.paced)?;
        screen.suit_device = options.suit_device;
        let mut viewer = Viewer::new(&gpu, options.config.clone());
        viewer.detail.target = options.lod_target;
        viewer.memory = options.lod_memory;
        viewer.stereo = options.stereo;
        viewer.panel = options.panel;
        viewer.by_plan = options.by_plan;
        viewer.governor = options.budget.map(Governor::new);
        viewer.open(options.scenes.clone());
        let now = Instant::now();
        let pictures = options.pictures.clone();
        let (input, gamepads) = (Input::default(), Gamepads::new());
        Ok(Self {
            screen,
            viewer,
            heat: HeatMap::default(),
            markers: Markers::default(),
            gpu,
            egui,
            input,
            gamepads,
            last: now,
            awake: now + AWAKE,
            owed: 0,
            rested: true,
            pictures,
            window,
        })
    }

    /// Whether the window stays open.
    fn event(&mut self, event: &WindowEvent) -> Result<bool, CommandError> {
        if matches!(event, WindowEvent::RedrawRequested) {
            return self.frame();
        }
        self.awake = Instant::now() + AWAKE;
        let typing = self.egui.egui_ctx().text_edit_focused();
        // Keys are the panel's while a number is typed into it; else it would move its focus by them.
        let keys = matches!(event, WindowEvent::KeyboardInput { .. });
        let consumed =
            if keys && !typing { false } else { self.egui.on_window_event(&self.window, event).consumed };
        match event {
            WindowEvent::CloseRequested => return Ok(false),
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } => {
                self.screen.resize(self.window.inner_size().into());
            }
            WindowEvent::DroppedFile(path) => self.viewer.open(vec![path.clone()]),
            WindowEvent::Focused(false) => self.input.release(),
            WindowEvent::KeyboardInput { event: key, .. } => {
                if let PhysicalKey::Code(code) = key.physical_key
                    && (!typing || key.state == ElementState::Released)
                    && let Some(command) = self.input.key(code, key.state, key.repeat)
                {
                    return self.obey(command);
                }
            }
            WindowEvent::MouseInput { state, button, .. }
                if !consumed || *state == ElementState::Released =>
            {
                if self.markers.is_on() && *button == MouseButton::Left {
                    self.markers.button(*state == ElementState::Pressed, self.input.place());
                } else {
                    self.input.button(*button, *state);
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                self.input.cursor([position.x, position.y]);
                self.markers.cursor([position.x, position.y]);
            }
            WindowEvent::MouseWheel { delta, .. } if !consumed => self.input.wheel(*delta),
            _ => {}
        }
        Ok(true)
    }

    /// Whether the window stays open.
    fn obey(&mut self, command: Command) -> Result<bool, CommandError> {
        match command {
            Command::Quit => return Ok(false),
            Command::SwitchHeatMap => self.heat.switch(),
            Command::SwitchMarking => {
                self.viewer.message = self.markers.switch(&self.viewer);
                self.heat.show_labels(self.markers.is_on());
            }
            Command::Screenshot => match self.picture() {
                Ok(file) => {
                    println!("{}", file.display());
                    self.viewer.message = Some(format!("saved {}", file.display()));
                }
                Err(error) => self.viewer.message = Some(error.to_string()),
            },
            other => self.viewer.obey(other),
        }
        Ok(true)
    }

    /// Saves what is shown, without the panel, at the window's size.
    fn picture(&mut self) -> Result<PathBuf, CommandError> {
        let picture = self.screen.picture(&mut self.viewer)?;
        let name = self.viewer.stage.as_ref().map_or("motes", |s| s.opened.name.as_str());
        let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
        std::fs::create_dir_all(&self.pictures).map_err(CommandError::io(&self.pictures))?;
        let file = (1..).map(|i| self.pictures.join(format!("{name}-{i:03}.png"))).find(|f| !f.exists());
        let file = file.unwrap_or_else(|| self.pictures.join(format!("{name}.png")));
        picture.save(&file)?;
        Ok(file)
    }

    /// Draws a frame. Whether the window stays open.
    fn frame(&mut self) -> Result<bool, CommandError> {
        let now = Instant::now();
        let since = (now - self.last).as_secs_f64();
        // After a pause, nothing jumps.
        let seconds = since.min(0.25);
        let since = (!std::mem::take(&mut self.rested)).then_some(since);
        self.last = now;
        self.owed = self.owed.saturating_sub(1);
        let (sticks, mut commands) = self.gamepads.poll();
        let height = f64::from(self.screen.size()[1]);
        let motion = self.input.motion(self.viewer.pace(), seconds, height, &sticks);
        if !motion.is_none() {
            self.awake = now + AWAKE;
        }
        if let Some(replaced) = self.viewer.advance(seconds, &motion) {
            // Frames under way may still use it.
            self.gpu.wait_idle()?;
            drop(replaced);
        }
        let title =
            self.viewer.stage.as_ref().map_or("Motes".to_owned(), |s| format!("{} – Motes", s.opened.name));
        if self.window.title() != title {
            self.window.set_title(&title);
        }

        let raw = self.egui.take_egui_input(&self.window);
        let context = self.egui.egui_ctx().clone();
        self.markers.update(&mut self.viewer, self.screen.size());
        self.heat.update(&context, &mut self.viewer, &mut self.screen, self.markers.labels());
        let (viewer, figures, heat) = (&mut self.viewer, &self.screen.figures, &self.heat);
        let markers = &mut self.markers;
        let device = &self.gpu.capabilities.device;
        let output = context.run_ui(raw, |ui| {
            heat.show(ui);
            markers.show(ui, viewer, ui.ctx().pixels_per_point());
            if viewer.panel {
                egui::Panel::right("panel").default_size(330.0).show(ui, |ui| {
                    commands.extend(motes_app::panel::show(ui, viewer, figures, device));
                });
            } else if let Some(loading) = viewer.loading() {
                egui::Area::new("loading".into()).fixed_pos([12.0, 12.0]).show(ui, |ui| {
                    ui.add(egui::ProgressBar::new(loading.fraction).desired_width(400.0).text(loading.what));
                });
            }
        });
        self.egui.handle_platform_output(&self.window, output.platform_output);
        let shapes = context.tessellate(output.shapes, output.pixels_per_point);
        self.window.pre_present_notify();
        self.screen.draw(&mut self.viewer, since, output.textures_delta, &shapes, output.pixels_per_point)?;
        self.owed = self.owed.max(self.screen.lacks);
        for command in commands {
            if !self.obey(command)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Takes everything down, and says whether the validation layer was content.
    fn close(self) -> Result<(), CommandError> {
        let Self { screen, viewer, gpu, .. } = self;
        gpu.wait_idle()?;
        drop(viewer);
        drop(screen);
        no_complaints(&gpu)
    }
}
