//! A scene as the viewer opens it: its splats, how it stands in the world, and the cameras that belong to it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3};
use motes_renderer::{Fov, View};
use motes_scenes::cameras::{self, Camera};
use motes_scenes::labels::{Class, Labels, class_colour};
use motes_scenes::levels::LevelFile;
use motes_scenes::settings::{SavedView, Settings};
use motes_scenes::{
    Format, LoadOptions, Scene, SceneError, SourceInfo, Splats, load_many, looks_like_sequence, sample,
    sequence_frames,
};

use crate::lod::Levels;

/// A scene, and what belongs to it.
#[derive(Clone, Debug)]
pub struct Opened {
    /// What to call it: the first file's name.
    pub name: String,
    /// The first file, beside which settings are kept; `None` for the sample.
    pub path: Option<PathBuf>,
    /// The splats.
    pub scene: Scene,
    /// How it stands in the world.
    pub settings: Settings,
    /// Whether the settings were found beside the scene, rather than assumed.
    pub settings_found: bool,
    /// The data set's cameras, empty where none were found.
    pub cameras: Vec<Camera>,
    /// The frames of a sequence, of which the scene is the first; empty for anything else.
    pub frames: Vec<PathBuf>,
    /// What the splats' labels mean: those saved beside the scene, or the files of a merged one; else empty.
    pub classes: Vec<Class>,
    /// All levels of a file of levels, of which the scene is one, where it was opened to be walked through.
    pub levels: Option<Arc<Levels>>,
}

impl Opened {
    /// Opens scenes, merged in their order; the sample where none is named, and in motion by [`sample::MOVING`].
    ///
    /// Settings are those beside the first, cameras those beside the first that has any.
    ///
    /// # Errors
    /// A scene or its settings cannot be read. A camera file beside it that cannot be read is a warning in the
    /// scene's report: nobody asked for it.
    pub fn load(paths: &[PathBuf], options: &LoadOptions) -> Result<Self, SceneError> {
        let of_sample = |name: String, scene| Self {
            name,
            path: None,
            scene,
            settings: sample::settings(),
            settings_found: false,
            cameras: Vec::new(),
            frames: Vec::new(),
            classes: Vec::new(),
            levels: None,
        };
        let first = match paths {
            [] => return Ok(of_sample(sample::NAME.to_owned(), sample::sample(options)?)),
            [one] if *one == Path::new(sample::MOVING) => {
                return Ok(of_sample(format!("{}, moving", sample::NAME), sample::moving(options)?));
            }
            [first, ..] => first,
        };
        let found = Settings::load(first)?;
        let mut opened = Self::with(paths, found, load_many(paths, options)?);
        opened.classes = classes(paths, &mut opened.scene);
        Ok(opened)
    }

    /// A part of a scene that is being read, with what belongs to it but for labels.
    ///
    /// # Errors
    /// Its settings cannot be read.
    pub fn part(path: &Path, part: Scene) -> Result<Self, SceneError> {
        Ok(Self::with(&[path.to_owned()], Settings::load(path)?, part))
    }

    /// A scene with the settings that were found, and the cameras beside it.
    fn with(paths: &[PathBuf], found: Option<Settings>, mut scene: Scene) -> Self {
        let settings_found = found.is_some();
        let settings = found.unwrap_or_else(|| {
            scene.sources.first().map(|s| Settings::for_format(s.format)).unwrap_or_default()
        });
        let mut cameras = Vec::new();
        if let Some(file) = paths.iter().find_map(|path| cameras::beside(path)) {
            match cameras::load(&file) {
                Ok(list) => cameras = list,
                Err(error) => {
                    log::warn!("{error}");
                    scene.report.warnings.push(format!("cameras are left out: {error}"));
                }
            }
        }
        let path = paths.first().cloned();
        Self {
            name: path.as_deref().map(name_of).unwrap_or_default(),
            path,
            scene,
            settings,
            settings_found,
            cameras,
            frames: Vec::new(),
            classes: Vec::new(),
            levels: None,
        }
    }

    /// As [`Opened::load`], but of a folder of numbered scenes it opens the first and lists them all, and of a file of levels
    /// it opens all of them: to be played and walked through.
    ///
    /// # Errors
    /// As [`Opened::load`].
    pub fn load_to_play(paths: &[PathBuf], options: &LoadOptions) -> Result<Self, SceneError> {
        let [folder] = paths else { return Self::load(paths, options) };
        if folder.is_file() && Format::detect(folder)? == Format::Levels {
            let mut opened = Self::load(paths, options)?;
            let levels = Levels::load(folder, &options.cancel)?;
            opened.scene.report.warnings.extend(levels.unfitted.clone());
            return Ok(Self { levels: Some(Arc::new(levels)), ..opened });
        }
        if !(folder.is_dir() && looks_like_sequence(folder)) {
            return Self::load(paths, options);
        }
        let frames = sequence_frames(folder)?;
        // Frames follow each other faster than parts of one would.
        let options = LoadOptions { early: None, ..options.clone() };
        let opened = Self::load(&frames[..frames.len().min(1)], &options)?;
        Ok(Self { name: name_of(folder), frames, ..opened })
    }

    /// The splats that the device holds: the scene's, or those of all its levels.
    pub fn stored(&self) -> &Splats {
        self.levels.as_ref().map_or(&self.scene.splats, |levels| &levels.splats)
    }
}

/// Labels the splats: of one scene by what is saved beside it, of several by the one that each came from. Labels that do
/// not fit are a warning in the scene's report.
fn classes(paths: &[PathBuf], scene: &mut Scene) -> Vec<Class> {
    match paths {
        [path] if scene.sources.iter().any(|s| s.format == Format::Levels) => {
            // It was opened a moment ago.
            LevelFile::open(path).map(|file| file.classes()).unwrap_or_default()
        }
        [path] => {
            let labels = Labels::beside(path).and_then(|labels| {
                labels.map(|l| l.apply(&mut scene.splats, &Labels::path_of(path)).map(|()| l)).transpose()
            });
            match labels {
                Ok(labels) => labels.map(|l| l.classes).unwrap_or_default(),
                Err(error) => {
                    log::warn!("{error}");
                    scene.report.warnings.push(format!("labels are left out: {error}"));
                    Vec::new()
                }
            }
        }
        _ => {
            scene.label_by_source();
            let class = |(id, source): (u16, &SourceInfo)| Class {
                id,
                name: name_of(&source.path),
                colour: class_colour(id),
            };
            (1..).zip(&scene.sources).map(class).collect()
        }
    }
}

/// A view that was saved with the scene; `fov`: the vertical field of view, radians, where none was saved.
pub fn saved_view(saved: &SavedView, fov: f64, size: [u32; 2]) -> View {
    let to_scene = DMat3::from_quat(DQuat::from_array(saved.rotation).normalize());
    View {
        rotation: to_scene.transpose(),
        eye: DVec3::from_array(saved.position),
        fov: Fov::vertical(saved.vertical_fov.map_or(fov, f64::to_radians), size),
        size,
    }
}

/// A scene's name for titles: its file's, and its folder's where the file's says nothing; of a level of a streamed scene
/// (`NAME/0_0`) with the scene's before it.
pub fn name_of(path: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    let Some(file) = name(path) else { return path.display().to_string() };
    if matches!(file.as_str(), "meta.json" | "lod-meta.json" | "point_cloud.ply") {
        return path.parent().filter(|folder| name(folder).is_some()).map_or(file, name_of);
    }
    match path.parent().and_then(name) {
        Some(scene) if is_level(&file) => format!("{scene}/{file}"),
        _ => file,
    }
}

/// Whether a folder is called as the levels of a streamed scene are: `LEVEL_PART`.
fn is_level(folder: &str) -> bool {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    folder.split_once('_').is_some_and(|(level, part)| number(level) && number(part))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_called_what_says_most() {
        for (path, name) in [
            ("scenes/plant.ply", "plant.ply"),
            ("plant.ply", "plant.ply"),
            ("scenes/skull/meta.json", "skull"),
            ("meta.json", "meta.json"),
            ("scenes/garden/3_0/meta.json", "garden/3_0"),
            ("scenes/garden/3_0", "garden/3_0"),
            ("scenes/garden/3_x", "3_x"),
            ("..", ".."),
        ] {
            assert_eq!(name_of(Path::new(path)), name, "{path}");
        }
    }
}
