//! The map: two lanes in a row, of which the second crosses an intersection, with their groups; a drivable
//! area, a crosswalk and a road line.

use std::sync::Arc;

use arrow_array::Int8Array;
use serde_json::json;

use super::START;
use super::pack::{Pack, packed};
use super::table::{Table, binaries, integers};

pub(super) fn table() -> Table {
    let rectangle = |x: f64, length: f64| {
        polygon(&[[x, -2.0, 0.0], [x + length, -2.0, 0.0], [x + length, 2.0, 0.0], [x, 2.0, 0.0]].map(at))
    };
    let lane = |group: i64, x: f64, successors: &[i64]| {
        Pack::map(&[
            ("lane_type", Pack::Int(2)),
            ("lane_group_id", Pack::Int(group)),
            ("centerline", Pack::points(&[[x, 0.0, 0.0], [x + 20.0, 0.0, 0.0]].map(at))),
            ("successor_ids", Pack::ints(successors)),
            ("speed_limit_mps", Pack::Float(13.5)),
        ])
    };
    let group = |intersection: Pack| Pack::map(&[("intersection_id", intersection)]);
    let none = || Pack::Map(Vec::new());
    let objects = [
        (11, 0, lane(21, 0.0, &[12]), rectangle(0.0, 20.0)),
        (12, 0, lane(22, 20.0, &[]), rectangle(20.0, 20.0)),
        (21, 1, group(Pack::Nil), rectangle(0.0, 20.0)),
        (22, 1, group(Pack::Int(31)), rectangle(20.0, 20.0)),
        (31, 2, none(), rectangle(20.0, 20.0)),
        (41, 3, none(), rectangle(18.0, 3.0)),
        (51, 6, none(), rectangle(-5.0, 50.0)),
        (61, 9, none(), line(&[[0.0, 2.0, 0.0], [20.0, 2.0, 0.0]].map(at))),
    ];
    let features: Vec<Vec<u8>> = objects.iter().map(|object| packed(&object.2)).collect();
    let columns = vec![
        ("object_id", integers(objects.iter().map(|object| object.0))),
        ("map_layer", Arc::new(Int8Array::from_iter_values(objects.iter().map(|object| object.1))) as _),
        ("features", binaries(features.iter().map(Vec::as_slice))),
        ("wkb", binaries(objects.iter().map(|object| object.3.as_slice()))),
    ];
    let about =
        json!({"dataset": "nuscenes", "location": "nowhere", "map_has_z": true, "map_is_per_log": true});
    Table::new("", columns, &about)
}

/// Returns a place in the coordinates of the map.
fn at([x, y, z]: [f64; 3]) -> [f64; 3] {
    [START.x + x, START.y + y, START.z + z]
}

/// Returns a polygon with z in extended well-known binary, little-endian.
pub fn polygon(corners: &[[f64; 3]]) -> Vec<u8> {
    let closed = [corners, &corners[..1]].concat();
    let head = [&[1][..], &0x8000_0003_u32.to_le_bytes(), &1_u32.to_le_bytes()].concat();
    [head, points(&closed)].concat()
}

/// Returns a line with z in extended well-known binary, little-endian.
pub fn line(corners: &[[f64; 3]]) -> Vec<u8> {
    [[&[1][..], &0x8000_0002_u32.to_le_bytes()].concat(), points(corners)].concat()
}

fn points(points: &[[f64; 3]]) -> Vec<u8> {
    let numbers = points.as_flattened().iter().flat_map(|number| number.to_le_bytes());
    (points.len() as u32).to_le_bytes().into_iter().chain(numbers).collect()
}
