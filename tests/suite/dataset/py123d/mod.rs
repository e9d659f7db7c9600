//! Logs of py123d: real ones, written by its own parsers, against what its own API reads; synthetic ones with
//! damage.

mod damage;
mod damaged_cells;
mod damaged_map;
mod damaged_values;
mod expected;
mod other_readers;
mod selection;
mod written;

use std::path::{Path, PathBuf};

use point_skeleton::dataset::{LogLocator, LogReader, open, py123d};
use pskel_testing::shared::shared;

/// Returns the folders of the recorded logs.
fn recorded() -> Option<Vec<PathBuf>> {
    let folder = shared("the logs of py123d")?.join("data/123d");
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut folders: Vec<PathBuf> = entries.filter(|path| path.join("expected.json").is_file()).collect();
    folders.sort();
    Some(folders)
}

/// Returns the locator of a recorded log.
fn locator(folder: &Path, dataset: &str) -> LogLocator {
    let own = folder.join("root");
    let recordings = folder.parent().unwrap().with_file_name("pandaset-002");
    let sensor_root = match dataset {
        _ if own.is_dir() => own,
        "nuscenes" => recordings.join("nuscenes"),
        _ => recordings.join("nuplan/nuplan-v1.1/sensor_blobs"),
    };
    LogLocator { sensor_root: Some(sensor_root), ..LogLocator::new(&py123d::FORMAT, folder) }
}

fn open_recorded(name: &str, dataset: &str) -> Option<Box<dyn LogReader>> {
    let folder = shared("the logs of py123d")?.join("data/123d").join(name);
    Some(open(&locator(&folder, dataset)).unwrap())
}
