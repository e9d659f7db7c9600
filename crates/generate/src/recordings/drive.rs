use image::RgbImage;
use point_skeleton::conditions::tensor::layout;
use point_skeleton::conditions::{CameraConditions, ConditionSet, DepthEmbedding, TensorEncoder};
use point_skeleton::geometry::{ImageSize, Pose};
use point_skeleton::scene::SceneState;
use serde::{Deserialize, Serialize};

use crate::conditions::frame_conditions::{CAMERA_NUMBERS, FrameConditions, action, camera_numbers};
use crate::{DenoiserError, Recipe};

/// A recording for training networks: conditions and images of each frame. Maps are stored as bytes and depth
/// bins.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingClip {
    /// Metadata of the recording.
    pub about: DriveInfo,
    /// Frames in order, evenly spaced in time.
    pub frames: Vec<DriveFrame>,
}

/// Metadata of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveInfo {
    /// Name of the log.
    pub log: String,
    /// Fingerprints of recording and HD map; empty in files of earlier versions.
    #[serde(default)]
    pub source: String,
    /// Frames per second.
    pub hz: f64,
    /// Channel names.
    pub cameras: Vec<String>,
    /// Recipe of its maps.
    pub recipe: Recipe,
}

/// One frame of a recording. Maps and images of the cameras are concatenated: `[V, H, W]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DriveFrame {
    /// RGB colors of the points, black where empty.
    pub color: Vec<[u8; 3]>,
    /// Depth bins, 0 where empty.
    pub bins: Vec<u16>,
    /// RGB layout of boxes on black.
    pub boxes: Vec<[u8; 3]>,
    /// RGB layout of the HD map on black.
    pub map: Vec<[u8; 3]>,
    /// Ground-truth images, RGB.
    pub truth: Vec<[u8; 3]>,
    /// Ego motion, as [`FrameConditions::action`].
    pub action: [f32; 3],
    /// Camera parameters, as [`FrameConditions::cameras`], `[V, 16]`.
    pub cameras: Vec<[f32; CAMERA_NUMBERS]>,
}

impl DriveFrame {
    /// Creates a frame from the rendered maps of a step and its images; `before` is the ego pose one frame
    /// earlier.
    ///
    /// # Errors
    /// Returns an error if a camera lacks a map, if maps or images have another size, or if the number of
    /// images differs from the number of cameras.
    pub fn new(
        about: &DriveInfo,
        set: &ConditionSet,
        state: &SceneState,
        before: Option<Pose>,
        images: &[RgbImage],
    ) -> Result<Self, DenoiserError> {
        if (images.len(), set.cameras.len()) != (about.cameras.len(), about.cameras.len()) {
            let found = format!("{} and {}", images.len(), set.cameras.len());
            return Err(wrong(format!("images and maps of {} cameras", about.cameras.len()), found));
        }
        let mut frame = Self {
            action: action(before, state),
            cameras: state.cameras.iter().map(camera_numbers).collect(),
            ..Self::default()
        };
        for (camera, image) in set.cameras.iter().zip(images) {
            frame.add(about, camera, image)?;
        }
        Ok(frame)
    }

    /// Returns the conditions of the frame, from maps with a size.
    pub fn conditions(&self, size: ImageSize, encoder: &TensorEncoder) -> FrameConditions {
        let pixels = size.pixels();
        let views = self.color.chunks(pixels).zip(self.bins.chunks(pixels));
        let layouts = self.boxes.chunks(pixels).zip(self.map.chunks(pixels));
        FrameConditions {
            size,
            points: views.flat_map(|(color, bins)| encoder.points_of_bins(color, bins)).collect(),
            layout: layouts.flat_map(|(boxes, map)| layout(boxes, Some(map))).collect(),
            action: self.action,
            cameras: self.cameras.clone(),
            prompt: String::new(),
        }
    }

    fn add(
        &mut self,
        about: &DriveInfo,
        camera: &CameraConditions,
        image: &RgbImage,
    ) -> Result<(), DenoiserError> {
        let size = about.recipe.size;
        if camera.size() != size {
            return Err(wrong(format!("maps of {size}"), format!("{} of {}", camera.name, camera.size())));
        }
        let of_image = ImageSize { height: image.height(), width: image.width() };
        if of_image != size {
            return Err(wrong(format!("images of {size}"), format!("{} of {of_image}", camera.name)));
        }
        let missing =
            || wrong("color, depth and boxes".to_owned(), format!("{} without one of them", camera.name));
        self.color.extend(camera.color.as_ref().ok_or_else(missing)?);
        self.bins
            .extend(camera.depth_m.as_ref().ok_or_else(missing)?.iter().map(|d| about.recipe.bins.bin(*d)));
        self.boxes.extend(camera.boxes.as_ref().ok_or_else(missing)?);
        let no_map = || vec![[0; 3]; size.pixels()];
        self.map.extend(camera.map.clone().unwrap_or_else(no_map));
        self.truth.extend(image.pixels().map(|pixel| pixel.0));
        Ok(())
    }
}

impl TrainingClip {
    /// Returns the encoder that [`TrainingClip::conditions`] needs.
    pub fn encoder(&self) -> TensorEncoder {
        TensorEncoder::new(self.about.recipe.bins, DepthEmbedding::Both)
    }

    /// Returns the conditions of a frame.
    pub fn conditions(&self, frame: usize, encoder: &TensorEncoder) -> FrameConditions {
        self.frames[frame].conditions(self.about.recipe.size, encoder)
    }

    /// Removes every N-th frame, N at least 2: frames N - 1, 2 N - 1 and so on. The ego motion of the frames
    /// behind them then includes theirs.
    #[must_use]
    pub fn without_every(mut self, n: usize) -> Self {
        let mut skipped = [0.0_f32; 3];
        let mut retained = Vec::with_capacity(self.frames.len());
        for (number, mut frame) in std::mem::take(&mut self.frames).into_iter().enumerate() {
            frame.action = joined(skipped, frame.action);
            if (number + 1).is_multiple_of(n) {
                skipped = frame.action;
            } else {
                skipped = [0.0; 3];
                retained.push(frame);
            }
        }
        Self { frames: retained, ..self }
    }

    /// Returns the images of a frame.
    pub fn images(&self, frame: usize) -> Vec<RgbImage> {
        let ImageSize { height, width } = self.about.recipe.size;
        let image = |pixels: &[[u8; 3]]| {
            let pixel = |x: u32, y: u32| image::Rgb(pixels[(y * width + x) as usize]);
            RgbImage::from_fn(width, height, pixel)
        };
        self.frames[frame].truth.chunks(self.about.recipe.size.pixels()).map(image).collect()
    }
}

/// Returns the motion of two motions in a row: forward, left, yaw.
fn joined(first: [f32; 3], second: [f32; 3]) -> [f32; 3] {
    let (sin, cos) = first[2].sin_cos();
    let [forward, left, yaw] = second;
    [first[0] + cos * forward - sin * left, first[1] + sin * forward + cos * left, first[2] + yaw]
}

fn wrong(expected: String, found: String) -> DenoiserError {
    DenoiserError::Input { expected, found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DMat3, DVec3};
    use point_skeleton::geometry::{Camera, View};
    use point_skeleton::scene::SceneCamera;

    const SIZE: ImageSize = ImageSize { height: 2, width: 3 };

    fn about() -> DriveInfo {
        let cameras = vec!["a".to_owned(), "b".to_owned()];
        DriveInfo {
            log: "l".into(),
            source: "2-0".into(),
            hz: 5.0,
            cameras,
            recipe: Recipe { size: SIZE, ..Recipe::default() },
        }
    }

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
        let camera = Camera { name: "a".parse().unwrap(), width: 6, height: 4, intrinsics, distortion: None };
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

    /// Frames return the conditions that they were created from, and a file returns the recording unchanged.
    #[test]
    fn frames_round_trip() {
        let set = ConditionSet { cameras: vec![camera("a", 1), camera("b", 2)] };
        let images = [
            RgbImage::from_pixel(3, 2, image::Rgb([5, 6, 7])),
            RgbImage::from_pixel(3, 2, image::Rgb([8, 9, 10])),
        ];
        let before = Pose::from_yaw(0.4, DVec3::new(-1.0, 0.0, 0.0));
        let frame = DriveFrame::new(&about(), &set, &state(1.0), Some(before), &images).unwrap();
        let first = DriveFrame::new(&about(), &set, &state(0.0), None, &images).unwrap();
        let drive = TrainingClip { about: about(), frames: vec![first, frame] };
        let found = drive.images(1);
        assert!(found[0].dimensions() == (3, 2) && found[0].pixels().all(|p| p.0 == [5, 6, 7]));
        assert!(found[1].pixels().all(|p| p.0 == [8, 9, 10]));
        let mut tensors = set.clone();
        let encoder = drive.encoder();
        tensors.cameras.iter_mut().for_each(|camera| camera.tensor = encoder.encode(camera));
        let expected = FrameConditions::new(&tensors, &state(1.0), Some(before), "").unwrap();
        assert_eq!(drive.conditions(1, &encoder), expected);
        // The ego moved two meters along x, at a yaw of 0.4, and turned 0.1 to the left.
        let moved = [2.0 * 0.4_f32.cos(), -2.0 * 0.4_f32.sin(), 0.1];
        assert!(
            expected.action.iter().zip(moved).all(|(a, b)| (a - b).abs() < 1e-6),
            "{:?}",
            expected.action
        );
        assert_eq!(drive.conditions(0, &encoder).action, [0.0; 3]);
        let numbers = expected.cameras[1];
        assert_eq!(
            ([numbers[3], numbers[7], numbers[11]], &numbers[12..]),
            ([1.0, 2.0, 3.0], &[0.5, 0.75, 0.5, 0.5][..])
        );

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.safetensors");
        drive.save(&path).unwrap();
        assert_eq!(TrainingClip::open(&path).unwrap(), drive);
        let mut beyond = drive.clone();
        beyond.frames[1].bins[0] = 257;
        beyond.save(&path).unwrap();
        assert!(TrainingClip::open(&path).unwrap_err().to_string().contains("bin 257 of 256"));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        let error = TrainingClip::open(&path).unwrap_err().to_string();
        assert!(error.contains("expected a training clip") && error.contains("drive.safetensors"), "{error}");
    }

    #[test]
    fn removed_frames_add_to_the_next_motion() {
        let frame = |action| DriveFrame { action, ..DriveFrame::default() };
        // A quarter turn to the left in every frame: forward, then left, then backward.
        let turn = std::f32::consts::FRAC_PI_2;
        let drive = TrainingClip { about: about(), frames: vec![frame([1.0, 0.0, turn]); 5] };
        let retained = drive.clone().without_every(2);
        let near = |found: [f32; 3], expected: [f32; 3]| {
            found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6)
        };
        assert!(retained.frames.len() == 3 && retained.frames[0] == drive.frames[0]);
        assert!(near(retained.frames[2].action, [1.0, 1.0, 2.0 * turn]), "{:?}", retained.frames[2].action);
        let retained = drive.without_every(3);
        assert_eq!(retained.frames.len(), 4);
        assert!(
            near(retained.frames[2].action, [1.0, 1.0, 2.0 * turn])
                && near(retained.frames[3].action, [1.0, 0.0, turn])
        );
    }

    #[test]
    fn rejects_inconsistent_maps() {
        let set = |camera| ConditionSet { cameras: vec![super::tests::camera("a", 1), camera] };
        let images = vec![RgbImage::new(3, 2); 2];
        let made =
            |camera, images: &[RgbImage]| DriveFrame::new(&about(), &set(camera), &state(0.0), None, images);
        let error = made(CameraConditions { width: 4, ..camera("b", 2) }, &images).unwrap_err().to_string();
        assert!(error.contains("maps of 2x3, found b of 2x4"), "{error}");
        let error =
            made(CameraConditions { boxes: None, ..camera("b", 2) }, &images).unwrap_err().to_string();
        assert!(error.contains("b without one of them"), "{error}");
        let large = [RgbImage::new(3, 2), RgbImage::new(6, 4)];
        let error = made(camera("b", 2), &large).unwrap_err().to_string();
        assert!(error.contains("images of 2x3, found b of 4x6"), "{error}");
        let error = made(camera("b", 2), &images[..1]).unwrap_err().to_string();
        assert!(error.contains("2 cameras, found 1 and 2"), "{error}");
    }
}
