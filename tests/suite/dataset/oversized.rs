//! Small files with large demands: endless SQL views, columns that unpack to gigabytes, corners shared by
//! many records, times whose differences overflow.

use std::sync::Arc;

use arrow_array::Float64Array;
use arrow_ipc::CompressionType;
use point_skeleton::dataset::nuscenes::{NuScenes, read_map_file};
use point_skeleton::dataset::{LogLocator, LogReader};
use pskel_testing::av2_log::{TinyAv2, sweep, write};
use pskel_testing::nuplan_log::NuplanLog;
use pskel_testing::tiny_log::TinyLog;
use serde_json::json;

#[test]
fn endless_views_are_aborted() {
    for (table, columns) in [("lidar_box", "other.*"), ("log", "other.*"), ("ego_pose", "other.*")] {
        let made = NuplanLog::new();
        made.sql(&format!(
            "ALTER TABLE {table} RENAME TO other; CREATE VIEW {table} AS WITH RECURSIVE n(i) AS
             (SELECT 0 UNION ALL SELECT i + 1 FROM n) SELECT {columns} FROM other, n;"
        ));
        let message = made.open().expect_err("an endless view").to_string();
        let given_up = message.contains("found interrupted") || message.contains("that fit into the file");
        assert!(given_up && message.ends_with(".db"), "{table}: {message}");
    }
}

#[test]
fn rejects_more_values_than_a_file_can_contain() {
    let made = NuplanLog::new();
    made.sql(
        "ALTER TABLE scenario_tag RENAME TO other; CREATE VIEW scenario_tag AS
         SELECT token, lidar_pc_token, hex(zeroblob(300000)) AS type FROM other;",
    );
    made.refuses(&["expected rows of scenario_tag that fit into the file, found more"]);
}

#[test]
fn rejects_columns_that_unpack_to_gigabytes() {
    let made = TinyAv2::new();
    let (dataset, path) = (made.open().unwrap(), made.path(&sweep(0)));
    // 40 MB of zeros in a few kilobytes.
    let zeros = Arc::new(Float64Array::from(vec![0.0; 1_000_000]));
    let columns =
        ["x", "y", "z", "intensity", "laser_number"].map(|name| (name.to_owned(), zeros.clone() as _));
    write(&path, columns.into(), Some(CompressionType::ZSTD));
    assert!(std::fs::metadata(&path).unwrap().len() < 20_000);
    let record = &dataset.recording().frames[0].sweeps[0];
    for message in [dataset.read_sweep(record).unwrap_err(), dataset.check_sweep(record).unwrap_err()] {
        let message = message.to_string();
        assert!(message.contains("columns that declare more than 16777216 bytes"), "{message}");
    }
}

#[test]
fn rejects_corners_shared_by_too_many_records() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.json");
    let map = |areas: usize| {
        let corners = ["a", "b", "c"].repeat(100);
        json!({
            "node": [{"token": "a", "x": 0, "y": 0}, {"token": "b", "x": 9, "y": 0}, {"token": "c", "x": 9,
            "y": 9}],
            "polygon": [{"token": "p", "exterior_node_tokens": corners}], "line": [], "lane": [],
            "ped_crossing": [],
            "drivable_area": [{"token": "d", "polygon_tokens": vec!["p"; areas]}], "stop_line": [],
            "road_divider": [], "lane_divider": [],
        })
    };
    std::fs::write(&path, map(8).to_string()).unwrap();
    assert_eq!(read_map_file(&path, "").unwrap().drivable_area.len(), 8);
    std::fs::write(&path, map(9).to_string()).unwrap();
    let message = read_map_file(&path, "").unwrap_err().to_string();
    assert!(message.contains("at most 8 records share on average, found more"), "{message}");
}

#[test]
fn rejects_times_of_other_millennia() {
    for (table, pointer) in [("sample", "/2/timestamp"), ("sample_data", "/0/timestamp")] {
        for t_us in [i64::MAX, i64::MIN] {
            let log = TinyLog::new();
            log.change(table, pointer, t_us.into());
            let message =
                NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, log.path("log")))
                    .unwrap_err();
            assert!(message.to_string().contains("a thousand years from 1970"), "{message}");
        }
    }
    let made = NuplanLog::new();
    made.sql("UPDATE lidar_pc SET timestamp = -9223372036854775808 WHERE rowid = 1");
    made.refuses(&["microseconds within a thousand years of 1970 as timestamp"]);
}
