//! Paths driven by the ego policies.

use glam::DVec2;
use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{EgoTrack, LogLocator, LogReader, Recording};
use point_skeleton::geometry::{Polyline, wrap_angle};
use pskel_sim::{
    EgoPolicy, EndReason, Instant, LocalPath, PathAnchor, Rates, Scenario, SimOptions, Simulation, Tracking,
};
use pskel_testing::shared::shared;
use pskel_testing::winding_road;
use pskel_town::{Town, TownOptions};

fn all(sim: &mut Simulation<'_>) -> Vec<Instant> {
    let mut instants = vec![(*sim.committed().get()).clone()];
    while sim.step().unwrap().is_some() {
        instants.push((*sim.committed().get()).clone());
    }
    instants
}

/// Returns the ego's offset to the left of the log's path, meters, from straight segments between all poses.
fn offset_m(log: &Recording, instant: &Instant) -> f64 {
    let track = EgoTrack::new(log);
    let line = Polyline::new(track.poses().iter().map(|(_, p)| p.translation.truncate())).unwrap();
    line.project(instant.ego.position_m(), 0.0..line.length_m()).offset_m
}

/// Checks the properties of a lane change in a rollout of 8.2 s after a warm-up of five plans.
fn assert_changes_lane(log: &Recording, rates: Rates, tracking: Tracking) {
    let steps = ((4.0 / rates.plan_hz + 8.2) * rates.sim_hz) as usize;
    let options =
        SimOptions { steps, warmup_frames: 5, ego: EgoPolicy::LaneChange, tracking, ..SimOptions::default() };
    let mut sim = Simulation::new(&Scenario { log, map: None, rates }, options).unwrap();
    let takeover = sim.takeover_step();
    let instants = all(&mut sim);
    assert_eq!(instants.len(), steps + 1);
    let last = instants.last().unwrap();
    assert!((last.ego.speed_mps - 10.0).abs() < 0.05, "{}", last.ego.speed_mps);
    let tail = 1.5 * rates.sim_hz;
    for instant in &instants[steps - tail as usize..] {
        let offset = offset_m(log, instant);
        assert!((offset + 3.5).abs() < 0.1, "{offset} at step {}", instant.step);
    }
    for pair in instants[takeover..].windows(2) {
        let (a, b) = (&pair[0].ego, &pair[1].ego);
        let dt = 1.0 / rates.sim_hz;
        // No jumps: the heading turns slowly, and the position follows from speed and heading.
        let turn = wrap_angle(b.heading_rad() - a.heading_rad());
        assert!(turn.abs() < 0.95 * dt, "{turn} at step {}", pair[1].step);
        let moved = b.position_m() - a.position_m();
        let led = DVec2::from_angle(a.heading_rad() + turn / 2.0) * ((a.speed_mps + b.speed_mps) / 2.0 * dt);
        assert!(moved.distance(led) < 0.03, "{moved} {led} at step {}", pair[1].step);
        assert!(b.acceleration_mps2.abs() < 1.5 + 0.6, "{}", b.acceleration_mps2);
    }
    let comfort = sim.metrics().comfort;
    assert!(comfort.comfortable, "{comfort:?}");
}

#[test]
fn a_lane_change_reaches_its_lane_in_comfort() {
    let log = winding_road::log(12);
    for tracking in [Tracking::Perfect, Tracking::Bicycle] {
        for rates in [Rates::default(), Rates::NUSCENES, Rates { sim_hz: 20.0, plan_hz: 5.0 }] {
            assert_changes_lane(&log, rates, tracking);
        }
    }
}

#[test]
fn a_lane_change_in_the_town_reaches_its_lane_in_comfort() {
    for seed in [3, 7] {
        let town =
            Town::new(&TownOptions { seed, frames: 50, size: [18, 32], ..TownOptions::default() }).unwrap();
        for tracking in [Tracking::Perfect, Tracking::Bicycle] {
            assert_changes_lane(town.recording(), Rates::default(), tracking);
        }
    }
}

#[test]
fn a_real_lane_change_reaches_its_lane_in_comfort() {
    let Some(shared) = shared("the PandaSet drive") else { return };
    let locator = LogLocator::new(
        &point_skeleton::dataset::nuscenes::FORMAT,
        shared.join("data/pandaset-002/nuscenes"),
    );
    let drive = NuScenes::open(&locator).unwrap();
    for tracking in [Tracking::Perfect, Tracking::Bicycle] {
        for rates in [Rates::default(), Rates::NUSCENES] {
            assert_changes_lane(drive.recording(), rates, tracking);
        }
    }
}

#[test]
fn a_lane_change_continues_after_the_log() {
    let log = winding_road::log(3);
    let options = SimOptions { steps: 120, ego: EgoPolicy::LaneChange, ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    let instants = all(&mut sim);
    assert_eq!(sim.ended(), Some(EndReason::Steps));
    let (a, b) = (&instants[100].ego, &instants[120].ego);
    assert!((a.position_m().distance(b.position_m()) - 20.0).abs() < 1e-6, "straight at 10 m/s");
    assert!((a.heading_rad() - b.heading_rad()).abs() < 1e-9);
    // Beyond the end of the log, the ground continues with the height and tilt of the last pose.
    let end = log.frames[30].global_from_ego;
    assert!((b.pose.translation.z - end.translation.z).abs() < 1e-9);
    assert!(((b.pose.rotation * glam::DVec3::X).z - (end.rotation * glam::DVec3::X).z).abs() < 1e-9);
}

#[test]
fn a_stationary_ego_starts_a_lane_change_smoothly() {
    let mut log = winding_road::log(12);
    let pose = log.frames[0].global_from_ego;
    log.frames.iter_mut().for_each(|f| f.global_from_ego = pose);
    let options = SimOptions { steps: 120, ego: EgoPolicy::LaneChange, ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    let instants = all(&mut sim);
    assert!(sim.metrics().comfort.comfortable, "{:?}", sim.metrics().comfort);
    let local = pose.inverse().transform_point(instants[120].ego.pose.translation);
    assert!((local.y + 3.5).abs() < 0.01 && local.x > 50.0, "{local}");
}

#[test]
fn forecasts_of_a_course_match_and_have_no_side_effects() {
    let log = winding_road::log(12);
    let options =
        SimOptions { steps: 60, warmup_frames: 3, ego: EgoPolicy::LaneChange, ..SimOptions::default() };
    let plain = all(&mut winding_road::start(&log, &options));
    let mut sim = winding_road::start(&log, &options);
    let mut seen = 0;
    while let Some(outcome) = sim.step().unwrap() {
        assert_eq!(
            outcome.plan.is_some(),
            sim.committed().get().step > 4 && sim.committed().get().step % 2 == 1
        );
        if sim.committed().get().step > 4 {
            // Within the range of the plan, the forecast of the ego and of the logged actors comes true.
            for forecast in sim.forecast(9).iter().filter(|f| f.get().step <= 60) {
                let (expected, happened) = (forecast.get(), &plain[forecast.get().step]);
                assert_eq!(expected.ego.pose, happened.ego.pose, "step {}", expected.step);
                assert_eq!(expected.actors, happened.actors);
                seen += 1;
            }
        }
        assert_eq!(sim.committed().get().ego, plain[sim.committed().get().step].ego);
    }
    assert!(seen > 100, "{seen}");
}

#[test]
fn the_warm_up_follows_the_log() {
    let log = winding_road::log(6);
    for ego in [EgoPolicy::Straight, EgoPolicy::LaneChange, EgoPolicy::RightThenBack, EgoPolicy::Cosine] {
        let options = SimOptions { steps: 30, warmup_frames: 6, ego, ..SimOptions::default() };
        let mut sim = winding_road::start(&log, &options);
        assert_eq!(sim.takeover_step(), 10);
        let instants = all(&mut sim);
        for (instant, frame) in instants.iter().zip(&log.frames).take(11) {
            assert_eq!(instant.ego.pose, frame.global_from_ego);
        }
        assert_ne!(instants[12].ego.pose, log.frames[12].global_from_ego);
    }
}

#[test]
fn straight_policy_drives_straight() {
    let log = winding_road::log(1);
    let options = SimOptions { steps: 50, ego: EgoPolicy::Straight, ..SimOptions::default() };
    let instants = all(&mut winding_road::start(&log, &options));
    let start = &instants[0].ego;
    for instant in &instants {
        let arm = instant.ego.position_m() - start.position_m();
        let forward = DVec2::from_angle(start.heading_rad());
        // Above 6 m/s the speed is constant.
        let distance_m = start.speed_mps * instant.step as f64 / 10.0;
        assert!((forward.dot(arm) - distance_m).abs() < 1e-6 && forward.perp_dot(arm).abs() < 1e-6);
    }
}

#[test]
fn a_path_relative_to_each_plan_continues() {
    let log = winding_road::log(2);
    // A quarter circle, from each pose on: the ego turns on a whole circle.
    let points = (0..=900)
        .map(|i| (f64::from(i) / 10.0).to_radians())
        .map(|a| [20.0 * a.sin(), 20.0 * (1.0 - a.cos())]);
    let ego = EgoPolicy::File(LocalPath::new(points.collect()).unwrap(), PathAnchor::EachPlan);
    let instants =
        all(&mut winding_road::start(&log, &SimOptions { steps: 200, ego, ..SimOptions::default() }));
    let start = instants[0].ego.pose;
    let center = DVec2::from_angle(start.yaw_rad()).perp() * 20.0 + start.translation.truncate();
    let travelled_m = instants[0].ego.speed_mps * 20.0;
    assert!(travelled_m > 20.0 * std::f64::consts::TAU, "more than once around");
    for instant in &instants {
        let off = instant.ego.position_m().distance(center) - 20.0;
        assert!(off.abs() < 0.05, "{off} at step {}", instant.step);
    }
    let turned = wrap_angle(instants[200].ego.heading_rad() - start.yaw_rad() - travelled_m / 20.0);
    assert!(turned.abs() < 0.01, "{turned}");
}

#[test]
fn follows_the_points_of_a_file() {
    let log = winding_road::log(2);
    // A quarter circle to the left with a radius of 20 m; then the ego drives on.
    let points =
        (0..=90).map(|i| f64::from(i).to_radians()).map(|a| [20.0 * a.sin(), 20.0 * (1.0 - a.cos())]);
    let path = LocalPath::new(points.collect()).unwrap();
    let ego = EgoPolicy::File(path, PathAnchor::Takeover);
    for (tracking, limit_m) in [(Tracking::Perfect, 0.01), (Tracking::Bicycle, 0.25)] {
        let options = SimOptions { steps: 60, ego: ego.clone(), tracking, ..SimOptions::default() };
        let instants = all(&mut winding_road::start(&log, &options));
        let start = instants[0].ego.pose;
        let arc_m = 20.0 * std::f64::consts::FRAC_PI_2;
        let center = DVec2::from_angle(start.yaw_rad()).perp() * 20.0 + start.translation.truncate();
        for instant in &instants {
            let distance_m = instants[0].ego.speed_mps * instant.step as f64 / 10.0;
            if distance_m < arc_m {
                let off = instant.ego.position_m().distance(center) - 20.0;
                assert!(off.abs() < limit_m, "{tracking:?} {off} at step {}", instant.step);
            }
        }
        let turned = wrap_angle(instants[60].ego.heading_rad() - start.yaw_rad());
        assert!((turned - std::f64::consts::FRAC_PI_2).abs() < 0.02, "{turned}");
    }
}
