//! What is shown, and from where it is seen at first.

use crate::XrError;
use glam::{DAffine3, DQuat, DVec3};
use motes_app::framing::Framing;
use motes_app::lod::Detail;
use motes_app::opened::Opened;
use motes_app::sequence::{BUDGET, SequenceOnDevice};
use motes_renderer::gpu::Gpu;
use motes_renderer::{Packing, SceneOnDevice, View};
use motes_scenes::settings::Settings;
use std::path::PathBuf;
use std::sync::Arc;

/// Vertical field of view that the first view is chosen for where only the scene's extent is known, radians: less than
/// a headset's, so that the scene lies well within it.
const FIRST_FOV: f64 = 1.2;

/// From where a scene is seen at first, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstView {
    /// The head's place, metres.
    pub place: DVec3,
    /// Where it looks.
    pub forward: DVec3,
    /// Whether the world's floor is known: the user stands on it then.
    pub floor_known: bool,
}

impl FirstView {
    /// The one that the settings name, else the data set's first camera, else one that shows the dense part.
    pub fn of(opened: &Opened, framing: &Framing) -> Self {
        let settings = &opened.settings;
        let (eye, forward) = if let Some(view) = &settings.first_view {
            (DVec3::from_array(view.position), DQuat::from_array(view.rotation) * DVec3::Z)
        } else if let Some(camera) = opened.cameras.first() {
            let view = View::from_camera(camera);
            (view.eye, view.rotation.row(2))
        } else {
            let eye = framing.eye(0.0, 0.2, FIRST_FOV);
            (eye, framing.center - eye)
        };
        let scene_to_world = settings.scene_to_world();
        Self {
            place: scene_to_world.transform_point3(eye),
            forward: scene_to_world.transform_vector3(forward),
            floor_known: settings.floor.is_some(),
        }
    }
}

/// A scene, and how it stands in the world.
pub struct Content {
    /// The splats; of a sequence the first frame's.
    pub scene: Arc<SceneOnDevice>,
    /// Its levels of detail, where it has any.
    pub detail: Option<Detail>,
    /// The frames of a sequence.
    pub sequence: Option<SequenceOnDevice>,
    /// From scene to world: turn, scale, floor.
    pub scene_to_world: DAffine3,
    /// From where it is seen at first.
    pub first_view: FirstView,
    /// What is known of it; nothing of a scene that was made on the spot.
    pub about: Option<About>,
}

/// What is known of a scene, and can be corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct About {
    /// Its name.
    pub name: String,
    /// Its file, beside which settings are kept; none of the sample's.
    pub path: Option<PathBuf>,
    /// How it stands in the world.
    pub settings: Settings,
}

impl Content {
    /// Brings an opened scene to the device.
    ///
    /// # Errors
    /// The device cannot hold it; the error says what would fit.
    pub fn new(gpu: &Arc<Gpu>, opened: &Opened, packing: Packing) -> Result<Self, XrError> {
        let scene = SceneOnDevice::new(gpu, &opened.scene.splats, packing)?;
        Self::of(gpu, opened, (Arc::new(scene), None), &Framing::of(&opened.scene.splats, &opened.settings))
    }

    /// An opened scene that is on the device, and its levels of detail, where it has any.
    ///
    /// # Errors
    /// The system gives no thread for the frames of a sequence.
    pub fn of(
        gpu: &Arc<Gpu>,
        opened: &Opened,
        (scene, detail): (Arc<SceneOnDevice>, Option<Detail>),
        framing: &Framing,
    ) -> Result<Self, XrError> {
        let sequence = if opened.frames.is_empty() {
            None
        } else {
            let sequence = SequenceOnDevice::new(gpu, &opened.frames, scene.packing, BUDGET);
            Some(sequence.map_err(XrError::Thread)?)
        };
        Ok(Self {
            scene,
            detail,
            sequence,
            scene_to_world: opened.settings.scene_to_world(),
            first_view: FirstView::of(opened, framing),
            about: Some(About {
                name: opened.name.clone(),
                path: opened.path.clone(),
                settings: opened.settings.clone(),
            }),
        })
    }
}
