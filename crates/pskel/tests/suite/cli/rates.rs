//! Frames at other rates than the log's: interpolated poses and boxes, and `pskel render --hz`.

use glam::{DQuat, DVec3};
use point_skeleton::dataset::{Class, EgoTrack, Frame, Recording, Track, TrackBox};
use point_skeleton::geometry::{Cuboid, Pose};
use point_skeleton::scene::{EgoOffset, state_at};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FIRST_US, START, STEP_US, TinyLog, WIDTH};
use pskel_testing::npz;

const KEYFRAMES: usize = 5;
const FROM_US: i64 = 1_533_151_603_512_404;

fn turned(axis: DVec3, angle: f64) -> DQuat {
    DQuat::from_axis_angle(axis.normalize(), angle)
}

/// Returns the ego and one car at a keyframe; keyframes are not exactly half a second apart.
fn keyframe(index: usize) -> (i64, Pose, Cuboid) {
    let i = index as f64;
    let t_us = FROM_US + 500_000 * index as i64 + [0, 137, -2_911, 50_000, 499][index];
    let ego = Pose {
        rotation: turned(DVec3::new(0.1, -0.2, 1.0), 2.6 + 0.4 * i),
        translation: START + DVec3::new(5.0 * i, i * i, 0.1 * i),
    };
    let car = Pose {
        rotation: turned(DVec3::new(0.0, 0.05, 1.0), -1.1 * i),
        translation: START + DVec3::new(20.0 - i, 3.0 + 7.0 * i, 0.5),
    };
    (t_us, ego, Cuboid::new(car, DVec3::new(4.0 + 0.1 * i, 2.0, 1.5)).unwrap())
}

/// Returns a log of 2 Hz keyframes; a second track exists only in the first two.
fn log() -> Recording {
    let frame = |index: usize| {
        let (t_us, global_from_ego, cuboid) = keyframe(index);
        let boxes = if index < 2 { vec![0, 1] } else { vec![0] };
        let boxes = boxes.into_iter().map(|track| TrackBox { track, cuboid }).collect();
        let (sweeps, images, between_images) = Default::default();
        Frame { t_us, global_from_ego, sweeps, images, between_images, boxes }
    };
    let track =
        |id: &str| Track { id: id.into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
    let tracks = vec![track("a"), track("b")];
    Recording { tracks, frames: (0..KEYFRAMES).map(frame).collect(), ..Recording::default() }
}

/// Interpolates two poses independently: rotates by a fraction of the angle about the axis between them.
fn between(a: &Pose, b: &Pose, s: f64) -> Pose {
    let step = b.rotation * a.rotation.conjugate();
    let step = if step.w < 0.0 { -step } else { step };
    let (axis, angle) = step.to_axis_angle();
    Pose {
        rotation: DQuat::from_axis_angle(axis, angle * s) * a.rotation,
        translation: a.translation * (1.0 - s) + b.translation * s,
    }
}

/// Returns the distance between two poses, meters or radians, whichever is larger.
fn apart(a: &Pose, b: &Pose) -> f64 {
    // From the chord: an arccosine loses half the digits of small angles.
    let chord = (a.rotation - b.rotation).length().min((a.rotation + b.rotation).length());
    a.translation.distance(b.translation).max(2.0 * chord)
}

#[test]
fn keyframes_at_2_hz_become_12_hz() {
    let log = log();
    let ego = EgoTrack::new(&log);
    let (first, last) = (keyframe(0).0, keyframe(KEYFRAMES - 1).0);
    let times: Vec<i64> =
        (0..).map(|i: i64| first + (i * 1_000_000 + 6) / 12).take_while(|t| *t <= last).collect();
    assert_eq!(times.len(), 25);
    let mut moved = 0.0_f64;
    for t_us in times {
        let state = state_at(&log, &ego, t_us, EgoOffset::default()).unwrap();
        let after = (1..KEYFRAMES).find(|i| keyframe(*i).0 >= t_us).unwrap();
        let ((t0, ego0, car0), (t1, ego1, car1)) = (keyframe(after - 1), keyframe(after));
        let s = (t_us - t0) as f64 / (t1 - t0) as f64;
        // Coordinates reach 4 000 000 m, where the spacing of f64 is 5e-10 m.
        assert!(apart(&state.global_from_ego, &between(&ego0, &ego1, s)) < 2e-9, "{t_us}");
        let car = state.actors[0].cuboid;
        assert!(apart(&car.pose, &between(&car0.pose, &car1.pose, s)) < 2e-9, "{t_us}");
        assert!((car.size - (car0.size * (1.0 - s) + car1.size * s)).length() < 1e-12);
        // The other track ends with the second keyframe.
        assert_eq!(state.actors.len(), if t_us <= keyframe(1).0 { 2 } else { 1 });
        moved = moved.max(apart(&car.pose, &car0.pose));
    }
    assert!(moved > 1.0);
    assert!(state_at(&log, &ego, last + 1, EgoOffset::default()).is_none());
}

#[test]
fn render_at_a_rate_covers_the_selected_frames() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let render = "render nuscenes:log --skeleton sk --format npz --splat 100:0 --out out";
    let summary = log.succeed(&format!("{render} --hz 12 --maps depth,instance"));
    assert!(summary.starts_with("rendered 13 frames, 26 camera views"), "{summary}");
    let index = log.json("out/index.json");
    assert_eq!(index["options"]["hz"], 12.0);
    for (i, frame) in index["frames"].as_array().unwrap().iter().enumerate() {
        let t_us = FIRST_US + (i as f64 * 1e6 / 12.0).round() as i64;
        assert_eq!((&frame["name"], &frame["t_us"]), (&json!(t_us.to_string()), &json!(t_us)));
        // The ego drives at 2 m/s; the car at 4 m/s, starting 10 m ahead.
        let seconds = (t_us - FIRST_US) as f64 * 1e-6;
        let x = frame["ego"][0][3].as_f64().unwrap();
        assert!((x - START.x - 2.0 * seconds).abs() < 1e-8, "{i}: {x}");
        assert_eq!(frame["actors"].as_array().unwrap().len(), 2);
        let meta = log.json(&format!("out/{t_us}/meta.json"));
        assert_eq!(meta["fps"], 12.0);
        for camera in meta["cameras"].as_array().unwrap() {
            assert_eq!(camera["global_from_ego"], frame["ego"]);
        }
        let maps = log.path(&format!("out/{t_us}/maps.npz"));
        let (instance, depth) =
            (npz::read::<u32>(&maps, "instance").data, npz::read::<f32>(&maps, "depth").data);
        let on_car = depth.iter().zip(&instance).filter(|(_, number)| **number == 1).map(|(d, _)| *d);
        let nearest = on_car.reduce(f32::min).unwrap();
        assert!((f64::from(nearest) - 10.0 - 2.0 * seconds).abs() < 1e-3, "{i}: {nearest}");
    }
    // Only the selected frames: from frame 1 to frame 2, at a rate that does not hit the end.
    log.succeed(&format!("{render}/part --hz 3 --frames 1..3 --ego-offset left_m=1"));
    let index = log.json("out/part/index.json");
    let names: Vec<String> =
        index["frames"].as_array().unwrap().iter().map(|f| f["name"].as_str().unwrap().into()).collect();
    let from = FIRST_US + STEP_US;
    assert_eq!(names, [from.to_string(), (from + 333_333).to_string()]);
    assert_eq!(index["frames"][0]["ego"][1][3], START.y + 1.0);
    // A single frame gives a single time.
    log.succeed(&format!("{render}/one --hz 100 --frames 1..2"));
    assert_eq!(log.json("out/one/index.json")["frames"].as_array().unwrap().len(), 1);
    assert_eq!(
        npz::read::<f32>(&log.path(&format!("out/one/{from}/maps.npz")), "depth").shape[2],
        WIDTH as usize
    );
}
