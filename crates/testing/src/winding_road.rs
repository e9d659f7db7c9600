//! A synthetic log: an ego on a winding road uphill, with other actors around it.

use glam::{DQuat, DVec2, DVec3};
use point_skeleton::dataset::{Class, Frame, Recording, Track, TrackBox, TrafficLight};
use point_skeleton::geometry::{Cuboid, Pose};
use pskel_sim::{Rates, Scenario, SimOptions, Simulation};

/// Start of the road, global meters.
pub const START: DVec3 = DVec3::new(664_000.0, 3_997_000.0, 100.0);
pub const FIRST_US: i64 = 1_600_000_000_000_000;
/// Speed of the ego, meters per second.
pub const SPEED_MPS: f64 = 8.0;
/// Rise per meter.
const SLOPE: f64 = 0.03;
/// Track ids and categories, in track order.
pub const TRACKS: [(&str, &str); 6] = [
    ("brief", "vehicle.car"),
    ("cone", "movable_object.trafficcone"),
    ("lead", "vehicle.car"),
    ("oncoming", "vehicle.truck"),
    ("parked", "vehicle.car"),
    ("walker", "human.pedestrian.adult"),
];

/// Returns the yaw of the road at a station in meters.
fn yaw(station_m: f64) -> f64 {
    0.4 + 0.3 * (station_m / 40.0).sin()
}

/// Returns the pose beside the road's center line at a station and an offset to the left, meters. Integrates
/// by Simpson's rule with steps of at most half a meter.
pub fn road(station_m: f64, left_m: f64) -> Pose {
    let count = 2 * (station_m.abs().ceil() as usize + 1);
    let h = station_m / count as f64;
    let weight = |i: usize| if i == 0 || i == count { 1.0 } else { 2.0 + 2.0 * (i % 2) as f64 };
    let sum: DVec2 = (0..=count).map(|i| DVec2::from_angle(yaw(i as f64 * h)) * weight(i)).sum();
    let place = sum * (h / 3.0) + DVec2::from_angle(yaw(station_m)).perp() * left_m;
    let rotation = DQuat::from_rotation_z(yaw(station_m)) * DQuat::from_rotation_y(-SLOPE.atan());
    Pose { rotation, translation: START + place.extend(station_m * SLOPE) }
}

/// Returns a log with frames at times in microseconds since the start.
pub fn log_at(times_us: &[i64]) -> Recording {
    let size = DVec3::new(4.4, 1.8, 1.5);
    let turned = DQuat::from_rotation_z(std::f64::consts::PI);
    let boxes = |t: f64| {
        let at = |track: usize, station_m: f64, left_m: f64, back: bool| {
            let mut pose = road(station_m, left_m);
            pose.rotation = if back { (pose.rotation * turned).normalize() } else { pose.rotation };
            TrackBox { track, cuboid: Cuboid { pose, size } }
        };
        let mut boxes = vec![
            at(1, 30.0, -8.0, false),
            at(2, 25.0 + SPEED_MPS * t, 0.0, false),
            at(3, 150.0 - 9.0 * t, 3.6, true),
            at(4, 60.0, -6.0, false),
            at(5, 10.0 + 1.4 * t, -9.0, false),
        ];
        if (2.0..5.0).contains(&t) {
            boxes.insert(0, at(0, SPEED_MPS * t - 15.0, 0.0, false));
        }
        boxes
    };
    let frame = |t_us: &i64| {
        let t = *t_us as f64 / 1e6;
        Frame {
            t_us: FIRST_US + t_us,
            global_from_ego: road(SPEED_MPS * t, 0.0),
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: boxes(t),
        }
    };
    let track = |(id, category): &(&str, &str)| Track {
        id: (*id).to_owned(),
        category: (*category).to_owned(),
        class: Class::from_category(category),
    };
    let light = |frame: usize| {
        let color = if frame < 50 { "red" } else { "green" };
        TrafficLight { frame, lane_connector: "7".into(), color: color.into() }
    };
    Recording {
        name: "made".into(),
        tracks: TRACKS.iter().map(track).collect(),
        frames: times_us.iter().map(frame).collect(),
        lights: (0..times_us.len()).map(light).collect(),
        ..Recording::default()
    }
}

/// Returns a log of ten frames per second.
pub fn log(seconds: i64) -> Recording {
    log_at(&(0..=seconds * 10).map(|i| i * 100_000).collect::<Vec<_>>())
}

pub fn scenario(log: &Recording) -> Scenario<'_> {
    Scenario { log, map: None, rates: Rates::default() }
}

pub fn start<'a>(log: &'a Recording, options: &SimOptions) -> Simulation<'a> {
    Simulation::new(&scenario(log), options.clone()).unwrap()
}
