//! Records of the tables that are missing, or written in another way: skipped and counted as missing files
//! are, or understood.

use serde_json::{Value, json};

use super::gaps::{assert_policy, info};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FRAMES, TinyLog};
use pskel_testing::av2_log::{self, TinyAv2};
use pskel_testing::nuplan_log::{FRAMES as SHOTS, NuplanLog, RING, pickled, token};

const DATA: &str = "sweeps and images that refer to a missing record";
const BOXES: &str = "boxes that refer to a missing record";

/// Edits the records of a tiny log's table.
fn edit(log: &TinyLog, table: &str, edit: impl FnOnce(&mut Vec<Value>)) {
    let name = format!("log/v1.0-mini/{table}.json");
    let mut records = log.json(&name);
    edit(records.as_array_mut().unwrap());
    std::fs::write(log.path(&name), records.to_string()).unwrap();
}

/// Returns the first record of a table for which a field has a value.
fn record_with<'a>(records: &'a mut [Value], field: &str, value: &str) -> &'a mut Value {
    records.iter_mut().find(|record| record[field] == value).unwrap()
}

#[test]
fn missing_rows_of_nuscenes_skip_their_dependents() {
    // All data of the last sample share an ego pose.
    for (table, kind, frames) in [
        ("ego_pose", DATA, FRAMES - 1),
        ("calibrated_sensor", DATA, FRAMES),
        ("sensor", DATA, FRAMES),
        ("instance", BOXES, FRAMES),
        ("category", BOXES, FRAMES),
    ] {
        let log = TinyLog::new();
        edit(&log, table, |records| _ = records.pop());
        let root = log.path("");
        assert_policy(&root, "nuscenes:log", kind, &format!("whose {table} "), 0);
        let (json, _) = info(&root, "nuscenes:log");
        let gaps = json["gaps"].as_array().unwrap().iter();
        let count = gaps.filter(|gap| gap.as_str().unwrap().starts_with(kind)).count();
        assert_eq!((&json["frames"], &json["left_out"][kind]), (&frames.into(), &count.into()));
    }
}

#[test]
fn missing_rows_of_nuplan_skip_their_dependents() {
    let one = |table: &str, column: &str, of: &str| {
        format!("DELETE FROM {table} WHERE token = (SELECT {column} FROM {of} ORDER BY rowid LIMIT 1);")
    };
    for (statement, table, kind, frames) in [
        (one("ego_pose", "ego_pose_token", "lidar_pc"), "ego_pose", DATA, SHOTS - 1),
        (one("ego_pose", "ego_pose_token", "image"), "ego_pose", DATA, SHOTS),
        ("DELETE FROM camera WHERE channel = 'CAM_B0';".to_owned(), "camera", DATA, SHOTS),
        (one("track", "track_token", "lidar_box"), "track", BOXES, SHOTS),
        (one("category", "category_token", "track"), "category", BOXES, SHOTS),
        (
            format!("UPDATE lidar_box SET track_token = NULL WHERE token = {};", token('b', 10)),
            "track",
            BOXES,
            SHOTS,
        ),
        (
            format!("UPDATE lidar_pc SET lidar_token = x'00ff' WHERE token = {};", token('p', 1)),
            "lidar",
            DATA,
            SHOTS,
        ),
    ] {
        let nuplan = NuplanLog::new();
        nuplan.sql(&statement);
        let (root, log) = (nuplan.path(""), format!("nuplan:{}", nuplan.database().display()));
        assert_policy(&root, &log, kind, &format!("whose {table} "), 0);
        assert_eq!(info(&root, &log).0["frames"], frames, "{statement}");
    }
}

#[test]
fn missing_rows_of_argoverse_skip_their_dependents() {
    let poses = "city_SE3_egovehicle.feather";
    let extrinsics = "calibration/egovehicle_SE3_sensor.feather";
    for (table, rows, kind, named) in [
        (poses, 5, "annotated times without an ego pose", poses),
        (extrinsics, 6, "ring cameras without calibration", extrinsics),
        ("calibration/intrinsics.feather", 6, "ring cameras without calibration", "intrinsics.feather"),
    ] {
        let log = TinyAv2::new();
        log.edit(table, |columns| columns.iter_mut().for_each(|(_, column)| *column = column.slice(0, rows)));
        let root = log.path("");
        assert_policy(&root, &format!("av2:{}", root.display()), kind, named, 0);
    }
}

/// Times rounded by 64-bit floats, and clocks that differ by less than a millisecond.
#[test]
fn sweeps_of_argoverse_belong_to_the_nearest_frame_within_a_millisecond() {
    let key = |offset_ns: i64| {
        let log = TinyAv2::new();
        let moved = format!("sensors/lidar/{}.feather", av2_log::frame_ns(1) + offset_ns);
        std::fs::rename(log.path(&av2_log::sweep(1)), log.path(&moved)).unwrap();
        let root = log.path("");
        let (json, code) = info(&root, &format!("av2:{}", root.display()));
        assert_eq!(json["sweeps"], 3);
        (json["left_out"].as_object().unwrap().is_empty(), code)
    };
    for offset_ns in [1, -1, 64, -64, 1_000_000, -1_000_000] {
        assert_eq!(key(offset_ns), (true, Some(0)), "{offset_ns}");
    }
    for offset_ns in [1_000_001, -1_000_001] {
        assert_eq!(key(offset_ns), (false, Some(1)), "{offset_ns}");
    }
}

#[test]
fn an_empty_table_of_boxes_is_a_log_without_annotations() {
    let log = TinyLog::new();
    edit(&log, "sample_annotation", Vec::clear);
    assert_policy(&log.path(""), "nuscenes:log", "1 logs without annotations", "sample_annotation.json", 0);
    let nuplan = NuplanLog::new();
    nuplan.sql("DELETE FROM lidar_box;");
    let log = format!("nuplan:{}", nuplan.database().display());
    assert_policy(&nuplan.path(""), &log, "1 logs without annotations", "without actors", 0);
}

/// Coefficients of the lens under other names, in the calibration or in the sensor.
#[test]
fn distortion_under_other_names_is_noted_and_applied() {
    let coefficients = json!([-0.3, 0.1, 0.0, 0.0, 0.01]);
    for table in ["calibrated_sensor", "sensor"] {
        for key in
            ["distortion", "D", "distortion_coefficients", "dist_coeffs", "distCoeffs", "camera_distortion"]
        {
            let log = TinyLog::new();
            edit(&log, table, |records| {
                records.iter_mut().for_each(|record| record[key] = coefficients.clone())
            });
            let (json, _) = info(&log.path(""), "nuscenes:log");
            let note = format!(
                "cameras with {key}, whose images are read as rectified (--image-distortion apply if they \
                    are not)"
            );
            assert_eq!(json["left_out"], json!({ note: 2 }));
            let applied = log.run("build nuscenes:log --out out/sk --image-distortion apply");
            assert!(
                applied.status.success()
                    && !String::from_utf8_lossy(&applied.stdout).contains("cameras with")
            );
        }
    }
    let log = TinyLog::new();
    edit(&log, "calibrated_sensor", |records| {
        records.iter_mut().for_each(|record| record["undistortion"] = json!("a.bin"))
    });
    let (json, _) = info(&log.path(""), "nuscenes:log");
    assert_eq!(
        json["left_out"],
        json!({"cameras with undistortion, which is not read (lens distortion?)": 2})
    );
}

#[test]
fn marks_of_invalid_data_have_many_spellings() {
    let marked = |mark: Value| {
        let log = TinyLog::new();
        edit(&log, "sample_data", |records| {
            record_with(records, "token", "d1CAM_BACK")["is_valid"] = mark;
        });
        info(&log.path(""), "nuscenes:log").0["left_out"].clone()
    };
    for mark in [json!(false), json!("false"), json!("False"), json!("0"), json!("no"), json!(0), json!(0.0)]
    {
        let notes = marked(mark.clone());
        assert_eq!(notes["sweeps and images that are marked as invalid (is_valid; not used)"], 1, "{mark}");
    }
    for mark in [json!(true), json!("True"), json!("1"), json!("yes"), json!(1), json!(null)] {
        assert_eq!(marked(mark.clone()), json!({}), "{mark}");
    }
    for mark in [json!("maybe"), json!(2), json!([])] {
        let note = "sweeps and images whose is_valid is neither true nor false (used)";
        assert_eq!(marked(mark.clone()), json!({ note: 1 }), "{mark}");
    }
}

/// Writers without booleans, with times as text, with nulls for empty references, and sensors in capitals.
#[test]
fn other_spellings_of_values_yield_the_same_log() {
    type Edit = fn(&TinyLog);
    let whole = info(&TinyLog::new().path(""), "nuscenes:log").0;
    let edits: [Edit; 6] = [
        |log| {
            edit(log, "sample", |r| {
                r.iter_mut().filter(|r| r["next"] == "").for_each(|r| r["next"] = json!(null))
            })
        },
        |log| {
            edit(log, "sample", |r| {
                let last = r.iter_mut().filter(|r| r["next"] == "");
                last.for_each(|r| _ = r.as_object_mut().unwrap().remove("next"));
            })
        },
        |log| {
            for table in ["sample", "sample_data"] {
                edit(log, table, |r| {
                    r.iter_mut().for_each(|r| r["timestamp"] = json!(r["timestamp"].to_string()))
                });
            }
        },
        |log| edit(log, "sample_data", |r| r.iter_mut().for_each(|r| r["is_key_frame"] = json!(1))),
        |log| edit(log, "sample_data", |r| r.iter_mut().for_each(|r| r["is_key_frame"] = json!("True"))),
        |log| {
            edit(log, "sensor", |r| {
                let upper = |r: &Value| json!(r["modality"].as_str().unwrap().to_uppercase());
                r.iter_mut().for_each(|r| r["modality"] = upper(r))
            })
        },
    ];
    for (i, edit) in edits.into_iter().enumerate() {
        let log = TinyLog::new();
        edit(&log);
        assert_eq!(info(&log.path(""), "nuscenes:log"), (whole.clone(), Some(0)), "{i}");
    }
    let log = TinyLog::new();
    edit(&log, "sensor", |r| r.iter_mut().for_each(|r| r["modality"] = json!("laser")));
    let refused = log.run("info nuscenes:log");
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(message.contains("sensors of modality camera or lidar, found \"laser\" of "), "{message}");
    assert!(message.contains("sensor.json"), "{message}");
}

#[test]
fn distortion_of_nuplan_may_be_short_or_empty() {
    let log = |value: &str| {
        let nuplan = NuplanLog::new();
        nuplan.sql(&format!("UPDATE camera SET distortion = {value} WHERE channel = '{}';", RING[1]));
        info(&nuplan.path(""), &format!("nuplan:{}", nuplan.database().display()))
    };
    let note = "cameras without distortion (NULL), whose images are read as rectified";
    let (short, code) = log(&pickled(&[-0.3, 0.1, 0.0, 0.0]));
    assert_eq!((&short["left_out"][note], code), (&Value::Null, Some(0)));
    assert_eq!(log("NULL").0["left_out"][note], 1);
}
