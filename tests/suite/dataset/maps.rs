//! Map records without an area or a length: skipped and counted, whatever the format of the map.

use point_skeleton::dataset::VectorMap;
use point_skeleton::dataset::av2::read_map_file;
use serde_json::{Value, json};

use pskel_testing::av2_log::map;
use pskel_testing::nuplan_log::{NuplanLog, geometry};

const UNMARKED: &str = "lane boundaries without a mark type (not drawn)";

#[test]
fn argoverse_maps_skip_records_without_a_shape() {
    type Edit = fn(&mut Value);
    let nan = json!({"x": null, "y": 1.0});
    let cases: [(Edit, &str); 7] = [
        (
            |m| m["lane_segments"]["9"]["left_lane_boundary"][0]["x"] = json!(null),
            "lane segments without a length (skipped)",
        ),
        (
            |m| m["lane_segments"]["9"]["left_lane_boundary"] = json!([]),
            "lane segments without a length (skipped)",
        ),
        (
            |m| {
                m["lane_segments"]["9"]["right_lane_boundary"][1] =
                    m["lane_segments"]["9"]["right_lane_boundary"][0].clone()
            },
            "lane segments without a length (skipped)",
        ),
        (
            |m| {
                m["lane_segments"]["9"]["right_lane_boundary"] =
                    m["lane_segments"]["9"]["left_lane_boundary"].clone()
            },
            "lane segments without an area (skipped)",
        ),
        (
            |m| m["drivable_areas"]["1"]["area_boundary"] = json!([{"x": 1, "y": 2}]),
            "drivable areas without an area (skipped)",
        ),
        (
            |m| _ = m["drivable_areas"]["1"]["area_boundary"].take(),
            "drivable areas without an area (skipped)",
        ),
        (|m| m["pedestrian_crossings"]["2"]["edge2"] = json!([]), "crossings without an area (skipped)"),
    ];
    let read = |map: &Value| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.json");
        // Python's words for numbers that JSON lacks.
        std::fs::write(&path, map.to_string().replace(&nan.to_string(), "{\"x\": NaN, \"y\": 1.0}")).unwrap();
        read_map_file(&path, "").unwrap()
    };
    let whole = read(&map());
    let elements = |map: &VectorMap| {
        map.lanes.len() + map.lane_connectors.len() + map.drivable_area.len() + map.crossings.len()
    };
    assert!(whole.notes.is_empty());
    for (edit, note) in cases {
        let mut map = map();
        edit(&mut map);
        let map = read(&map);
        assert_eq!(map.notes.into_iter().collect::<Vec<_>>(), [(note.to_owned(), 1)]);
    }
    let mut map = map();
    map["drivable_areas"]["1"]["area_boundary"][0] = nan.clone();
    let map = read(&map);
    assert_eq!(elements(&map), elements(&whole) - 1);
}

#[test]
fn argoverse_maps_skip_bad_records_and_count_missing_layers() {
    type Edit = fn(&mut Value);
    let unreadable = "records of lane_segments that cannot be read (skipped)";
    let cases: [(Edit, Option<&str>, usize); 8] = [
        (|m| m["lane_segments"]["9"]["left_lane_mark_type"] = json!(null), Some(UNMARKED), 3),
        (
            |m| _ = m["lane_segments"]["9"].as_object_mut().unwrap().remove("left_lane_mark_type"),
            Some(UNMARKED),
            3,
        ),
        (
            |m| _ = m["lane_segments"]["9"].as_object_mut().unwrap().remove("is_intersection"),
            Some(unreadable),
            2,
        ),
        (|m| m["lane_segments"]["9"] = json!(null), Some(unreadable), 2),
        (|m| m["lane_segments"]["9"]["left_lane_boundary"] = json!("far"), Some(unreadable), 2),
        (|m| m["lane_segments"]["9"]["id"] = json!("9"), None, 3),
        (|m| _ = m["pedestrian_crossings"].take(), Some("maps without pedestrian_crossings"), 3),
        (|m| _ = m.as_object_mut().unwrap().remove("drivable_areas"), Some("maps without drivable_areas"), 3),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.json");
    for (edit, note, lanes) in cases {
        let mut map = map();
        edit(&mut map);
        std::fs::write(&path, map.to_string()).unwrap();
        let map = read_map_file(&path, "").unwrap();
        assert_eq!(map.lanes.len() + map.lane_connectors.len(), lanes, "{note:?}");
        assert_eq!(
            map.notes.into_iter().collect::<Vec<_>>(),
            note.map(|note| (note.to_owned(), 1)).into_iter().collect::<Vec<_>>()
        );
    }
}

#[test]
fn nuplan_maps_skip_bad_features() {
    let (whole, _) = NuplanLog::map_and_notes("");
    for (statement, note) in [
        ("UPDATE lanes_polygons SET geom = x'0011' WHERE fid = 12;", "records of lanes_polygons"),
        ("UPDATE baseline_paths SET lane_fid = 'abc' WHERE fid = 41;", "records of baseline_paths"),
    ] {
        let (map, reported) = NuplanLog::map_and_notes(statement);
        assert!(reported.contains(&(format!("{note} that cannot be read (skipped)"), 1)), "{reported:?}");
        assert_eq!((&map.crossings, &map.dividers), (&whole.crossings, &whole.dividers));
        assert_eq!(map.lane_connectors.len(), whole.lane_connectors.len());
    }
}

#[test]
fn nuplan_maps_skip_features_without_a_shape() {
    let notes = NuplanLog::map_and_notes;
    let one = |kind: &str, count: usize| vec![(kind.to_owned(), count)];
    let (whole, none) = notes("");
    assert_eq!(none, []);

    let (map, reported) = notes("UPDATE crosswalks SET geom = NULL;");
    assert_eq!(reported, one("features of crosswalks with an empty geometry", 1));
    assert!(map.crossings.is_empty() && map.lanes == whole.lanes);
    let point = [-115.0, 36.0];
    for corners in
        [&[point, [-115.1, 36.0], point][..], &[point; 5], &[[f64::NAN, 36.0], point, [-115.1, 36.1]]]
    {
        let (map, reported) = notes(&format!("UPDATE crosswalks SET geom = {};", geometry(true, corners)));
        assert_eq!(reported, one("geometries of crosswalks without an area (skipped)", 1));
        assert!(map.crossings.is_empty() && map.lanes == whole.lanes);
    }
    for points in [&[point][..], &[point; 2], &[point, [-115.0, f64::INFINITY]]] {
        let (map, reported) = notes(&format!("UPDATE boundaries SET geom = {};", geometry(false, points)));
        let count = whole.dividers.len();
        assert_eq!(reported, one("geometries of boundaries without a length (skipped)", count));
        assert!(map.dividers.is_empty());
    }
    let (map, reported) =
        notes("UPDATE gen_lane_connectors_scaled_width_polygons SET lane_connector_fid = NULL;");
    assert!(
        reported
            .contains(&("areas of lane connectors that refer to a missing record (skipped)".to_owned(), 1))
    );
    assert_eq!(map.lanes.len(), whole.lanes.len());
}
