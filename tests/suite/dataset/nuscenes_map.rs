//! The map expansion of nuScenes: a synthetic map, broken maps, real maps.

use std::path::{Path, PathBuf};

use glam::DVec2;
use point_skeleton::dataset::nuscenes::{NuScenes, read_map_file};
use point_skeleton::dataset::{Area, LogLocator, LogReader, VectorMap};
use proptest::prelude::*;
use pskel_testing::shared::shared;
use pskel_testing::six_cameras::{VERSION, copy_to};
use serde_json::{Value, json};

/// Returns a 10 m square with a hole, a lane on it that ends in a connector, a crossing, a stop line and two
/// dividers.
fn synthetic_map() -> Value {
    let square = [("a", 0, 0), ("b", 10, 0), ("c", 10, 10), ("d", 0, 10)];
    let hole = [("e", 4, 4), ("f", 6, 4), ("g", 5, 6)];
    let nodes = square.iter().chain(&hole).map(|(token, x, y)| json!({"token": token, "x": x, "y": y}));
    let polygon =
        |token: &str, corners: &[&str]| json!({"token": token, "exterior_node_tokens": corners, "holes": []});
    let holed = json!({"token": "holed", "exterior_node_tokens": ["a", "b", "c", "d", "a"],
        "holes": [{"node_tokens": ["e", "f", "g"]}, {"node_tokens": []}]});
    let surface = |token: &str, polygon: &str| json!([{"token": token, "polygon_token": polygon}]);
    let path = json!([{"start_pose": [1, 1, 0], "end_pose": [3, 1, 0], "shape": "LSR", "radius": 999.999,
        "segment_length": [0, 2, 0]}]);
    json!({
        "version": "1.3", "canvas_edge": [20, 20], "walkway": [], "traffic_light": [],
        "node": nodes.collect::<Vec<_>>(),
        "polygon": [holed, polygon("half", &["a", "b", "c"]), polygon("other", &["a", "c", "d"])],
        "line": [{"token": "line", "node_tokens": ["a", "c"]}],
        "drivable_area": [{"token": "drive", "polygon_tokens": ["holed", "half"]}],
        "lane": surface("lane", "half"), "lane_connector": surface("connector", "other"),
        "ped_crossing": surface("cross", "other"), "stop_line": surface("stop", "half"),
        "road_divider": [{"token": "road", "line_token": "line"}],
        "lane_divider": [{"token": "lanes", "line_token": "line", "lane_divider_segments": []}],
        "arcline_path_3": {"lane": path},
        "connectivity": {"lane": {"incoming": [], "outgoing": ["connector", "beyond"]}},
    })
}

fn read(map: &Value) -> Result<VectorMap, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nowhere.json");
    std::fs::write(&path, map.to_string()).unwrap();
    let result = read_map_file(&path, "nowhere").map_err(|e| e.to_string());
    if let Err(message) = &result {
        assert!(message.ends_with(path.to_str().unwrap()), "{message}");
    }
    result
}

#[test]
fn reads_a_synthetic_map() {
    let map = read(&synthetic_map()).unwrap();
    let at = |x: f64, y: f64| DVec2::new(x, y);
    let half = Area { exterior: vec![at(0.0, 0.0), at(10.0, 0.0), at(10.0, 10.0)], holes: vec![] };
    let square = vec![at(0.0, 0.0), at(10.0, 0.0), at(10.0, 10.0), at(0.0, 10.0)];
    let hole = vec![at(4.0, 4.0), at(6.0, 4.0), at(5.0, 6.0)];
    assert_eq!(map.location, "nowhere");
    assert_eq!(map.drivable_area, [Area { exterior: square, holes: vec![hole] }, half.clone()]);
    let lane = &map.lanes[0];
    assert_eq!((map.lanes.len(), lane.id.as_str(), &lane.outline), (1, "lane", &half));
    assert_eq!(lane.successors, ["connector", "beyond"]);
    let middle: Vec<DVec2> = (0..=4).map(|i| at(1.0 + 0.5 * f64::from(i), 1.0)).collect();
    assert!(lane.centerline.iter().zip(&middle).all(|(a, b)| a.distance(*b) < 1e-12));
    assert_eq!(lane.centerline.len(), middle.len());
    let connector = &map.lane_connectors[0];
    assert_eq!(
        (connector.id.as_str(), connector.centerline.len(), connector.successors.len()),
        ("connector", 0, 0)
    );
    assert_eq!(map.crossings[0].exterior[2], at(0.0, 10.0));
    assert_eq!((&map.stop_lines, map.crossings.len()), (&vec![half], 1));
    assert_eq!(map.dividers, vec![vec![at(0.0, 0.0), at(10.0, 10.0)]; 2]);
}

/// Maps before version 1.2 lack these layers; some write an empty array in place of an empty object.
#[test]
fn layers_of_later_versions_may_be_missing() {
    let mut map = synthetic_map();
    for layer in ["lane_connector", "connectivity"] {
        map.as_object_mut().unwrap().remove(layer);
    }
    map["arcline_path_3"] = json!([]);
    let map = read(&map).unwrap();
    assert!(map.lane_connectors.is_empty() && map.lanes[0].successors.is_empty());
    assert!(map.lanes[0].centerline.is_empty());
}

#[test]
fn lines_without_nodes_are_counted() {
    let mut map = synthetic_map();
    map["line"].as_array_mut().unwrap().push(json!({"token": "empty", "node_tokens": []}));
    assert!(read(&map).unwrap().notes.is_empty());
    map["lane_divider"][0]["line_token"] = json!("empty");
    let map = read(&map).unwrap();
    assert_eq!(map.dividers, [[DVec2::ZERO, DVec2::splat(10.0)]]);
    assert_eq!(
        map.notes.into_iter().collect::<Vec<_>>(),
        [("dividers whose line has no nodes".to_owned(), 1)]
    );
}

#[test]
fn records_without_a_shape_are_skipped_and_counted() {
    type Edit = fn(&mut Value);
    let cases: [(Edit, &[&str]); 17] = [
        (|m| m["lane"][0]["polygon_token"] = json!("gone"), &["lanes that refer to a missing record"]),
        (|m| m["lane"][0]["polygon_token"] = json!(null), &["lanes that refer to a missing record"]),
        (|m| m["stop_line"][0]["polygon_token"] = json!(""), &["stop lines that refer to a missing record"]),
        (
            |m| _ = m["ped_crossing"][0].as_object_mut().unwrap().remove("polygon_token"),
            &["crossings that refer to a missing record"],
        ),
        (
            |m| m["drivable_area"][0]["polygon_tokens"][1] = json!("gone"),
            &["drivable areas that refer to a missing record"],
        ),
        (
            |m| m["lane_divider"][0]["line_token"] = json!("gone"),
            &["dividers that refer to a missing record"],
        ),
        (
            |m| m["polygon"][0]["exterior_node_tokens"][0] = json!("gone"),
            &["drivable areas that refer to a missing record"],
        ),
        (
            |m| m["polygon"][0]["exterior_node_tokens"][0] = json!(null),
            &["drivable areas that refer to a missing record"],
        ),
        (
            |m| m["polygon"][0]["holes"][0]["node_tokens"][0] = json!("gone"),
            &["holes that refer to a missing record"],
        ),
        (|m| m["polygon"][0]["exterior_node_tokens"] = json!([]), &["drivable areas without an area"]),
        (
            |m| m["polygon"][1]["exterior_node_tokens"] = json!(["a", "b", "a"]),
            &["drivable areas without an area", "lanes without an area", "stop lines without an area"],
        ),
        (
            |m| m["polygon"][0]["exterior_node_tokens"] = json!(["a", "a", "a", "a"]),
            &["drivable areas without an area"],
        ),
        (|m| _ = m["polygon"][0]["exterior_node_tokens"].take(), &["drivable areas without an area"]),
        (|m| m["line"][0]["node_tokens"] = json!(["a"]), &["dividers without a length"]),
        (|m| m["line"][0]["node_tokens"] = json!(["a", "a"]), &["dividers without a length"]),
        (|m| m["node"][4]["x"] = json!(null), &["holes without an area"]),
        (|m| m["arcline_path_3"]["lane"][0]["shape"] = json!("LQR"), &["damaged centerlines of lanes"]),
    ];
    assert!(read(&synthetic_map()).unwrap().notes.is_empty());
    for (edit, notes) in cases {
        let mut map = synthetic_map();
        edit(&mut map);
        let map = read(&map).unwrap();
        let found: Vec<&str> = map.notes.keys().map(|note| note.trim_end_matches(" (skipped)")).collect();
        assert_eq!(found, notes);
        let retained =
            [&map.lanes.len(), &map.drivable_area.len(), &map.crossings.len(), &map.stop_lines.len()];
        assert!(retained.into_iter().sum::<usize>() >= 2, "{found:?}");
    }
}

#[test]
fn broken_maps_are_errors() {
    type Edit = fn(&mut Value);
    let cases: [(Edit, &[&str]); 4] = [
        (
            |m| m["stop_line"][0]["token"] = json!(5),
            &["expected a map expansion", "no record of stop_line", "5 instead of text in token of record 5"],
        ),
        (|m| m["ped_crossing"] = json!([null]), &["no record of ped_crossing"]),
        (|m| m["lane"] = json!({}), &["expected a map expansion", "an array of records"]),
        (|m| m["connectivity"] = json!([1]), &["an object by lane, or an empty array"]),
    ];
    for (edit, parts) in cases {
        let mut map = synthetic_map();
        edit(&mut map);
        let message = read(&map).unwrap_err();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}\nexpected {parts:?}");
    }
    for layer in ["node", "polygon", "lane"] {
        let mut map = synthetic_map();
        map.as_object_mut().unwrap().remove(layer);
        assert!(read(&map).unwrap_err().contains(&format!("no field {layer}")));
    }
}

#[test]
fn missing_map_layers_are_counted() {
    for layer in ["line", "drivable_area", "ped_crossing", "stop_line", "road_divider", "lane_divider"] {
        for value in [None, Some(Value::Null)] {
            let mut map = synthetic_map();
            map.as_object_mut().unwrap().remove(layer);
            if let Some(value) = value {
                map[layer] = value;
            }
            let map = read(&map).unwrap();
            assert_eq!(map.notes[&format!("maps without {layer}")], 1);
            assert_eq!(map.lanes.len(), 1);
        }
    }
}

#[test]
fn bad_records_are_skipped_and_counted() {
    type Edit = fn(&mut Value);
    let cases: [(Edit, &str); 8] = [
        (|m| again(&mut m["polygon"]), "records of polygon with the identifier of another (skipped)"),
        (|m| again(&mut m["node"]), "records of node with the identifier of another (skipped)"),
        (|m| again(&mut m["lane"]), "lanes with the identifier of another (skipped)"),
        (
            |m| insert(&mut m["lane"], json!({"token": "x", "polygon_token": 5})),
            "records of lane that cannot be read (skipped)",
        ),
        (
            |m| insert(&mut m["node"], json!({"token": 5, "x": 1, "y": 1})),
            "records of node that cannot be read (skipped)",
        ),
        (|m| insert(&mut m["stop_line"], json!(null)), "records of stop_line that cannot be read (skipped)"),
        (
            |m| m["connectivity"]["other"] = json!({"outgoing": "lane"}),
            "records of connectivity that cannot be read (skipped)",
        ),
        (
            |m| m["arcline_path_3"]["other"] = json!("path"),
            "records of arcline_path_3 that cannot be read (skipped)",
        ),
    ];
    let whole = read(&synthetic_map()).unwrap();
    for (edit, note) in cases {
        let mut map = synthetic_map();
        edit(&mut map);
        let mut map = read(&map).unwrap();
        assert_eq!(std::mem::take(&mut map.notes).into_iter().collect::<Vec<_>>(), [(note.to_owned(), 1)]);
        assert_eq!(map, whole);
    }
}

fn insert(records: &mut Value, record: Value) {
    records.as_array_mut().unwrap().push(record);
}

/// Adds the first record again.
fn again(records: &mut Value) {
    let first = records[0].clone();
    insert(records, first);
}

proptest! {
    /// The reader returns a map or an error for any file content.
    #[test]
    fn no_map_makes_the_reader_panic(
        places in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in proptest::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = synthetic_map().to_string().into_bytes();
        for (place, value) in places {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        bytes.truncate(cut.map_or(bytes.len(), |cut| cut.index(bytes.len())));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("nowhere.json");
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(map) = read_map_file(&path, "nowhere") {
            prop_assert!(map.lanes.len() <= 1);
        }
    }
}

fn log_with(map_root: Option<PathBuf>, root: &Path) -> NuScenes {
    NuScenes::open(&LogLocator {
        map_root,
        ..LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, root)
    })
    .unwrap()
}

/// The file is named after the log's location. `--map-root` takes precedence; without a file there is no map.
#[test]
fn the_map_of_the_logs_location_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    copy_to(root, |name| name.starts_with(VERSION));
    assert!(log_with(None, root).read_map().unwrap().is_none());
    for below in ["maps/expansion", "elsewhere"] {
        std::fs::create_dir_all(root.join(below)).unwrap();
    }
    std::fs::write(root.join("maps/expansion/town.json"), synthetic_map().to_string()).unwrap();
    let map = log_with(None, root).read_map().unwrap().unwrap();
    assert_eq!((map.location.as_str(), map.lanes.len()), ("town", 1));
    let elsewhere = Some(root.join("elsewhere"));
    // The given map folder must contain the log's map.
    let message = log_with(elsewhere.clone(), root).read_map().unwrap_err().to_string();
    assert!(message.contains("expected map town.json or") && message.ends_with("elsewhere"), "{message}");
    let (gone, file) = (root.join("gone"), root.join("v1.0-mini/log.json"));
    for (place, found) in [(&gone, "cannot read"), (&file, "expected a folder, found a file")] {
        let usual = LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, root);
        let maps = LogLocator { map_root: Some(place.clone()), ..usual.clone() };
        let sensors = LogLocator { sensor_root: Some(place.clone()), ..usual };
        for locator in [maps, sensors] {
            let message = NuScenes::open(&locator).unwrap_err().to_string();
            assert!(message.contains(found) && message.ends_with(place.to_str().unwrap()), "{message}");
        }
    }
    std::fs::write(root.join("elsewhere/town.json"), "[").unwrap();
    let message = log_with(elsewhere, root).read_map().unwrap_err().to_string();
    assert!(message.contains("expected a map expansion") && message.ends_with("town.json"), "{message}");
}

/// Returns the area of a ring, m².
fn area(ring: &[DVec2]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>().abs() / 2.0
}

#[test]
fn a_real_map_without_centerlines_is_read() {
    let Some(shared) = shared("a map of Boston") else { return };
    let path = shared.join("data/nuscenes-map/boston-thomaspark.json");
    let map = read_map_file(&path, "boston-thomaspark").unwrap();
    assert_eq!((map.lanes.len(), map.lane_connectors.len(), map.dividers.len()), (137, 0, 59 + 28));
    assert!(map.drivable_area.is_empty() && map.crossings.is_empty() && map.stop_lines.is_empty());
    assert!(map.lanes.iter().all(|l| l.outline.exterior.first() != l.outline.exterior.last()));
    let total: f64 = map.lanes.iter().map(|l| area(&l.outline.exterior)).sum();
    assert!((total - 45_985.065_640_3).abs() < 1e-3, "{total} m2, NumPy says 45985.0656");
}

/// Compares centerlines with the start and end of each path in the file, and lanes with their successors.
#[test]
fn the_pandaset_map_is_consistent() {
    let Some(shared) = shared("the PandaSet drive") else { return };
    let root = shared.join("data/pandaset-002/nuscenes");
    let map = log_with(None, &root).read_map().unwrap().unwrap();
    assert_eq!((map.lanes.len(), map.lane_connectors.len(), map.dividers.len()), (8, 4, 5));
    assert_eq!((map.drivable_area.len(), map.crossings.len(), map.stop_lines.len()), (1, 2, 1));
    assert!(!map.drivable_area[0].holes.is_empty());

    let text = std::fs::read(root.join("maps/expansion/pandaset-002.json")).unwrap();
    let raw: Value = serde_json::from_slice(&text).unwrap();
    let lanes = || map.lanes.iter().chain(&map.lane_connectors);
    let mut worst_m = 0.0_f64;
    for lane in lanes() {
        for path in raw["arcline_path_3"][&lane.id].as_array().unwrap() {
            for end in ["start_pose", "end_pose"] {
                let at = DVec2::new(path[end][0].as_f64().unwrap(), path[end][1].as_f64().unwrap());
                let off = lane.centerline.iter().map(|p| p.distance(at)).fold(f64::INFINITY, f64::min);
                worst_m = worst_m.max(off);
            }
        }
        assert!(lane.centerline.windows(2).all(|w| w[0].distance(w[1]) < 0.51));
        for next in &lane.successors {
            let next = lanes().find(|l| l.id == *next).unwrap();
            let gap = lane.centerline.last().unwrap().distance(next.centerline[0]);
            assert!(gap < 0.05, "{} to {}: {gap} m", lane.id, next.id);
        }
    }
    assert!(worst_m < 1e-3, "{worst_m} m");
}
