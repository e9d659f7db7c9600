use glam::{DVec2, DVec3};
use serde_json::json;

use super::Command;
use crate::dataset::{ActorEdits, ChangedLog, Class, Frame, Recording, Track, TrackBox};
use crate::dataset::{DatasetError, ImageRecord, LogReader, Sweep, SweepRecord};
use crate::geometry::{Cuboid, Pose};

const SIZE: DVec3 = DVec3::new(4.0, 2.0, 1.5);

/// Eleven frames at 10 Hz. The ego drives along x at 10 m/s on a slope of 1 in 10; car `b` is 20 m ahead of
/// its first place and drives at 5 m/s to the left; `c` is parked at (5, 5) in the first six frames.
fn log() -> Recording {
    let track = |id: &str| Track {
        id: id.to_owned(),
        category: "vehicle.car".to_owned(),
        class: Class::MotorVehicle,
    };
    let cuboid = |x: f64, y: f64, yaw: f64| {
        Cuboid::new(Pose::from_yaw(yaw, DVec3::new(x, y, x / 10.0 + SIZE.z / 2.0)), SIZE).unwrap()
    };
    let frame = |i: usize| {
        let t_s = i as f64 / 10.0;
        let left = cuboid(20.0, 5.0 * t_s, std::f64::consts::FRAC_PI_2);
        let moving = TrackBox { track: 0, cuboid: left };
        let parked = TrackBox { track: 1, cuboid: cuboid(5.0, 5.0, 0.0) };
        let boxes = [moving, parked].into_iter().take(if i < 6 { 2 } else { 1 }).collect();
        let global_from_ego = Pose::from_yaw(0.0, DVec3::new(10.0 * t_s, 0.0, t_s));
        let (sweeps, images, between_images) = Default::default();
        Frame { t_us: 100_000 * i as i64, global_from_ego, sweeps, images, between_images, boxes }
    };
    let tracks = ["b", "c"].map(track).to_vec();
    Recording { name: "log".into(), tracks, frames: (0..11).map(frame).collect(), ..Recording::default() }
}

struct Reader(Recording);

impl LogReader for Reader {
    fn recording(&self) -> &Recording {
        &self.0
    }

    fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
        unreachable!("no sweeps")
    }

    fn read_image(&self, _: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        unreachable!("no images")
    }
}

fn edited(edits: &serde_json::Value) -> Result<Recording, String> {
    let edits: ActorEdits = serde_json::from_value(edits.clone()).map_err(|error| error.to_string())?;
    let reader = std::sync::Arc::new(Reader(log()));
    let changed = ChangedLog::with_edits(reader, &edits).map_err(|error| error.to_string())?;
    Ok(changed.recording().clone())
}

fn changed(changes: serde_json::Value) -> Recording {
    edited(&json!({"changes": changes})).unwrap()
}

/// Returns x and y of a track's box in each frame, rounded to micrometers.
fn places(log: &Recording, id: &str) -> Vec<Option<[f64; 2]>> {
    let track = log.tracks.iter().position(|track| track.id == id).unwrap();
    let place = |frame: &Frame| {
        let at: DVec2 = frame.cuboid_of(track)?.pose.translation.truncate();
        Some(at.to_array().map(|part| (part * 1e6).round() / 1e6))
    };
    log.frames.iter().map(place).collect()
}

#[test]
fn inserted_actors_stand_on_the_ground_of_the_road() {
    let at = json!({"in": {"ego": {"after_s": 0.5}}, "x_m": 3.0, "y_m": -2.0, "yaw_deg": 90.0});
    let insert = json!({"insert": {"category": "vehicle.car", "size_m": [4.5, 1.8, 1.6], "at": at}});
    let log = changed(
        json!([{"track": "a", "action": insert, "start": {"after_s": 0.3}, "end": {"t_us": 600_000}}]),
    );
    assert_eq!(log.tracks.iter().map(|t| t.id.as_str()).collect::<Vec<_>>(), ["a", "b", "c"]);
    let standing = Some([8.0, -2.0]);
    let expected = (0..11).map(|i| standing.filter(|_| (3..6).contains(&i))).collect::<Vec<_>>();
    assert_eq!(places(&log, "a"), expected);
    let cuboid = log.frames[4].cuboid_of(0).unwrap();
    assert!((cuboid.pose.translation.z - (0.8 + 0.8)).abs() < 1e-9, "{cuboid:?}");
    assert!((cuboid.pose.yaw_rad() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    // The others have other numbers, but the same boxes.
    let source = self::log();
    assert_eq!((places(&log, "b"), places(&log, "c")), (places(&source, "b"), places(&source, "c")));
    assert!(log.frames.iter().all(|frame| frame.boxes.is_sorted_by_key(|item| item.track)));
    assert_ne!(log.fingerprint(), source.fingerprint());
}

#[test]
fn removed_moved_and_shifted_actors() {
    let log = changed(json!([
        {"track": "b", "action": {"shift": {"forward_m": 1.0, "left_m": 2.0}}},
        {"track": "b", "action": "remove", "start": {"after_s": 0.4}, "end": {"after_s": 0.6}},
        {"track": "c", "action": {"move": {"in": "global", "x_m": 1.0, "y_m": 2.0}},
         "start": {"after_s": 0.9}},
    ]));
    // Forward is +y for the car that drives to the left.
    let moved = |i: usize| Some([18.0, 0.5 * i as f64 + 1.0]).filter(|_| !(4..6).contains(&i));
    assert_eq!(places(&log, "b"), (0..11).map(moved).collect::<Vec<_>>());
    let parked = |i: usize| match i {
        0..6 => Some([5.0, 5.0]),
        9.. => Some([1.0, 2.0]),
        _ => None,
    };
    assert_eq!(places(&log, "c"), (0..11).map(parked).collect::<Vec<_>>());
}

#[test]
fn paths_begin_where_the_actor_is_and_go_on_after_the_log() {
    let points =
        json!([{"x_m": 0.0, "y_m": 0.0, "speed_mps": 0.0}, {"x_m": 5.0, "y_m": 0.0, "speed_mps": 10.0}]);
    let log = changed(json!([
        {"track": "b", "action": {"path": {"in": "actor", "points": points}}, "start": {"after_s": 0.2}},
    ]));
    // From (20, 1) along +y: 5 m/s² for 1 s.
    let moved = |i: usize| {
        let since_s = (i as f64 - 2.0) / 10.0;
        Some([20.0, if i < 2 { 0.5 * i as f64 } else { 1.0 + 5.0 * since_s * since_s }])
            .map(|at| at.map(|part| (part * 1e6).round() / 1e6))
    };
    assert_eq!(places(&log, "b"), (0..11).map(moved).collect::<Vec<_>>());
    let (script, triggers) = (&log.script, log.script.timed());
    let later = script.box_at(0, 2_200_000, &triggers).unwrap().pose.translation;
    assert!(later.truncate().distance(DVec2::new(20.0, 16.0)) < 1e-9, "{later}");
    let command = |t_us: i64| script.command(0, t_us, &triggers);
    assert_eq!([0, 199_999, 200_000].map(command), [Command::Free, Command::Free, Command::Script]);
    assert_eq!(script.command(1, 0, &triggers), Command::Free);
}

#[test]
fn conditions_are_met_by_the_recorded_ego() {
    // The ego is within 12 m of (20, y) from x = 9.1 on: at frame 10; within 4 m of (9, 0) from x = 5.
    let near = json!({"ego_within": {"distance_m": 4.0, "point_m": [9.0, 0.0]}});
    let log = changed(json!([
        {"track": "b", "action": "remove", "start": near,
         "end": {"ego_within": {"distance_m": 11.5, "track": "b"}}},
        {"track": "c", "action": "remove", "start": {"ego_within": {"distance_m": 5.5}}},
    ]));
    let there = |id: &str| places(&log, id).iter().map(Option::is_some).collect::<Vec<_>>();
    assert_eq!(there("b"), (0..11).map(|i| i < 5).collect::<Vec<_>>(), "its end waits for it to be there");
    // (5, 5) is within 5.5 m of (x, 0) for x from 2.7 on.
    assert_eq!(there("c"), (0..11).map(|i| i < 3).collect::<Vec<_>>());
    let triggers = log.script.recorded(&log, i64::MAX);
    let known = log.script.known_at(&triggers, 400_000);
    assert_eq!(serde_json::to_value(&triggers).unwrap(), json!([[500_000, null], [300_000, null]]));
    assert_eq!(serde_json::to_value(&known).unwrap(), json!([[null, null], [300_000, null]]));
}

#[test]
fn edits_of_nothing_leave_the_log_as_it_is() {
    assert_eq!(edited(&json!({})).unwrap(), log());
    assert_eq!(edited(&json!({"changes": []})).unwrap().fingerprint(), log().fingerprint());
}

#[test]
fn sizes_keep_the_ground() {
    let log = edited(&json!({"size_m": {"c": [6.0, 2.5, 3.5]}})).unwrap();
    let cuboid = log.frames[0].cuboid_of(1).unwrap();
    assert_eq!((cuboid.size, cuboid.pose.translation.z), (DVec3::new(6.0, 2.5, 3.5), 0.5 + 1.75));
}

#[test]
fn impossible_changes_are_refused() {
    let at = json!({"in": "global", "x_m": 0.0, "y_m": 0.0});
    let insert =
        |category: &str| json!({"insert": {"category": category, "size_m": [4.0, 2.0, 1.5], "at": at}});
    let path = |points: serde_json::Value| json!({"path": {"in": "actor", "points": points}});
    let point = |x: f64, speed: f64| json!({"x_m": x, "y_m": 0.0, "speed_mps": speed});
    for (change, expected) in [
        (
            json!({"track": "x", "action": "remove"}),
            "expected a track of log log or an inserted one in change 1",
        ),
        (
            json!({"track": "b", "action": insert("vehicle.car")}),
            "expected a track that the log does not have",
        ),
        (json!({"track": "x", "action": insert("spaceship")}), "expected a category as in nuScenes"),
        (
            json!({"track": "x", "action": {"insert": {"at": at}}}),
            "expected a category, or a track to look like in change 1, of track x, found none",
        ),
        (
            json!({"track": "b", "action": "remove", "start": {"after_s": 2.0}}),
            "expected a time of the log (0 to",
        ),
        (
            json!({"track": "b", "action": "remove", "start": {"after_s": 0.5}, "end": {"after_s": 0.5}}),
            "expected an end after the start at 500000 us",
        ),
        (
            json!({"track": "b", "action": path(json!([point(0.0, 1.0)]))}),
            "expected a path of two or more points",
        ),
        (
            json!({"track": "c", "action": path(json!([point(0.0, 1.0), point(1.0, 1.0)])),
                   "start": {"after_s": 0.9}}),
            "expected an actor with a box at the start",
        ),
        (
            json!({"track": "b", "action": "remove", "start": {"ego_within": {"distance_m": -1.0}}}),
            "expected a distance of more than 0",
        ),
        (
            json!({"track": "b", "action": {"move": {"in": "global", "x_m": 1e9, "y_m": 0.0}}}),
            "expected a place at most 100000 m away",
        ),
        (json!({"track": "b", "action": "vanish"}), "unknown variant `vanish`"),
        (json!({"track": "b", "action": "remove", "from": 3}), "unknown field `from`"),
        (json!({"track": "b", "action": "remove", "start": {"after": 3}}), "unknown variant `after`"),
    ] {
        let message = edited(&json!({"changes": [change]})).unwrap_err();
        assert!(message.starts_with(expected), "{message}");
    }
    let message = edited(&json!({"size_m": {"c": [0.0, 1.0, 1.0]}})).unwrap_err();
    assert!(message.starts_with("expected sizes of boxes"), "{message}");
    let message = edited(&json!({"moves": []})).unwrap_err();
    assert!(message.starts_with("unknown field `moves`"), "{message}");
}
