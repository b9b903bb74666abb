//! What pictures are measured against: the f64 reference, or the most exact configuration of the device where the
//! reference takes too long. The record says which.

use std::path::{Path, PathBuf};
use std::time::Instant;

use motes_renderer::reference::{self, ReferenceImage, ReferenceOptions, ReferenceOrder};
use motes_renderer::{Offscreen, Packing, RenderConfig, SceneOnDevice, View};

use super::record::TruthRecord;
use super::subject::Subject;
use super::{BenchError, sweep};
use crate::measure::{ColourMap, Picture, coloured, psnr, squared_errors};
use crate::shots::Shot;

/// Splats × pixels up to which the reference is affordable: 2 million at 640 × 480, some tens of seconds.
pub const AFFORDABLE: f64 = 2e6 * 640.0 * 480.0;

/// Layers per pixel that a heat map's last colour stands for.
pub const LAYERS_SHOWN: f64 = 200.0;

/// What the reference shows: every rung of the ladder of projections, every order and every filter is measured against
/// this one picture. Near plane, background and time are the default configuration's.
pub fn options(config: &RenderConfig, view: &Shot) -> ReferenceOptions {
    ReferenceOptions {
        order: ReferenceOrder::Radial(Some(view.view.eye)),
        near: config.near.into(),
        near_fade: config.near_fade.into(),
        background: config.background.map(f64::from),
        time: view.time.unwrap_or(0.0).into(),
        ..ReferenceOptions::default()
    }
}

/// The file of a view's truth in a bench's folder.
pub fn path(folder: &Path, scene: &str, view: &str) -> PathBuf {
    folder.join("truth").join(format!("{}.png", file_name(&[scene, view])))
}

/// The file of a view's layers in a bench's folder.
pub fn layers_path(folder: &Path, scene: &str, view: &str) -> PathBuf {
    folder.join("truth").join(format!("{}.layers.png", file_name(&[scene, view])))
}

/// A file name from words: what no file system minds, and a hash so that different words never meet.
pub fn file_name(words: &[&str]) -> String {
    let joined = words.join("--");
    let plain: String = joined
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' })
        .take(80)
        .collect();
    format!("{plain}-{:08x}", super::measure::hash(joined.as_bytes()) as u32)
}

/// Makes the truth of a view and writes its pictures.
///
/// # Errors
/// The reference's, the device's, or the file system's.
pub fn make(
    folder: &Path,
    subject: &Subject,
    view: &Shot,
    offscreen: &mut Offscreen,
) -> Result<(Picture, TruthRecord), BenchError> {
    let start = Instant::now();
    let config = RenderConfig::default();
    let options = options(&config, view);
    let affordable = cost(subject, &view.view) <= AFFORDABLE;
    let reference = |view: &View| {
        reference::render(&subject.splats, view, &options)
            .map_err(|source| BenchError::Reference { subject: subject.name.clone(), source })
    };
    std::fs::create_dir_all(folder.join("truth")).map_err(BenchError::io(folder.join("truth")))?;
    let mut record = TruthRecord {
        scene: subject.name.clone(),
        view: view.name.clone(),
        size: view.view.size,
        what: "reference in 64-bit floating point, exact projection".into(),
        seconds: 0.0,
        layers: None,
        hidden: None,
        stand_in_psnr: None,
    };
    let picture = if affordable {
        let image = reference(&view.view)?;
        let [mean, hidden] = [
            image.mean(|p| f64::from(p.layers)),
            image.mean(|p| f64::from(p.layers.saturating_sub(p.layers_until))),
        ];
        let most = image.pixels.iter().map(|p| p.layers).max().unwrap_or(0);
        record.layers = Some([mean, f64::from(most)]);
        record.hidden = Some(hidden);
        layers_picture(&image)?.save(&layers_path(folder, &subject.name, &view.name))?;
        Picture::from_rgb8(image.size, &image.to_rgb8())?
    } else {
        let picture = stand_in(subject, view, &view.view, offscreen)?;
        // The stand-in itself is checked where the reference is affordable: at a smaller size.
        let side = (AFFORDABLE / cost(subject, &view.view)).sqrt();
        let small = view.view.size.map(|s| ((f64::from(s) * side) as u32).max(32));
        let small = View { size: small, ..view.view };
        let image = reference(&small)?;
        let truth = Picture::from_rgb8(image.size, &image.to_rgb8())?;
        let errors = squared_errors(&truth, &stand_in(subject, view, &small, offscreen)?);
        let db = psnr(errors.iter().sum::<f64>() / errors.len() as f64);
        record.stand_in_psnr = Some(db.min(999.0));
        record.what = format!(
            "stand-in: the device's most exact configuration ({}), {db:.1} dB from the reference at {} × {}",
            sweep::EXACT.iter().map(|(n, v)| format!("{n}={v}")).collect::<Vec<_>>().join(" "),
            small.size[0],
            small.size[1]
        );
        picture
    };
    picture.save(&path(folder, &subject.name, &view.name))?;
    record.seconds = start.elapsed().as_secs_f64();
    Ok((picture, record))
}

fn cost(subject: &Subject, view: &View) -> f64 {
    subject.splats.len() as f64 * f64::from(view.size[0]) * f64::from(view.size[1])
}

fn stand_in(
    subject: &Subject,
    named: &Shot,
    view: &View,
    offscreen: &mut Offscreen,
) -> Result<Picture, BenchError> {
    let mut config = RenderConfig { time: named.time.unwrap_or(0.0), ..Default::default() };
    for (name, value) in sweep::EXACT {
        sweep::change(&mut config, name, value)?;
    }
    let gpu = offscreen.renderer().gpu().clone();
    let scene = SceneOnDevice::new(&gpu, &subject.splats, Packing::of_config(&config))?;
    let (pictures, _) = offscreen.render(&scene, std::slice::from_ref(view), &config)?;
    pictures
        .first()
        .map(super::measure::to_picture)
        .unwrap_or_else(|| Err(BenchError::Setting("no picture was drawn".into())))
}

fn layers_picture(image: &ReferenceImage) -> Result<Picture, BenchError> {
    let layers = image.pixels.iter().map(|p| f64::from(p.layers));
    Ok(coloured(image.size, layers, [0.0, LAYERS_SHOWN], ColourMap::Viridis)?)
}
