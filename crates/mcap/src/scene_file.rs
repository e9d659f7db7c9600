use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use foxglove::messages::Timestamp;
use foxglove::messages::log::Level;
use glam::DVec3;
use point_skeleton::conditions::ImageSize;
use point_skeleton::dataset::{Frame, Recording};
use point_skeleton::error::FileError;
use point_skeleton::geometry::{Camera, Cuboid};
use point_skeleton::lidar::LidarNumber;
use point_skeleton::scene::SceneState;

use crate::file::LogFile;
use crate::messages;

/// MCAP file with the instants of a log or rollout. Messages are written in the order of the calls.
pub struct SceneFile<W: Write> {
    file: LogFile<W>,
    /// Origin of the frame `map`, global coordinates.
    origin: DVec3,
}

/// Returns a topic of a camera, `/camera/CAM/KIND`.
pub fn camera_topic(camera: &str, kind: &str) -> String {
    format!("/{}/{kind}", messages::camera_frame(camera))
}

impl<W: Write> SceneFile<W> {
    /// Begins a file with the metadata record `log`. `shown` is the path for messages.
    ///
    /// # Errors
    /// Fails if the file cannot be written, as do the other methods.
    pub fn begin(file: W, shown: &Path, log: &Recording) -> Result<Self, FileError> {
        let origin =
            Frame::origin_of(&log.frames).map_or(DVec3::ZERO, |frame| frame.global_from_ego.translation);
        let [x, y, z] = origin.to_array();
        let mut file = Self { file: LogFile::begin(file, shown)?, origin };
        let metadata = [
            ("name", log.name.clone()),
            ("location", log.location.clone()),
            ("map_origin", format!("[{x:?},{y:?},{z:?}]")), // JSON
        ];
        file.describe("log", metadata.map(|(key, value)| (key.to_owned(), value)).into())?;
        Ok(file)
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn describe(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), FileError> {
        self.file.describe(name, metadata)
    }

    /// Returns the time of messages from absolute microseconds.
    ///
    /// # Errors
    /// Fails if messages cannot represent it.
    pub fn time(&self, t_us: i64) -> Result<Timestamp, FileError> {
        messages::timestamp(t_us).ok_or_else(|| {
            let found = format!("{t_us} microseconds after 1970");
            FileError::content("times from 1970 to 2106", found, self.file.shown())
        })
    }

    /// Writes a message to `/log`.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_text(
        &mut self,
        level: Level,
        name: &str,
        text: String,
        time: Timestamp,
    ) -> Result<(), FileError> {
        self.file.write("/log", time, &messages::text(level, name, text, time))
    }

    /// Writes the poses of ego and cameras to `/tf`, the boxes of actors to `/actors`, and the calibrations
    /// of maps with these sizes, one per camera.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_state(
        &mut self,
        state: &SceneState,
        sizes: &[ImageSize],
        time: Timestamp,
    ) -> Result<(), FileError> {
        self.file.write("/tf", time, &messages::transforms(state, self.origin, time))?;
        self.file.write("/actors", time, &messages::actors(&state.actors, self.origin, time))?;
        for (camera, size) in state.cameras.iter().zip(sizes) {
            let camera = &camera.view.camera;
            self.write_calibration(&camera_topic(&camera.name, "calibration"), camera, *size, time)?;
        }
        Ok(())
    }

    /// Writes the calibration of images with a size to a topic.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_calibration(
        &mut self,
        topic: &str,
        camera: &Camera,
        size: ImageSize,
        time: Timestamp,
    ) -> Result<(), FileError> {
        self.file.write(topic, time, &messages::calibration(camera, size, time))
    }

    /// Writes an encoded image, such as of the format `png`, to a topic of a camera.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_image(
        &mut self,
        topic: &str,
        format: &str,
        bytes: Vec<u8>,
        time: Timestamp,
    ) -> Result<(), FileError> {
        self.file.write(topic, time, &messages::image(topic, format, bytes, time))
    }

    /// Writes the box of the ego, in its frame, to `/ego`.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_ego(&mut self, cuboid: &Cuboid, rgb: [u8; 3], time: Timestamp) -> Result<(), FileError> {
        self.file.write("/ego", time, &messages::ego(cuboid, rgb, time))
    }

    /// Writes a line through global points to `/NAME`; it replaces an earlier one.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_line(
        &mut self,
        name: &str,
        points: &[DVec3],
        rgb: [u8; 3],
        time: Timestamp,
    ) -> Result<(), FileError> {
        let line = messages::line(name, points, self.origin, rgb, time);
        self.file.write(&format!("/{name}"), time, &line)
    }

    /// Writes points in the ego frame to `/lidar`: rows of columns, one after the other.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn write_points(
        &mut self,
        columns: &[(&str, LidarNumber)],
        rows: Vec<u8>,
        time: Timestamp,
    ) -> Result<(), FileError> {
        self.file.write("/lidar", time, &messages::points(columns, rows, time))
    }

    /// Writes the index and returns the file.
    ///
    /// # Errors
    /// See [`Self::begin`].
    pub fn finish(self) -> Result<W, FileError> {
        self.file.finish()
    }
}
