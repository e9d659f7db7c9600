use point_skeleton::dataset::Recording;
use point_skeleton::geometry::ImageSize;

/// Cameras of a log, and the rate of its frames: what a network in another process may want to know
/// beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct DenoiserRig {
    /// Channel names, in the order of all tensors.
    pub cameras: Vec<String>,
    /// Sizes of the original images, one per camera.
    pub image_sizes: Vec<ImageSize>,
    /// Generated frames, that is planning steps, per second.
    pub fps: f64,
}

impl DenoiserRig {
    /// Returns the cameras of a log.
    pub fn of(log: &Recording, fps: f64) -> Self {
        Self {
            cameras: log.rig.iter().map(|rig| rig.camera.name.to_string()).collect(),
            image_sizes: log.rig.iter().map(|rig| ImageSize::of(&rig.camera)).collect(),
            fps,
        }
    }
}
