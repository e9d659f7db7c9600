use super::super::FORMAT;
use super::*;
use serde_json::json;

/// Three samples at 0, 0.5 and 1.5 s. Car `a` is in all of them, `b` only in the first two, with a gap
/// `c`; a camera with a sweep in the first interval.
fn tables() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("v1.0-mini");
    std::fs::create_dir(&root).unwrap();
    let sample = |token: &str, t_us: i64, prev: &str, next: &str| {
        let scene = "scene";
        json!({"token": token, "timestamp": t_us, "prev": prev, "next": next, "scene_token": scene})
    };
    let half_turn = std::f64::consts::FRAC_1_SQRT_2;
    let annotation = |token: &str, sample: &str, x: f64, rotation: [f64; 4], links: [&str; 2]| {
        json!({"token": token, "sample_token": sample, "instance_token": token[..1], "visibility_token": "4",
            "attribute_tokens": [], "translation": [x, 2.0, 0.0], "size": [2.0, 4.0, 1.5],
            "rotation": rotation, "prev": links[0], "next": links[1], "num_lidar_pts": 7, "num_radar_pts": 0})
    };
    let none = [1.0, 0.0, 0.0, 0.0];
    let file = |token: &str, sample: &str, t_us: i64, key: bool, links: [&str; 2]| {
        json!({"token": token, "sample_token": sample, "ego_pose_token": format!("pose-{token}"),
            "calibrated_sensor_token": "front", "timestamp": t_us, "fileformat": "jpg", "is_key_frame": key,
            "height": 9, "width": 16, "filename": format!("{token}.jpg"), "prev": links[0], "next": links[1]})
    };
    let write = |table: &str, records: Value| {
        std::fs::write(root.join(format!("{table}.json")), records.to_string()).unwrap();
    };
    write(
        "sample",
        json!([
            sample("s", 1_000_000, "", "t"),
            sample("t", 1_500_000, "s", "u"),
            sample("u", 2_500_000, "t", "")
        ]),
    );
    write(
        "sample_annotation",
        json!([
            annotation("a0", "s", 0.0, none, ["", "a1"]),
            annotation("b0", "s", 5.0, none, ["", "b1"]),
            annotation("c0", "s", 9.0, none, ["", "c2"]),
            annotation("b1", "t", 6.0, none, ["b0", ""]),
            annotation("a1", "t", 3.0, [-half_turn, 0.0, 0.0, -half_turn], ["a0", "a2"]),
            annotation("a2", "u", 9.0, [half_turn, 0.0, 0.0, half_turn], ["a1", ""]),
            annotation("c2", "u", 9.0, none, ["c0", ""]),
        ]),
    );
    write(
        "sample_data",
        json!([
            file("f", "s", 990_000, true, ["", "g"]),
            file("g", "t", 1_240_000, false, ["f", "h"]),
            file("h", "t", 1_490_000, true, ["g", "i"]),
            file("i", "u", 2_490_000, true, ["h", ""]),
        ]),
    );
    write(
        "scene",
        json!([{"token": "scene", "nbr_samples": 3, "first_sample_token": "s", "last_sample_token": "u"}]),
    );
    write(
        "instance",
        json!([
            {"token": "a", "nbr_annotations": 3},
            {"token": "b", "nbr_annotations": 2},
            {"token": "c", "nbr_annotations": 2}
        ]),
    );
    write("ego_pose", json!([{"token": "pose-f", "timestamp": 1}]));
    folder
}

fn interpolated(hz: u8) -> (InterpolatedCounts, impl Fn(&str) -> Vec<Value>) {
    let (data, out) = (tables(), tempfile::tempdir().unwrap());
    let locator = LogLocator::new(&FORMAT, data.path());
    let folder = out.path().join("interp");
    let counts = interpolate_tables(&locator, hz, &folder).unwrap();
    let read = move |table: &str| {
        let _ = (&data, &out);
        serde_json::from_slice(&std::fs::read(path(&folder, table)).unwrap()).unwrap()
    };
    (counts, read)
}

fn fields<'a>(records: &'a [Value], field: &str) -> Vec<&'a Value> {
    records.iter().map(|record| &record[field]).collect()
}

#[test]
fn boxes_move_evenly_between_samples() {
    let (counts, read) = interpolated(4);
    assert_eq!(counts, InterpolatedCounts { samples: 5, annotations: 10, files: 5, repeated: 1 });
    let samples = read("sample");
    assert_eq!(fields(&samples, "token"), ["s", "s1", "t", "t1", "u"]);
    assert_eq!(fields(&samples, "prev"), ["", "s", "s1", "t", "t1"]);
    assert_eq!(fields(&samples, "next"), ["s1", "t", "t1", "u", ""]);
    assert_eq!(fields(&samples, "timestamp"), [1_000_000, 1_250_000, 1_500_000, 2_000_000, 2_500_000]);
    let boxes = read("sample_annotation");
    // An object that is not in the next sample ends; one that returns later begins there.
    assert_eq!(fields(&boxes, "token"), ["a0", "b0", "c0", "a01", "b01", "b1", "a1", "a11", "a2", "c2"]);
    assert_eq!(fields(&boxes, "next"), ["a01", "b01", "c2", "a1", "b1", "", "a11", "a2", "", ""]);
    assert_eq!(fields(&boxes, "prev"), ["", "", "", "a0", "b0", "b01", "a01", "a1", "a11", "c0"]);
    assert_eq!(
        (&boxes[3]["translation"], &boxes[3]["sample_token"]),
        (&json!([1.5, 2.0, 0.0]), &json!("s1"))
    );
    assert_eq!((&boxes[3]["size"], &boxes[3]["num_lidar_pts"]), (&json!([2.0, 4.0, 1.5]), &json!(7)));
    // An eighth of a turn, on the shorter arc; and none, although the signs differ.
    let eighth = [(std::f64::consts::PI / 8.0).cos(), (std::f64::consts::PI / 8.0).sin()];
    for (place, [w, z]) in [(3, eighth), (7, [std::f64::consts::FRAC_1_SQRT_2; 2])] {
        let found: [f64; 4] = serde_json::from_value(boxes[place]["rotation"].clone()).unwrap();
        let sign = found[0].signum();
        assert!((sign * found[0] - w).abs() < 1e-12 && (sign * found[3] - z).abs() < 1e-12, "{found:?}");
    }
    assert_eq!(fields(&read("scene"), "nbr_samples"), [5]);
    assert_eq!(fields(&read("instance"), "nbr_annotations"), [5, 3, 2]);
    assert_eq!(read("ego_pose"), [json!({"token": "pose-f", "timestamp": 1})]);
}

#[test]
fn recorded_images_are_placed_by_time() {
    let (counts, read) = interpolated(12);
    let files = read("sample_data");
    assert_eq!((counts.samples, files.len(), counts.repeated), (13, 13, 1 + 5));
    // The image at 0.25 s is the closest of frames 2 to 5; none lies between the last two samples.
    let names = ["f", "f", "g", "g", "g", "g", "h", "h", "h", "h", "h", "h", "i"];
    assert_eq!(fields(&files, "filename"), names.map(|name| json!(format!("{name}.jpg"))).each_ref());
    assert_eq!(fields(&files, "ego_pose_token"), names.map(|name| json!(format!("pose-{name}"))).each_ref());
    assert_eq!(files[2]["timestamp"], json!(1_240_000));
    assert_eq!(fields(&files, "sample_token"), fields(&read("sample"), "token"));
    let tokens = fields(&files, "token");
    assert_eq!(fields(&files, "next")[..12], tokens[1..]);
    assert_eq!(fields(&files, "prev")[1..], tokens[..12]);
    assert!(files.iter().all(|file| file["is_key_frame"] == json!(true)));
}

#[test]
fn rejects_other_rates_and_damaged_tables() {
    let data = tables();
    let locator = LogLocator::new(&FORMAT, data.path());
    let out = data.path().join("interp_12Hz_trainval");
    let fails = |hz| interpolate_tables(&locator, hz, &out).unwrap_err().to_string();
    for hz in [0, 2, 5, 22] {
        assert!(fails(hz).starts_with("expected a multiple of 2 Hz from 4 to 20, found"), "{hz}");
    }
    let table = data.path().join("v1.0-mini/sample_annotation.json");
    let text = std::fs::read_to_string(&table).unwrap().replacen("\"s\"", "\"x\"", 1);
    std::fs::write(&table, text).unwrap();
    assert!(fails(12).contains("expected samples that exist, found sample \"x\" of a0"), "{}", fails(12));
    assert!(!out.exists());
    std::fs::remove_file(table).unwrap();
    assert!(fails(12).contains("sample_annotation.json"));
}
