//! Small pictures of scenes, for lists of them: taken when a scene is first opened, and kept in a folder.

use std::fs::File;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io::{BufReader, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use motes_renderer::gpu::{Gpu, GpuError};
use motes_renderer::{Offscreen, RenderConfig, SceneOnDevice, View};

use crate::framing::Framing;
use crate::opened::{Opened, saved_view};
use crate::viewer::in_scene_units;

/// Width and height of a small picture, pixels.
pub const SIZE: [u32; 2] = [192, 144];

/// Vertical field of view where none is known, radians.
const FOV: f64 = 1.0;

/// A small picture of a scene: [`SIZE`], RGB by rows from the upper left.
#[derive(Clone, PartialEq, Eq)]
pub struct Thumbnail(Vec<u8>);

impl std::fmt::Debug for Thumbnail {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Thumbnail of {} bytes", self.0.len())
    }
}

impl Thumbnail {
    /// What a scene looks like at first: from its settings' first view, else the data set's first camera, else from outside
    /// of its dense part.
    ///
    /// # Errors
    /// The driver's.
    pub fn take(
        gpu: &Arc<Gpu>,
        opened: &Opened,
        scene: &SceneOnDevice,
        framing: &Framing,
    ) -> Result<Self, GpuError> {
        let saved = opened.settings.first_view.as_ref().map(|saved| saved_view(saved, FOV, SIZE));
        let camera = opened.cameras.first().map(View::from_camera);
        let seen = framing.view(0.0, 0.2, FOV, SIZE);
        // A camera's picture has another shape: only its place is taken over.
        let view = saved.or(camera.map(|view| View { fov: seen.fov, size: SIZE, ..view })).unwrap_or(seen);
        let config = in_scene_units(&RenderConfig::default(), opened.settings.scale);
        let (pictures, _) = Offscreen::new(gpu)?.render(scene, &[view], &config)?;
        let pixels = pictures.iter().flat_map(|picture| &picture.pixels);
        Ok(Self(pixels.flat_map(|p| [p[0], p[1], p[2]]).collect()))
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        SIZE
    }

    /// RGB by rows from the upper left.
    pub fn rgb(&self) -> &[u8] {
        &self.0
    }

    /// The file in a folder for a scene as it is now: another one once the scene has been written anew.
    pub fn file(folder: &Path, scene: &Path) -> PathBuf {
        let mut hasher = DefaultHasher::new();
        scene.hash(&mut hasher);
        if let Ok(facts) = std::fs::metadata(scene) {
            facts.len().hash(&mut hasher);
            facts.modified().ok().hash(&mut hasher);
        }
        folder.join(format!("{:016x}.png", hasher.finish()))
    }

    /// Reads one; none where there is none, or what is there is none.
    pub fn load(file: &Path) -> Option<Self> {
        let mut reader = png::Decoder::new(BufReader::new(File::open(file).ok()?)).read_info().ok()?;
        let info = reader.info();
        let kind = (info.color_type, info.bit_depth);
        if [info.width, info.height] != SIZE || kind != (png::ColorType::Rgb, png::BitDepth::Eight) {
            return None;
        }
        let mut pixels = vec![0; 3 * (SIZE[0] * SIZE[1]) as usize];
        reader.next_frame(&mut pixels).ok()?;
        Some(Self(pixels))
    }

    /// Writes it; the file appears under its name only once it is complete.
    ///
    /// # Errors
    /// The system's.
    pub fn save(&self, file: &Path) -> std::io::Result<()> {
        if let Some(folder) = file.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let partial = file.with_extension("part");
        let mut encoder = png::Encoder::new(BufWriter::new(File::create(&partial)?), SIZE[0], SIZE[1]);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.0)?;
        writer.finish()?;
        std::fs::rename(partial, file)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_found_again_until_the_scene_changes() {
        let folder = std::env::temp_dir().join(format!("motes-thumbnail-{}", std::process::id()));
        let scene = folder.join("scene.ply");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(&scene, "one").unwrap();
        let file = Thumbnail::file(&folder, &scene);
        assert_eq!(Thumbnail::load(&file), None);
        let picture = Thumbnail((0..3 * SIZE[0] * SIZE[1]).map(|i| (i % 251) as u8).collect());
        picture.save(&file).unwrap();
        assert_eq!(Thumbnail::load(&file), Some(picture));
        assert_eq!(Thumbnail::file(&folder, &scene), file);
        std::fs::write(&scene, "another").unwrap();
        assert_ne!(Thumbnail::file(&folder, &scene), file);
        std::fs::write(&file, "no picture").unwrap();
        assert_eq!(Thumbnail::load(&file), None);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
