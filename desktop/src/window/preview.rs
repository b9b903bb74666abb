//! A recorded headset session in a window, both eyes side by side, as fast as it was.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ash::vk;
use motes_app::governor::Governor;
use motes_app::opened::Opened;
use motes_renderer::Renderer;
use motes_renderer::gpu::{Gpu, GpuOptions};
use motes_xr::{Content, EyeImages, Script, ScriptedHeadset, Viewer};
use winit::application::ApplicationHandler;
use winit::event::{ElementState, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use winit::window::{Window, WindowId};

use super::screen::to_window;
use super::swapchain::Swapchain;
use super::{event_loop, way, window_error};
use crate::error::CommandError;
use crate::replay::ReplayOptions;
use crate::studio::no_complaints;

/// Shows a session once, and returns when it is over or the window is closed.
///
/// # Errors
/// There is no display or device, the device cannot draw it, or nothing was drawn in the session.
pub fn preview(
    script: Script,
    opened: Opened,
    options: ReplayOptions,
    validation: bool,
) -> Result<(), CommandError> {
    let event_loop = event_loop()?;
    event_loop.set_control_flow(ControlFlow::Poll);
    let mut shell =
        Shell { session: Some((script, opened, options)), validation, open: None, result: Ok(()) };
    event_loop.run_app(&mut shell).map_err(|e| CommandError::Usage(format!("the window system: {e}")))?;
    if let Some(open) = shell.open.take() {
        let ended = open.close();
        shell.result = shell.result.and(ended);
    }
    shell.result
}

/// What lives as long as the event loop.
struct Shell {
    session: Option<(Script, Opened, ReplayOptions)>,
    validation: bool,
    open: Option<Open>,
    result: Result<(), CommandError>,
}

impl Shell {
    fn end(&mut self, event_loop: &ActiveEventLoop, result: Result<(), CommandError>) {
        if self.result.is_ok() {
            self.result = result;
        }
        event_loop.exit();
    }
}

impl ApplicationHandler for Shell {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        let Some((script, opened, options)) = self.session.take() else { return };
        match Open::new(event_loop, script, opened, &options, self.validation) {
            Ok(open) => self.open = Some(open),
            Err(error) => self.end(event_loop, Err(error)),
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => self.end(event_loop, Ok(())),
            WindowEvent::KeyboardInput { event: key, .. }
                if key.physical_key == PhysicalKey::Code(KeyCode::Escape)
                    && key.state == ElementState::Pressed =>
            {
                self.end(event_loop, Ok(()));
            }
            WindowEvent::RedrawRequested => match self.open.as_mut().map(Open::frame) {
                Some(Ok(false)) => self.end(event_loop, Ok(())),
                Some(Err(error)) => self.end(event_loop, Err(error)),
                Some(Ok(true)) | None => {}
            },
            _ => {}
        }
    }

    fn about_to_wait(&mut self, _: &ActiveEventLoop) {
        if let Some(open) = &self.open {
            open.window.request_redraw();
        }
    }
}

/// An open window. Fields go in this order.
struct Open {
    viewer: Viewer,
    headset: ScriptedHeadset,
    /// Command buffers for what brings the eyes to the window.
    copier: Renderer,
    swapchain: Swapchain,
    gpu: Arc<Gpu>,
    opened: Opened,
    options: ReplayOptions,
    /// The step at which the scene appears, and the next one.
    first: usize,
    step: usize,
    /// Frames that were shown.
    shown: usize,
    period: Duration,
    due: Instant,
    window: Arc<Window>,
}

impl Open {
    fn new(
        event_loop: &ActiveEventLoop,
        mut script: Script,
        opened: Opened,
        options: &ReplayOptions,
        validation: bool,
    ) -> Result<Self, CommandError> {
        let Some(first) = script.first_drawn() else {
            return Err(CommandError::Usage("no frame of the session shows a scene".into()));
        };
        let [width, height] = script.images.size;
        let size = winit::dpi::PhysicalSize::new(2 * width, height);
        let attributes = Window::default_attributes()
            .with_title(format!("{} – Motes, replayed", opened.name))
            .with_inner_size(size)
            .with_resizable(false);
        let window = Arc::new(event_loop.create_window(attributes).map_err(window_error)?);
        let display = window.display_handle().map_err(window_error)?.as_raw();
        let handle = window.window_handle().map_err(window_error)?.as_raw();
        let gpu = Gpu::new(&way(display, None)?, &GpuOptions { validation })?;
        let swapchain = Swapchain::new(&gpu, display, handle, size.into(), true)?;
        let period = Duration::from_secs(1) / u32::from(script.frames_per_second());
        // In the window's own format, so that eyes are copied as they are.
        script.images = EyeImages { size: [width, height], format: swapchain.format() };
        let headset = ScriptedHeadset::new(&gpu, script)?;
        let mut viewer = Viewer::new(&headset, options.config_for(&opened), options.comfort)?;
        viewer.governor = options.budget.map(Governor::new);
        let (copier, due) = (Renderer::new(&gpu)?, Instant::now());
        let options = options.clone();
        Ok(Self {
            viewer,
            headset,
            copier,
            swapchain,
            gpu,
            opened,
            options,
            first,
            step: 0,
            shown: 0,
            period,
            due,
            window,
        })
    }

    /// Shows the next frame. Whether there are more.
    fn frame(&mut self) -> Result<bool, CommandError> {
        std::thread::sleep(self.due.saturating_duration_since(Instant::now()));
        // A device that is too slow shows every frame, later.
        self.due = Instant::now().max(self.due) + self.period;
        if self.step == self.first {
            let (packing, _) = self.options.storage.of(&self.opened);
            self.viewer.show(Content::new(&self.gpu, &self.opened, packing)?)?;
        }
        self.step += 1;
        let drawn = self.viewer.frames();
        if self.viewer.step(&mut self.headset)?.is_some() {
            return Ok(false);
        }
        if self.viewer.frames() > drawn {
            self.window.pre_present_notify();
            self.present()?;
        }
        Ok(true)
    }

    /// Brings what the eyes see to the window.
    fn present(&mut self) -> Result<(), CommandError> {
        use vk::{AccessFlags as Access, ImageLayout as Layout, PipelineStageFlags as Stage};
        let frame = self.copier.begin()?;
        let commands = frame.commands();
        self.shown += 1;
        let Some(acquired) = self.swapchain.acquire(self.shown)? else {
            // The window system changed something: made anew, it shows the next frame.
            self.copier.submit(frame, &[], &[])?;
            self.gpu.wait_idle()?;
            return Ok(self.swapchain.resize(self.window.inner_size().into())?);
        };
        let eyes = self.headset.eye_images();
        let drawn = (Stage::COLOR_ATTACHMENT_OUTPUT, Access::COLOR_ATTACHMENT_WRITE);
        let read = (Stage::TRANSFER, Access::TRANSFER_READ);
        let source = [Layout::COLOR_ATTACHMENT_OPTIMAL, Layout::TRANSFER_SRC_OPTIMAL];
        // SAFETY: the eyes were drawn by what was submitted before, and are alive.
        unsafe { self.gpu.change_layout(commands, (eyes.raw(), 2), source, drawn, read) };
        to_window(&self.gpu, commands, &acquired, Some(eyes), self.swapchain.size(), 2);
        let copied = (Stage::TRANSFER, Access::TRANSFER_WRITE);
        let shown = (Stage::BOTTOM_OF_PIPE, Access::empty());
        let present = [Layout::TRANSFER_DST_OPTIMAL, Layout::PRESENT_SRC_KHR];
        // SAFETY: the window's image is acquired, and has one layer.
        unsafe { self.gpu.change_layout(commands, (acquired.image, 1), present, copied, shown) };
        self.copier.submit(frame, &[(acquired.free, Stage::TRANSFER)], &[acquired.drawn])?;
        self.swapchain.present(&acquired)?;
        Ok(())
    }

    /// Takes everything down, and says whether the validation layer was content.
    fn close(self) -> Result<(), CommandError> {
        let Self { viewer, headset, copier, swapchain, gpu, .. } = self;
        gpu.wait_idle()?;
        drop((viewer, headset, copier, swapchain));
        no_complaints(&gpu)
    }
}
