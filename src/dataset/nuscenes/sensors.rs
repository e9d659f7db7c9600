//! Tables of sensor data, and checks against the samples that they belong to.

use serde::Deserialize;

use super::chain::Chain;
use super::tables::numbers::{TimeUs, Truth};
use super::tables::{CalibratedSensor, EgoPose, Record, SampleData, Sensor, Table};
use crate::dataset::clock::{KeyTimes, Offset, PoseTimes, TOLERANCE_US};
use crate::dataset::recording::notes::DANGLING_DATA;
use crate::dataset::{DatasetError, Gap, ImageDistortion};
use crate::error::FileError;

/// Kind of a sensor, from its modality in any case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SensorKind {
    Camera,
    Lidar,
    /// Data are not read.
    Other,
}

/// Tables for resolving sensor data.
pub(super) struct Sensors {
    pub(super) data: Table<SampleData>,
    pub(super) poses: Table<EgoPose>,
    pub(super) calibrated: Table<CalibratedSensor>,
    pub(super) sensors: Table<Sensor>,
    pub(super) distortion: ImageDistortion,
}

/// Records that sensor data refer to.
#[derive(Clone, Copy)]
pub(super) struct Origin<'a> {
    pub(super) sensor: &'a Sensor,
    pub(super) calibrated: &'a CalibratedSensor,
    pub(super) ego: &'a EgoPose,
}

impl Sensor {
    pub(super) fn kind(&self) -> SensorKind {
        match self.modality.trim().to_ascii_lowercase().as_str() {
            "camera" => SensorKind::Camera,
            "lidar" => SensorKind::Lidar,
            _ => SensorKind::Other,
        }
    }
}

impl SampleData {
    /// Returns whether the data set marks the data as usable; `None` if the mark is not understood.
    pub(super) fn is_marked_valid(&self) -> Option<bool> {
        let Some(mark) = self.is_valid.as_ref().filter(|mark| !mark.is_null()) else { return Some(true) };
        Truth::deserialize(mark).ok().map(|truth| truth.0)
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
    ///
    /// # Errors
    /// Returns the gap if one of them is missing.
    pub(super) fn sensor_of(&self, data: &SampleData) -> Result<(&Sensor, &CalibratedSensor), Gap> {
        let token = &data.calibrated_sensor_token;
        let calibrated = self.calibrated.find(token);
        let calibrated = calibrated.ok_or_else(|| missing(data, &self.calibrated, token))?;
        let sensor = self.sensors.find(&calibrated.sensor_token);
        let sensor = sensor.ok_or_else(|| missing(data, &self.sensors, &calibrated.sensor_token))?;
        Ok((sensor, calibrated))
    }

    /// Returns the records that sensor data refer to.
    ///
    /// # Errors
    /// Returns the gap if one of them is missing.
    pub(super) fn origin(&self, data: &SampleData) -> Result<Origin<'_>, Gap> {
        let (sensor, calibrated) = self.sensor_of(data)?;
        let ego = self.poses.find(&data.ego_pose_token);
        let ego = ego.ok_or_else(|| missing(data, &self.poses, &data.ego_pose_token))?;
        Ok(Origin { sensor, calibrated, ego })
    }

    /// Checks that the time of a key frame is near the time of its sample: boxes exist at that time only.
    /// Adds it to the times of its sensor.
    pub(super) fn check_clock(
        &self,
        data: &SampleData,
        sensor: &Sensor,
        chain: &Chain,
        times: &mut KeyTimes,
    ) -> Result<(), DatasetError> {
        let Some(place) = chain.place.get(&data.sample_token).filter(|_| data.is_key_frame.0) else {
            return Ok(());
        };
        let sample_us = chain.times_us[*place];
        if sensor.kind() == SensorKind::Other {
            return Ok(());
        }
        let channel = &sensor.channel;
        times.add(channel, data.timestamp.0, sample_us);
        let Some(offset) = Offset::of(data.timestamp.0, sample_us) else { return Ok(()) };
        let expected =
            format!("key frames within a second of their sample ({} at {sample_us})", data.sample_token);
        let found = format!("sample_data {} of {channel} at {}, {offset}", data.token, data.timestamp.0);
        Err(FileError::content(expected, found, &self.data.path).into())
    }

    /// Creates the error of a scene without sensor data: what keeps them from being read, as far as known.
    pub(super) fn no_key_frames(&self, first: Option<&Gap>) -> FileError {
        let used = self.data.records.iter().filter_map(|data| self.sensor_of(data).ok());
        let used: Vec<&Sensor> = used.map(|(sensor, _)| sensor).collect();
        if let Some(sensor) = used.first()
            && used.iter().all(|sensor| sensor.kind() == SensorKind::Other)
        {
            let found = format!("{:?} of {}", sensor.modality, sensor.channel);
            return FileError::content("sensors of modality camera or lidar", found, &self.sensors.path);
        }
        let found = first.map_or_else(|| "none".to_owned(), |gap| format!("none ({gap})"));
        FileError::content("key frames of the samples of the scene", found, &self.data.path)
    }
}

/// Compares the time of the ego pose of sensor data, if it has one.
pub(super) fn compare_pose(data: &SampleData, sensor: &Sensor, pose: &EgoPose, times: &mut PoseTimes) {
    let t_us = pose.timestamp.as_ref().and_then(|t_us| TimeUs::deserialize(t_us).ok());
    if let Some(TimeUs(t_us)) = t_us {
        times.compare(t_us, data.timestamp.0, || [sensor.channel.clone(), data.ego_pose_token.clone()]);
    }
}

/// Creates the gap of sensor data whose record in a table is missing.
fn missing<R: Record>(data: &SampleData, table: &Table<R>, token: &str) -> Gap {
    Gap::dangling(DANGLING_DATA, &format!("sample_data {}", data.token), R::TABLE, token, &table.path)
}
