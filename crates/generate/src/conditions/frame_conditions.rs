use point_skeleton::conditions::ConditionSet;
use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use point_skeleton::geometry::{ImageSize, Pose};
use point_skeleton::scene::SceneState;

use crate::{Condition, DenoiserError, DroppedConditions};

/// Conditions of one frame as network input: the model tensors of all cameras, and numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameConditions {
    /// Size of the maps, H x W.
    pub size: ImageSize,
    /// Color / 255 (3), depth (1), its sines (8) and cosines (8) of each camera: `[V, 20, H, W]`.
    pub points: Vec<f32>,
    /// Boxes / 255 (3) and map / 255 (3) of each camera: `[V, 6, H, W]`.
    pub layout: Vec<f32>,
    /// Ego motion since the previous frame, in the previous ego frame: forward and left in meters, yaw in
    /// radians. Zero for the first frame.
    pub action: [f32; 3],
    /// Parameters of each camera, `[V, 16]`: the upper three rows of `ego_from_camera` (row-major, meters),
    /// then focal lengths and principal point (x, y each) as fractions of width and height.
    pub cameras: Vec<[f32; CAMERA_NUMBERS]>,
    /// Prompt for a text encoder; may be empty.
    pub prompt: String,
}

/// Number of parameters per camera in [`FrameConditions::cameras`].
pub const CAMERA_NUMBERS: usize = 16;
/// Value of dropped color and layout. Source: the condition contract.
pub const NO_COLOR: f32 = 0.1255;
/// Value of dropped depth.
const NO_DEPTH: f32 = -1.0;
/// Value of a dropped action.
pub const NO_ACTION: f32 = -1000.0;

impl FrameConditions {
    /// Creates the conditions of a step with model tensors; `before` is the ego pose one step earlier.
    ///
    /// # Errors
    /// Returns an error if there is no camera, if a camera lacks its model tensors, or if the cameras differ
    /// in size.
    pub fn new(
        set: &ConditionSet,
        state: &SceneState,
        before: Option<Pose>,
        prompt: &str,
    ) -> Result<Self, DenoiserError> {
        let size = set.cameras.first().map(|camera| camera.size());
        let size = size.ok_or_else(|| DenoiserError::input("conditions of a camera at least", "none"))?;
        let (mut points, mut layout) = (Vec::new(), Vec::new());
        for camera in &set.cameras {
            if camera.size() != size {
                let found = format!("{} of {}", camera.name, camera.size());
                return Err(DenoiserError::input(format!("conditions of {size} for all cameras"), found));
            }
            let tensor = camera.tensor.as_ref();
            let tensor = tensor.ok_or_else(|| {
                DenoiserError::input("model tensors of all cameras", format!("none of {}", camera.name))
            })?;
            points.extend_from_slice(&tensor.points);
            layout.extend_from_slice(&tensor.layout);
        }
        let action = action(before, state);
        let cameras = state.cameras.iter().map(camera_numbers).collect();
        Ok(Self { size, points, layout, action, cameras, prompt: prompt.to_owned() })
    }

    /// Number of cameras, V.
    pub fn views(&self) -> usize {
        self.cameras.len()
    }
}

/// Computes [`FrameConditions::action`] of a step.
pub(crate) fn action(before: Option<Pose>, state: &SceneState) -> [f32; 3] {
    before.map_or([0.0; 3], |before| {
        let moved = before.inverse() * state.global_from_ego;
        [moved.translation.x as f32, moved.translation.y as f32, moved.yaw_rad() as f32]
    })
}

/// Computes [`FrameConditions::cameras`] of a camera.
pub(crate) fn camera_numbers(camera: &point_skeleton::scene::SceneCamera) -> [f32; CAMERA_NUMBERS] {
    let pose = camera.ego_from_camera.unwrap_or(Pose::IDENTITY);
    let rotation = glam::DMat3::from_quat(pose.rotation);
    let row = |i: usize| [rotation.row(i).x, rotation.row(i).y, rotation.row(i).z, pose.translation[i]];
    let lens = &camera.view.camera;
    let k = lens.intrinsics;
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let shares = [k.x_axis.x / width, k.y_axis.y / height, k.z_axis.x / width, k.z_axis.y / height];
    let numbers = [row(0), row(1), row(2), shares].concat();
    std::array::from_fn(|i| numbers[i] as f32)
}

impl Condition for FrameConditions {
    fn without(&self, dropped: DroppedConditions) -> Self {
        let mut left = self.clone();
        let pixels = self.size.pixels();
        for points in left.points.chunks_mut((POINT_CHANNELS * pixels).max(1)) {
            let (color, depth) = points.split_at_mut(3 * pixels);
            if dropped.color {
                color.fill(NO_COLOR);
            }
            if dropped.depth {
                let (depth, waves) = depth.split_at_mut(pixels);
                depth.fill(NO_DEPTH);
                waves.fill(0.0);
            }
        }
        if dropped.layout {
            left.layout.fill(NO_COLOR);
        }
        if dropped.action {
            left.action.fill(NO_ACTION);
            left.prompt.clear();
        }
        debug_assert_eq!(left.layout.len(), self.views() * LAYOUT_CHANNELS * pixels);
        left
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_dropped_independently() {
        let size = ImageSize { height: 2, width: 3 };
        let whole = FrameConditions {
            size,
            points: vec![0.5; 2 * 20 * 6],
            layout: vec![0.5; 2 * 6 * 6],
            action: [1.0, 2.0, 3.0],
            cameras: vec![[0.5; 16]; 2],
            prompt: "rain".to_owned(),
        };
        assert_eq!(whole.without(DroppedConditions::default()), whole);
        let guided = whole.without(DroppedConditions::GUIDED);
        assert_eq!(guided.points, whole.points);
        assert!(guided.layout.iter().all(|v| *v == 0.1255) && guided.action == [-1000.0; 3]);
        assert!(guided.prompt.is_empty() && guided.cameras == whole.cameras);
        let value = |conditions: &FrameConditions, view: usize, channel: usize| {
            let first = (view * 20 + channel) * 6;
            assert!(conditions.points[first..first + 6].iter().all(|v| *v == conditions.points[first]));
            conditions.points[first]
        };
        let color = whole.without(DroppedConditions { color: true, ..DroppedConditions::default() });
        let depth = whole.without(DroppedConditions { depth: true, ..DroppedConditions::default() });
        for view in 0..2 {
            assert_eq!([0, 2, 3, 19].map(|c| value(&color, view, c)), [0.1255, 0.1255, 0.5, 0.5]);
            assert_eq!([0, 2, 3, 4, 19].map(|c| value(&depth, view, c)), [0.5, 0.5, -1.0, 0.0, 0.0]);
        }
        assert_eq!((&color.layout, color.action), (&whole.layout, whole.action));
    }
}
