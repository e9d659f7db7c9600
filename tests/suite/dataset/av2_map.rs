//! Broken maps of Argoverse 2.

use std::path::Path;

use point_skeleton::dataset::LogReader;
use point_skeleton::dataset::av2::read_map_file;
use serde_json::{Value, json};

use pskel_testing::av2_log::{MAP, TinyAv2, map};

fn read_map(map: &Value) -> Result<usize, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.json");
    std::fs::write(&path, map.to_string()).unwrap();
    let read = read_map_file(&path, "");
    read.map(|map| map.lanes.len()).map_err(|e| e.to_string().replace(path.to_str().unwrap(), "map.json"))
}

#[test]
fn broken_maps_are_errors() {
    type Edit = fn(&mut Value);
    let cases: [(Edit, &[&str]); 2] = [
        (|m| m["lane_segments"] = json!([]), &["an Argoverse 2 map", "an object by id"]),
        (
            |m| m["drivable_areas"]["1"]["area_boundary"] = json!("far"),
            &["an Argoverse 2 map", "no record of drivable_areas that can be read", "an array"],
        ),
    ];
    for (edit, parts) in cases {
        let mut map = map();
        edit(&mut map);
        let message = read_map(&map).unwrap_err();
        assert!(message.ends_with(": map.json"), "{message}");
        assert!(parts.iter().all(|part| message.contains(part)), "{message}\nexpected {parts:?}");
    }
    let mut lanes = map();
    lanes.as_object_mut().unwrap().remove("lane_segments");
    assert!(read_map(&lanes).unwrap_err().contains("no field lane_segments"));
    let log = TinyAv2::new();
    let whole = std::fs::read(log.path(MAP)).unwrap();
    for cut in (0..whole.len()).step_by(61) {
        std::fs::write(log.path(MAP), &whole[..cut]).unwrap();
        let message = log.open().unwrap().read_map().unwrap_err().to_string();
        assert!(message.contains("an Argoverse 2 map") && message.ends_with(MAP), "{message}");
    }
    assert!(
        read_map_file(Path::new("/nowhere.json"), "").unwrap_err().to_string().starts_with("cannot read")
    );
}
