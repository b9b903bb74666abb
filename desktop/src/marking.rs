//! Labels by hand: strokes of a brush and boxes on the picture give the splats that show there a class.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use motes_renderer::View;
use motes_renderer::detail::mark::marked;
use motes_renderer::reference::{ReferenceError, ReferenceOptions};
use motes_scenes::labels::{Class, Labels, class_colour};
use motes_scenes::{SceneError, Splats};

/// How a stroke marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tool {
    /// All that is nearer to the stroke than the brush is wide.
    Brush,
    /// The box between the stroke's first and last point.
    Box,
}

/// A stroke over a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroke {
    /// How it marks.
    pub tool: Tool,
    /// Radius of the brush, as a share of the picture's height.
    pub radius: f64,
    /// Places, as shares of the picture's width and height.
    pub points: Vec<[f64; 2]>,
}

impl Stroke {
    /// The pixels that it marks, by rows.
    pub fn marks(&self, size: [u32; 2]) -> Vec<bool> {
        let [width, height] = size.map(f64::from);
        let points: Vec<[f64; 2]> = self.points.iter().map(|p| [p[0] * width, p[1] * height]).collect();
        let (Some(&first), Some(&last)) = (points.first(), points.last()) else {
            return vec![false; size[0] as usize * size[1] as usize];
        };
        // A brush finer than a pixel still marks the one that it is in.
        let radius = (self.radius * height).max(0.71);
        let within = |a: f64, b: f64, v: f64| a.min(b) <= v && v <= a.max(b);
        let marks = |at: [f64; 2]| match self.tool {
            Tool::Box => within(first[0], last[0], at[0]) && within(first[1], last[1], at[1]),
            Tool::Brush => {
                let near = |a: [f64; 2], b: [f64; 2]| distance(at, a, b) <= radius;
                near(first, first) || points.windows(2).any(|pair| near(pair[0], pair[1]))
            }
        };
        let pixel = |i: u32| [f64::from(i % size[0]) + 0.5, f64::from(i / size[0]) + 0.5];
        (0..size[0] * size[1]).map(|i| marks(pixel(i))).collect()
    }
}

/// Distance of a point from the line between two.
fn distance(at: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (at, a, b) = (glam::DVec2::from(at), glam::DVec2::from(a), glam::DVec2::from(b));
    let t = ((at - a).dot(b - a) / (b - a).length_squared().max(1e-12)).clamp(0.0, 1.0);
    at.distance(a.lerp(b, t))
}

/// Labels of a scene while they are changed.
pub struct Marking {
    file: PathBuf,
    ids: Arc<Vec<u16>>,
    classes: Vec<Class>,
    /// By stroke, what its splats were before.
    before: Vec<Vec<(u32, u16)>>,
    saved: bool,
}

impl Marking {
    /// The labels that a scene has, or none at all; they will be saved beside it.
    pub fn of(splats: &Splats, classes: &[Class], scene: &Path) -> Self {
        let labels = Labels::of_splats(splats, classes);
        let labels =
            labels.unwrap_or_else(|| Labels { classes: classes.to_vec(), ids: vec![0; splats.len()] });
        Self {
            file: Labels::path_of(scene),
            ids: Arc::new(labels.ids),
            classes: labels.classes,
            before: Vec::new(),
            saved: true,
        }
    }

    /// A class for each splat.
    pub fn ids(&self) -> &Arc<Vec<u16>> {
        &self.ids
    }

    /// The classes.
    pub fn classes(&self) -> &[Class] {
        &self.classes
    }

    /// Whether there is nothing to save.
    pub fn is_saved(&self) -> bool {
        self.saved
    }

    /// Whether a stroke can be taken back.
    pub fn can_undo(&self) -> bool {
        !self.before.is_empty()
    }

    /// A class that there was not yet; its number.
    pub fn add_class(&mut self) -> u16 {
        let id = (1..u16::MAX).find(|id| self.classes.iter().all(|c| c.id != *id)).unwrap_or(u16::MAX);
        if self.classes.iter().all(|c| c.id != id) {
            self.classes.push(Class { id, name: format!("class {id}"), colour: class_colour(id) });
            self.classes.sort_by_key(|c| c.id);
        }
        id
    }

    /// Gives splats a class (0 takes theirs away); returns how many had another.
    pub fn give(&mut self, splats: &[u32], class: u16) -> usize {
        let ids = Arc::make_mut(&mut self.ids);
        let mut before = Vec::new();
        for &i in splats {
            if let Some(id) = ids.get_mut(i as usize).filter(|id| **id != class) {
                before.push((i, std::mem::replace(id, class)));
            }
        }
        let changed = before.len();
        if changed > 0 {
            self.before.push(before);
            self.saved = false;
        }
        changed
    }

    /// Takes the last stroke back.
    pub fn undo(&mut self) {
        let Some(before) = self.before.pop() else { return };
        let ids = Arc::make_mut(&mut self.ids);
        for (i, id) in before {
            ids[i as usize] = id;
        }
        self.saved = false;
    }

    /// Writes the labels beside the scene; returns where.
    ///
    /// # Errors
    /// The disk's.
    pub fn save(&mut self) -> Result<&Path, SceneError> {
        let labels = Labels { classes: self.classes.clone(), ids: self.ids.to_vec() };
        labels.save(&self.file)?;
        self.saved = true;
        Ok(&self.file)
    }
}

/// The splats that a stroke over a view is meant for.
///
/// # Errors
/// The reference's.
pub fn splats_of(
    splats: &Splats,
    view: &View,
    stroke: &Stroke,
    options: &ReferenceOptions,
) -> Result<Vec<u32>, ReferenceError> {
    marked(splats, view, &stroke.marks(view.size), options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use motes_renderer::Fov;
    use motes_scenes::synthetic::Recipe;

    #[test]
    fn strokes_mark_what_they_go_over() {
        let stroke = |tool, points: &[[f64; 2]]| Stroke { tool, radius: 0.1, points: points.to_vec() };
        let count = |stroke: &Stroke| stroke.marks([40, 20]).iter().filter(|m| **m).count();
        let across = stroke(Tool::Brush, &[[0.25, 0.5], [0.75, 0.5]]);
        let marks = across.marks([40, 20]);
        // Four pixels high, 20 wide, and the round ends.
        assert!((80..100).contains(&count(&across)), "{}", count(&across));
        assert!(marks[10 * 40 + 20] && !marks[2 * 40 + 20] && !marks[10 * 40 + 2]);
        let frame = stroke(Tool::Box, &[[0.5, 0.75], [0.9, 0.9], [0.25, 0.25]]);
        assert_eq!(count(&frame), 10 * 10, "between the first and the last point");
        let dot = Stroke { radius: 0.0, ..stroke(Tool::Brush, &[[0.5, 0.5]]) };
        assert!((1..=4).contains(&count(&dot)));
        assert_eq!(count(&stroke(Tool::Brush, &[])), 0);
    }

    #[test]
    fn labels_are_given_taken_back_and_saved_beside_the_scene() {
        let folder = std::env::temp_dir().join(format!("motes-marking-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let scene = folder.join("scene.ply");
        let mut splats = Recipe { count: 300, log_scales: [-3.5, -3.0], ..Default::default() }.still();
        let mut marking = Marking::of(&splats, &[], &scene);
        let class = marking.add_class();
        assert_eq!((class, marking.add_class(), marking.is_saved()), (1, 2, true));
        let fov = Fov { left: -0.5, right: 0.5, up: -0.5, down: 0.5 };
        let view = View::look_at(DVec3::Z * -4.0, DVec3::ZERO, DVec3::NEG_Y, fov, [64, 64]);
        let left = Stroke { tool: Tool::Box, radius: 0.0, points: vec![[0.0, 0.0], [0.5, 1.0]] };
        let found = splats_of(&splats, &view, &left, &ReferenceOptions::default()).unwrap();
        assert!(found.len() > 80);
        let side = |i: u32| view.to_eye(splats.mean_of(i as usize).into()).x < 0.02;
        assert!(found.iter().all(|&i| side(i)), "only what is left is meant");
        assert_eq!(marking.give(&found, class), found.len());
        assert_eq!(marking.give(&found, class), 0, "they have it");
        assert_eq!(marking.give(&found[..10], 2), 10);
        marking.undo();
        assert!(found.iter().all(|&i| marking.ids()[i as usize] == class) && !marking.is_saved());
        assert_eq!(marking.save().unwrap(), folder.join("scene.ply.labels.json"));
        let saved = Labels::beside(&scene).unwrap().unwrap();
        assert_eq!((&saved.ids, saved.classes.len()), (&**marking.ids(), 2));
        // They are what the scene has when it is opened again.
        saved.apply(&mut splats, &scene).unwrap();
        let again = Marking::of(&splats, &saved.classes, &scene);
        assert_eq!((again.ids(), again.can_undo()), (marking.ids(), false));
        marking.undo();
        assert!(marking.ids().iter().all(|&id| id == 0) && !marking.can_undo());
    }
}
