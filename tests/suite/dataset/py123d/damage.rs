//! Incomplete and damaged tables: a log that lacks some opens, and a damaged one is refused with a line that
//! names the file, what was expected and what was found.

use std::sync::Arc;

use arrow_array::types::{Int32Type, UInt16Type};
use arrow_array::{BooleanArray, Float64Array, UInt64Array};
use point_skeleton::dataset::py123d::Py123d;
use point_skeleton::dataset::{GapPlace, LogLocator, LogReader, MissingData, ReadOptions};
use pskel_testing::py123d_log::{
    BOXES, EGO, FRAMES, FRONT, LEFT, LIDAR, LIGHTS, MAP, SYNC, Table, TinyPy123d, assert_message,
    integer_lists, integers, texts, vectors,
};

/// Tables that `sync` refers to.
pub(super) const KEYS: [&str; 6] = [EGO, BOXES, LIGHTS, FRONT, LEFT, LIDAR];

pub(super) type Edit = fn(&mut Table);

/// Opens a log for each change of a table, and collects the messages that lack a part or the file's name.
#[track_caller]
pub(super) fn all_refused(cases: &[(&str, Edit, &[&str])]) {
    let mut wrong = Vec::new();
    for (number, (table, edit, parts)) in cases.iter().enumerate() {
        let mut log = TinyPy123d::new();
        log.edit(table, edit);
        let message = log.open().map_or_else(|error| error.to_string(), |_| "a log".to_owned());
        let is_line =
            message.ends_with(&format!("/{table}.arrow")) && !message.contains('\n') && message.len() < 600;
        if !is_line || parts.iter().any(|part| !message.contains(part)) {
            wrong.push(format!("{number}: {message:?} does not have {parts:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_log_without_a_table_opens() {
    for missing in KEYS {
        let made = TinyPy123d::new();
        std::fs::remove_file(made.path(missing)).unwrap();
        let reader = made.open().unwrap();
        let log = reader.recording();
        let gap = GapPlace::File(made.path(missing));
        assert!(log.gaps.iter().any(|found| found.kind == "tables that do not exist" && found.place == gap));
        assert_eq!(log.notes["tables that do not exist"], 1);
        let (frames, boxes) = (&log.frames, log.frames.iter().map(|frame| frame.boxes.len()).sum::<usize>());
        let (sweeps, images) = frames.iter().fold((0, 0), |(sweeps, images), frame| {
            (sweeps + frame.sweeps.len(), images + frame.images.len())
        });
        let found = (frames.len(), boxes, log.lights.len(), images, sweeps);
        let (other, notes) = match missing {
            EGO => ((0, 0, 0, 0, 0), "frames without an ego pose"),
            BOXES => ((4, 0, 4, 8, 4), "logs without annotations"),
            LIGHTS => ((4, 8, 0, 8, 4), "tables that do not exist"),
            LIDAR => ((4, 8, 4, 8, 0), "tables that do not exist"),
            _ => ((4, 8, 4, 4, 4), "tables that do not exist"),
        };
        assert_eq!(found, other, "{missing}");
        assert!(log.notes.contains_key(notes), "{missing}: {:?}", log.notes);
        assert!(reader.read_map().unwrap().is_some());
        let reading = ReadOptions { missing: MissingData::Error, ..ReadOptions::default() };
        let error = Py123d::open(&LogLocator { reading, ..made.locator() }).err().unwrap();
        assert!(error.to_string().starts_with("expected a log without gaps, found "), "{error}");
    }
    let made = TinyPy123d::new();
    std::fs::remove_file(made.path(MAP)).unwrap();
    assert!(made.open().unwrap().read_map().unwrap().is_none());
    std::fs::remove_file(made.path(SYNC)).unwrap();
    made.refuses(
        &["expected a log (a folder with sync.arrow)", "found tables without sync.arrow"],
        "/2026.01.02.made",
    );
}

/// Opens a log and reads its map.
fn read_all(made: &TinyPy123d) -> String {
    let read = made.open().and_then(|log| log.read_map());
    read.map_or_else(|error| error.to_string(), |_| "a log".to_owned())
}

#[test]
fn truncated_tables_and_other_formats_are_named() {
    let made = TinyPy123d::new();
    for table in KEYS.into_iter().chain([SYNC, MAP]) {
        let (path, ending) = (made.path(table), format!("/{table}.arrow"));
        let whole = std::fs::read(&path).unwrap();
        let check = |bytes: &[u8], found: &str| {
            std::fs::write(&path, bytes).unwrap();
            let expected = "expected an Arrow file (Feather)";
            assert_message(&read_all(&made), &[expected, &format!("found {found}")], &ending);
        };
        for cut in (1..whole.len()).step_by(whole.len().div_ceil(50)).chain([whole.len() - 1]) {
            check(&whole[..cut], &format!("{cut} bytes (cut off, or another format)"));
        }
        check(&[], "an empty file");
        check(b"PAR1 and more than ten bytes", "a Parquet file");
        check(
            &[&[0; 8], &whole[8..]].concat(),
            &format!("{} bytes (cut off, or another format)", whole.len()),
        );
        check(&[&whole[..], &whole[whole.len() - 6..]].concat(), "");
        check(
            &[&whole[..8], &vec![0xa5; whole.len() - 18], &whole[whole.len() - 10..]].concat(),
            "a damaged footer",
        );
        std::fs::write(&path, whole).unwrap();
    }
    assert_eq!(read_all(&made), "a log");
}

#[test]
fn a_missing_column_is_named() {
    let columns = [
        (SYNC, "sync.timestamp_us"),
        (EGO, "ego_state_se3.timestamp_us"),
        (EGO, "ego_state_se3.imu_se3"),
        (BOXES, "box_detections_se3.bounding_box_se3"),
        (BOXES, "box_detections_se3.track_token"),
        (BOXES, "box_detections_se3.label"),
        (LIGHTS, "traffic_light_detections.lane_id"),
        (LIGHTS, "traffic_light_detections.status"),
        (FRONT, "camera.pcam_f0.timestamp_us"),
        (FRONT, "camera.pcam_f0.camera_to_global_se3"),
        (LIDAR, "lidar.lidar_merged.end_timestamp_us"),
    ];
    for (table, column) in columns {
        let mut made = TinyPy123d::new();
        made.edit(table, |table| table.remove(column));
        made.refuses(&[&format!("expected a column {column}, found columns ")], &format!("/{table}.arrow"));
    }
    for table in [FRONT, LIDAR] {
        let mut made = TinyPy123d::new();
        made.edit(table, |table| table.remove("data"));
        let expected = format!("expected paths, bytes or frame numbers in column {table}.data, found none");
        made.refuses(&[&expected], &format!("/{table}.arrow"));
    }
    // Counts of points, and columns that are not read, may be missing.
    let mut made = TinyPy123d::new();
    made.edit(BOXES, |table| table.remove("num_lidar_points"));
    made.edit(BOXES, |table| table.remove("velocity_3d"));
    made.edit(SYNC, |table| table.remove("sync.uuid"));
    let log = made.open().unwrap();
    assert!(log.box_points().is_none() && log.recording().notes.is_empty(), "{:?}", log.recording().notes);
}

#[test]
fn columns_of_other_types_are_named() {
    all_refused(&[
        (
            SYNC,
            |t| t.set("timestamp_us", texts(["1"; FRAMES])),
            &["integers in column sync.timestamp_us", "type Utf8"],
        ),
        (
            SYNC,
            |t| t.set("timestamp_us", integers([None; FRAMES])),
            &["a value in every row", "found 4 empty ones"],
        ),
        (
            SYNC,
            |t| t.set(LIDAR, texts(["1"; FRAMES])),
            &["integers in column lidar.lidar_merged", "found type Utf8"],
        ),
        (
            SYNC,
            |t| t.set(EGO, Arc::new(Float64Array::from(vec![0.5; FRAMES]))),
            &["integers", "found type Float64"],
        ),
        (
            EGO,
            |t| t.set("imu_se3", vectors([[0.0; 6]; FRAMES])),
            &["vectors of 7 numbers in column ego_state_se3.imu_se3"],
        ),
        (EGO, |t| t.set("imu_se3", integers(0..4)), &["vectors of 7 numbers", "found type Int64"]),
        (
            EGO,
            |t| t.set("imu_se3", integer_lists::<Int32Type>(vec![vec![0; 7]; FRAMES])),
            &["vectors of 7 numbers", "found type List"],
        ),
        (
            BOXES,
            |t| t.set("bounding_box_se3", vectors([[0.0; 10]; FRAMES])),
            &["lists of vectors of 10 numbers", "found type FixedSizeList"],
        ),
        (
            BOXES,
            |t| t.set("bounding_box_se3", integer_lists::<Int32Type>(vec![vec![0; 10]; FRAMES])),
            &["lists of vectors of 10 numbers"],
        ),
        (BOXES, |t| t.set("track_token", texts(["a"; FRAMES])), &["lists of texts", "found type Utf8"]),
        (
            BOXES,
            |t| t.set("label", integers(0..4)),
            &["lists of integers in column box_detections_se3.label", "found type Int64"],
        ),
        (
            BOXES,
            |t| t.set("num_lidar_points", texts(["a"; FRAMES])),
            &["lists of integers", "found type Utf8"],
        ),
        (
            LIGHTS,
            |t| t.set("status", integers(0..4)),
            &["lists of integers in column traffic_light_detections.status"],
        ),
        (
            FRONT,
            |t| t.set("data", Arc::new(BooleanArray::from(vec![true; FRAMES]))),
            &["paths, bytes or frame numbers", "found type Boolean"],
        ),
        (FRONT, |t| t.set("camera_to_global_se3", vectors([[0.0; 8]; FRAMES])), &["vectors of 7 numbers"]),
        (LIDAR, |t| t.set("end_timestamp_us", texts(["1"; FRAMES])), &["integers", "found type Utf8"]),
    ]);
    // Other widths have the same values.
    let mut made = TinyPy123d::new();
    made.edit(SYNC, |t| t.set(EGO, Arc::new(UInt64Array::from(vec![0, 1, 2, 3]))));
    made.edit(BOXES, |t| t.set("label", integer_lists::<UInt16Type>(vec![vec![10, 0]; FRAMES])));
    assert_eq!(made.open().unwrap().recording().frames.len(), FRAMES);
}

#[test]
fn damaged_metadata_are_named() {
    let replace = |table: &str, metadata: Option<Vec<u8>>, parts: &[&str]| {
        let mut made = TinyPy123d::new();
        made.edit(table, |table| table.metadata = metadata);
        let expected = "expected metadata of a table of py123d in the schema, found ";
        made.refuses(&[&[expected], parts].concat(), &format!("/{table}.arrow"));
    };
    for table in [SYNC, BOXES, FRONT, LIDAR] {
        let field = match table {
            SYNC => "missing field `dataset`",
            BOXES => "missing field `box_detection_label_class`",
            FRONT => "missing field `width`",
            _ => "did not match",
        };
        replace(table, None, &["found none"]);
        replace(table, Some(vec![0xc1]), &[]); // a byte that is never used
        replace(table, Some(b"{\"dataset\": 1}".to_vec()), &[]);
        replace(table, Some(vec![0xdf, 0xff, 0xff, 0xff, 0xff]), &[]); // a map of 2³² entries
        replace(table, Some(vec![0x81, 0xdb, 0xff, 0xff, 0xff, 0xff]), &[]); // a text of 2³² bytes
        replace(table, Some([&[0x81, 0xa1, b'a'][..], &[0x91; 100_000], &[0xc0]].concat()), &["depth limit"]);
        if table != LIDAR {
            replace(table, Some(vec![0x80]), &[field]);
        }
    }
    all_refused(&[
        (SYNC, |t| t.about(|v| v["log_name"] = 1.into()), &["invalid type", "at log_name"]),
        (SYNC, |t| t.about(|v| v["location"] = true.into()), &["invalid type", "at location"]),
        (FRONT, |t| t.about(|v| v["width"] = (-1).into()), &["at width"]),
        (FRONT, |t| t.about(|v| v["intrinsics"] = "1".into()), &["at intrinsics"]),
        (FRONT, |t| t.about(|v| v["camera_to_imu_se3"] = vec![0.0; 6].into()), &["at camera_to_imu_se3"]),
        (LIDAR, |t| t.about(|v| v["2"]["lidar_to_imu_se3"] = vec![0.0; 6].into()), &["metadata of a table"]),
    ]);
}
