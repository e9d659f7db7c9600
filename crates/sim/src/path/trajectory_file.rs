//! Waypoints with times, read from files.

use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::files::input::{read_file, utf8};
use point_skeleton::files::{json, write_json};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::trajectory::Waypoint;
use crate::LocalPathError;
use crate::time::seconds;

/// Maximum number of waypoints: more than a day at 10 Hz.
const MAX_WAYPOINTS: usize = 1_000_000;
/// Maximum file size, at an upper bound of bytes per waypoint; checked before reading.
const MAX_BYTES: u64 = 512 * MAX_WAYPOINTS as u64;
/// Maximum speed at and between waypoints, meters per second.
const MAX_SPEED_MPS: f64 = 100.0;

/// Waypoints of an ego in the global frame, with absolute times that strictly increase.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryFile {
    waypoints: Vec<Waypoint>,
}

#[derive(Serialize, Deserialize)]
struct Content<T> {
    waypoints: T,
}

impl TrajectoryFile {
    /// Validates waypoints.
    ///
    /// # Errors
    /// Fails if there are none or more than a million, if a value is not finite, if the times do not
    /// strictly increase, or if speeds at or between waypoints exceed 100 m/s.
    pub fn new(waypoints: Vec<Waypoint>) -> Result<Self, LocalPathError> {
        let wrong = |expected: &'static str, found: String| Err(LocalPathError::Points { expected, found });
        if waypoints.is_empty() || waypoints.len() > MAX_WAYPOINTS {
            return wrong("1 to 1000000 waypoints", waypoints.len().to_string());
        }
        let is_sound = |w: &Waypoint| {
            [w.x_m, w.y_m, w.heading_rad].iter().all(|n| n.is_finite()) && w.speed_mps.abs() <= MAX_SPEED_MPS
        };
        if let Some(i) = waypoints.iter().position(|w| !is_sound(w)) {
            let found = format!("{:?} at waypoint {i}", waypoints[i]);
            return wrong("finite numbers and speeds up to 100 m/s", found);
        }
        for (i, pair) in waypoints.windows(2).enumerate() {
            let (before, to) = (&pair[0], &pair[1]);
            if to.t_us <= before.t_us {
                return wrong("times that rise", format!("{} us at waypoint {}", to.t_us, i + 1));
            }
            let speed_mps = before.position_m().distance(to.position_m()) / seconds(before.t_us, to.t_us);
            if speed_mps > MAX_SPEED_MPS {
                let found = format!("a jump at {speed_mps:.0} m/s to waypoint {}", i + 1);
                return wrong("waypoints at most 100 m/s apart", found);
            }
        }
        Ok(Self { waypoints })
    }

    /// Reads waypoints from a JSON file, `{"waypoints": [{"t_us", "x_m", "y_m", "heading_rad", "speed_mps"},
    /// ..]}`.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has another format. Returns any error of [`TrajectoryFile::new`].
    pub fn read(path: &Path) -> Result<Self, LocalPathError> {
        Self::parse(&read_file(path, MAX_BYTES)?, path)
    }

    /// Parses the content of a file as [`TrajectoryFile::read`] does.
    pub(crate) fn parse(bytes: &[u8], path: &Path) -> Result<Self, LocalPathError> {
        const EXPECTED: &str =
            "{\"waypoints\": [{\"t_us\", \"x_m\", \"y_m\", \"heading_rad\", \"speed_mps\"}, ..]}";
        if bytes.len() as u64 > MAX_BYTES {
            return Err(FileError::content("at most 512 MB", format!("{} bytes", bytes.len()), path).into());
        }
        let content: Content<Vec<Waypoint>> = json::parse(bytes, EXPECTED, path)?;
        Self::new(content.waypoints).map_err(|error| match error {
            LocalPathError::Points { expected, found } => FileError::content(expected, found, path).into(),
            error => error,
        })
    }

    /// Returns whether the content of a file is a JSON object with waypoints.
    pub(crate) fn is_in(bytes: &[u8], path: &Path) -> bool {
        let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
        let is_object = || utf8(bytes).is_ok_and(|text| text.trim_start().starts_with('{'));
        is_json && is_object() && json::parsed::<Content<IgnoredAny>>(bytes).is_ok()
    }

    /// Writes the waypoints to a JSON file that [`TrajectoryFile::read`] reads without loss.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        write_json(path, &Content { waypoints: &self.waypoints })
    }

    /// Returns the waypoints.
    pub fn waypoints(&self) -> &[Waypoint] {
        &self.waypoints
    }
}

impl Serialize for TrajectoryFile {
    /// Serializes the number of waypoints and a hash of them, which suffices to distinguish trajectories.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use std::hash::{Hash, Hasher};
        let mut hasher = rand_seeder::SipHasher::new();
        for w in &self.waypoints {
            let numbers = [w.x_m, w.y_m, w.heading_rad, w.speed_mps];
            (w.t_us, numbers.map(f64::to_bits)).hash(&mut hasher);
        }
        format!("{} waypoints {:016x}", self.waypoints.len(), hasher.finish()).serialize(serializer)
    }
}
