//! `motes golden`: renders the reference pictures and photographs of the sample scenes again, and says how close it comes.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use glam::DMat3;
use motes_renderer::gpu::Gpu;
use motes_renderer::{RenderConfig, TargetFormat, View};
use motes_scenes::cameras::{self, Camera};
use motes_scenes::{LoadOptions, Scene, load_many};
use std::sync::Arc;

use crate::error::CommandError;
use crate::measure::{Picture, psnr, squared_errors};
use crate::shots::resized;
use crate::studio::{DeviceArgs, Studio, no_complaints, reference_pictures};

/// The f64 reference must come this close to a golden picture, dB.
pub const REFERENCE_BOUND: f64 = 55.0;
/// The device in the trainers' semantics must come this close, dB.
pub const DEVICE_BOUND: f64 = 45.0;
/// PSNR against photographs must be within this of what the data set states, dB.
pub const PHOTOGRAPH_BOUND: f64 = 0.1;

/// Check the pictures of the sample scenes: golden views, and photographs; fails where a bound does not hold
#[derive(Clone, Debug, clap::Args)]
pub struct GoldenArgs {
    /// The folder of the sample scenes, with golden/golden.json and photos_snowmiku
    #[arg(env = "MOTES_SCENES")]
    pub scenes: PathBuf,
    /// Only views whose name contains this
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// How close the pictures of one view come to the golden one; PSNR in dB.
#[derive(Clone, Debug)]
pub struct Figures {
    /// The view's name.
    pub name: String,
    /// The f64 reference, trainers' semantics.
    pub reference: f64,
    /// The device, trainers' semantics.
    pub device: f64,
    /// The device, as it draws by default.
    pub default: f64,
    /// The device with the second axis of the camera's rotation flipped: must miss the bound.
    pub control: f64,
}

impl Figures {
    /// Whether every bound holds, and the control misses its.
    pub fn hold(&self) -> bool {
        self.reference >= REFERENCE_BOUND && self.device >= DEVICE_BOUND && self.control < DEVICE_BOUND
    }
}

/// Prints both tables.
///
/// # Errors
/// A scene cannot be read, or a bound does not hold.
pub fn run(args: &GoldenArgs) -> Result<(), CommandError> {
    let gpu = args.device.offscreen()?;
    let wanted = |name: &str| args.only.as_ref().is_none_or(|text| name.contains(text.as_str()));
    let mut out = std::io::stdout();
    let mut print = |text: &str| out.write_all(text.as_bytes()).map_err(CommandError::Print);
    let mut missed = Vec::new();

    print(&format!("{} ({})\n\n", gpu.capabilities.device, gpu.capabilities.driver))?;
    print("PSNR in dB              f64 reference   GPU as trainers   GPU by default   control (flipped)\n")?;
    print(&format!("{:22} {:>14} {:>17} {:>16} {:>19}\n", "bound", "≥ 55", "≥ 45", "", "< 45"))?;
    let folder = args.scenes.join("golden");
    for camera in cameras::load(&folder.join("golden.json"))?.iter().filter(|c| wanted(&c.name)) {
        let scene = load_many(&inputs(&args.scenes, camera), &LoadOptions::default())?;
        let golden = Picture::load(&folder.join(format!("{}.png", camera.name)))?;
        let f = figures(&gpu, &scene, camera, &golden)?;
        let Figures { name, reference, device, default, control } = &f;
        print(&format!("{name:22} {reference:14.2} {device:17.2} {default:16.2} {control:19.2}\n"))?;
        if !f.hold() {
            missed.push(name.clone());
        }
    }
    let folder = args.scenes.join("photos_snowmiku");
    let photographs: Vec<_> = photographs(&folder)?.into_iter().filter(|p| wanted(&p.camera.name)).collect();
    if !photographs.is_empty() {
        let scene = load_many(&[folder.join("snowmiku_sh3.ply")], &LoadOptions::default())?;
        print("\nPSNR in dB against photographs, trainers' semantics\n")?;
        print("photograph               stated   f64 reference   GPU rgba32f   GPU rgba16f\n")?;
        for photograph in &photographs {
            let [reference, wide, half] = photograph_figures(&gpu, &scene, photograph)?;
            let Photograph { camera, stated } = photograph;
            let name = &camera.name;
            print(&format!("{name:22} {stated:8.2} {reference:15.2} {wide:13.2} {half:13.2}\n"))?;
            if [reference, wide].iter().any(|f| !((f - stated).abs() <= PHOTOGRAPH_BOUND)) {
                missed.push(camera.name.clone());
            }
        }
    }
    no_complaints(&gpu)?;
    if missed.is_empty() {
        print("\nevery bound holds\n")
    } else {
        let mut text = String::from("a bound does not hold:");
        for name in &missed {
            let _ = write!(text, " {name}");
        }
        Err(CommandError::Failed(text))
    }
}

/// The scene files of a golden view. A moving scene's entry says “FILE evaluated at time”.
pub fn inputs(scenes: &Path, camera: &Camera) -> Vec<PathBuf> {
    let file = |input: &String| scenes.join(input.trim_end_matches(" evaluated at time"));
    camera.inputs.iter().map(file).collect()
}

/// PSNR of two pictures of one size, dB.
///
/// # Errors
/// The sizes differ.
pub fn decibels(reference: &Picture, test: &Picture) -> Result<f64, CommandError> {
    if reference.size() != test.size() {
        let (a, b) = (reference.size(), test.size());
        return Err(CommandError::Usage(format!("pictures of {a:?} and {b:?} pixels cannot be compared")));
    }
    let errors = squared_errors(reference, test);
    Ok(psnr(errors.iter().sum::<f64>() / errors.len().max(1) as f64))
}

/// The same camera with the second axis of its rotation (y, down) pointing the other way: a mirrored picture.
pub fn flipped(view: &View) -> View {
    let flip = DMat3::from_diagonal(glam::DVec3::new(1.0, -1.0, 1.0));
    View { rotation: flip * view.rotation, ..*view }
}

/// Renders a golden view in every way.
///
/// # Errors
/// The view makes no picture, or the driver's.
pub fn figures(
    gpu: &Arc<Gpu>,
    scene: &Scene,
    camera: &Camera,
    golden: &Picture,
) -> Result<Figures, CommandError> {
    let view = View::from_camera(camera);
    let time = camera.time.unwrap_or(0.0) as f32;
    let trainers = RenderConfig { time, ..RenderConfig::inria() };
    let ours = RenderConfig { time, ..RenderConfig::default() };
    let reference = only(reference_pictures(&scene.splats, &[view], &trainers, true)?)?;
    let mut studio = Studio::new(gpu, &scene.splats, &trainers)?;
    let mut take = |view: &View, config: &RenderConfig| {
        only(studio.take(&[resized(view, golden.size())], config)?.0).and_then(|p| decibels(golden, &p))
    };
    Ok(Figures {
        name: camera.name.clone(),
        reference: decibels(golden, &reference)?,
        device: take(&view, &trainers)?,
        default: take(&view, &ours)?,
        control: take(&flipped(&view), &trainers)?,
    })
}

fn only(pictures: Vec<Picture>) -> Result<Picture, CommandError> {
    pictures.into_iter().next().ok_or_else(|| CommandError::Failed("no picture was made".into()))
}

/// A photograph, and the PSNR that the data set states for it.
#[derive(Clone, Debug)]
pub struct Photograph {
    /// Its camera.
    pub camera: Camera,
    /// PSNR of the trainers' rendering against it, dB.
    pub stated: f64,
}

#[derive(serde::Deserialize)]
struct Stated {
    img: String,
    psnr_vs_photo: f64,
}

/// The held-out photographs of a data set with a `psnr.json`.
///
/// # Errors
/// A file cannot be read or is not what it should be.
pub fn photographs(folder: &Path) -> Result<Vec<Photograph>, CommandError> {
    let path = folder.join("psnr.json");
    let text = std::fs::read(&path).map_err(CommandError::io(&path))?;
    let stated: Vec<Stated> =
        serde_json::from_slice(&text).map_err(|e| CommandError::io(&path)(std::io::Error::other(e)))?;
    let list = cameras::load(&folder.join("cameras.json"))?;
    let mut photographs = Vec::new();
    for entry in stated {
        let camera = cameras::find(&list, &entry.img).map_err(CommandError::Usage)?;
        if camera.split == Some(cameras::Split::Test) {
            photographs.push(Photograph { camera: camera.clone(), stated: entry.psnr_vs_photo });
        }
    }
    Ok(photographs)
}

/// PSNR of the reference, and of the device blending in 32-bit and in 16-bit floats, against a photograph, dB; all in
/// the trainers' semantics. The 16-bit figure depends on how the device rounds: a CPU driver that cuts every layer
/// towards zero darkens a picture of a hundred layers by half a step of 255.
///
/// # Errors
/// The photograph cannot be read, or the driver's.
pub fn photograph_figures(
    gpu: &Arc<Gpu>,
    scene: &Scene,
    photograph: &Photograph,
) -> Result<[f64; 3], CommandError> {
    let Some(file) = &photograph.camera.image else {
        let text = format!("the photograph {} is not on disk", photograph.camera.photograph);
        return Err(CommandError::Usage(text));
    };
    let photo = Picture::load(file)?;
    let view = resized(&View::from_camera(&photograph.camera), photo.size());
    let trainers = RenderConfig::inria();
    let reference = only(reference_pictures(&scene.splats, &[view], &trainers, true)?)?;
    let mut studio = Studio::new(gpu, &scene.splats, &trainers)?;
    let mut take = |target| {
        let config = RenderConfig { target, ..trainers.clone() };
        only(studio.take(&[view], &config)?.0).and_then(|p| decibels(&photo, &p))
    };
    let [wide, half] = [take(TargetFormat::Rgba32F)?, take(TargetFormat::Rgba16F)?];
    Ok([decibels(&photo, &reference)?, wide, half])
}
