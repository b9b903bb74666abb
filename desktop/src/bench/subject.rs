//! What is looked at in a bench: scenes, and from where.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DMat3;
use motes_app::framing::Framing;
use motes_app::headset::Comfort;
use motes_app::opened::Opened;
use motes_renderer::{Fov, View};
use motes_scenes::cameras::{self, Camera};
use motes_scenes::{LoadOptions, Splats};
use motes_xr::{FirstView, Script};

use super::BenchError;
use crate::shots::{Shot, resized};

/// Size of a picture where no camera names one.
pub const DEFAULT_SIZE: [u32; 2] = [400, 300];

/// Vertical angle of views that were chosen here, radians.
const VERTICAL: f64 = 60.0 * std::f64::consts::PI / 180.0;

/// Field of view of a Quest 3's eye, about 110° × 96°, as tangents of the half angles.
const HEADSET: Fov = Fov { left: -1.43, right: 1.43, up: -1.11, down: 1.11 };

/// How far a wide view looks past the scene's middle, so that much of it lies towards the rim.
const ASIDE: f64 = 30.0 * std::f64::consts::PI / 180.0;

/// A scene and the views that it is measured from.
pub struct Subject {
    /// Its name, unique in the bench.
    pub name: String,
    /// The splats.
    pub splats: Arc<Splats>,
    /// Views, at least one.
    pub views: Vec<Shot>,
    /// The named experiment that it is only there for.
    pub only: Option<&'static str>,
}

/// What `--views` says: a file of cameras, and which of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Views {
    /// The file or folder.
    pub path: PathBuf,
    /// Names of cameras; empty: all.
    pub names: Vec<String>,
}

impl std::str::FromStr for Views {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // A colon may be part of the path (a drive): names come after the last one, if what stands before it exists.
        match text.rsplit_once(':') {
            Some((path, names))
                if !Path::new(text).exists() && !path.is_empty() && !names.contains(['/', '\\']) =>
            {
                Ok(Self {
                    path: path.into(),
                    names: names.split(',').map(|n| n.trim().to_owned()).filter(|n| !n.is_empty()).collect(),
                })
            }
            _ => Ok(Self { path: text.into(), names: Vec::new() }),
        }
    }
}

/// What to look at.
pub struct Wanted<'a> {
    /// Scenes; none: those that the views were taken of, or else the sample.
    pub scenes: &'a [PathBuf],
    /// Cameras.
    pub views: Option<&'a Views>,
    /// Size of pictures; a camera's own, where it has one.
    pub size: Option<[u32; 2]>,
    /// A recorded headset session: views are what its left eye saw, so many as are automatic, evenly spread.
    pub session: Option<&'a Path>,
    /// Views of a scene for which no camera is named.
    pub automatic: usize,
    /// Adds a wide view of every scene, for the named experiment.
    pub wide: Option<&'static str>,
}

/// Loads what is looked at.
///
/// # Errors
/// A scene or a camera that cannot be read or found.
pub fn subjects(wanted: &Wanted<'_>) -> Result<Vec<Subject>, BenchError> {
    let cameras = match wanted.views {
        None => Vec::new(),
        Some(views) => {
            let mut all = cameras::load(&views.path)?;
            for name in &views.names {
                if !all.iter().any(|c| c.name == *name) {
                    let known: Vec<_> = all.iter().map(|c| c.name.as_str()).take(40).collect();
                    return Err(BenchError::Setting(format!(
                        "{} has no view '{name}'; it has: {}",
                        views.path.display(),
                        known.join(", ")
                    )));
                }
            }
            all.retain(|c| views.names.is_empty() || views.names.contains(&c.name));
            all
        }
    };
    let mut subjects: Vec<Subject> = Vec::new();
    for (paths, cameras) in groups(wanted, cameras)? {
        let opened = Opened::load(&paths, &LoadOptions::default())?;
        let mut name = opened.name.clone();
        while subjects.iter().any(|s| s.name == name) {
            name.push('′');
        }
        let views = match wanted.session {
            Some(session) => walked(&opened, session, wanted)?,
            None => views(&opened, &cameras, wanted),
        };
        if let (Some(only), Some(first)) = (wanted.wide, views.first()) {
            let wide = Shot { name: "wide".to_owned(), view: wide(&first.view), time: first.time };
            let name = format!("{name} (headset's field of view)");
            let splats = Arc::new(opened.scene.splats);
            subjects.push(Subject {
                name: name.clone(),
                splats: splats.clone(),
                views: vec![wide],
                only: Some(only),
            });
            let last = subjects.len() - 1;
            let plain = name.trim_end_matches(" (headset's field of view)").to_owned();
            subjects.insert(last, Subject { name: plain, splats, views, only: None });
        } else {
            subjects.push(Subject { name, splats: Arc::new(opened.scene.splats), views, only: None });
        }
    }
    Ok(subjects)
}

/// The files of a scene, and its cameras.
type Group = (Vec<PathBuf>, Vec<Camera>);

fn groups(wanted: &Wanted<'_>, cameras: Vec<Camera>) -> Result<Vec<Group>, BenchError> {
    let Some(views) = wanted.views else {
        let scenes = wanted.scenes.iter().map(|s| (vec![s.clone()], Vec::new()));
        let scenes: Vec<_> = scenes.collect();
        return Ok(if scenes.is_empty() { vec![(Vec::new(), Vec::new())] } else { scenes });
    };
    if !wanted.scenes.is_empty() {
        let mut groups = Vec::new();
        for scene in wanted.scenes {
            // Cameras that say what they were taken of are for that scene alone.
            let is_of =
                |c: &&Camera| c.inputs.is_empty() || c.inputs.iter().any(|i| scene.ends_with(input_path(i)));
            let own: Vec<Camera> = cameras.iter().filter(is_of).cloned().collect();
            if own.is_empty() {
                return Err(BenchError::Setting(format!(
                    "none of the views in {} was taken of {}; name another file of views, or leave --views out",
                    views.path.display(),
                    scene.display()
                )));
            }
            groups.push((vec![scene.clone()], own));
        }
        return Ok(groups);
    }
    let mut groups: Vec<Group> = Vec::new();
    for camera in cameras {
        let mut paths = Vec::new();
        for input in &camera.inputs {
            let input = input_path(input);
            let found = views.path.ancestors().skip(1).map(|a| a.join(input)).find(|p| p.exists());
            paths.push(found.ok_or_else(|| {
                BenchError::Setting(format!(
                    "{}: '{}' was taken of {input}, which is not found beside or above the file; name the scene",
                    views.path.display(),
                    camera.name
                ))
            })?);
        }
        if paths.is_empty() {
            return Err(BenchError::Setting(format!(
                "{} does not say what its views were taken of; name the scene",
                views.path.display()
            )));
        }
        match groups.iter_mut().find(|(known, _)| *known == paths) {
            Some((_, cameras)) => cameras.push(camera),
            None => groups.push((paths, vec![camera])),
        }
    }
    Ok(groups)
}

/// The file that an input names; some lists say in words what was done with it.
fn input_path(input: &str) -> &str {
    input.split_once(" evaluated").map_or(input, |(path, _)| path)
}

fn views(opened: &Opened, cameras: &[Camera], wanted: &Wanted<'_>) -> Vec<Shot> {
    let sized = |view: View| wanted.size.map_or(view, |size| resized(&view, size));
    let of_camera = |c: &Camera| Shot {
        name: c.name.clone(),
        view: sized(View::from_camera(c)),
        time: c.time.map(|t| t as f32),
    };
    if !cameras.is_empty() {
        return cameras.iter().map(of_camera).collect();
    }
    let framing = Framing::of(&opened.scene.splats, &opened.settings);
    let size = wanted.size.unwrap_or(DEFAULT_SIZE);
    let time = opened.scene.splats.motion.as_ref().map(|_| 0.5);
    (0..wanted.automatic.max(1))
        .map(|i| {
            let turn = i as f64 * std::f64::consts::TAU / wanted.automatic.max(1) as f64;
            let view = framing.view(turn, 0.25, VERTICAL, size);
            Shot { name: format!("{}°", turn.to_degrees().round()), view, time }
        })
        .collect()
}

/// What the left eye of a recorded session saw.
fn walked(opened: &Opened, session: &Path, wanted: &Wanted<'_>) -> Result<Vec<Shot>, BenchError> {
    let refuse = |problem: String| BenchError::File { path: session.to_owned(), problem };
    let script = Script::read(session).map_err(|e| refuse(e.to_string()))?;
    let framing = Framing::of(&opened.scene.splats, &opened.settings);
    let first = FirstView::of(opened, &framing);
    let all = script.views(&opened.settings.scene_to_world(), &first, &Comfort::default());
    if all.is_empty() {
        return Err(refuse("no frame of the session shows a scene".into()));
    }
    let count = wanted.automatic.clamp(1, all.len());
    let time = opened.scene.splats.motion.as_ref().map(|_| 0.5);
    let shot = |i: usize| {
        let at = i * (all.len() - 1) / (count - 1).max(1);
        let [left, _] = all[at];
        let view = wanted.size.map_or(left, |size| resized(&left, size));
        Shot { name: format!("frame {at}"), view, time }
    };
    Ok((0..count).map(shot).collect())
}

/// The same eye with a headset's field of view, turned aside.
fn wide(view: &View) -> View {
    View { rotation: DMat3::from_rotation_y(ASIDE) * view.rotation, fov: HEADSET, ..*view }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_a_file_and_names() {
        let parse = |t: &str| t.parse::<Views>().unwrap();
        assert_eq!(parse("a/b.json"), Views { path: "a/b.json".into(), names: vec![] });
        assert_eq!(
            parse("a/b.json:one, two"),
            Views { path: "a/b.json".into(), names: vec!["one".into(), "two".into()] }
        );
        assert_eq!(parse("C:/b.json"), Views { path: "C:/b.json".into(), names: vec![] });
        assert_eq!(input_path("4d/x.splatv evaluated at time"), "4d/x.splatv");
    }

    #[test]
    fn the_sample_is_looked_at_where_nothing_is_named() {
        let wanted = Wanted {
            scenes: &[],
            views: None,
            session: None,
            size: Some([64, 48]),
            automatic: 3,
            wide: Some("projection"),
        };
        let subjects = subjects(&wanted).unwrap();
        assert_eq!(subjects.len(), 2);
        assert_eq!((subjects[0].views.len(), subjects[1].views.len()), (3, 1));
        assert_eq!((subjects[0].only, subjects[1].only), (None, Some("projection")));
        assert!(subjects[1].name.starts_with(&subjects[0].name));
        assert_eq!(subjects[0].views[0].view.size, [64, 48]);
        // The wide view stands where the first does, and looks past the middle by the stated angle.
        let (narrow, wide) = (&subjects[0].views[0].view, &subjects[1].views[0].view);
        assert_eq!(narrow.eye, wide.eye);
        let angle = narrow.rotation.row(2).dot(wide.rotation.row(2)).acos();
        assert!((angle - ASIDE).abs() < 1e-9, "{angle}");
    }

    #[test]
    fn a_recorded_session_says_from_where() {
        use motes_app::headset::{Eye, EyeFov, Input, Pose};
        use motes_xr::{EyeImages, FrameTime, ScriptFrame, ScriptStep};
        let eye = |x: f32| Eye {
            pose: Pose { position: [x, 1.6, 0.0], ..Pose::default() },
            fov: EyeFov { left: -0.8, right: 0.7, up: 0.8, down: -0.8 },
        };
        // A step of 10 cm to the right a frame.
        let frame = |i: i64| {
            let at = 0.1 * i as f32;
            ScriptStep::Frame(Box::new(ScriptFrame {
                time: FrameTime { display_time: i, period: 1, should_render: true, focused: true },
                input: Input::default(),
                eyes: Some([eye(at - 0.032), eye(at + 0.032)]),
                order: None,
                hidden: None,
            }))
        };
        let images = EyeImages { size: [64, 48], format: ash::vk::Format::R8G8B8A8_SRGB };
        let session = std::env::temp_dir().join(format!("motes-walk-{}.jsonl", std::process::id()));
        Script { images, steps: (0..9).map(frame).collect() }.write(&session).unwrap();
        let mut wanted = Wanted {
            scenes: &[],
            views: None,
            session: Some(&session),
            size: None,
            automatic: 3,
            wide: None,
        };
        let seen = subjects(&wanted).unwrap();
        let views = &seen[0].views;
        assert_eq!(views.iter().map(|v| &*v.name).collect::<Vec<_>>(), ["frame 0", "frame 4", "frame 8"]);
        let right = views[0].view.rotation.row(0);
        for pair in views.windows(2) {
            let moved = pair[1].view.eye - pair[0].view.eye;
            assert!((moved - 0.4 * right).length() < 1e-5 && pair[0].view.size == [64, 48], "{moved}");
        }
        std::fs::remove_file(&session).unwrap();
        wanted.automatic = 1;
        assert!(subjects(&wanted).err().unwrap().to_string().contains("motes-walk"));
    }

    #[test]
    fn what_is_not_there_is_named() {
        let missing = Views { path: "no/such.json".into(), names: vec![] };
        let wanted = Wanted {
            scenes: &[],
            views: Some(&missing),
            session: None,
            size: None,
            automatic: 1,
            wide: None,
        };
        assert!(subjects(&wanted).err().unwrap().to_string().contains("no/such.json"));
        let folder = std::env::temp_dir().join(format!("motes-subject-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("views.json");
        let one = |name: &str, inputs: &str| {
            format!(
                "{{\"name\":\"{name}\",{inputs}\"width\":8,\"height\":6,\"fx\":8,\"fy\":8,\"cx\":4,\"cy\":3,\
                 \"R_w2c\":[[1,0,0],[0,1,0],[0,0,1]],\"t_w2c\":[0,0,2]}}"
            )
        };
        std::fs::write(&file, format!("[{}]", one("a", "\"inputs\":[\"gone.ply\"],"))).unwrap();
        let error = |text: String, scenes: &[PathBuf]| {
            let views: Views = text.parse().unwrap();
            let wanted =
                Wanted { scenes, views: Some(&views), session: None, size: None, automatic: 1, wide: None };
            subjects(&wanted).err().unwrap().to_string()
        };
        let path = file.display().to_string();
        assert!(error(path.clone(), &[]).contains("gone.ply"));
        assert!(error(format!("{path}:b"), &[]).contains("no view 'b'"));
        assert!(error(path.clone(), &["other.ply".into()]).contains("other.ply"));
        std::fs::write(&file, format!("[{}]", one("a", ""))).unwrap();
        assert!(error(path, &[]).contains("name the scene"));
    }
}
