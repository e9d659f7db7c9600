//! Writes data sets with nuScenes' tables, and what the reader reads of them, for
//! `tests/peers/table_sets.py`.

use std::path::Path;

use glam::DVec3;
use point_skeleton::dataset::{LogLocator, LogReader, SweepRecord, open};
use pskel_testing::table_sets::{write_lyft, write_t4, write_truckscenes};
use serde_json::{Value, json};

/// A data set, and the function that writes it.
type DataSet = (&'static str, fn(&Path));

const DATA_SETS: [DataSet; 3] = [("truckscenes", write_truckscenes), ("t4", write_t4), ("lyft", write_lyft)];

fn main() {
    let out = std::env::args().nth(1).expect("usage: table_sets OUT");
    for (name, write) in DATA_SETS {
        let folder = Path::new(&out).join(name);
        write(&folder);
        let locator: LogLocator = folder.to_str().expect("a path of text").parse().expect("a data set");
        let read = summary(&*open(&locator).expect("a log"));
        std::fs::write(folder.with_extension("json"), read.to_string()).expect("a file");
    }
}

/// Returns the key frames of LiDARs by time and number of points, the places of cameras, and the boxes.
fn summary(reader: &dyn LogReader) -> Value {
    let log = reader.recording();
    let frames = || log.frames.iter();
    let sweeps = frames().flat_map(|frame| frame.sweeps.iter().filter(|sweep| sweep.is_key));
    let images = frames().flat_map(|frame| &frame.images).map(|image| {
        let place = (image.global_from_ego * image.ego_from_camera).translation;
        json!([log.cameras[image.channel].to_string(), image.t_us, place.to_array()])
    });
    let boxes = frames().flat_map(|frame| &frame.boxes).map(|item| {
        json!([
            log.tracks[item.track].category,
            item.cuboid.pose.translation.to_array(),
            item.cuboid.size.to_array()
        ])
    });
    json!({
        "sweeps": sweeps.map(|record| sweep(reader, record)).collect::<Vec<_>>(),
        "images": images.collect::<Vec<_>>(),
        "boxes": boxes.collect::<Vec<_>>(),
    })
}

/// Returns the time of a sweep, its number of points, and their mean, global.
fn sweep(reader: &dyn LogReader, record: &SweepRecord) -> Value {
    let points = reader.read_sweep(record).expect("a sweep").points;
    let global = record.global_from_ego * record.ego_from_lidar;
    let at = |p: [f32; 3]| global.transform_point(DVec3::from(p.map(f64::from)));
    let sum: DVec3 = points.iter().map(|point| at(point.position)).sum();
    json!([record.t_us, points.len(), (sum / points.len() as f64).to_array()])
}
