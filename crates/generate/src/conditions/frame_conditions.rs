use std::hash::Hasher;

use bytemuck::cast_slice;
use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS, layout};
use point_skeleton::conditions::{
    CameraConditions, ConditionSet, DepthBins, DepthEmbedding, Prompts, TensorEncoder,
};
use point_skeleton::geometry::{ImageSize, Pose};
use point_skeleton::scene::SceneState;
use twox_hash::XxHash3_64;

use crate::{Condition, DenoiserError, DroppedConditions};

/// Conditions of one frame: maps of all cameras, as bytes and depth bins, and numbers. Maps of the cameras
/// are concatenated, `[V, H, W]`.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameConditions {
    /// Size of the maps, H x W.
    pub size: ImageSize,
    /// RGB colors of the points, black where empty.
    pub color: Vec<[u8; 3]>,
    /// Depth bins, 0 where empty.
    pub bins: Vec<u16>,
    /// Quantization of depth.
    pub depth_bins: DepthBins,
    /// RGB layout of boxes on black.
    pub boxes: Vec<[u8; 3]>,
    /// RGB layout of the HD map on black.
    pub map: Vec<[u8; 3]>,
    /// Maps that are dropped: the network is shown none of their pixels.
    pub dropped: DroppedConditions,
    /// Ego motion since the previous frame, in the previous ego frame: forward and left in meters, yaw in
    /// radians. Zero for the first frame.
    pub action: [f32; 3],
    /// Parameters of each camera, `[V, 16]`: the upper three rows of `ego_from_camera` (row-major, meters),
    /// then focal lengths and principal point (x, y each) as fractions of width and height.
    pub cameras: Vec<[f32; CAMERA_NUMBERS]>,
    /// Texts for a text encoder; may be empty.
    pub prompts: Prompts,
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
    /// Creates the conditions of a step from its maps; `before` is the ego pose one step earlier.
    ///
    /// # Errors
    /// Returns an error if there is no camera, if a camera lacks color, depth or boxes, or if the cameras
    /// differ in size.
    pub fn new(
        set: &ConditionSet,
        state: &SceneState,
        before: Option<Pose>,
        prompts: &Prompts,
        depth_bins: DepthBins,
    ) -> Result<Self, DenoiserError> {
        let size = set.cameras.first().map(CameraConditions::size);
        let size = size.ok_or_else(|| DenoiserError::input("conditions of a camera at least", "none"))?;
        let mut frame = Self {
            size,
            color: Vec::new(),
            bins: Vec::new(),
            depth_bins,
            boxes: Vec::new(),
            map: Vec::new(),
            dropped: DroppedConditions::default(),
            action: action(before, state),
            cameras: state.cameras.iter().map(camera_numbers).collect(),
            prompts: prompts.clone(),
        };
        for camera in &set.cameras {
            frame.add(camera)?;
        }
        Ok(frame)
    }

    fn add(&mut self, camera: &CameraConditions) -> Result<(), DenoiserError> {
        let size = self.size;
        if camera.size() != size {
            let found = format!("{} of {}", camera.name, camera.size());
            return Err(DenoiserError::input(format!("conditions of {size} for all cameras"), found));
        }
        let missing = || {
            let found = format!("{} without one of them", camera.name);
            DenoiserError::input("color, depth and boxes of all cameras", found)
        };
        self.color.extend(camera.color.as_ref().ok_or_else(missing)?);
        let depth_m = camera.depth_m.as_ref().ok_or_else(missing)?;
        self.bins.extend(depth_m.iter().map(|depth_m| self.depth_bins.bin(*depth_m)));
        self.boxes.extend(camera.boxes.as_ref().ok_or_else(missing)?);
        match &camera.map {
            Some(map) => self.map.extend(map),
            None => self.map.resize(self.boxes.len(), [0; 3]),
        }
        Ok(())
    }

    /// Number of cameras, V.
    pub fn views(&self) -> usize {
        self.cameras.len()
    }

    /// Returns whether all maps have one value per pixel of each camera.
    pub fn is_whole(&self) -> bool {
        let pixels = self.views() * self.size.pixels();
        [self.color.len(), self.bins.len(), self.boxes.len(), self.map.len()] == [pixels; 4]
    }

    /// Returns the point conditions of a network, `[V, 20, H, W]`: color / 255 (3), depth (1), its sines (8)
    /// and cosines (8); 0.1255 where color is dropped, and -1 and 0 where depth is.
    pub fn points(&self) -> Vec<f32> {
        let pixels = self.size.pixels().max(1);
        let encoder = TensorEncoder::new(self.depth_bins, DepthEmbedding::Both);
        let views = self.color.chunks(pixels).zip(self.bins.chunks(pixels));
        let mut points = Vec::with_capacity(self.color.len() * POINT_CHANNELS);
        for (color, bins) in views {
            let mut view = encoder.points_of_bins(color, bins);
            let (color, depth) = view.split_at_mut(3 * color.len());
            if self.dropped.color {
                color.fill(NO_COLOR);
            }
            if self.dropped.depth {
                let (depth, waves) = depth.split_at_mut(bins.len());
                depth.fill(NO_DEPTH);
                waves.fill(0.0);
            }
            points.append(&mut view);
        }
        points
    }

    /// Returns the layout of a network, `[V, 6, H, W]`: boxes / 255 (3) and map / 255 (3); 0.1255 where it is
    /// dropped.
    pub fn layout(&self) -> Vec<f32> {
        if self.dropped.layout {
            return vec![NO_COLOR; self.boxes.len() * LAYOUT_CHANNELS];
        }
        let pixels = self.size.pixels().max(1);
        let views = self.boxes.chunks(pixels).zip(self.map.chunks(pixels));
        views.flat_map(|(boxes, map)| layout(boxes, Some(map))).collect()
    }

    /// Returns a hash of everything but the texts.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = XxHash3_64::new();
        for rgb in [&self.color, &self.boxes, &self.map] {
            hasher.write(rgb.as_flattened());
        }
        hasher.write(cast_slice(&self.bins));
        hasher.write(cast_slice(&self.action));
        hasher.write(cast_slice(self.cameras.as_flattened()));
        hasher.write(format!("{:?} {:?} {:?}", self.size, self.depth_bins, self.dropped).as_bytes());
        hasher.finish()
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
        let mut left = Self { dropped: self.dropped.or(dropped), ..self.clone() };
        if dropped.action {
            left.action.fill(NO_ACTION);
            left.prompts = Prompts::default();
        }
        left
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DMat3, DVec3};
    use point_skeleton::geometry::{Camera, View};
    use point_skeleton::scene::SceneCamera;

    const SIZE: ImageSize = ImageSize { height: 2, width: 3 };

    fn camera(name: &str, level: u8) -> CameraConditions {
        CameraConditions {
            name: name.parse().unwrap(),
            width: 3,
            height: 2,
            color: Some((0..6).map(|i| [level, i, 0]).collect()),
            depth_m: Some((0..6).map(|i| if i == 0 { f32::INFINITY } else { i as f32 * 10.0 }).collect()),
            boxes: Some(vec![[0, level, 9]; 6]),
            map: (level == 1).then(|| vec![[7; 3]; 6]),
            ..CameraConditions::default()
        }
    }

    fn state(x_m: f64) -> SceneState {
        let intrinsics =
            DMat3::from_cols(DVec3::new(3.0, 0.0, 0.0), DVec3::new(0.0, 3.0, 0.0), DVec3::new(3.0, 2.0, 1.0));
        let camera = Camera { name: "a".parse().unwrap(), width: 6, height: 4, intrinsics, lens: None };
        let scene = SceneCamera {
            view: View { camera, camera_from_world: DAffine3::IDENTITY },
            ego_from_camera: Some(Pose::from_yaw(0.0, DVec3::new(1.0, 2.0, 3.0))),
            global_from_ego: Pose::IDENTITY,
        };
        SceneState {
            name: "000000".into(),
            t_us: 0,
            global_from_ego: Pose::from_yaw(0.5, DVec3::new(x_m, 0.0, 0.0)),
            cameras: vec![scene.clone(), scene],
            actors: Vec::new(),
            map: None,
        }
    }

    fn made(set: &ConditionSet) -> Result<FrameConditions, DenoiserError> {
        let before = Pose::from_yaw(0.4, DVec3::new(-1.0, 0.0, 0.0));
        let rain = Prompts::Frame("rain".to_owned());
        FrameConditions::new(set, &state(1.0), Some(before), &rain, DepthBins::default())
    }

    /// The tensors are those that the renderer makes of the same maps.
    #[test]
    fn tensors_equal_those_of_the_maps() {
        let set = ConditionSet { cameras: vec![camera("a", 1), camera("b", 2)] };
        let whole = made(&set).unwrap();
        let encoder = TensorEncoder::new(DepthBins::default(), DepthEmbedding::Both);
        let tensors: Vec<_> = set.cameras.iter().map(|camera| encoder.encode(camera).unwrap()).collect();
        assert_eq!(whole.points(), [tensors[0].points.as_slice(), &tensors[1].points].concat());
        assert_eq!(whole.layout(), [tensors[0].layout.as_slice(), &tensors[1].layout].concat());
        assert!(whole.is_whole() && !FrameConditions { bins: Vec::new(), ..whole.clone() }.is_whole());
        // The ego moved two meters along x, at a yaw of 0.4, and turned 0.1 to the left.
        let moved = [2.0 * 0.4_f32.cos(), -2.0 * 0.4_f32.sin(), 0.1];
        assert!(whole.action.iter().zip(moved).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", whole.action);
        let first =
            FrameConditions::new(&set, &state(0.0), None, &Prompts::default(), DepthBins::default()).unwrap();
        assert_eq!(first.action, [0.0; 3]);
        let numbers = whole.cameras[1];
        assert_eq!(
            ([numbers[3], numbers[7], numbers[11]], &numbers[12..]),
            ([1.0, 2.0, 3.0], &[0.5, 0.75, 0.5, 0.5][..])
        );
    }

    #[test]
    fn rejects_inconsistent_maps() {
        let error = |camera| {
            let set = ConditionSet { cameras: vec![super::tests::camera("a", 1), camera] };
            made(&set).unwrap_err().to_string()
        };
        let found = error(CameraConditions { width: 4, ..camera("b", 2) });
        assert!(found.contains("conditions of 2x3 for all cameras, found b of 2x4"), "{found}");
        let found = error(CameraConditions { boxes: None, ..camera("b", 2) });
        assert!(found.contains("b without one of them"), "{found}");
        let none = made(&ConditionSet { cameras: Vec::new() }).unwrap_err().to_string();
        assert!(none.contains("a camera at least, found none"), "{none}");
    }

    #[test]
    fn parts_are_dropped_independently() {
        let whole = made(&ConditionSet { cameras: vec![camera("a", 1), camera("b", 2)] }).unwrap();
        assert_eq!(whole.without(DroppedConditions::default()), whole);
        let guided = whole.without(DroppedConditions::GUIDED);
        assert_eq!(guided.points(), whole.points());
        assert!(guided.layout().iter().all(|v| *v == 0.1255) && guided.action == [-1000.0; 3]);
        assert!(guided.prompts == Prompts::default() && guided.cameras == whole.cameras);
        let color = whole.without(DroppedConditions { color: true, ..DroppedConditions::default() });
        let depth = whole.without(DroppedConditions { depth: true, ..DroppedConditions::default() });
        assert_eq!((color.layout(), color.action), (whole.layout(), whole.action));
        let [color, depth, points] = [color.points(), depth.points(), whole.points()];
        for (i, value) in points.iter().enumerate() {
            let channel = i / SIZE.pixels() % POINT_CHANNELS;
            assert_eq!(color[i], if channel < 3 { 0.1255 } else { *value }, "{i}");
            let expected = match channel {
                0..3 => *value,
                3 => -1.0,
                _ => 0.0,
            };
            assert_eq!(depth[i], expected, "{i}");
        }
        let fingerprints = [&whole, &guided].map(FrameConditions::fingerprint);
        assert!(fingerprints[0] == whole.clone().fingerprint() && fingerprints[0] != fingerprints[1]);
    }
}
