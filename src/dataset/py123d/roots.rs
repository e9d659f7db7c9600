//! Folders that paths in tables refer to: they are relative to a folder that is not named in the log.

use std::path::PathBuf;

use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::input::DataRoot;

/// Environment variables of py123d by data set, each with the folder below it, in the order in which they are
/// looked up.
const VARIABLES: [(&str, &[(&str, &str)]); 9] = [
    ("nuscenes", &[("NUSCENES_DATA_ROOT", "")]),
    ("nuplan", &[("NUPLAN_SENSOR_ROOT", ""), ("NUPLAN_DATA_ROOT", "nuplan-v1.1/sensor_blobs")]),
    ("av2-sensor", &[("AV2_DATA_ROOT", "sensor")]),
    ("pandaset", &[("PANDASET_DATA_ROOT", "")]),
    ("kitti360", &[("KITTI360_DATA_ROOT", "")]),
    ("wod-perception", &[("WOD_PERCEPTION_DATA_ROOT", "")]),
    ("nureasoning", &[("NUREASONING_DATA_ROOT", "")]),
    ("griffin", &[("GRIFFIN_DATA_ROOT", "")]),
    ("truckdrive", &[("TRUCKDRIVE_DATA_ROOT", "")]),
];

/// Returns the folder of the files that a log of a data set refers to: the given one, or that of an
/// environment variable. `table` is a table with paths, for messages.
///
/// # Errors
/// Fails if neither is given.
pub(super) fn sensors(
    locator: &LogLocator,
    dataset: &str,
    table: &std::path::Path,
) -> Result<DataRoot, DatasetError> {
    let allow_outside = locator.allow_outside;
    if let Some(path) = &locator.sensor_root {
        return Ok(DataRoot { path: path.clone(), allow_outside });
    }
    let dataset = dataset.replace('_', "-");
    let known = VARIABLES.iter().find(|(name, _)| *name == dataset).map_or(&[][..], |(_, known)| *known);
    for (variable, below) in known {
        if let Some(root) = std::env::var_os(variable).filter(|root| !root.is_empty()) {
            return Ok(DataRoot { path: PathBuf::from(root).join(below), allow_outside });
        }
    }
    let names: Vec<&str> = known.iter().map(|(variable, _)| *variable).collect();
    let or =
        if names.is_empty() { String::new() } else { format!(" or the variable {}", names.join(" or ")) };
    let expected = format!("--sensor-root{or}: the folder of the files that the table names");
    Err(FileError::content(expected, "neither", table).into())
}
