//! Tables of sensor data, and checks against the samples that they belong to.

use serde_json::Value;

use super::chain::Chain;
use super::lens::lens;
use super::tables::{CalibratedSensor, EgoPose, SampleData, Sensor, Table};
use crate::dataset::clock::{KeyTimes, Offset, PoseTimes, TOLERANCE_US};
use crate::dataset::{DatasetError, ImageDistortion};
use crate::error::FileError;

/// Modalities of which data are read.
const READ: [&str; 2] = ["camera", "lidar"];

/// Note for cameras whose coefficients are not used.
pub(super) const IGNORED_LENSES: &str = "cameras with camera_distortion, whose images are read as rectified (--image-distortion apply if they are not)";

/// Tables for resolving sensor data.
pub(super) struct Sensors {
    pub(super) data: Table<SampleData>,
    pub(super) poses: Table<EgoPose>,
    pub(super) calibrated: Table<CalibratedSensor>,
    pub(super) sensors: Table<Sensor>,
    pub(super) distortion: ImageDistortion,
}

impl SampleData {
    /// Returns whether the data set marks the data as unusable.
    pub(super) fn is_marked_invalid(&self) -> bool {
        matches!(&self.is_valid, Some(value) if *value == Value::Bool(false) || value.as_f64() == Some(0.0))
    }
}

impl Chain {
    /// Returns whether a time is before the first sample by more than the tolerance of clocks.
    pub(super) fn is_long_before(&self, t_us: i64) -> bool {
        self.times_us.first().is_some_and(|first| t_us < *first && t_us.abs_diff(*first) > TOLERANCE_US)
    }
}

impl Sensors {
    /// Returns the sensor and the calibration of a data record.
    pub(super) fn sensor_of(&self, data: &SampleData) -> Result<(&Sensor, &CalibratedSensor), DatasetError> {
        let calibrated =
            self.calibrated.get(&data.calibrated_sensor_token, || format!("sample_data {}", data.token))?;
        let by = || format!("calibrated_sensor {}", calibrated.token);
        Ok((self.sensors.get(&calibrated.sensor_token, by)?, calibrated))
    }

    /// Checks that the time of a key frame is near the time of its sample: boxes exist at that time only.
    /// Adds it to the times of its sensor.
    pub(super) fn check_clock(
        &self,
        data: &SampleData,
        chain: &Chain,
        times: &mut KeyTimes,
    ) -> Result<(), DatasetError> {
        let Some(place) = chain.place.get(&data.sample_token).filter(|_| data.is_key_frame) else {
            return Ok(());
        };
        let sample_us = chain.times_us[*place];
        let Sensor { channel, modality, .. } = self.sensor_of(data)?.0;
        if !READ.contains(&modality.as_str()) {
            return Ok(());
        }
        times.add(channel, data.timestamp.0, sample_us);
        let Some(offset) = Offset::of(data.timestamp.0, sample_us) else { return Ok(()) };
        let expected =
            format!("key frames within a second of their sample ({} at {sample_us})", data.sample_token);
        let found = format!("sample_data {} of {channel} at {}, {offset}", data.token, data.timestamp.0);
        Err(FileError::content(expected, found, &self.data.path).into())
    }

    /// Compares the time of the ego pose of sensor data, if it has one.
    pub(super) fn compare_pose(&self, data: &SampleData, times: &mut PoseTimes) {
        let pose = self.poses.find(&data.ego_pose_token);
        let t_us = pose.and_then(|pose| pose.timestamp.as_ref()?.as_f64());
        if let Some(t_us) = t_us.filter(|t_us| t_us.is_finite()) {
            let sensor = || self.sensor_of(data).map_or("an unknown sensor", |(sensor, _)| &sensor.channel);
            let names = || [sensor().to_owned(), data.ego_pose_token.clone()];
            times.compare(t_us as i64, data.timestamp.0, names);
        }
    }

    /// Returns whether an image has distortion coefficients that are not used.
    pub(super) fn ignores_lens(&self, data: &SampleData) -> Result<bool, DatasetError> {
        let (sensor, calibrated) = self.sensor_of(data)?;
        // Coefficients that cannot be used are reported with their camera.
        let lens = lens(calibrated, self.distortion, "", &self.calibrated.path);
        Ok(sensor.modality == "camera" && lens.is_ok_and(|lens| lens.is_ignored))
    }
}
