use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use point_skeleton::dataset::{
    Action, ActorEdits, Anchor, Appearance, Change, Insert, Path, PathPoint, Place, Recording, When,
};

use super::draw::Draw;
use super::family::{Family, TRACK};
use crate::recorded::Recorded;
use crate::{EGO_SIZE_M, EgoState, REAR_AXLE_TO_CENTER_M};

/// Minimum speed of the ego where it collides.
pub(super) const MIN_SPEED_MPS: f64 = 3.0;
/// Time from the begin of a scenario to the end of the log at least, seconds.
pub(super) const AHEAD_S: f64 = 4.2;
/// Range of the time to the collision, seconds.
const TO_COLLISION_S: [f64; 2] = [2.6, 3.7];
/// Interval of possible begins, microseconds.
const START_STEP_US: usize = 100_000;
/// Depth to which bodies overlap at the collision, so that steps of any rate meet it, meters.
const OVERLAP_M: f64 = 0.3;
/// From the ego's rear axle to its front bumper, meters.
const FRONT_M: f64 = REAR_AXLE_TO_CENTER_M + EGO_SIZE_M.x / 2.0;
/// Distance between lanes, meters.
const LANE_M: f64 = 3.4;

/// Actor on collision course.
pub(super) struct Course {
    pub(super) edits: ActorEdits,
    pub(super) start_us: i64,
    /// Planned time of the collision, absolute microseconds.
    pub(super) collision_us: i64,
}

/// Returns the times at which a scenario may begin, absolute microseconds.
pub(super) fn starts(recorded: &Recorded<'_>) -> Vec<i64> {
    let last_us = recorded.last_us - (AHEAD_S * 1e6) as i64;
    let collision_us = ((TO_COLLISION_S[0] + TO_COLLISION_S[1]) / 2.0 * 1e6) as i64;
    let is_fast =
        |t_us: &i64| recorded.ego_at(t_us + collision_us).is_some_and(|ego| ego.speed_mps >= MIN_SPEED_MPS);
    (recorded.first_us..=last_us).step_by(START_STEP_US).filter(is_fast).collect()
}

impl Course {
    /// Draws a course; `None` if the ego is too slow at the collision.
    pub(super) fn drawn(recorded: &Recorded<'_>, family: Family, starts: &[i64], draw: Draw) -> Option<Self> {
        let start_us = draw.of("start", starts)?;
        let took_s = draw.uniform("time to collision", TO_COLLISION_S[0], TO_COLLISION_S[1]);
        let collision_us = start_us + (took_s * 1e6).round() as i64;
        let ego = recorded.ego_at(collision_us).filter(|ego| ego.speed_mps >= MIN_SPEED_MPS)?;
        let target = Target::drawn(recorded.log, family, draw);
        let points = points(family, &ego, &target, took_s, draw);
        let first = points.first()?;
        let second =
            points.get(1).map_or(first.0 + DVec2::from_angle(ego.heading_rad()), |(point, _)| *point);
        let jitter_deg = draw.uniform("yaw", -8.0, 8.0);
        let heading = second - first.0;
        let standing_deg = if points.len() == 1 { jitter_deg } else { 0.0 };
        let at = Place {
            anchor: Anchor::Global,
            x_m: first.0.x,
            y_m: first.0.y,
            yaw_deg: heading.to_angle().to_degrees() + standing_deg,
        };
        let category = Some(target.category.to_owned()).filter(|_| target.like.is_none());
        let size_m = Some(target.size.to_array()).filter(|_| target.like.is_none());
        let change = |action: Action| Change {
            track: TRACK.to_owned(),
            action,
            start: Some(When::TUs(start_us)),
            end: None,
        };
        let mut changes = vec![change(Action::Insert(Insert { category, size_m, at }))];
        if points.len() > 1 {
            let point =
                |(at, speed_mps): &(DVec2, f64)| PathPoint { x_m: at.x, y_m: at.y, speed_mps: *speed_mps };
            let points = points.iter().map(point).collect();
            changes.push(change(Action::Path(Path { anchor: Anchor::Global, points })));
        }
        let look = target.like.map_or(Appearance::Template, Appearance::Track);
        let replace = BTreeMap::from([(TRACK.to_owned(), look)]);
        let edits = ActorEdits { replace, changes, ..ActorEdits::default() };
        Some(Self { edits, start_us, collision_us })
    }
}

/// What the actor looks like.
struct Target {
    /// Track of the log.
    like: Option<String>,
    category: &'static str,
    /// Length, width and height, meters.
    size: DVec3,
}

impl Target {
    /// Draws one of the log's cars or pedestrians; without any, a template.
    fn drawn(log: &Recording, family: Family, draw: Draw) -> Self {
        let (category, size) = match family {
            Family::Crossing => ("human.pedestrian.adult", DVec3::new(0.7, 0.7, 1.75)),
            _ => ("vehicle.car", DVec3::new(4.5, 1.9, 1.6)),
        };
        // Long and broad boxes of other vehicles would fill the road.
        let fits = |track: &usize| {
            let found = log.median_size(*track);
            log.tracks[*track].category.starts_with(category)
                && (found - size).abs().max_element() < 0.35 * size.x
                && !log.track_boxes(*track).is_empty()
        };
        let tracks: Vec<usize> = (0..log.tracks.len()).filter(fits).collect();
        match draw.of("asset", &tracks) {
            Some(track) => {
                let like = Some(log.tracks[track].id.clone());
                Self { like, category, size: log.median_size(track) }
            }
            None => Self { like: None, category, size },
        }
    }
}

/// Returns the points of the path with speeds, global meters and meters per second; one point for an actor
/// that stands. `ego` is the recorded one at the collision, `took_s` seconds after the start.
fn points(family: Family, ego: &EgoState, target: &Target, took_s: f64, draw: Draw) -> Vec<(DVec2, f64)> {
    let forward = DVec2::from_angle(ego.heading_rad());
    let left = forward.perp();
    let side = left * draw.sign("side");
    // Centers of bodies that the ego's front bumper touches, lengthwise and across.
    let ahead = ego.position_m() + forward * (FRONT_M + target.size.x / 2.0 - OVERLAP_M);
    let across = ego.position_m() + forward * (FRONT_M + target.size.y / 2.0 - OVERLAP_M);
    match family {
        Family::Stationary => vec![(ahead + left * draw.uniform("offset", -0.5, 0.5), 0.0)],
        Family::Frontal => {
            // It has just stopped when the ego arrives.
            let speed_mps = draw.uniform("speed", 4.0, 8.0);
            let (length_m, offset_m) =
                (speed_mps * (took_s - 0.3) / 2.0, draw.uniform("offset", 2.0, LANE_M));
            let along_m = (length_m * length_m - offset_m * offset_m).sqrt();
            vec![(ahead + forward * along_m + left * offset_m, speed_mps), (ahead, 0.0)]
        }
        Family::Side | Family::Crossing => {
            let (distance_m, beyond_m, first_mps) = match family {
                Family::Crossing => {
                    let distance_m = draw.uniform("distance", 3.5, 6.0);
                    (distance_m, distance_m, distance_m / took_s)
                }
                // As far beyond the way as it still may be on the road.
                _ => (draw.uniform("distance", 6.0, 9.0), draw.uniform("beyond", 3.5, 6.0), 1.0),
            };
            let speed_mps = 2.0 * distance_m / took_s - first_mps;
            let tilt = DVec2::from_angle(draw.uniform("angle", -0.2, 0.2));
            let from = tilt.rotate(side);
            vec![
                (across + from * distance_m, first_mps),
                (across, speed_mps),
                (across - from * (beyond_m * 0.6), speed_mps),
                (across - from * beyond_m, 0.0),
            ]
        }
        Family::CutIn => {
            let speed_mps = ego.speed_mps * draw.uniform("speed", 0.25, 0.45);
            let travel_m = speed_mps * took_s;
            vec![
                (ahead - forward * travel_m + side * LANE_M, speed_mps),
                (ahead - forward * (0.7 * travel_m) + side * (0.8 * LANE_M), speed_mps),
                (ahead - forward * (0.2 * travel_m), speed_mps),
                (ahead + forward * 2.0, speed_mps),
            ]
        }
    }
}
