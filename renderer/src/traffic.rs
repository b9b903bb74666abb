//! How many bytes a frame moves, from its counts: the same on every device.
//!
//! A model, not a measurement: every splat is read once wherever it is projected, every record once where it is drawn,
//! and every fragment reads and writes its pixel. What a device keeps on chip costs it nothing of that: a tile-based
//! one blends there, so [`Traffic::blended`] is named apart.

use crate::config::{Composite, Expansion, RenderConfig, TargetFormat};
use crate::report::FrameReport;
use crate::scene::SceneOnDevice;
use motes_shaders::layout::RECORD_WORDS;

/// Bytes that a frame moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Traffic {
    /// From the processor: order and frame data.
    pub uploaded: u64,
    /// Of the scene: order, geometry, motion, spherical harmonics.
    pub scene: u64,
    /// Records of projected splats, written and read (precomputed expansion).
    pub records: u64,
    /// Blended pixels, read and written by every fragment, and read by the resolve: on chip on a tile-based device.
    pub blended: u64,
    /// The finished image, written.
    pub image: u64,
}

impl Traffic {
    /// Of a frame that is done.
    pub fn of(scene: &SceneOnDevice, config: &RenderConfig, report: &FrameReport) -> Self {
        let splats = u64::from(scene.splats);
        let views = u64::from(report.views);
        let harmonics = if config.sh_degree > 0 { scene.harmonics.splat_bytes } else { 0 };
        let motion = if scene.moving { scene.motion.splat_bytes } else { 0 };
        let splat = scene.geometry.splat_bytes + motion + harmonics + 4;
        let corners = u64::from(config.shape.corners());
        let (scene, records) = match config.expansion {
            Expansion::Precomputed | Expansion::Tiles => {
                let words = RECORD_WORDS[config.projection as usize];
                (splats * splat, 2 * u64::from(report.visible) * 4 * u64::from(words) * views)
            }
            Expansion::Instanced => (splats * splat * corners * views, 0),
            Expansion::Geometry => (splats * splat * views, 0),
        };
        let texel = match config.target {
            TargetFormat::Rgba32F => 16,
            TargetFormat::Rgba16F => 8,
            TargetFormat::Rgba8 | TargetFormat::Rgb10A2 => 4,
        };
        let marks = if config.composite == Composite::EarlyStop { report.full_screen_fragments } else { 0 };
        let shaded = report.fragments;
        Self {
            uploaded: report.uploaded_bytes,
            scene,
            records,
            blended: texel * (2 * shaded + marks + report.pixels),
            image: 4 * report.shown_pixels,
        }
    }

    /// All of it.
    pub fn total(&self) -> u64 {
        self.uploaded + self.scene + self.records + self.blended + self.image
    }

    /// What leaves or enters the chip of a tile-based device.
    pub fn off_chip(&self) -> u64 {
        self.total() - self.blended
    }
}
