//! Times of sweeps and images by another clock than that of the log.

use point_skeleton::dataset::LogReader;
use pskel_testing::av2_log::{TinyAv2, picture, sweep};
use pskel_testing::nuplan_log::{NuplanLog, token};

const HOUR_US: i64 = 3_600_000_000;

#[test]
fn images_of_another_clock_are_refused_in_nuplan() {
    for (change, found) in [
        (format!("timestamp + {HOUR_US}"), "later (1 h"),
        (format!("timestamp - {HOUR_US}"), "earlier (1 h"),
        ("timestamp / 1000".to_owned(), "milliseconds instead"),
    ] {
        let made = NuplanLog::new();
        let camera = token('c', 2);
        made.sql(&format!("UPDATE image SET timestamp = {change} WHERE camera_token = {camera}"));
        made.refuses(&["images of CAM_R1 within a second of the log's lidar_pc", found, "image "]);
    }
}

#[test]
fn sweeps_of_another_clock_are_refused_in_nuplan() {
    let made = NuplanLog::new();
    made.sql(&format!("UPDATE lidar_pc SET timestamp = timestamp + {HOUR_US}"));
    // The images and the ego poses agree.
    made.refuses(&["sweeps within a second of the log's ego poses and images", "lidar_pc at", "later (1 h"]);
    let made = NuplanLog::new();
    made.sql("UPDATE lidar_pc SET timestamp = timestamp / 1000 + rowid");
    made.refuses(&["lidar_pc at", "milliseconds instead of microseconds"]);
    let made = NuplanLog::new();
    made.sql(&format!(
        "UPDATE lidar_pc SET timestamp = timestamp + {HOUR_US}; UPDATE ego_pose SET timestamp = 0"
    ));
    made.refuses(&["within a second of the log's lidar_pc", "earlier (1 h"]);
    let made = NuplanLog::new();
    made.sql(&format!("UPDATE ego_pose SET timestamp = timestamp + {HOUR_US}"));
    let notes = made.open().unwrap().recording().notes.clone();
    let note = notes.iter().find(|(note, _)| note.contains("ego poses of another time")).unwrap();
    assert!(note.0.contains("later (1 h"), "{note:?}");
}

#[test]
fn images_with_another_time_than_their_ego_pose_are_noted_in_nuplan() {
    let made = NuplanLog::new();
    assert!(made.open().unwrap().recording().notes.keys().all(|note| !note.contains("another time")));
    let camera = token('c', 2);
    made.sql(&format!("UPDATE image SET timestamp = timestamp + 500000 WHERE camera_token = {camera}"));
    let notes = made.open().unwrap().recording().notes.clone();
    let note = notes.iter().find(|(note, _)| note.contains("another time")).unwrap();
    let begin = "ego poses of another time than their data of CAM_R1 (used; ego_pose ";
    assert!(note.0.starts_with(begin) && note.0.ends_with("is 0.500 s earlier)"), "{note:?}");
    assert_eq!(*note.1, 2);
}

#[test]
fn sensors_of_another_clock_are_refused_in_argoverse() {
    let image = |frame: usize| picture(frame, "ring_front_center");
    for (file, kind) in [(sweep(0), "sweeps"), (image(0), "images")] {
        let log = TinyAv2::new();
        let folder = log.path(&file).parent().unwrap().to_owned();
        for entry in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            let t_ns: i64 = entry.file_stem().unwrap().to_str().unwrap().parse().unwrap();
            let ending = entry.extension().unwrap().to_str().unwrap();
            std::fs::rename(&entry, folder.join(format!("{}.{ending}", t_ns + 1000 * HOUR_US))).unwrap();
        }
        let message = log.open().err().unwrap().to_string();
        for part in [format!("{kind} within a second of the annotated times").as_str(), "later (1 h"] {
            assert!(message.contains(part), "{message} without {part}");
        }
    }
}
