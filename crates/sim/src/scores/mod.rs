//! Scores of a rollout that benchmarks compare, computed from its steps.

mod alpasim;
mod ncap;

pub use alpasim::AlpaSimScores;
pub use ncap::{NeuroNcap, ncap_score};

use point_skeleton::scene::SceneMap;
use serde::Serialize;

use crate::metrics::Road;
use crate::pdm::{DriveScores, PdmScorer};
use crate::recorded::Recorded;
use crate::report::{Phase, StepRow};
use crate::{Metrics, Scenario};

/// Progress of the log up to which the route counts as completed, meters.
const MIN_ROUTE_M: f64 = 5.0;

/// Scores of a rollout from the takeover on.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DrivingScores {
    /// Share of the route that was driven, 0 to 1. The route is what the log's ego drove in the same time; 1
    /// if that is less than 5 m.
    pub route_completion: f64,
    /// Score of NeuroNCAP.
    pub neuro_ncap: NeuroNcap,
    /// Fields of AlpaSim's evaluation.
    pub alpasim: AlpaSimScores,
    /// PDM scores; `None` without a map or for less than four seconds.
    pub pdm: Option<DriveScores>,
}

impl DrivingScores {
    /// Scores the steps of a rollout.
    pub(crate) fn of(scenario: &Scenario<'_>, rows: &[StepRow], metrics: &Metrics) -> Self {
        let map = scenario.map.as_deref().map(SceneMap::vector_map);
        let road = map.and_then(Road::new);
        let scorer = map.and_then(|map| PdmScorer::new(scenario.log, map));
        let driven = driven(rows);
        let recorded = Recorded::new(scenario.log);
        let alpasim = recorded.map(|recorded| alpasim::of(driven, &recorded, road.as_ref(), scorer.as_ref()));
        Self {
            route_completion: completion(metrics.progress_m, metrics.log_progress_m),
            neuro_ncap: ncap::of(rows, driven.first(), &metrics.collisions),
            alpasim: alpasim.unwrap_or_default(),
            pdm: scorer.and_then(|scorer| scorer.drive(rows)),
        }
    }
}

/// Returns the steps from the takeover on.
fn driven(rows: &[StepRow]) -> &[StepRow] {
    let first = rows.iter().position(|row| row.phase == Phase::Policy);
    &rows[first.map_or(0, |row| row.saturating_sub(1))..]
}

/// Returns a driven share of a route, both in meters.
fn completion(driven_m: f64, route_m: f64) -> f64 {
    if route_m < MIN_ROUTE_M { 1.0 } else { (driven_m / route_m).clamp(0.0, 1.0) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::report::{ActorRow, EgoRow};
    use glam::{DVec2, DVec3};
    use point_skeleton::dataset::{Area, Class, Frame, Lane, Recording, Track, VectorMap};
    use point_skeleton::geometry::Pose;

    /// Returns a step of a tenth of a second. The ego and all actors, cars of 4 by 2 m, head along x; an
    /// actor has a place ahead of the ego's rear axle and a speed. The ego is 1 m to the left of the x axis.
    pub(crate) fn row(step: usize, x: f64, speed_mps: f64, actors: &[(f64, f64)]) -> StepRow {
        let matrix = |x: f64, y: f64| {
            [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        };
        let actor = |(index, (ahead_m, speed_mps)): (usize, &(f64, f64))| ActorRow {
            instance: index as u32 + 1,
            track: format!("t{index}"),
            category: "vehicle.car".into(),
            class: 1,
            center_m: [x + ahead_m, 6.0, 0.8],
            heading_rad: 0.0,
            size_m: [4.0, 2.0, 1.6],
            speed_mps: *speed_mps,
            velocity_mps: [*speed_mps, 0.0],
            yaw_rate_radps: 0.0,
            seen: None,
            new_in_view: None,
        };
        StepRow {
            step,
            t_us: step as i64 * 100_000,
            phase: if step == 0 { Phase::WarmUp } else { Phase::Policy },
            ego: EgoRow {
                global_from_ego: matrix(x, 1.0),
                heading_rad: 0.0,
                speed_mps,
                acceleration_mps2: 0.0,
                yaw_rate_radps: 0.0,
                steering_rad: 0.0,
                lateral_deviation_m: 1.0,
                heading_deviation_rad: 0.0,
            },
            actors: actors.iter().enumerate().map(actor).collect(),
            lights: Vec::new(),
            driving_command: "straight".into(),
            plan: None,
        }
    }

    /// Returns a log of six seconds at 10 m/s along the x axis, with a car that is never in its frames.
    fn log() -> Recording {
        let frame = |i: i64| Frame {
            t_us: i * 100_000,
            global_from_ego: Pose::from_yaw(0.0, DVec3::X * i as f64),
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        let track = Track { id: "t0".into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        Recording { tracks: vec![track], frames: (0..=60).map(frame).collect(), ..Recording::default() }
    }

    /// Returns a lane of 8 m around the x axis.
    fn map() -> VectorMap {
        let corners = [(-20.0, -4.0), (200.0, -4.0), (200.0, 4.0), (-20.0, 4.0)].map(DVec2::from);
        let outline = Area { exterior: corners.to_vec(), holes: Vec::new() };
        let centerline = vec![DVec2::new(-20.0, 0.0), DVec2::new(200.0, 0.0)];
        let lane = Lane { id: "a".into(), outline: outline.clone(), centerline, successors: Vec::new() };
        VectorMap { lanes: vec![lane], drivable_area: vec![outline], ..VectorMap::default() }
    }

    #[test]
    fn routes_are_completed_up_to_their_end() {
        let found = [(30.0, 60.0), (70.0, 60.0), (-2.0, 60.0), (0.0, 4.9)].map(|(a, b)| completion(a, b));
        assert_eq!(found, [0.5, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn alpasim_fields_of_a_drive_beside_the_log() {
        let (log, map) = (log(), map());
        let recorded = Recorded::new(&log).unwrap();
        let road = Road::new(&map);
        let scorer = PdmScorer::new(&log, &map);
        // A meter to the left of the log at 8 m/s, beside a car whose side is at 5 m.
        let rows: Vec<StepRow> = (0..=60).map(|i| row(i, 0.8 * i as f64, 8.0, &[(1.461, 8.0)])).collect();
        let found = alpasim::of(&rows, &recorded, road.as_ref(), scorer.as_ref());
        assert!((found.dist_to_gt_trajectory_m - 1.0).abs() < 1e-9, "{found:?}");
        assert!((found.dist_to_gt_location_m - (12.0_f64.powi(2) + 1.0).sqrt()).abs() < 1e-9, "{found:?}");
        assert!((found.progress_clipped_rel - 0.8).abs() < 1e-9, "{found:?}");
        assert!((found.min_distance_to_obstacle_m.unwrap() - (5.0 - 1.0 - 2.297 / 2.0)).abs() < 1e-9);
        assert!(
            (found.dist_traveled_m - 48.0).abs() < 1e-9 && (found.gt_dist_traveled_m - 60.0).abs() < 1e-9
        );
        assert_eq!((found.offroad, found.wrong_lane, found.passed), (Some(false), Some(false), true));
        assert!((found.score - 1.0).abs() < 1e-9);
        // The same drive without the map, backward in the lane, and off the road.
        assert_eq!(alpasim::of(&rows, &recorded, None, None).offroad, None);
        let mut turned = rows.clone();
        turned.iter_mut().for_each(|row| row.ego.heading_rad = 3.0);
        assert_eq!(alpasim::of(&turned, &recorded, road.as_ref(), scorer.as_ref()).wrong_lane, Some(true));
        let mut off = rows;
        off[20].ego.global_from_ego[1][3] = -4.0;
        let off = alpasim::of(&off, &recorded, road.as_ref(), scorer.as_ref());
        assert_eq!((off.score, off.failure_reason), (0.0, Some("offroad")));
        assert!(
            (off.dist_traveled_m - (15.2 + 5.0_f64.hypot(0.8))).abs() < 1e-9,
            "nothing counts afterwards"
        );
    }

    #[test]
    fn drives_are_scored_in_windows() {
        let (log, map) = (log(), map());
        let scorer = PdmScorer::new(&log, &map).unwrap();
        let rows: Vec<StepRow> = (0..=60).map(|i| row(i, i as f64, 10.0, &[])).collect();
        let found = scorer.drive(&rows).unwrap();
        // They start at 0, 0.5, 1, 1.5 and 2 s.
        assert_eq!(found.windows, 5);
        let mean = found.mean;
        assert_eq!([mean.no_at_fault_collisions, mean.drivable_area_compliance, mean.comfort], [1.0; 3]);
        assert_eq!([mean.driving_direction_compliance, mean.time_to_collision_within_bound], [1.0; 2]);
        // A meter beside the center line for all the time.
        assert_eq!(mean.lane_keeping, 0.0);
        // PDM-Closed accelerates from 10 toward 15 m/s.
        assert!(mean.ego_progress > 0.7 && mean.ego_progress < 1.0, "{mean:?}");
        let expected = (5.0 * mean.ego_progress + 5.0 + 2.0) / 14.0;
        assert!((mean.epdms - expected).abs() < 1e-9, "{mean:?}");
        assert_eq!(scorer.drive(&rows[..40]), None);
        // A standing car that the ego runs into after 3.5 s.
        let rows: Vec<StepRow> = (0..=60)
            .map(|i| {
                let mut row = row(i, i as f64, 10.0, &[(41.0 - i as f64, 0.0)]);
                row.actors[0].center_m[1] = 1.0;
                row
            })
            .collect();
        let hit = scorer.drive(&rows).unwrap().mean;
        assert_eq!((hit.no_at_fault_collisions, hit.time_to_collision_within_bound), (0.0, 0.0));
        assert_eq!((hit.pdms, hit.epdms), (0.0, 0.0));
    }
}
