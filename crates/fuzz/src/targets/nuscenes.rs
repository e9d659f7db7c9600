//! nuScenes: tables and map expansion.

use std::cell::RefCell;

use point_skeleton::dataset::nuscenes::{LogWriter, MapLayers, NuScenes, expand, read_map_file, write_log};
use point_skeleton::dataset::{
    DatasetError, ImageRecord, LogLocator, LogReader, Recording, Sweep, SweepRecord, VectorMap,
};
use serde_json::{Map, Value};

use super::{LARGE, Scratch, edited, seed};
use crate::check::{assert_names_file, assert_names_file_in, check_map, dataset};
use crate::edits::json_file;
use crate::folder::Folder;
use crate::synthetic_log::{self, SyntheticLog};
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 3] = [
    Target { name: "nuscenes_table", run: table, seeds: table_seeds, max_len: 8192, memory: LARGE },
    Target { name: "nuscenes_edits", run: edits, seeds: edit_seeds, max_len: 256, memory: LARGE },
    Target { name: "nuscenes_map", run: map, seeds: map_seeds, max_len: 16_384, memory: LARGE },
];

const TABLES: [&str; 13] = [
    "scene",
    "sample",
    "sample_data",
    "ego_pose",
    "calibrated_sensor",
    "sensor",
    "instance",
    "sample_annotation",
    "category",
    "attribute",
    "visibility",
    "log",
    "map",
];

thread_local! {
    static DATA_SET: RefCell<(Folder, Value)> = RefCell::new(data_set());
    static MAP: RefCell<(Scratch, Value, SyntheticLog)> =
        RefCell::new((Scratch::new(), map_json(), SyntheticLog::new(3)));
}

fn file(table: &str) -> String {
    format!("v1.0-mini/{table}.json")
}

/// Returns the data set, and its tables in one object.
fn data_set() -> (Folder, Value) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_log(folder.path(), "v1.0-mini", &SyntheticLog::new(2)).expect("a data set");
    let folder = Folder::copy_of(folder.path());
    let table = |name: &str| serde_json::from_slice(folder.base(&file(name))).expect("JSON");
    let tables: Map<String, Value> = TABLES.iter().map(|name| ((*name).to_owned(), table(name))).collect();
    (folder, tables.into())
}

fn open(folder: &Folder, data: &[u8]) {
    let locator = LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, folder.root());
    match NuScenes::open(&locator) {
        Ok(set) => dataset(&set, folder.root(), data),
        Err(error) => assert_names_file_in(error, folder.root(), data),
    }
    if let Err(error) = expand(&LogLocator { scene: Some("*".into()), ..locator }) {
        assert_names_file_in(error, folder.root(), data);
    }
}

/// Replaces the table selected by the first byte with the remaining bytes.
fn table(data: &[u8]) {
    DATA_SET.with_borrow_mut(|(folder, _)| {
        let (number, bytes) = data.split_first().unwrap_or((&0, &[]));
        folder.put(&file(TABLES[usize::from(*number) % TABLES.len()]), bytes);
        open(folder, data);
        folder.reset();
    });
}

fn table_seeds() -> Vec<Seed> {
    let (folder, _) = data_set();
    let with =
        |(number, name): (usize, &&str)| seed(name, [&[number as u8], folder.base(&file(name))].concat());
    TABLES.iter().enumerate().map(with).collect()
}

/// Edits values of all tables.
fn edits(data: &[u8]) {
    DATA_SET.with_borrow_mut(|(folder, tables)| {
        let edited = edited(tables, data);
        for name in TABLES.iter().filter(|name| edited.get(**name) != tables.get(**name)) {
            folder.put(&file(name), edited.get(*name).unwrap_or(&Value::Null).to_string().as_bytes());
        }
        open(folder, data);
        folder.reset();
    });
}

fn edit_seeds() -> Vec<Seed> {
    super::edit_seeds()
}

fn map(data: &[u8]) {
    MAP.with_borrow_mut(|(scratch, base, synthetic)| {
        let path = scratch.put("nowhere.json", &json_file(data, base));
        match read_map_file(&path, "nowhere") {
            Ok(map) => check_map(&map, synthetic.recording()),
            Err(error) => assert_names_file(error, &path, data),
        }
    });
}

/// The synthetic log, with a map.
struct Mapped(SyntheticLog);

impl LogReader for Mapped {
    fn recording(&self) -> &Recording {
        self.0.recording()
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        self.0.read_sweep(record)
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        self.0.read_image(record)
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        Ok(Some(synthetic_log::map()))
    }
}

fn map_json() -> Value {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let layers = MapLayers::default();
    let writer = LogWriter { version: "v1.0-mini", map: Some(&layers), frame_done: &|_| () };
    writer.write(folder.path(), &Mapped(SyntheticLog::new(1))).expect("a data set");
    let text = std::fs::read(folder.path().join("maps/expansion/nowhere.json")).expect("a map");
    serde_json::from_slice(&text).expect("JSON")
}

fn map_seeds() -> Vec<Seed> {
    let mut seeds = super::edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", map_json().to_string().into_bytes()));
    seeds
}
