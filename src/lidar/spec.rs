//! Description of a LiDAR: beams, columns, range, mounting, timing and losses, as a preset or a JSON file.

use std::path::Path;

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::motion::Motion;
use super::rays::LidarRays;
use crate::error::FileError;
use crate::files::json;
use crate::geometry::Pose;

/// Maximum absolute elevation of a beam, degrees.
pub const MAX_ELEVATION_DEG: f64 = 75.0;
/// Maximum number of rays in a sweep.
pub const MAX_RAYS: usize = 1 << 24;
/// Maximum number of devices.
const MAX_DEVICES: usize = 16;
/// Limits of ranges, meters.
const RANGES_M: [f64; 2] = [0.1, 1000.0];
/// Maximum duration of a sweep, seconds.
const MAX_SWEEP_S: f64 = 10.0;
/// Time in which columns count as firing at once, seconds: a device at 20 m/s moves by less than a millimeter
/// from the middle of that time to one of its columns. Rays that fire at once are cast together, which is
/// faster, up to a number of columns.
const AT_ONCE_S: f64 = 120e-6;
const MAX_AT_ONCE: usize = 4;

/// A LiDAR: one device, or several whose returns are merged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LidarSpec {
    /// Devices, at least one.
    pub devices: Vec<LidarDevice>,
    /// Seed of the losses.
    #[serde(default)]
    pub seed: u64,
}

/// A device that scans columns of beams, one after the other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LidarDevice {
    /// Name, for messages and files.
    pub name: String,
    /// Elevations of the beams above the horizontal plane of the device, degrees.
    pub elevations_deg: Vec<f64>,
    /// Azimuth of each beam relative to its column, degrees to the left; empty for 0.
    #[serde(default)]
    pub azimuth_offsets_deg: Vec<f64>,
    /// Number of columns.
    pub columns: usize,
    /// Azimuths at which the first column begins and the last one ends, degrees to the left of forward. The
    /// second is less than the first for a device that turns clockwise, seen from above.
    #[serde(default = "full_turn")]
    pub azimuth_deg: [f64; 2],
    /// Least and greatest range of a return, meters.
    pub range_m: [f64; 2],
    /// Where the device is mounted: x forward, y left, z up. `None` for the position of the log's LiDAR.
    #[serde(default)]
    pub ego_from_lidar: Option<Mount>,
    /// Duration of a sweep, seconds; 0 if all columns fire at once.
    #[serde(default)]
    pub sweep_s: f64,
    /// Part of the sweep that has passed at its time stamp, 0 to 1.
    #[serde(default = "one")]
    pub stamp: f64,
    /// Share of the returns that is lost, 0 to 1.
    #[serde(default)]
    pub dropout: f64,
}

/// Position and orientation on the ego.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// Meters, ego frame.
    pub translation: [f64; 3],
    /// Unit quaternion `w x y z`.
    #[serde(default = "level")]
    pub rotation: [f64; 4],
}

fn full_turn() -> [f64; 2] {
    [180.0, -180.0]
}

fn one() -> f64 {
    1.0
}

fn level() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl Mount {
    /// Creates a level mount that looks forward, at a position in meters.
    pub const fn level(translation: [f64; 3]) -> Self {
        Self { translation, rotation: [1.0, 0.0, 0.0, 0.0] }
    }

    /// Returns the pose; `None` if the numbers are none.
    fn pose(&self) -> Option<Pose> {
        Pose::from_wxyz(self.rotation, self.translation).ok()
    }
}

impl LidarSpec {
    /// Reads a JSON file: `{"devices": [{"name", "elevations_deg", "columns", "range_m", ..}], "seed"}`.
    ///
    /// # Errors
    /// Fails if the file cannot be read, has other fields, or a value is out of range.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let expected = r#"{"devices": [{"name", "elevations_deg", "columns", "range_m"}]}"#;
        let spec: Self = json::read(path, expected)?;
        match spec.fault() {
            Some((expected, found)) => Err(FileError::content(expected, found, path)),
            None => Ok(spec),
        }
    }

    /// Returns the first value that is out of range: what was expected, and what was found.
    pub fn fault(&self) -> Option<(String, String)> {
        let count = self.devices.len();
        if !(1..=MAX_DEVICES).contains(&count) {
            return Some((format!("1 to {MAX_DEVICES} LiDAR devices"), count.to_string()));
        }
        let rays: usize = self.devices.iter().map(LidarDevice::rays).fold(0, usize::saturating_add);
        if rays > MAX_RAYS {
            return Some((format!("at most {MAX_RAYS} rays in a sweep"), rays.to_string()));
        }
        let faults = self.devices.iter().find_map(LidarDevice::fault);
        faults.map(|(expected, found, name)| (expected, format!("{found} in LiDAR device {name:?}")))
    }

    /// Returns the number of beams, summed over the devices.
    pub fn beams(&self) -> usize {
        self.devices.iter().map(|device| device.elevations_deg.len()).sum()
    }

    /// Returns the duration of the longest sweep of a device, seconds.
    pub fn duration_s(&self) -> f64 {
        self.devices.iter().fold(0.0, |most, device| device.sweep_s.max(most))
    }

    /// Returns the spec with devices without a mount at a position, meters in the ego frame.
    #[must_use]
    pub fn mounted_at(mut self, position_m: DVec3) -> Self {
        let mount = Mount::level(position_m.to_array());
        self.devices
            .iter_mut()
            .for_each(|device| device.ego_from_lidar = device.ego_from_lidar.or(Some(mount)));
        self
    }
}

impl LidarDevice {
    /// Returns the number of rays in a sweep.
    pub fn rays(&self) -> usize {
        self.columns.saturating_mul(self.elevations_deg.len())
    }

    /// Returns the pose on the ego; devices without a mount are at its origin.
    pub fn ego_from_lidar(&self) -> Pose {
        self.ego_from_lidar.and_then(|mount| mount.pose()).unwrap_or(Pose::IDENTITY)
    }

    /// Returns the azimuth of a column's middle, radians to the left of forward.
    pub fn azimuth_rad(&self, column: usize) -> f64 {
        let [first, end] = self.azimuth_deg;
        (first + (end - first) * (column as f64 + 0.5) / self.columns as f64).to_radians()
    }

    /// Returns how many columns fire at once.
    pub fn columns_at_once(&self) -> usize {
        let column_s = self.sweep_s / self.columns as f64;
        ((AT_ONCE_S / column_s) as usize).clamp(1, MAX_AT_ONCE)
    }

    /// Returns when a column fires after the time stamp, seconds: in the middle of those that fire at once.
    pub fn offset_s(&self, column: usize) -> f64 {
        let at_once = self.columns_at_once();
        let first = column - column % at_once;
        let end = (first + at_once).min(self.columns);
        self.sweep_s * ((first + end) as f64 / 2.0 / self.columns as f64 - self.stamp)
    }

    /// Returns the unit direction of a beam in a column, in the device's frame.
    pub fn direction(&self, beam: usize, column: usize) -> DVec3 {
        DMat3::from_rotation_z(self.azimuth_rad(column)) * self.beam(beam)
    }

    /// Returns the unit direction of a beam in a column that is directed forward.
    fn beam(&self, beam: usize) -> DVec3 {
        let (up, across) = self.elevations_deg[beam].to_radians().sin_cos();
        let offset_deg = self.azimuth_offsets_deg.get(beam).copied().unwrap_or(0.0);
        let (left, forward) = offset_deg.to_radians().sin_cos();
        DVec3::new(across * forward, across * left, up)
    }

    /// Returns the pose in the global frame at the time of a column.
    pub fn pose(&self, motion: &Motion<'_>, column: usize) -> Pose {
        motion.ego(self.offset_s(column)) * self.ego_from_lidar()
    }

    /// Returns the rays of a sweep while the ego moves: of all columns that fire at once, column by column.
    pub fn sweep_rays(&self, motion: &Motion<'_>) -> Vec<LidarRays> {
        let beams: Vec<DVec3> = (0..self.elevations_deg.len()).map(|beam| self.beam(beam)).collect();
        let at_once = self.columns_at_once();
        let rays = |first: usize| {
            let Pose { rotation, translation } = self.pose(motion, first);
            let turn = |column| DMat3::from_quat(rotation) * DMat3::from_rotation_z(self.azimuth_rad(column));
            let columns = first..(first + at_once).min(self.columns);
            let directions = columns.map(turn).flat_map(|turn| beams.iter().map(move |beam| turn * *beam));
            LidarRays { after_s: self.offset_s(first), origin: translation, directions: directions.collect() }
        };
        (0..self.columns).into_par_iter().step_by(at_once).map(rays).collect()
    }

    fn fault(&self) -> Option<(String, String, String)> {
        let wrong = |expected: &str, found: String| Some((expected.to_owned(), found, self.name.clone()));
        let elevations = &self.elevations_deg;
        if elevations.is_empty() || self.columns == 0 {
            return wrong(
                "at least one beam and one column",
                format!("{}x{}", elevations.len(), self.columns),
            );
        }
        if elevations.len() > usize::from(u16::MAX) {
            return wrong("at most 65535 beams", elevations.len().to_string());
        }
        let is_elevation = |deg: &&f64| !(-MAX_ELEVATION_DEG..=MAX_ELEVATION_DEG).contains(*deg);
        if let Some(deg) = elevations.iter().find(is_elevation) {
            return wrong(&format!("elevations within ±{MAX_ELEVATION_DEG} degrees"), deg.to_string());
        }
        let offsets = &self.azimuth_offsets_deg;
        if !offsets.is_empty() && offsets.len() != elevations.len() {
            return wrong(
                &format!("azimuth_offsets_deg of {} beams", elevations.len()),
                offsets.len().to_string(),
            );
        }
        if let Some(deg) = offsets.iter().find(|deg| !(-45.0..=45.0).contains(*deg)) {
            return wrong("azimuth_offsets_deg within ±45", deg.to_string());
        }
        let [first, end] = self.azimuth_deg;
        let turn = (end - first).abs();
        if !(turn > 0.0 && turn <= 360.0 && first.abs() <= 720.0) {
            return wrong(
                "azimuth_deg of more than 0 and at most one turn",
                format!("{:?}", self.azimuth_deg),
            );
        }
        let [near, far] = self.range_m;
        if !(near >= RANGES_M[0] && near < far && far <= RANGES_M[1]) {
            return wrong("a rising range_m within 0.1 to 1000 m", format!("{:?}", self.range_m));
        }
        if self.ego_from_lidar.is_some_and(|mount| mount.pose().is_none()) {
            return wrong(
                "ego_from_lidar with a position and a unit quaternion",
                format!("{:?}", self.ego_from_lidar),
            );
        }
        if !(0.0..=MAX_SWEEP_S).contains(&self.sweep_s) {
            return wrong("sweep_s of 0 to 10", self.sweep_s.to_string());
        }
        let share = |value: f64| !(0.0..=1.0).contains(&value);
        if share(self.stamp) || share(self.dropout) {
            return wrong("stamp and dropout of 0 to 1", format!("{} and {}", self.stamp, self.dropout));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneState;
    use std::f64::consts::PI;

    fn device() -> LidarDevice {
        LidarDevice {
            name: "top".into(),
            elevations_deg: vec![-30.0, 0.0],
            azimuth_offsets_deg: Vec::new(),
            columns: 4,
            azimuth_deg: full_turn(),
            range_m: [1.0, 50.0],
            ego_from_lidar: None,
            sweep_s: 0.1,
            stamp: 1.0,
            dropout: 0.0,
        }
    }

    /// Four columns clockwise from behind: their middles are at 135, 45, −45 and −135 degrees.
    #[test]
    fn columns_have_azimuths_and_times() {
        let mut device = device();
        let azimuths = [0, 1, 2, 3].map(|column| device.azimuth_rad(column) / PI * 4.0);
        let times = [0, 1, 2, 3].map(|column| device.offset_s(column));
        for (found, expected) in azimuths.iter().zip([3.0, 1.0, -1.0, -3.0]) {
            assert!((found - expected).abs() < 1e-12, "{azimuths:?}");
        }
        for (found, expected) in times.iter().zip([-0.0875, -0.0625, -0.0375, -0.0125]) {
            assert!((found - expected).abs() < 1e-12, "{times:?}");
        }
        let (root, half) = (0.5_f64.sqrt(), 3.0_f64.sqrt() / 2.0);
        assert!(device.direction(0, 1).distance(DVec3::new(half * root, half * root, -0.5)) < 1e-12);
        device.azimuth_offsets_deg = vec![0.0, 45.0];
        assert!(device.direction(1, 1).distance(DVec3::Y) < 1e-12);
    }

    /// 5 columns of 50 µs: two fire at once, and the last one alone.
    #[test]
    fn short_columns_fire_at_once() {
        let device = LidarDevice { columns: 5, sweep_s: 250e-6, ..device() };
        let times = [0, 1, 2, 3, 4].map(|column| device.offset_s(column) * 1e6);
        for (found, expected) in times.iter().zip([-200.0, -200.0, -100.0, -100.0, -25.0]) {
            assert!((found - expected).abs() < 1e-9, "{times:?}");
        }
        let at_once = |columns: usize, sweep_s: f64| {
            LidarDevice { columns, sweep_s, ..device.clone() }.columns_at_once()
        };
        assert_eq!(
            [
                at_once(1800, 0.1),
                at_once(360, 0.1),
                at_once(3600, 0.1),
                at_once(100_000, 0.1),
                at_once(9, 0.0)
            ],
            [2, 1, 4, 4, 4]
        );
        let (name, global_from_ego) = ("0".to_owned(), Pose::IDENTITY);
        let state =
            SceneState { name, t_us: 0, global_from_ego, cameras: Vec::new(), actors: Vec::new(), map: None };
        let rays = device.sweep_rays(&Motion::new(&state, None));
        let directions: Vec<DVec3> = rays.iter().flat_map(|rays| rays.directions.clone()).collect();
        let expected: Vec<DVec3> = (0..10).map(|ray| device.direction(ray % 2, ray / 2)).collect();
        assert!(directions.iter().zip(&expected).all(|(a, b)| a.distance(*b) < 1e-12), "{directions:?}");
        assert_eq!(rays.iter().map(|rays| rays.directions.len()).collect::<Vec<_>>(), [4, 4, 2]);
    }

    #[test]
    fn files_are_read_and_checked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lidar.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            LidarSpec::read(&path).map_err(|error| error.to_string())
        };
        let text = r#"{"devices": [{"name": "top", "elevations_deg": [-30, 0], "columns": 4,
            "range_m": [1, 50], "sweep_s": 0.1}]}"#;
        assert_eq!(read(text), Ok(LidarSpec { devices: vec![device()], seed: 0 }));
        let spec = LidarSpec { devices: vec![device()], seed: 3 }.mounted_at(DVec3::new(1.0, 0.0, 2.0));
        assert_eq!(read(&serde_json::to_string(&spec).unwrap()), Ok(spec));
        for (from, to, expected) in [
            ("[-30, 0]", "[]", "at least one beam"),
            ("[-30, 0]", "[-76, 0]", "elevations within ±75 degrees, found -76"),
            (": 4", ": 0", "one column"),
            (": 4", ": 40000000", "at most 16777216 rays"),
            ("[1, 50]", "[50, 1]", "a rising range_m"),
            ("[1, 50]", "[0, 1]", "a rising range_m"),
            ("\"sweep_s\": 0.1", "\"sweep_s\": -1", "sweep_s of 0 to 10, found -1"),
            ("\"sweep_s\": 0.1", "\"dropout\": 1.5", "dropout of 0 to 1"),
            ("\"sweep_s\": 0.1", "\"azimuth_deg\": [0, 400]", "at most one turn"),
            ("\"sweep_s\": 0.1", "\"azimuth_offsets_deg\": [1]", "azimuth_offsets_deg of 2 beams, found 1"),
            (
                "\"sweep_s\": 0.1",
                "\"ego_from_lidar\": {\"translation\": [0,0,1], \"rotation\": [2,0,0,0]}",
                "unit",
            ),
            ("\"sweep_s\"", "\"spin\"", "spin"),
        ] {
            let message = read(&text.replace(from, to)).unwrap_err();
            assert!(message.contains(expected) && message.contains("lidar.json"), "{message}");
        }
        assert!(read(r#"{"devices": []}"#).unwrap_err().contains("1 to 16 LiDAR devices, found 0"));
    }
}
