//! `FRAME/meta.json`, the network inputs other than maps, and `index.json`, the index of an output folder.
//!
//! Poses are row-major 4×4 matrices in meters; their names put the target frame first.

use std::path::Path;

use glam::{DAffine3, DVec3};
use serde::Serialize;

use crate::cloud::cameras::rows;
use crate::conditions::{ConditionOptions, ImageSize};
use crate::dataset::Class;
use crate::error::FileError;
use crate::files::FileName;
use crate::files::json;
use crate::files::write_json;
use crate::geometry::LensModel;
use crate::scene::{SceneCamera, SceneState};

/// Row-major 4×4 matrix.
pub type Matrix = [[f64; 4]; 4];

/// Parts of the text prompt, from an annotation file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
pub struct PromptParts {
    /// Weather, for instance `Sunny`.
    pub weather: Option<String>,
    /// City, for instance `Boston`.
    pub city: Option<String>,
}

impl PromptParts {
    /// Reads `{"weather": text, "city": text}`, both optional.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        json::read(path, r#"{"weather": text, "city": text}"#)
    }

    /// Returns `"{weather}. A driving scene in {city}"` without unknown parts; `None` if both are unknown.
    pub fn prompt(&self) -> Option<String> {
        match (&self.weather, &self.city) {
            (Some(weather), Some(city)) => Some(format!("{weather}. A driving scene in {city}")),
            (Some(weather), None) => Some(format!("{weather}. A driving scene")),
            (None, Some(city)) => Some(format!("A driving scene in {city}")),
            (None, None) => None,
        }
    }
}

/// Content of `meta.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameMeta {
    /// Folder name of the frame.
    pub name: String,
    /// Timestamp, absolute microseconds.
    pub t_us: i64,
    /// Text prompt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prompt: Option<String>,
    /// Frames per second of the sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// Cameras, in the order of the maps.
    pub cameras: Vec<CameraMeta>,
}

/// A camera of [`FrameMeta`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraMeta {
    /// Channel name.
    pub name: FileName,
    /// Height of the written maps, pixels.
    pub height: u32,
    /// Width of the written maps, pixels.
    pub width: u32,
    /// 3×3 intrinsics for this height and width.
    pub intrinsics: [[f64; 3]; 3],
    /// OpenCV coefficients k1, k2, p1, p2, k3 if the maps are distorted by the lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distortion: Option<[f64; 5]>,
    /// Lens of another model if the maps are distorted by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<LensMeta>,
    /// Extrinsics; null for a camera that is not mounted on an ego.
    pub ego_from_camera: Option<Matrix>,
    /// Ego pose at the camera's timestamp.
    pub global_from_ego: Matrix,
    /// Pose of the camera, as a transform from global to camera coordinates.
    pub camera_from_global: Matrix,
    /// Indices of the left neighbor, of the camera itself, and of the right neighbor.
    pub neighbours: [usize; 3],
}

/// Lens of a [`CameraMeta`]. It maps rays to a plane, in units of the focal length near the axis; the
/// intrinsics map the plane to pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LensMeta {
    /// Model with its numbers.
    #[serde(flatten)]
    pub model: LensNumbers,
    /// Share of the pixels that are empty because the lens shows more there than a pinhole image can.
    pub uncovered: f64,
}

/// Model of a [`LensMeta`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum LensNumbers {
    /// See [`Mei`](crate::geometry::Mei).
    Mei {
        /// Mirror parameter.
        xi: f64,
        /// Radial distortion.
        k1: f64,
        /// Radial distortion.
        k2: f64,
    },
    /// See [`FTheta`](crate::geometry::FTheta).
    FTheta {
        /// Coefficients of the radius by angle (radians), from the constant.
        polynomial: [f64; 6],
    },
}

impl LensNumbers {
    /// Returns the numbers of a lens; `None` for a Brown–Conrady lens, which [`CameraMeta::distortion`]
    /// describes.
    pub fn new(lens: &LensModel) -> Option<Self> {
        match lens {
            LensModel::BrownConrady(_) => None,
            LensModel::Mei(mei) => {
                let [k1, k2] = mei.radial();
                Some(Self::Mei { xi: mei.xi(), k1, k2 })
            }
            LensModel::FTheta(f_theta) => Some(Self::FTheta { polynomial: f_theta.polynomial() }),
        }
    }
}

impl FrameMeta {
    /// Creates the metadata of a rendered step.
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
                lens: None,
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

    /// Records the lenses of the cameras, for a step whose maps were distorted; `uncovered` are the shares of
    /// empty pixels per camera.
    pub fn distorted(mut self, state: &SceneState, uncovered: &[f64]) -> Self {
        for ((meta, camera), uncovered) in self.cameras.iter_mut().zip(&state.cameras).zip(uncovered) {
            let Some(lens) = &camera.view.camera.lens else { continue };
            meta.distortion = lens.distortion().map(|distortion| distortion.coefficients());
            meta.lens = LensNumbers::new(lens).map(|model| LensMeta { model, uncovered: *uncovered });
        }
        self
    }

    /// Writes `meta.json`.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        write_json(path, self)
    }
}

/// Returns for each camera its neighbors in the ring around the ego: left, itself, right. The ring orders the
/// optical axes by their angle in the ego frame. With fewer than three cameras an index occurs more than
/// once.
pub(crate) fn ring_neighbours(cameras: &[SceneCamera]) -> Vec<[usize; 3]> {
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
        // Angles increase to the left.
        let left = ring[(place + 1) % ring.len()].1;
        let right = ring[(place + ring.len() - 1) % ring.len()].1;
        neighbours[camera] = [left, camera, right];
    }
    neighbours
}

/// Content of `index.json`. The options are [`ConditionOptions`] or any other serializable type.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Index<O = ConditionOptions> {
    /// Options with which the maps were rendered.
    pub options: O,
    /// Frames in rendering order.
    pub frames: Vec<IndexFrame>,
}

/// A frame of [`Index`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IndexFrame {
    /// Name of the frame's folder.
    pub name: String,
    /// Timestamp, absolute microseconds.
    pub t_us: i64,
    /// Pose `global_from_ego`.
    pub ego: Matrix,
    /// Camera names, in the order of the maps.
    pub cameras: Vec<FileName>,
    /// Actors that the numbers in the instance map refer to.
    pub actors: Vec<IndexActor>,
}

/// An actor of [`IndexFrame`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IndexActor {
    /// Number in the instance map.
    pub instance: u32,
    /// Track id.
    pub track: String,
    /// Category name of the data set.
    pub category: String,
    /// Number in the class map.
    pub class: u8,
}

impl IndexFrame {
    /// Creates the entry of a step.
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
    /// Fails if the file cannot be written.
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
    use crate::geometry::{Camera, Cuboid, LensModel, Pose, View};
    use crate::scene::ActorState;
    use glam::{DMat3, DQuat};

    /// Returns a camera that looks along `yaw`, counted to the left from the ego's x axis.
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
            appearance: None,
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
    fn neighbours_are_left_and_right_in_the_ring() {
        let neighbours = ring_neighbours(&state().cameras);
        // front: left is front_left, right is front_right. The ring closes between front_right and back.
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
        bent.cameras[1].view.camera.lens = LensModel::from_opencv([0.1, 0.2, 0.3, 0.4, 0.5]);
        let bent = FrameMeta::new(&bent, &options, &prompt, None).distorted(&bent, &[0.0; 6]);
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
