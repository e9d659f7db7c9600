//! Poses and boxes interpolated between the frames of a log.

use glam::{DQuat, DVec3};
use point_skeleton::dataset::{Class, EgoTrack, Frame, Recording, Track, TrackBox};
use point_skeleton::geometry::{Cuboid, Pose};
use point_skeleton::scene::{EgoOffset, state_at};
use pskel_testing::tiny_log::START;

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
