//! What the rims of the lenses hide of each eye's image, as a runtime states it (`XR_KHR_visibility_mask`).

use motes_app::headset::{Eye, EyeFov};
use serde::{Deserialize, Serialize};

/// Corners of an eye's triangles, at most; a finer mask would cost more than it saves.
const MOST_CORNERS: usize = 3000;

/// Triangles over both eyes' images, left first, three corners each: tangents of the angles from the forward axis, to the
/// right and upwards. Empty where nothing is hidden.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HiddenArea(pub [Vec<[f32; 2]>; 2]);

impl HiddenArea {
    /// From a runtime's meshes; what is no mesh of triangles hides nothing, so that no picture is lost by it.
    pub(crate) fn of_meshes(meshes: [(&[[f32; 2]], &[u32]); 2]) -> Self {
        Self(meshes.map(|(corners, indices)| {
            let at = |index: &u32| corners.get(*index as usize).filter(|c| c.iter().all(|v| v.is_finite()));
            let list: Option<Vec<[f32; 2]>> = indices.iter().map(|index| at(index).copied()).collect();
            list.filter(|list| list.len() % 3 == 0 && list.len() <= MOST_CORNERS).unwrap_or_else(|| {
                log::warn!("the runtime's visibility mask cannot be used: images are drawn whole");
                Vec::new()
            })
        }))
    }

    /// Whether nothing is hidden.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(Vec::is_empty)
    }

    /// Where the corners are on images with these fields of view: across and down, −1 ..= 1.
    pub fn on_images(&self, eyes: &[Eye; 2]) -> [Vec<[f32; 2]>; 2] {
        [0, 1].map(|eye| {
            let EyeFov { left, right, up, down } = eyes[eye].fov;
            let [left, right, up, down] = [left, right, up, down].map(f32::tan);
            let place = |[x, y]: [f32; 2]| {
                [2.0 * (x - left) / (right - left) - 1.0, 2.0 * (up - y) / (up - down) - 1.0]
            };
            self.0[eye].iter().map(|&corner| place(corner)).collect()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_app::headset::Pose;

    #[test]
    fn corners_of_the_view_are_corners_of_the_image() {
        let fov = EyeFov { left: -0.9, right: 0.7, up: 0.8, down: -0.5 };
        let eye = Eye { pose: Pose::default(), fov };
        let tan = |a: f32| a.tan();
        let upper_left = [tan(-0.9), tan(0.8)];
        let lower_right = [tan(0.7), tan(-0.5)];
        let area = HiddenArea([vec![upper_left, lower_right, [tan(-0.9), 0.0]], Vec::new()]);
        let [left, right] = area.on_images(&[eye, eye]);
        let near = |a: [f32; 2], b: [f32; 2]| (0..2).all(|k| (a[k] - b[k]).abs() < 1e-5);
        assert!(near(left[0], [-1.0, -1.0]) && near(left[1], [1.0, 1.0]), "{left:?}");
        assert!(left[2][1] > -1.0 && left[2][1] < 1.0 && right.is_empty());
    }

    #[test]
    fn what_is_no_mesh_hides_nothing() {
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let nowhere = [[0.0, 0.0], [f32::NAN, 0.0], [0.0, 1.0]];
        let area = |a: &[[f32; 2]], i: &[u32]| HiddenArea::of_meshes([(a, i), (&corners, &[0, 1, 2])]);
        assert_eq!(area(&corners, &[2, 1, 0]).0[0], [corners[2], corners[1], corners[0]]);
        for broken in [area(&corners, &[0, 1, 3]), area(&corners, &[0, 1]), area(&nowhere, &[0, 1, 2])] {
            assert!(broken.0[0].is_empty() && broken.0[1].len() == 3, "{broken:?}");
        }
        assert!(HiddenArea::default().is_empty() && !area(&corners, &[]).is_empty());
    }
}
