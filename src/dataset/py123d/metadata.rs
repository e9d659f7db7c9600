//! Metadata of tables: a MessagePack map in the schema.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::dataset::DatasetError;
use crate::dataset::tables::ArrowFile;
use crate::error::FileError;
use crate::geometry::Pose;

/// Entry of the schema that holds the map.
const KEY: &str = "metadata";

/// Maximum depth of nested maps and arrays.
const MAX_DEPTH: usize = 32;

/// Reads the metadata of a table.
///
/// # Errors
/// Fails if there are none, or if an entry is missing or has another type.
pub(super) fn read<T: DeserializeOwned>(file: &ArrowFile) -> Result<T, FileError> {
    let expected = "metadata of a table of py123d in the schema";
    let bytes = file.metadata(KEY).ok_or_else(|| FileError::content(expected, "none", file.path()))?;
    decode(bytes).map_err(|found| FileError::content(expected, found, file.path()))
}

/// Decodes a MessagePack value.
///
/// # Errors
/// Returns a description of the invalid content.
pub(super) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    let mut decoder = rmp_serde::Deserializer::from_read_ref(bytes);
    decoder.set_max_depth(MAX_DEPTH);
    serde_path_to_error::deserialize(&mut decoder).map_err(|error| match error.path().to_string().as_str() {
        "." => error.inner().to_string(),
        path => format!("{} at {path}", error.inner()),
    })
}

/// Metadata of `sync.arrow`.
#[derive(Debug, Deserialize)]
pub(super) struct LogMetadata {
    pub(super) dataset: String,
    pub(super) split: String,
    pub(super) log_name: String,
    pub(super) location: Option<String>,
}

/// Metadata of boxes.
#[derive(Debug, Deserialize)]
pub(super) struct BoxMetadata {
    pub(super) box_detection_label_class: String,
}

/// Metadata of a camera.
#[derive(Debug, Deserialize)]
pub(super) struct CameraMetadata {
    #[serde(default = "pinhole")]
    pub(super) camera_model: String,
    pub(super) width: u32,
    pub(super) height: u32,
    camera_to_imu_se3: [f64; 7],
    /// Pinhole: fx fy cx cy skew. f-theta: cx cy, six coefficients forward, six backward.
    pub(super) intrinsics: Option<Vec<f64>>,
    /// Pinhole: k1 k2 p1 p2 k3. Fisheye: k1 k2 p1 p2.
    pub(super) distortion: Option<Vec<f64>>,
    /// Whether the images of a pinhole fit the bare matrix.
    #[serde(default)]
    pub(super) is_undistorted: bool,
    /// Fisheye: offset of the projection center from the sphere's.
    pub(super) mirror_parameter: Option<f64>,
    /// Fisheye: gamma1 gamma2 u0 v0.
    pub(super) projection: Option<Vec<f64>>,
}

fn pinhole() -> String {
    "pinhole".to_owned()
}

impl CameraMetadata {
    /// Returns the mounting pose.
    ///
    /// # Errors
    /// Fails if it is invalid.
    pub(super) fn ego_from_camera(&self, file: &ArrowFile) -> Result<Pose, DatasetError> {
        pose(self.camera_to_imu_se3, "camera_to_imu_se3", file)
    }
}

/// Metadata of one LiDAR.
#[derive(Debug, Deserialize)]
pub(super) struct LidarMetadata {
    pub(super) lidar_id: u8,
    lidar_to_imu_se3: [f64; 7],
}

impl LidarMetadata {
    /// Returns the mounting pose.
    ///
    /// # Errors
    /// Fails if it is invalid.
    pub(super) fn ego_from_lidar(&self, file: &ArrowFile) -> Result<Pose, DatasetError> {
        pose(self.lidar_to_imu_se3, "lidar_to_imu_se3", file)
    }
}

/// Metadata of a sweep table: one LiDAR, or several that are merged, by their ids.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum SweepMetadata {
    One(LidarMetadata),
    Merged(BTreeMap<String, LidarMetadata>),
}

impl SweepMetadata {
    /// Returns the LiDARs in the order of their ids.
    pub(super) fn lidars(self) -> Vec<LidarMetadata> {
        let mut lidars = match self {
            Self::One(lidar) => vec![lidar],
            Self::Merged(lidars) => lidars.into_values().collect(),
        };
        lidars.sort_by_key(|lidar| lidar.lidar_id);
        lidars
    }
}

/// Converts x y z qw qx qy qz of a record.
///
/// # Errors
/// Fails if a number is not finite, or the quaternion is not of length 1.
pub(super) fn pose(
    [x, y, z, qw, qx, qy, qz]: [f64; 7],
    record: &str,
    file: &ArrowFile,
) -> Result<Pose, DatasetError> {
    let wrong =
        |source| DatasetError::Pose { source, record: record.to_owned(), path: file.path().to_owned() };
    Pose::from_wxyz([qw, qx, qy, qz], [x, y, z]).map_err(wrong)
}
