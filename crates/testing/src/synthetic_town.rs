//! A short synthetic log that many tests share; it is generated and written once.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::LazyLock;

use point_skeleton::dataset::LogLocator;
use point_skeleton::dataset::nuscenes::{LogWriter, NuScenes};
use pskel_town::{Town, TownOptions};

use crate::tiny_log::{tree, write_tree};

pub const FRAMES: usize = 6;
pub const OPTIONS: TownOptions = TownOptions {
    seed: 3,
    frames: FRAMES,
    hz: 5.0,
    lidar_hz: 10.0,
    beams: 32,
    size: [90, 160],
    daylight: None,
};
/// Folder of the written tables.
pub const VERSION: &str = "v1.0-mini";

/// Returns the town in memory; meshes and device are created once.
pub fn town() -> &'static Town {
    static TOWN: LazyLock<Town> = LazyLock::new(|| Town::new(&OPTIONS).unwrap());
    &TOWN
}

/// Returns another town.
pub fn other_town(options: &str) -> Town {
    Town::new(&options.parse().unwrap()).unwrap()
}

/// The log written as a nuScenes data set with its map.
pub struct Written {
    pub files: BTreeMap<String, Vec<u8>>,
    /// Frame indices that the writer reported as done.
    pub done: Vec<usize>,
}

pub fn written() -> &'static Written {
    static WRITTEN: LazyLock<Written> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        let (layers, done) = (town().map_layers(), RefCell::new(Vec::new()));
        let frame_done = |index: usize| done.borrow_mut().push(index);
        let writer = LogWriter { version: VERSION, map: Some(&layers), frame_done: &frame_done };
        writer.write(folder.path(), town()).unwrap();
        Written { files: tree(folder.path()), done: done.take() }
    });
    &WRITTEN
}

/// Writes the files whose names are selected.
pub fn copy_to(folder: &Path, wanted: impl Fn(&str) -> bool) {
    write_tree(folder, written().files.iter().filter(|(name, _)| wanted(name)));
}

/// Writes all files to a folder and opens the log there.
pub fn read() -> (tempfile::TempDir, NuScenes) {
    let folder = tempfile::tempdir().unwrap();
    copy_to(folder.path(), |_| true);
    let log =
        NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, folder.path())).unwrap();
    (folder, log)
}
