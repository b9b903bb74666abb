//! Views of the sample scenes at which layers, times and errors are measured.

use crate::sample;
use glam::{DMat3, DVec3};
use motes_renderer::{Fov, View};
use motes_scenes::{LoadOptions, Splats, load_many};

/// A scene and a view of it.
pub struct GoldenView {
    /// Name, as in `golden.json` where it comes from there.
    pub name: &'static str,
    /// The scene.
    pub splats: Splats,
    /// The view, 640 × 480.
    pub view: View,
}

impl GoldenView {
    /// The same view with so many times the pixels on each side.
    pub fn scaled(&self, times: u32) -> View {
        View { size: self.view.size.map(|s| s * times), ..self.view }
    }
}

/// Names of the views that figures are quoted for.
pub const NAMES: [&str; 5] = ["skull_sh3", "flowers", "playbot_lod0_sh2", "lacadiere_a", "hq_garden_lod2_a"];

/// Loads one of [`NAMES`].
///
/// # Panics
/// Where a file is missing or unknown in form.
#[allow(clippy::panic, clippy::unwrap_used, reason = "only tests and benches call it")]
pub fn golden_view(name: &'static str) -> GoldenView {
    let load = |files: &[&str]| {
        let files: Vec<_> = files.iter().map(sample).collect();
        load_many(&files, &LoadOptions::default()).unwrap().splats
    };
    if name == "flowers" {
        // No golden view: from before the flowers, towards the scene's centre.
        let size = [640, 480];
        let fov = Fov::vertical(60f64.to_radians(), size);
        let (eye, target) = (DVec3::new(0.0, -0.08, -0.35), DVec3::new(0.0, -0.05, 0.0));
        let view = View::look_at(eye, target, DVec3::NEG_Y, fov, size);
        return GoldenView { name, splats: load(&["static/flowers_lod0"]), view };
    }
    let text = std::fs::read_to_string(sample("golden/golden.json")).unwrap();
    let rows: serde_json::Value = serde_json::from_str(&text).unwrap();
    let row = rows.as_array().unwrap().iter().find(|r| r["name"] == name).unwrap();
    let number = |key: &str| row[key].as_f64().unwrap();
    let line = |v: &serde_json::Value| DVec3::from_array([0, 1, 2].map(|i| v[i].as_f64().unwrap()));
    let rotation = DMat3::from_cols(line(&row["R_w2c"][0]), line(&row["R_w2c"][1]), line(&row["R_w2c"][2]));
    let rotation = rotation.transpose();
    let eye = -(rotation.transpose() * line(&row["t_w2c"]));
    let size = [number("width") as u32, number("height") as u32];
    let fov = Fov::pinhole(number("fx"), number("fy"), number("cx"), number("cy"), size);
    let inputs: Vec<_> = row["inputs"].as_array().unwrap().iter().map(|i| i.as_str().unwrap()).collect();
    GoldenView { name, splats: load(&inputs), view: View { rotation, eye, fov, size } }
}
