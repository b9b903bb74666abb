//! How near a changed scene comes to the one that it was made from, and what it costs, over views that nothing was fitted to.

use motes_app::prediction::{FrameLoad, Prediction, StageRates};
use motes_renderer::Expansion;
use motes_renderer::reference::{self, ReferenceImage, ReferenceOptions};
use motes_scenes::Splats;

use crate::error::CommandError;
use crate::measure::{self, Picture, Settings};
use crate::vantage::Seat;

/// Figures of one scene, means over the views.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Figures {
    /// Splats in the scene.
    pub splats: usize,
    /// Splats that a view can see.
    pub visible: f64,
    /// Layers per pixel that are blended where every one is: alphas of at least 1/255.
    pub every_layer: f64,
    /// Layers per pixel until less than 1/255 of the light is left: what early stop can come down to.
    pub layers: f64,
    /// Predicted frame of both eyes on a Quest 3, ms, with [`Figures::layers`].
    pub frame_ms: f64,
    /// FLIP against the original.
    pub flip: f64,
    /// PSNR against the original, dB: of the mean squared error over all views; ∞ (in JSON: null) for the original.
    pub psnr: f64,
    /// SSIM against the original.
    pub ssim: f64,
    /// PSNR against the photographs, dB, where there are any: mean over views.
    pub photo_psnr: Option<f64>,
    /// SSIM against them.
    pub photo_ssim: Option<f64>,
}

/// Pictures of the original, which others are measured against.
pub struct Bench {
    seats: Vec<Seat>,
    options: ReferenceOptions,
    originals: Vec<Picture>,
    photographs: Vec<Option<Picture>>,
    settings: Settings,
}

impl Bench {
    /// Takes the original's pictures.
    ///
    /// # Errors
    /// The reference's, or a photograph cannot be read.
    pub fn new(
        original: &Splats,
        seats: &[Seat],
        options: &ReferenceOptions,
        settings: Settings,
    ) -> Result<Self, CommandError> {
        // Layers are counted through the whole scene, whatever a picture stops at.
        let options = ReferenceOptions { stop_below: 0.0, ..options.clone() };
        let mut bench =
            Self { seats: seats.to_vec(), originals: Vec::new(), photographs: Vec::new(), options, settings };
        for seat in seats {
            bench.originals.push(picture(&reference::render(original, &seat.view, &bench.options)?)?);
            let photograph = match &seat.photograph {
                Some(file) => Some(Picture::load(file)?).filter(|p| p.size() == seat.view.size),
                None => None,
            };
            bench.photographs.push(photograph);
        }
        Ok(bench)
    }

    /// The original's pictures, in the order of the seats.
    pub fn originals(&self) -> &[Picture] {
        &self.originals
    }

    /// Judges a scene; also returns its pictures.
    ///
    /// # Errors
    /// The reference's.
    pub fn judge(&self, splats: &Splats) -> Result<(Figures, Vec<Picture>), CommandError> {
        let n = self.seats.len().max(1) as f64;
        let mut sum = Figures { splats: splats.len(), ..Figures::default() };
        let (mut squares, mut pictures) = (0.0, Vec::new());
        let (mut photos, mut photo_psnr, mut photo_ssim) = (0, 0.0, 0.0);
        for (i, seat) in self.seats.iter().enumerate() {
            let image = reference::render(splats, &seat.view, &self.options)?;
            let test = picture(&image)?;
            let whole = measure::compare(&self.originals[i], &test, &self.settings)?.whole;
            squares += 10f64.powf(-whole.psnr / 10.0) / n;
            sum.flip += whole.flip / n;
            sum.ssim += whole.ssim.unwrap_or(1.0) / n;
            sum.visible += image.visible as f64 / n;
            sum.every_layer += image.mean(|p| p.layers.into()) / n;
            sum.layers += image.mean(|p| p.layers_until.into()) / n;
            if let Some(photograph) = &self.photographs[i] {
                let whole = measure::compare(photograph, &test, &self.settings)?.whole;
                photos += 1;
                photo_psnr += whole.psnr;
                photo_ssim += whole.ssim.unwrap_or(1.0);
            }
            pictures.push(test);
        }
        sum.psnr = measure::psnr(squares);
        if photos > 0 {
            sum.photo_psnr = Some(photo_psnr / f64::from(photos));
            sum.photo_ssim = Some(photo_ssim / f64::from(photos));
        }
        sum.frame_ms = predicted(sum.visible, sum.layers).ms();
        Ok((sum, pictures))
    }
}

/// The predicted frame of both eyes on a Quest 3.
pub fn predicted(visible: f64, layers: f64) -> Prediction {
    let load = FrameLoad::new(visible as u32, Expansion::Precomputed, 8, layers);
    StageRates::quest_3().predict(&load)
}

fn picture(image: &ReferenceImage) -> Result<Picture, CommandError> {
    Ok(Picture::new(image.size, image.to_rgb_f32())?)
}
