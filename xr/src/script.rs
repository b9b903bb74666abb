//! A recorded session: written while a runtime is in use, replayed without one.
//!
//! A text file, one JSON object a line: first what the images are, then everything that the headset said. Floats keep
//! every bit, and each frame names the order of splats that it was drawn in, so that a replay draws the same pixels.

use crate::{EyeImages, FrameTime, Headset, HiddenArea, Quad, SessionState, Step, XrError};
use ash::vk;
use motes_app::governor::Foveation;
use motes_app::headset::{Eye, Input};
use motes_renderer::gpu::{Gpu, Image, ImageDescription};
use motes_renderer::order::OrderRequest;
use motes_renderer::{DepthTarget, KeyBits, OrderKey, Target, TimeCull};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The version that is written.
const VERSION: u32 = 1;

/// A line longer than this is no session's.
const LONGEST_LINE: u64 = 1 << 20;

/// More lines than this (three hours at 90 Hz) are refused.
const MOST_LINES: usize = 1_000_000;

/// The first line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Header {
    /// The version of the format.
    motes_session: u32,
    /// Width and height of an eye's image, pixels.
    size: [u32; 2],
    /// `VkFormat` of the images.
    format: i32,
}

/// The order that a frame was drawn in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Order {
    key: OrderKey,
    bits: KeyBits,
    center: [f64; 3],
    forward: [f64; 3],
    /// Of the second eye's own order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    second: Option<[[f64; 3]; 2]>,
    time: f32,
    #[serde(default)]
    time_cull: TimeCull,
}

impl From<OrderRequest> for Order {
    fn from(r: OrderRequest) -> Self {
        Self {
            key: r.key,
            bits: r.bits,
            center: r.center.to_array(),
            forward: r.forward.to_array(),
            second: r.second.map(|(center, forward)| [center.to_array(), forward.to_array()]),
            time: r.time,
            time_cull: r.time_cull,
        }
    }
}

impl From<Order> for OrderRequest {
    fn from(o: Order) -> Self {
        Self {
            key: o.key,
            bits: o.bits,
            center: o.center.into(),
            forward: o.forward.into(),
            second: o.second.map(|[center, forward]| (center.into(), forward.into())),
            time: o.time,
            time_cull: o.time_cull,
            parts: 0,
        }
    }
}

/// A frame as it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScriptFrame {
    /// Its time.
    pub time: FrameTime,
    /// Hands and buttons.
    #[serde(default)]
    pub input: Input,
    /// Both eyes, left first; none where nothing was drawn or the head was not tracked.
    #[serde(default)]
    pub eyes: Option<[Eye; 2]>,
    /// The order of splats, where something was drawn.
    #[serde(default)]
    pub order: Option<Order>,
    /// What nobody sees of the images from this frame on, where that has changed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hidden: Option<HiddenArea>,
}

/// Everything that a headset said, line by line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScriptStep {
    /// No frame was wanted.
    Waiting(SessionState),
    /// A frame.
    Frame(Box<ScriptFrame>),
    /// The session ended.
    Ended(SessionState),
}

impl ScriptStep {
    /// Whether a scene was drawn in it.
    fn is_drawn(&self) -> bool {
        matches!(self, Self::Frame(frame) if frame.order.is_some())
    }
}

/// A recorded or written session.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// What is drawn.
    pub images: EyeImages,
    /// What the headset says.
    pub steps: Vec<ScriptStep>,
}

impl Script {
    /// Reads a session.
    ///
    /// # Errors
    /// The file cannot be read, or a line is not a session's; the error says which.
    pub fn read(path: &Path) -> Result<Self, XrError> {
        const REMEDY: &str = "Record the session again";
        let error = |place: String, problem: String| XrError::Script {
            file: path.display().to_string(),
            place,
            problem,
            remedy: REMEDY,
        };
        let file = File::open(path).map_err(|e| error("opening it".into(), e.to_string()))?;
        let mut reader = BufReader::new(file);
        let mut line = String::new();
        let mut images = None;
        let mut steps = Vec::new();
        for number in 1.. {
            line.clear();
            let place = || format!("line {number}");
            let read = std::io::Read::take(&mut reader, LONGEST_LINE).read_line(&mut line);
            let bytes = read.map_err(|e| error(place(), e.to_string()))? as u64;
            if bytes == 0 {
                break;
            }
            if bytes == LONGEST_LINE || number > MOST_LINES {
                return Err(error(place(), "is too long, or there are too many".into()));
            }
            let parsed = |e: serde_json::Error| error(place(), e.to_string());
            if images.is_some() {
                steps.push(serde_json::from_str(&line).map_err(parsed)?);
                continue;
            }
            let header: Header = serde_json::from_str(&line).map_err(parsed)?;
            if header.motes_session != VERSION {
                let problem = format!("version {} is not {VERSION}", header.motes_session);
                return Err(error(place(), problem));
            }
            images = Some(EyeImages { size: header.size, format: vk::Format::from_raw(header.format) });
        }
        match images {
            Some(images) => Ok(Self { images, steps }),
            None => Err(error("the file".into(), "is empty".into())),
        }
    }

    /// The place among the steps of the first frame that a scene was drawn in; none where there is no such frame.
    pub fn first_drawn(&self) -> Option<usize> {
        self.steps.iter().position(ScriptStep::is_drawn)
    }

    /// How many frames a scene was drawn in.
    pub fn drawn(&self) -> u32 {
        self.steps.iter().filter(|step| step.is_drawn()).count() as u32
    }

    /// The display's rate as the first frame says it, Hz, `1 ..= 240`; 72 without frames.
    pub fn frames_per_second(&self) -> u16 {
        let frame = self.steps.iter().find_map(|step| match step {
            ScriptStep::Frame(frame) => Some(frame.time.period),
            _ => None,
        });
        frame.map_or(72, |period| (1e9 / period.max(1) as f64).round().clamp(1.0, 240.0) as u16)
    }

    /// Writes a session.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn write(&self, path: &Path) -> Result<(), XrError> {
        let mut writer = Writer::create(path, self.images)?;
        for step in &self.steps {
            writer.step(step)?;
        }
        writer.finish()
    }
}

/// Writes a session line by line.
struct Writer {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Writer {
    fn create(path: &Path, images: EyeImages) -> Result<Self, XrError> {
        let file = File::create(path).map_err(|e| refused(path, e))?;
        let mut writer = Self { path: path.to_owned(), file: BufWriter::new(file) };
        let format = images.format.as_raw();
        writer.line(&Header { motes_session: VERSION, size: images.size, format })?;
        Ok(writer)
    }

    fn line(&mut self, value: &impl Serialize) -> Result<(), XrError> {
        let text = serde_json::to_string(value).map_err(|e| refused(&self.path, e.into()))?;
        writeln!(self.file, "{text}").map_err(|e| refused(&self.path, e))
    }

    fn step(&mut self, step: &ScriptStep) -> Result<(), XrError> {
        self.line(step)
    }

    fn finish(&mut self) -> Result<(), XrError> {
        self.file.flush().map_err(|e| refused(&self.path, e))
    }
}

fn refused(path: &Path, e: std::io::Error) -> XrError {
    XrError::Script {
        file: path.display().to_string(),
        place: "writing it".into(),
        problem: e.to_string(),
        remedy: "Choose another place for the recording",
    }
}

/// A headset whose every word is written down.
pub struct Recorder<H> {
    headset: H,
    writer: Writer,
    frame: Option<ScriptFrame>,
}

impl<H: Headset> Recorder<H> {
    /// Begins a recording.
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn new(headset: H, path: &Path) -> Result<Self, XrError> {
        let writer = Writer::create(path, headset.images())?;
        Ok(Self { headset, writer, frame: None })
    }

    /// The headset inside.
    pub fn inner(&self) -> &H {
        &self.headset
    }

    /// The headset inside.
    pub fn inner_mut(&mut self) -> &mut H {
        &mut self.headset
    }
}

impl<H: Headset> Headset for Recorder<H> {
    fn gpu(&self) -> &Arc<Gpu> {
        self.headset.gpu()
    }

    fn images(&self) -> EyeImages {
        self.headset.images()
    }

    fn next(&mut self) -> Result<Step, XrError> {
        let step = self.headset.next()?;
        match step {
            // Nothing happens while no frame is wanted.
            Step::Waiting(_) => {}
            Step::Ended(state) => {
                self.writer.step(&ScriptStep::Ended(state))?;
                self.writer.finish()?;
            }
            Step::Frame(time) => {
                let input = Input::default();
                self.frame = Some(ScriptFrame { time, input, eyes: None, order: None, hidden: None });
            }
        }
        Ok(step)
    }

    fn input(&mut self, frame: &FrameTime) -> Result<Input, XrError> {
        let input = self.headset.input(frame)?;
        if let Some(frame) = &mut self.frame {
            frame.input = input;
        }
        Ok(input)
    }

    fn eyes(&mut self, frame: &FrameTime) -> Result<Option<[Eye; 2]>, XrError> {
        let eyes = self.headset.eyes(frame)?;
        if let Some(frame) = &mut self.frame {
            frame.eyes = eyes;
        }
        Ok(eyes)
    }

    fn hidden(&mut self) -> Result<Option<HiddenArea>, XrError> {
        let hidden = self.headset.hidden()?;
        if let (Some(frame), Some(hidden)) = (&mut self.frame, &hidden) {
            frame.hidden = Some(hidden.clone());
        }
        Ok(hidden)
    }

    fn order(&mut self, newest: OrderRequest) -> Result<OrderRequest, XrError> {
        let order = self.headset.order(newest)?;
        if let Some(frame) = &mut self.frame {
            frame.order = Some(order.into());
        }
        Ok(order)
    }

    fn target(&mut self) -> Result<Target, XrError> {
        self.headset.target()
    }

    fn panel(&mut self) -> Result<Option<Target>, XrError> {
        self.headset.panel()
    }

    fn surroundings(&self) -> Option<bool> {
        self.headset.surroundings()
    }

    fn show_surroundings(&mut self, shown: bool) -> Result<(), XrError> {
        self.headset.show_surroundings(shown)
    }

    fn takes_depth(&self) -> bool {
        self.headset.takes_depth()
    }

    fn depth(&mut self, near: f32) -> Result<Option<DepthTarget>, XrError> {
        self.headset.depth(near)
    }

    fn foveation(&self) -> Option<Foveation> {
        self.headset.foveation()
    }

    fn foveate(&mut self, level: Foveation) -> Result<(), XrError> {
        self.headset.foveate(level)
    }

    fn image(&self) -> Option<vk::Image> {
        self.headset.image()
    }

    fn end(&mut self, frame: &FrameTime, shown: Option<&[Eye; 2]>, quads: &[Quad]) -> Result<(), XrError> {
        if let Some(frame) = self.frame.take() {
            self.writer.step(&ScriptStep::Frame(Box::new(frame)))?;
        }
        self.headset.end(frame, shown, quads)
    }

    fn request_exit(&mut self) -> Result<bool, XrError> {
        self.headset.request_exit()
    }
}

/// A headset that says what a script says, and keeps the images to itself.
pub struct ScriptedHeadset {
    gpu: Arc<Gpu>,
    script: Script,
    next: usize,
    image: Image,
    drawing: bool,
    transparent: bool,
}

impl ScriptedHeadset {
    /// Replays a script on a device.
    ///
    /// # Errors
    /// Images of the script's size and format cannot be had.
    pub fn new(gpu: &Arc<Gpu>, script: Script) -> Result<Self, XrError> {
        let description = ImageDescription {
            format: script.images.format,
            size: script.images.size,
            layers: 2,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC,
            aspect: vk::ImageAspectFlags::COLOR,
        };
        let image = Image::new(gpu, "scripted eyes", description)?;
        Ok(Self { gpu: gpu.clone(), script, next: 0, image, drawing: false, transparent: false })
    }

    /// What the eyes see: two layers, drawn as a colour attachment and left so.
    pub fn eye_images(&self) -> &Image {
        &self.image
    }

    fn current(&self) -> Option<&ScriptFrame> {
        match self.next.checked_sub(1).and_then(|i| self.script.steps.get(i)) {
            Some(ScriptStep::Frame(frame)) => Some(frame),
            _ => None,
        }
    }
}

impl Headset for ScriptedHeadset {
    fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    fn images(&self) -> EyeImages {
        self.script.images
    }

    fn next(&mut self) -> Result<Step, XrError> {
        let Some(step) = self.script.steps.get(self.next) else {
            return Ok(Step::Ended(SessionState::Exiting));
        };
        self.next += 1;
        Ok(match step {
            ScriptStep::Waiting(state) => Step::Waiting(*state),
            ScriptStep::Frame(frame) => Step::Frame(frame.time),
            ScriptStep::Ended(state) => Step::Ended(*state),
        })
    }

    fn input(&mut self, _: &FrameTime) -> Result<Input, XrError> {
        Ok(self.current().map(|frame| frame.input).unwrap_or_default())
    }

    fn eyes(&mut self, _: &FrameTime) -> Result<Option<[Eye; 2]>, XrError> {
        Ok(self.current().and_then(|frame| frame.eyes))
    }

    fn hidden(&mut self) -> Result<Option<HiddenArea>, XrError> {
        Ok(self.current().and_then(|frame| frame.hidden.clone()))
    }

    fn order(&mut self, newest: OrderRequest) -> Result<OrderRequest, XrError> {
        Ok(self.current().and_then(|frame| frame.order).map_or(newest, Into::into))
    }

    fn target(&mut self) -> Result<Target, XrError> {
        self.drawing = true;
        Ok(Target {
            all: self.image.view(),
            layers: [self.image.layer_view(0), self.image.layer_view(1)],
            format: self.script.images.format,
            size: self.script.images.size,
            layout: vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
            background_alpha: if self.transparent { 0.0 } else { 1.0 },
            depth: None,
            density: None,
        })
    }

    fn panel(&mut self) -> Result<Option<Target>, XrError> {
        Ok(None)
    }

    fn surroundings(&self) -> Option<bool> {
        Some(self.transparent)
    }

    fn show_surroundings(&mut self, shown: bool) -> Result<(), XrError> {
        self.transparent = shown;
        Ok(())
    }

    fn image(&self) -> Option<vk::Image> {
        self.drawing.then(|| self.image.raw())
    }

    fn end(&mut self, _: &FrameTime, _: Option<&[Eye; 2]>, _: &[Quad]) -> Result<(), XrError> {
        self.drawing = false;
        Ok(())
    }

    fn request_exit(&mut self) -> Result<bool, XrError> {
        // The script knows when it ends.
        Ok(true)
    }
}

impl Drop for ScriptedHeadset {
    fn drop(&mut self) {
        if let Err(e) = self.gpu.wait_idle() {
            log::error!("{e}");
        }
    }
}
