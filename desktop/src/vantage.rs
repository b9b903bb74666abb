//! From where a scene is looked at to change it, and from where the result is judged: never the same views.

use std::path::PathBuf;

use glam::DVec3;
use motes_app::framing::Framing;
use motes_app::opened::Opened;
use motes_renderer::{Fov, View};
use motes_scenes::cameras::{self, Camera, Split};

use crate::bench::subject::Views;
use crate::error::CommandError;
use crate::shots::resized;

/// From where a scene is looked at to change it.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "From where")]
pub struct LookArgs {
    /// Cameras to look from (those beside the scene; where there are none, views are generated around it)
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Look from so many views at most, spread evenly over the cameras; where there are fewer cameras, also from between
    /// neighbouring ones
    #[arg(long, value_name = "N", default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub views: u32,
    /// Size of the pictures that are looked at, as a share of the cameras'
    #[arg(long, value_name = "SHARE", default_value_t = 0.5, value_parser = share)]
    pub scale: f64,
}

/// From where the result is judged.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "From where")]
pub struct JudgeArgs {
    /// Judge by these cameras (the data set's test pictures, else every eighth camera)
    #[arg(long, value_name = "FILE[:NAME,…]")]
    pub judge: Option<Views>,
    /// Size of the pictures that are judged, as a share of the cameras'
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, value_parser = share)]
    pub judge_scale: f64,
}

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if (0.01..=4.0).contains(&value) { Ok(value) } else { Err("it must be 0.01 to 4".into()) }
}

/// A view to judge by.
#[derive(Clone, Debug)]
pub struct Seat {
    /// Its name.
    pub name: String,
    /// From where.
    pub view: View,
    /// The photograph taken there, where there is one.
    pub photograph: Option<PathBuf>,
}

/// Views by what they are for.
#[derive(Clone, Debug)]
pub struct Vantage {
    /// Views to look from.
    pub look: Vec<View>,
    /// Views to judge by.
    pub judge: Vec<Seat>,
    /// What they are, for people.
    pub said: String,
}

/// Size and vertical field of view of generated views: a picture at arm's length.
const SIZE: [u32; 2] = [480, 360];
const VERTICAL: f64 = 60.0 * std::f64::consts::PI / 180.0;
/// Generated views that are kept for judging.
const JUDGES: u32 = 8;
/// Without a split, every so manyth camera is held out, as the trainers do it (Kerbl et al. 2023).
const HELD_OUT: usize = 8;

impl LookArgs {
    /// The scene's cameras, or those that are named.
    fn cameras(&self, opened: &Opened) -> Result<Vec<Camera>, CommandError> {
        Ok(match &self.cameras {
            Some(file) => cameras::load(file)?,
            None => opened.cameras.clone(),
        })
    }

    /// The views to look from, and what they are, for people.
    ///
    /// # Errors
    /// The camera file cannot be read.
    pub fn views(&self, opened: &Opened) -> Result<(Vec<View>, String), CommandError> {
        let (cameras, _) = split(&self.cameras(opened)?);
        let mut look: Vec<View> = cameras.iter().map(View::from_camera).collect();
        let mut said = format!("{} of the data set's cameras", look.len().min(self.views as usize));
        if look.is_empty() {
            let framing = Framing::of(&opened.scene.splats, &opened.settings);
            look = (0..self.views).map(|i| generated(&framing, i, self.views, 0.0)).collect();
            said = format!("{} views generated around the scene", look.len());
        }
        let missing = (self.views as usize).saturating_sub(look.len());
        if missing > 0 && look.len() > 1 {
            let between: Vec<View> = spread(&look, missing).into_iter().map(|v| towards(v, &look)).collect();
            said += &format!(", {} views between them", between.len());
            look.extend(between);
        }
        let look = spread(&look, self.views as usize).into_iter().map(|v| scaled(v, self.scale)).collect();
        Ok((look, said))
    }

    /// The views for a scene.
    ///
    /// # Errors
    /// A camera file cannot be read, or has no camera of a name.
    pub fn vantage(&self, opened: &Opened, judging: &JudgeArgs) -> Result<Vantage, CommandError> {
        let (look, said) = self.views(opened)?;
        let (_, mut judge) = judging.seats(&self.cameras(opened)?)?;
        if judge.is_empty() {
            let framing = Framing::of(&opened.scene.splats, &opened.settings);
            judge = (0..JUDGES)
                .map(|i| Seat {
                    name: format!("between-{i}"),
                    view: scaled(&generated(&framing, i, JUDGES, 0.37), judging.judge_scale),
                    photograph: None,
                })
                .collect();
        }
        Ok(Vantage { look, said: format!("{said}; judged by {} others", judge.len()), judge })
    }
}

impl JudgeArgs {
    /// Seats that nobody judges by, and those to judge by; all at the size of pictures that are judged.
    ///
    /// # Errors
    /// A camera file cannot be read, or has no camera of a name.
    pub fn seats(&self, cameras: &[Camera]) -> Result<(Vec<Seat>, Vec<Seat>), CommandError> {
        let (rest, held_out) = split(cameras);
        let judges = match &self.judge {
            None => held_out,
            Some(views) => {
                let all = cameras::load(&views.path)?;
                let named = |n: &String| cameras::find(&all, n).cloned().map_err(CommandError::Usage);
                match views.names.is_empty() {
                    true => all,
                    false => views.names.iter().map(named).collect::<Result<_, _>>()?,
                }
            }
        };
        let seat = |camera: &Camera| Seat {
            name: camera.name.clone(),
            view: scaled(&View::from_camera(camera), self.judge_scale),
            photograph: camera.image.clone(),
        };
        let judges: Vec<Seat> = judges.iter().map(seat).collect();
        let judged = |seat: &Seat| judges.iter().any(|judge| judge.view == seat.view);
        let rest = rest.iter().map(seat).filter(|seat| !judged(seat)).collect();
        Ok((rest, judges))
    }
}

/// Cameras that are not held out, and those that are: the data set's test pictures, else every eighth.
fn split(cameras: &[Camera]) -> (Vec<Camera>, Vec<Camera>) {
    let said = cameras.iter().any(|c| c.split == Some(Split::Test));
    let (mut rest, mut held_out) = (Vec::new(), Vec::new());
    for (i, camera) in cameras.iter().enumerate() {
        let held = if said { camera.split == Some(Split::Test) } else { i.is_multiple_of(HELD_OUT) };
        if held { held_out.push(camera.clone()) } else { rest.push(camera.clone()) }
    }
    (rest, held_out)
}

/// So many of a list, evenly spread.
fn spread<T>(list: &[T], most: usize) -> Vec<&T> {
    let n = list.len().min(most);
    (0..n).map(|i| &list[i * list.len() / n]).collect()
}

/// Half-way from a view to the nearest that looks the same way: nobody stands where the cameras stood, but near them.
fn towards(view: &View, others: &[View]) -> View {
    let ahead = |v: &View| v.rotation.transpose() * DVec3::Z;
    let apart = |v: &&View| view.eye.distance(v.eye) * (2.0 - ahead(view).dot(ahead(v)));
    let other = |v: &&View| v.eye != view.eye || v.rotation != view.rotation;
    let nearest = others.iter().filter(other).min_by(|a, b| apart(a).total_cmp(&apart(b)));
    let Some(nearest) = nearest else { return *view };
    let turn = |v: &View| glam::DQuat::from_mat3(&v.rotation);
    let rotation = glam::DMat3::from_quat(turn(view).slerp(turn(nearest), 0.5));
    View { rotation, eye: view.eye.lerp(nearest.eye, 0.5), ..*view }
}

/// A view at a share of its size.
pub fn scaled(view: &View, share: f64) -> View {
    let side = |n: u32| ((f64::from(n) * share).round() as u32).max(16);
    resized(view, view.size.map(side))
}

/// One of several views of the dense part: directions along a spiral from above the middle to a little below it, at three
/// distances in turn, since splats that only show from nearby must be seen.
fn generated(framing: &Framing, i: u32, of: u32, aside: f64) -> View {
    let at = (f64::from(i) + 0.5 + aside) / f64::from(of);
    let lift = (-0.3 + 1.2 * at.fract()).asin();
    let turn = (f64::from(i) + aside) * 2.399_963;
    let far = framing.eye(turn, lift, VERTICAL);
    let near = [1.0, 0.7, 0.5][i as usize % 3];
    let eye: DVec3 = framing.center.lerp(far, near);
    View::look_at(eye, framing.center, framing.up, Fov::vertical(VERTICAL, SIZE), SIZE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_scenes::synthetic::Recipe;

    #[test]
    fn nothing_is_judged_from_where_it_was_looked_at() {
        let framing = Framing::of(&Recipe::default().still(), &Default::default());
        let look: Vec<View> = (0..24).map(|i| generated(&framing, i, 24, 0.0)).collect();
        for i in 0..JUDGES {
            let judge = generated(&framing, i, JUDGES, 0.37);
            let nearest = look.iter().map(|v| v.eye.distance(judge.eye)).fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.02 * framing.radius, "{nearest}");
            let ahead = judge.to_eye(framing.center);
            assert!(ahead.z > 0.0 && ahead.x.abs() < 1e-9 * ahead.z.abs().max(1.0));
        }
        let between = towards(&look[0], &look);
        let nearest = look[1..].iter().map(|v| v.eye.distance(look[0].eye)).fold(f64::INFINITY, f64::min);
        assert!(between.check().is_ok() && between.eye.distance(look[0].eye) >= 0.49 * nearest);
        assert!(look.iter().all(|v| v.eye.distance(between.eye) > 0.1 * nearest));
        assert_eq!(spread(&[1, 2, 3, 4, 5, 6], 3), [&1, &3, &5]);
        assert_eq!(spread(&[1, 2], 9), [&1, &2]);
        assert_eq!(scaled(&look[0], 0.5).size, [240, 180]);
    }
}
