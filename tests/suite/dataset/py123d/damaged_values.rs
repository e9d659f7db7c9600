//! Values that cannot be: rows, times, poses, sizes, labels, names and cameras.

use std::sync::Arc;

use arrow_array::types::{UInt8Type, UInt16Type};
use arrow_array::{ArrayRef, UInt64Array};
use point_skeleton::dataset::LogReader;
use pskel_testing::py123d_log::{
    BOXES, EGO, FIRST_US, FRAMES, FRONT, LEFT, LIDAR, LIGHTS, MAP, SYNC, TinyPy123d, assert_message,
    integer_lists, integers, text_lists, vector_lists, vectors,
};

use super::damage::{KEYS, all_refused};

#[test]
fn rows_of_sync_must_exist() {
    for key in KEYS {
        for row in [4, -1, i64::MAX, i64::MIN] {
            let mut made = TinyPy123d::new();
            made.edit(SYNC, |table| table.set(key, integers([0, 1, row, 3])));
            let expected = format!("expected rows of {key}.arrow below 4 in column {key}, found {row}: ");
            made.refuses(&[&expected], "/sync.arrow");
        }
        let mut made = TinyPy123d::new();
        made.edit(SYNC, |table| table.set(key, Arc::new(UInt64Array::from(vec![0, 1, u64::MAX, 3]))));
        made.refuses(&["below 4", "found 9223372036854775807"], "/sync.arrow");
        // An empty cell is no row.
        let mut made = TinyPy123d::new();
        made.edit(SYNC, |table| table.set(key, integers([Some(0), None, None, Some(3)])));
        assert_eq!(made.open().unwrap().recording().frames.len(), if key == EGO { 2 } else { FRAMES });
    }
}

/// The lists of a row are copied to each of its frames.
#[test]
fn lists_of_a_row_belong_to_few_frames() {
    for frames in [64, 65] {
        for key in [BOXES, LIGHTS] {
            let mut made = TinyPy123d::new();
            made.edit(SYNC, |table| {
                let times = integers((0..frames).map(|frame| FIRST_US + 100_000 * frame));
                let rows = || integers((0..frames).map(|_| 2));
                let columns = [("sync.timestamp_us", times), (EGO, rows()), (key, rows())];
                table.columns = columns.map(|(name, values)| (name.to_owned(), values)).into();
            });
            if frames == 65 {
                let expected =
                    format!("expected a row in at most 64 frames in column {key}, found row 2 in 65 frames");
                made.refuses(&[&expected], "/sync.arrow");
            } else {
                assert_eq!(made.open().unwrap().recording().frames.len(), 64);
            }
        }
    }
}

fn times(offsets: [i64; FRAMES]) -> ArrayRef {
    integers(offsets.map(|offset| FIRST_US + offset))
}

#[test]
fn times_must_increase() {
    all_refused(&[
        (
            SYNC,
            |t| t.set("timestamp_us", times([0, 1, 1, 2])),
            &["times that increase", "before 1700000000000001 in row 2"],
        ),
        (SYNC, |t| t.set("timestamp_us", times([0, 3, 1, 2])), &["times that increase", "in row 2"]),
        (EGO, |t| t.set("timestamp_us", times([0, 1, 2, 1])), &["times that increase", "in row 3"]),
        (FRONT, |t| t.set("timestamp_us", times([1, 0, 2, 3])), &["times that increase", "in row 1"]),
        (LIDAR, |t| t.set("end_timestamp_us", times([1, 0, 2, 3])), &["times that increase", "in row 1"]),
        (
            SYNC,
            |t| t.set("timestamp_us", integers([0, 1, 2, i64::MAX])),
            &["times in microseconds", "in row 3"],
        ),
        (
            SYNC,
            |t| t.set("timestamp_us", integers([i64::MIN, 1, 2, 3])),
            &["times in microseconds", "in row 0"],
        ),
        (
            EGO,
            |t| t.set("timestamp_us", integers([0, 1, 2, i64::MAX])),
            &["times in microseconds", "in row 3"],
        ),
        (
            FRONT,
            |t| t.set("timestamp_us", integers([i64::MIN, 1, 2, 3])),
            &["times in microseconds", "in row 0"],
        ),
        (
            LIDAR,
            |t| t.set("end_timestamp_us", integers([i64::MIN, 1, 2, 3])),
            &["times in microseconds", "in row 0"],
        ),
        (
            SYNC,
            |t| t.columns.iter_mut().for_each(|column| column.1 = column.1.slice(0, 0)),
            &["at least one frame", "none"],
        ),
    ]);
    // Rows of other tables may have equal times.
    let mut made = TinyPy123d::new();
    made.edit(EGO, |t| t.set("timestamp_us", times([0, 100_000, 100_000, 300_000])));
    made.edit(FRONT, |t| t.set("timestamp_us", times([0, 100_000, 100_000, 300_000])));
    assert_eq!(made.open().unwrap().recording().frames.len(), FRAMES);
}

/// Vectors of poses, of which the one in row 2 has another number.
fn poses<const N: usize>(place: usize, value: f64) -> [[f64; N]; FRAMES] {
    let mut rows = [std::array::from_fn(|i| if i == 3 || i > 6 { 1.0 } else { 0.0 }); FRAMES];
    rows[2][place] = value;
    rows
}

fn boxes(place: usize, value: f64) -> ArrayRef {
    vector_lists(&poses::<10>(place, value).map(|row| vec![poses::<10>(0, 0.0)[0], row]))
}

#[test]
fn poses_must_be_valid() {
    const UNIT: &str = "expected a unit quaternion (w x y z), found length 2 in ";
    const FINITE: &str = "expected finite numbers in a pose, found ";
    const FAR: &str = "expected coordinates of at most ";
    all_refused(&[
        (
            EGO,
            |t| t.set("imu_se3", vectors(poses::<7>(3, 2.0))),
            &[UNIT, "row 2 of column ego_state_se3.imu_se3"],
        ),
        (EGO, |t| t.set("imu_se3", vectors(poses::<7>(0, f64::NAN))), &[FINITE, "NaN in row 2 of column"]),
        (EGO, |t| t.set("imu_se3", vectors(poses::<7>(2, 1e9))), &[FAR, "row 2 of column"]),
        (
            EGO,
            |t| {
                t.set(
                    "imu_se3",
                    vectors([Some([1.0; 7]), None, None, None].map(|row| row.map(|_| poses::<7>(0, 0.0)[0]))),
                )
            },
            &["expected a pose, found none in row 1 of column ego_state_se3.imu_se3"],
        ),
        (
            FRONT,
            |t| t.set("camera_to_global_se3", vectors(poses::<7>(3, 2.0))),
            &[UNIT, "row 2 of column camera.pcam_f0."],
        ),
        (
            FRONT,
            |t| t.set("camera_to_global_se3", vectors(poses::<7>(6, f64::INFINITY))),
            &[FINITE, "inf in row 2"],
        ),
        (
            FRONT,
            |t| t.about(|v| v["camera_to_imu_se3"][3] = 9.0.into()),
            &["a unit quaternion", "camera_to_imu_se3"],
        ),
        (
            LIDAR,
            |t| t.about(|v| v["2"]["lidar_to_imu_se3"][3] = 9.0.into()),
            &["a unit quaternion", "lidar_to_imu_se3"],
        ),
        (BOXES, |t| t.set("bounding_box_se3", boxes(3, 2.0)), &[UNIT, "box 1 of row 2"]),
        (BOXES, |t| t.set("bounding_box_se3", boxes(1, f64::NAN)), &[FINITE, "NaN in box 1 of row 2"]),
        (BOXES, |t| t.set("bounding_box_se3", boxes(1, -1e9)), &[FAR, "box 1 of row 2"]),
        (BOXES, |t| t.set("bounding_box_se3", boxes(9, f64::NAN)), &["NaN", "box 1 of row 2"]),
        (BOXES, |t| t.set("bounding_box_se3", boxes(7, 1e6)), &["box 1 of row 2"]),
    ]);
}

#[test]
fn boxes_without_a_size_are_counted() {
    for size in [0.0, -4.0, 1e-9] {
        let mut made = TinyPy123d::new();
        made.edit(BOXES, |t| t.set("bounding_box_se3", boxes(8, size)));
        let reader = made.open().unwrap();
        let log = reader.recording();
        assert_eq!((log.notes["boxes without a size"], log.gaps.len()), (1, 1));
        assert_eq!(log.frames.iter().map(|frame| frame.boxes.len()).collect::<Vec<_>>(), [2, 2, 1, 2]);
    }
}

#[test]
fn lists_must_match() {
    all_refused(&[
        (
            BOXES,
            |t| t.set("label", integer_lists::<UInt16Type>(vec![vec![10]; FRAMES])),
            &["a box, a token and a label of each actor in row 0", "lists of 2, 2 and 1"],
        ),
        (
            BOXES,
            |t| t.set("track_token", text_lists(&vec![vec!["a", "b", "c"]; FRAMES])),
            &["lists of 2, 3 and 2"],
        ),
        (
            LIGHTS,
            |t| t.set("status", integer_lists::<UInt8Type>(vec![vec![0, 1]; FRAMES])),
            &["a state per lane", "1 lanes and 2 states in row 0"],
        ),
    ]);
    let mut made = TinyPy123d::new();
    made.edit(BOXES, |t| t.set("num_lidar_points", integer_lists::<UInt16Type>(vec![vec![5]; FRAMES])));
    let log = made.open().unwrap();
    assert_eq!(log.box_points().unwrap()[0], [None, Some(5)]);
    assert_eq!(log.recording().notes["boxes with an unknown number of LiDAR points"], FRAMES);
    // A track may have one box in a frame.
    made.edit(BOXES, |t| t.set("track_token", text_lists(&vec![vec!["a", "a"]; FRAMES])));
    let notes = made.open().unwrap().recording().notes.clone();
    assert_eq!(notes["boxes of a track that has another one in the frame"], FRAMES);
}

#[test]
fn unknown_labels_and_states_are_counted() {
    let noted = |made: &TinyPy123d, note: &str| {
        let reader = made.open().unwrap();
        let log = reader.recording();
        let categories = log.tracks.iter().map(|track| track.category.clone()).collect::<Vec<_>>().join(" ");
        (log.notes.get(note).copied(), categories)
    };
    let mut made = TinyPy123d::new();
    made.edit(BOXES, |t| t.about(|v| v["box_detection_label_class"] = "mine.OtherLabel".into()));
    let note = "boxes of the unknown category 10 of mine.OtherLabel (read as objects)";
    assert_eq!(noted(&made, note), (Some(FRAMES), "movable_object movable_object".to_owned()));
    let mut made = TinyPy123d::new();
    made.edit(BOXES, |t| t.set("label", integer_lists::<UInt16Type>(vec![vec![23, 0]; FRAMES])));
    let note = "boxes of the unknown category 23 of py123d.parser.registry.NuScenesBoxDetectionLabel \
        (read as objects)";
    assert_eq!(noted(&made, note), (Some(FRAMES), "vehicle.car movable_object".to_owned()));
    let mut made = TinyPy123d::new();
    made.edit(LIGHTS, |t| t.set("status", integer_lists::<UInt8Type>(vec![vec![5]; FRAMES])));
    assert_eq!(noted(&made, "traffic lights of an unknown state or lane").0, Some(FRAMES));
}

#[test]
fn cameras_must_be_valid() {
    all_refused(&[
        (
            FRONT,
            |t| t.about(|v| v["width"] = 0.into()),
            &["a size of 1 to", "found 48x0 in the metadata of PCAM_F0"],
        ),
        (FRONT, |t| t.about(|v| v["height"] = u32::MAX.into()), &["a size of 1 to", "4294967295x64"]),
        (FRONT, |t| t.about(|v| v["intrinsics"][0] = 0.0.into()), &["invertible intrinsics", "fx 0.0"]),
        (
            FRONT,
            |t| t.about(|v| v["intrinsics"] = vec![1.0; 4].into()),
            &["intrinsics fx fy cx cy skew", "[1.0, 1.0, 1.0, 1.0]"],
        ),
        (FRONT, |t| t.about(|v| v["distortion"] = vec![1.0; 4].into()), &["distortion k1 k2 p1 p2 k3"]),
    ]);
    for (field, value) in [("camera_model", "spherical".into()), ("intrinsics", serde_json::Value::Null)] {
        let mut made = TinyPy123d::new();
        made.edit(FRONT, |t| t.about(|v| v[field] = value));
        let reader = made.open().unwrap();
        let log = reader.recording();
        assert_eq!((log.cameras[0].as_str(), log.cameras.len(), log.rig.len()), ("PCAM_L0", 1, 1));
        let model = if field == "camera_model" { "spherical" } else { "pinhole" };
        let note = format!("cameras without intrinsics, or of the unknown model {model} (left out)");
        assert_eq!(log.notes[&note], 1);
        assert!(log.frames.iter().all(|frame| frame.images.len() == 1 && frame.images[0].channel == 0));
    }
}

#[test]
fn names_must_be_names_of_files() {
    let long = "x".repeat(129);
    for name in ["..", ".", "", "a/b", "../x", "a\\b", "a\u{1b}[2Jb", long.as_str()] {
        // They are parts of the name of the map.
        for field in ["location", "dataset"] {
            let mut made = TinyPy123d::new();
            std::fs::remove_file(made.path(MAP)).unwrap();
            made.edit(SYNC, |table| {
                table.remove(LEFT);
                table.about(|about| about[field] = name.into());
            });
            std::fs::remove_file(made.path(LEFT)).unwrap();
            made.refuses(&["expected a name "], "/sync.arrow");
        }
        // Columns of `sync` are names of tables.
        let mut made = TinyPy123d::new();
        made.edit(SYNC, |table| table.columns.push((format!("{name}/"), integers(0..FRAMES as i64))));
        made.refuses(&["expected a name ", "as the key of a table"], "/sync.arrow");
    }
    for (key, parts) in [
        ("camera.cache", "a name other than"),
        ("camera.a\u{7}", "control characters"),
        ("camera.", "1 to 128"),
    ] {
        let made = TinyPy123d::new();
        std::fs::rename(made.path(FRONT), made.path(key)).unwrap();
        assert_message(&made.open().err().unwrap(), &["expected ", parts], ".arrow");
    }
    let made = TinyPy123d::new();
    std::fs::copy(made.path(FRONT), made.path("camera.PCAM_F0")).unwrap();
    made.refuses(
        &["bytes or frame numbers in column camera.PCAM_F0.data, found none"],
        "/camera.PCAM_F0.arrow",
    );
    let mut table = made.tables[FRONT].clone();
    table.columns.iter_mut().for_each(|(name, _)| *name = name.replace("pcam_f0", "PCAM_F0"));
    table.write(&made.path("camera.PCAM_F0")).unwrap();
    made.refuses(&["expected cameras of different names, found PCAM_F0 of "], ".arrow");
}
