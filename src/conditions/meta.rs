//! `FRAME/meta.json`, what a network needs beside the maps, and `index.json`, what lies in an output folder.
//!
//! Poses are 4×4 matrices row by row, named target first, metres.

use std::path::Path;

use glam::{DAffine3, DVec3};
use serde::Serialize;

use super::{ConditionOptions, ImageSize};
use crate::cloud::cameras::rows;
use crate::dataset::Class;
use crate::error::FileError;
use crate::files::FileName;
use crate::files::write_json;
use crate::scene::{SceneCamera, SceneState};

/// A 4×4 matrix, row by row.
pub type Matrix = [[f64; 4]; 4];

/// What the prompt says; from an annotation file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
pub struct PromptParts {
    /// For instance `Sunny`.
    pub weather: Option<String>,
    /// For instance `Boston`.
    pub city: Option<String>,
}

impl PromptParts {
    /// `"{weather}. A driving scene in {city}"`, less what is not known; `None` if nothing is.
    pub fn prompt(&self) -> Option<String> {
        match (&self.weather, &self.city) {
            (Some(weather), Some(city)) => Some(format!("{weather}. A driving scene in {city}")),
            (Some(weather), None) => Some(format!("{weather}. A driving scene")),
            (None, Some(city)) => Some(format!("A driving scene in {city}")),
            (None, None) => None,
        }
    }
}

/// `meta.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameMeta {
    /// Folder name of the frame.
    pub name: String,
    /// Absolute microseconds.
    pub t_us: i64,
    /// Text condition.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prompt: Option<String>,
    /// Frames per second of the sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// In the order of the maps.
    pub cameras: Vec<CameraMeta>,
}

/// A camera of [`FrameMeta`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraMeta {
    /// Channel name.
    pub name: FileName,
    /// Of the maps as written, pixels.
    pub height: u32,
    /// Of the maps as written, pixels.
    pub width: u32,
    /// 3×3, for the size above.
    pub intrinsics: [[f64; 3]; 3],
    /// k1, k2, p1, p2, k3 as OpenCV has them, if the maps are distorted by the lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distortion: Option<[f64; 5]>,
    /// Extrinsics; null for a camera that no ego carries.
    pub ego_from_camera: Option<Matrix>,
    /// Ego pose at the camera's time.
    pub global_from_ego: Matrix,
    /// Where the camera stands.
    pub camera_from_global: Matrix,
    /// Indices of the neighbour to the left, of the camera itself, and of the neighbour to the right.
    pub neighbours: [usize; 3],
}

impl FrameMeta {
    /// Of a step as it was rendered.
    pub fn new(
        state: &SceneState,
        options: &ConditionOptions,
        prompt: &PromptParts,
        fps: Option<f64>,
    ) -> Self {
        let neighbours = ring_neighbours(&state.cameras);
        let camera = |(camera, neighbours): (&SceneCamera, [usize; 3])| {
            let ImageSize { height, width } = options.written_size(&camera.view);
            CameraMeta {
                name: camera.view.camera.name.clone(),
                height,
                width,
                intrinsics: camera.view.camera.resized(height, width).rows(),
                distortion: None,
                ego_from_camera: camera.ego_from_camera.map(|pose| rows(&pose.affine())),
                global_from_ego: rows(&camera.global_from_ego.affine()),
                camera_from_global: rows(&camera.view.camera_from_world),
                neighbours,
            }
        };
        Self {
            name: state.name.clone(),
            t_us: state.t_us,
            prompt: prompt.prompt(),
            fps,
            cameras: state.cameras.iter().zip(neighbours).map(camera).collect(),
        }
    }

    /// Tells that the maps of this step were distorted as the cameras' lenses do.
    pub fn distorted(mut self, state: &SceneState) -> Self {
        for (meta, camera) in self.cameras.iter_mut().zip(&state.cameras) {
            meta.distortion = camera.view.camera.distortion.map(|d| d.coefficients());
        }
        self
    }

    /// Writes `meta.json`.
    ///
    /// # Errors
    /// The system's.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        write_json(path, self)
    }
}

/// Per camera the neighbours in the ring around the ego: left, itself, right. The ring is the order of the optical
/// axes by their angle in the ego frame. With fewer than three cameras a camera is there more than once.
pub fn ring_neighbours(cameras: &[SceneCamera]) -> Vec<[usize; 3]> {
    let angle = |camera: &SceneCamera| {
        let world_from_camera: DAffine3 = camera.view.camera_from_world.inverse();
        let axis = world_from_camera.transform_vector3(DVec3::Z);
        let axis = camera.global_from_ego.inverse().rotation * axis;
        axis.y.atan2(axis.x)
    };
    let mut ring: Vec<(f64, usize)> = cameras.iter().enumerate().map(|(i, c)| (angle(c), i)).collect();
    ring.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut neighbours = vec![[0; 3]; ring.len()];
    for (place, &(_, camera)) in ring.iter().enumerate() {
        // Angles grow to the left.
        let left = ring[(place + 1) % ring.len()].1;
        let right = ring[(place + ring.len() - 1) % ring.len()].1;
        neighbours[camera] = [left, camera, right];
    }
    neighbours
}

/// `index.json`. The options are [`ConditionOptions`], or whatever else is to be told with them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Index<O = ConditionOptions> {
    /// How the maps were made.
    pub options: O,
    /// In the order they were rendered.
    pub frames: Vec<IndexFrame>,
}

/// A frame of [`Index`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IndexFrame {
    /// Folder name.
    pub name: String,
    /// Absolute microseconds.
    pub t_us: i64,
    /// `global_from_ego`.
    pub ego: Matrix,
    /// Names, in the order of the maps.
    pub cameras: Vec<FileName>,
    /// What the instance map's numbers mean.
    pub actors: Vec<IndexActor>,
}

/// An actor of [`IndexFrame`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IndexActor {
    /// Number in the instance map.
    pub instance: u32,
    /// Track id.
    pub track: String,
    /// The data set's category name.
    pub category: String,
    /// Number in the class map.
    pub class: u8,
}

impl IndexFrame {
    /// Of a step.
    pub fn new(state: &SceneState) -> Self {
        let actor = |(number, actor): (u32, &crate::scene::ActorState)| IndexActor {
            instance: number,
            track: actor.track.clone(),
            category: actor.category.clone(),
            class: class_number(actor.class),
        };
        Self {
            name: state.name.clone(),
            t_us: state.t_us,
            ego: rows(&state.global_from_ego.affine()),
            cameras: state.cameras.iter().map(|c| c.view.camera.name.clone()).collect(),
            actors: (1..).zip(&state.actors).map(actor).collect(),
        }
    }
}

impl<O: Serialize> Index<O> {
    /// Writes `index.json`.
    ///
    /// # Errors
    /// The system's.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        write_json(path, self)
    }
}

fn class_number(class: Class) -> u8 {
    class as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, Cuboid, Distortion, Pose, View};
    use crate::scene::ActorState;
    use glam::{DMat3, DQuat};

    /// A camera that looks along `yaw` (to the left of the ego's x).
    fn camera(name: &str, yaw: f64, ego: Pose) -> SceneCamera {
        let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let rotation = DQuat::from_rotation_z(yaw) * DQuat::from_mat3(&axes);
        let ego_from_camera = Pose { rotation, translation: DVec3::new(1.0, 0.0, 1.5) };
        let rows = [[1000.0, 0.0, 800.0], [0.0, 1000.0, 450.0], [0.0, 0.0, 1.0]];
        let view = View {
            camera: Camera::new(name, 1600, 900, rows).unwrap(),
            camera_from_world: (ego * ego_from_camera).inverse().affine(),
        };
        SceneCamera { view, ego_from_camera: Some(ego_from_camera), global_from_ego: ego }
    }

    fn state() -> SceneState {
        let ego = Pose::from_yaw(2.5, DVec3::new(600.0, 4e6, 0.0));
        let yaws =
            [("front", 0.0), ("front_left", 0.9), ("front_right", -0.9), ("back", 3.1), ("back_left", 1.9)];
        let cuboid = Cuboid::new(ego, DVec3::ONE).unwrap();
        let actor = ActorState {
            track: "a".into(),
            category: "vehicle.car".into(),
            class: Class::MotorVehicle,
            cuboid,
        };
        SceneState {
            name: "000003".into(),
            t_us: 1_500_000,
            global_from_ego: ego,
            cameras: yaws.iter().map(|(name, yaw)| camera(name, *yaw, ego)).collect(),
            actors: vec![actor],
            map: None,
        }
    }

    #[test]
    fn neighbours_stand_left_and_right_in_the_ring() {
        let neighbours = ring_neighbours(&state().cameras);
        // front: left is front_left, right is front_right; the ring closes between front_right and back.
        assert_eq!(neighbours, [[1, 0, 2], [4, 1, 0], [0, 2, 3], [2, 3, 4], [3, 4, 1]]);
        assert_eq!(ring_neighbours(&state().cameras[..1]), [[0, 0, 0]]);
    }

    #[test]
    fn meta_and_index_hold_the_step() {
        let options = ConditionOptions {
            out_size: Some(ImageSize { height: 450, width: 400 }),
            ..ConditionOptions::default()
        };
        let prompt = PromptParts { weather: Some("Rainy".into()), city: Some("Boston".into()) };
        let meta = serde_json::to_value(FrameMeta::new(&state(), &options, &prompt, Some(2.0))).unwrap();
        assert_eq!(meta["prompt"], "Rainy. A driving scene in Boston");
        assert_eq!(
            meta["cameras"][0]["intrinsics"],
            serde_json::json!([[250.0, 0.0, 200.0], [0.0, 500.0, 225.0], [0.0, 0.0, 1.0]])
        );
        assert_eq!(meta["cameras"][0]["global_from_ego"][1][3], 4e6);
        assert!(meta["cameras"][0].get("distortion").is_none());
        let mut bent = state();
        bent.cameras[1].view.camera.distortion = Distortion::from_opencv([0.1, 0.2, 0.3, 0.4, 0.5]);
        let bent = FrameMeta::new(&bent, &options, &prompt, None).distorted(&bent);
        let distortion = bent.cameras.iter().map(|c| c.distortion).collect::<Vec<_>>();
        assert_eq!(distortion[..3], [None, Some([0.1, 0.2, 0.3, 0.4, 0.5]), None]);
        let bare = FrameMeta::new(&state(), &options, &PromptParts::default(), None);
        assert!(serde_json::to_value(bare).unwrap().get("prompt").is_none());
        let index = Index { options, frames: vec![IndexFrame::new(&state())] };
        let json = serde_json::to_value(index).unwrap();
        let actor = serde_json::json!({"instance": 1, "track": "a", "category": "vehicle.car", "class": 1});
        assert_eq!(json["frames"][0]["actors"], serde_json::json!([actor]));
        assert_eq!(json["frames"][0]["cameras"][4], "back_left");
        assert_eq!(json["frames"][0]["ego"][3], serde_json::json!([0.0, 0.0, 0.0, 1.0]));
    }
}
