//! LiDAR sweeps beside the maps.

use std::path::Path;

use clap::Args;
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::lidar::{LidarFormat, LidarSpec};
use point_skeleton::sequence::LidarOutput;

use super::names::names;
#[cfg(feature = "network")]
use crate::WrongUsage;

/// Options of LiDAR sweeps.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "LiDAR")]
pub(crate) struct LidarArgs {
    /// Also write LiDAR sweeps: hdl-32e, vlp-32c, pandar64, pandar128, at128, av2, nuplan, or a JSON file of
    /// devices (name.json). Points are in the ego frame at the time of the frame or step; intensity is 0,
    /// since skeletons do not keep it
    #[arg(long, value_name = "SPEC", value_parser = spec)]
    lidar: Option<String>,
    /// Points of a sweep: lidar.pcd.bin as nuScenes, or lidar.pcd or lidar.npy, also with device, class,
    /// actor and time
    #[arg(long, value_parser = names::<LidarFormat>(), default_value = "bin", requires = "lidar")]
    lidar_format: LidarFormat,
}

/// Argument parser for a preset or a file: checks the name of a preset; files are read later.
pub(crate) fn spec(text: &str) -> Result<String, String> {
    if !is_file(text) {
        LidarSpec::named(text).map_err(|error| error.to_string())?;
    }
    Ok(text.to_owned())
}

/// Iterates over the file that a spec is in, if it is in one.
pub(crate) fn file(spec: Option<&str>) -> impl Iterator<Item = &Path> {
    spec.filter(|text| is_file(text)).map(Path::new).into_iter()
}

fn is_file(text: &str) -> bool {
    Path::new(text).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"))
}

impl LidarArgs {
    /// Returns the file that is read.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        file(self.lidar.as_deref())
    }

    /// Checks that sweeps can replace those in a copy of a nuScenes data set.
    #[cfg(feature = "network")]
    pub(crate) fn check_copy(&self) -> Result<(), WrongUsage> {
        if self.lidar.is_none() || self.lidar_format == LidarFormat::Bin {
            return Ok(());
        }
        let found = self.lidar_format.name();
        Err(WrongUsage(format!("expected --lidar-format bin with a copy of the data set, found {found}")))
    }

    /// Returns the sweeps to write; `None` for maps alone. Devices without a mount are where the log's LiDAR
    /// is.
    ///
    /// # Errors
    /// Fails if a file is invalid, or if a device has no mount and the log no sweeps.
    pub(crate) fn output(&self, log: &Recording) -> Result<Option<LidarOutput>, FileError> {
        let spec = self.lidar.as_deref().map(|text| mounted(text, log)).transpose()?;
        Ok(spec.map(|spec| LidarOutput { spec, format: self.lidar_format }))
    }

    /// Returns the sweeps to write with devices as they are described, for any log.
    ///
    /// # Errors
    /// Fails if a file is invalid.
    #[cfg(feature = "network")]
    pub(crate) fn unmounted(&self) -> Result<Option<LidarOutput>, FileError> {
        let spec = self.lidar.as_deref().map(LidarSpec::named).transpose()?;
        Ok(spec.map(|spec| LidarOutput { spec, format: self.lidar_format }))
    }
}

/// Returns a preset, or the spec of a file. Devices without a mount are where the log's LiDAR is.
///
/// # Errors
/// Fails if a file is invalid, or if a device has no mount and the log no sweeps.
pub(crate) fn mounted(text: &str, log: &Recording) -> Result<LidarSpec, FileError> {
    let spec = LidarSpec::named(text)?;
    let is_mounted = spec.devices.iter().all(|device| device.ego_from_lidar.is_some());
    match log.lidar_position_m() {
        Some(at) => Ok(spec.mounted_at(at)),
        None if is_mounted => Ok(spec),
        None => {
            let expected = "ego_from_lidar of each device, or a log with sweeps";
            Err(FileError::content(expected, "neither", Path::new(text)))
        }
    }
}
