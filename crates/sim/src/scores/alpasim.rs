//! Fields of AlpaSim's evaluation, named as there (NVlabs/alpasim 3032e0c, `src/eval`).
//!
//! Two definitions differ: the ego is off road where a part of it is outside of the drivable area (AlpaSim
//! compares with lanes and road edges), and the recorded trajectory is that of the rollout's time.

use glam::DVec2;
use point_skeleton::geometry::{Cuboid, Footprint, Polyline, Pose};
use serde::Serialize;

use crate::metrics::Road;
use crate::pdm::{PdmScorer, PdmState, shape};
use crate::recorded::Recorded;
use crate::report::{ActorRow, StepRow};

/// Share of the recorded progress with the full score.
const PROGRESS_SATURATION: f64 = 0.8;
/// Recorded distance below which progress does not count, meters.
const MIN_GT_M: f64 = 5.0;

/// Fields of AlpaSim's evaluation, up to the first step that is off the road or a collision.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AlpaSimScores {
    /// Whether any contact occurred.
    pub collision_any: bool,
    /// Whether the front bumper touched an actor.
    pub collision_front: bool,
    /// Whether the rear bumper, and not the front one, touched an actor.
    pub collision_rear: bool,
    /// Whether a side touched an actor, and no bumper did.
    pub collision_lateral: bool,
    /// Front or lateral collision.
    pub collision_at_fault: bool,
    /// Whether a part of the ego was outside of the drivable area; `None` without a map.
    pub offroad: Option<bool>,
    /// Whether the ego's heading was more than 120 degrees from a lane's below it; `None` without a
    /// map.
    pub wrong_lane: Option<bool>,
    /// Maximum distance of the ego's center from the recorded path, meters.
    pub dist_to_gt_trajectory_m: f64,
    /// Maximum distance from the recorded place at the same time, meters.
    pub dist_to_gt_location_m: f64,
    /// Minimum distance from an actor, meters, 0 for a contact; `None` without actors.
    pub min_distance_to_obstacle_m: Option<f64>,
    /// Driven distance, meters.
    pub dist_traveled_m: f64,
    /// Recorded distance in the time of the whole rollout, meters.
    pub gt_dist_traveled_m: f64,
    /// Share of the recorded path that was driven, 0 to 1.
    pub progress_clipped_rel: f64,
    /// Scene score: 0 after a failure, else the progress over 0.8, at most 1; 1 if the recorded distance is
    /// less than 5 m.
    pub score: f64,
    /// Whether there was no failure.
    pub passed: bool,
    /// First kind of failure: `collision_at_fault` or `offroad`.
    pub failure_reason: Option<&'static str>,
}

/// Contact of the ego with an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Contact {
    Front,
    Rear,
    Lateral,
}

/// Computes the fields of the steps from the takeover on.
pub(super) fn of(
    rows: &[StepRow],
    recorded: &Recorded<'_>,
    road: Option<&Road>,
    scorer: Option<&PdmScorer<'_>>,
) -> AlpaSimScores {
    let mut scores = AlpaSimScores {
        offroad: road.map(|_| false),
        wrong_lane: scorer.map(|_| false),
        ..AlpaSimScores::default()
    };
    let center = |t_us: i64| recorded.ego_at(t_us).map(|ego| Footprint::from(&ego.cuboid()).center);
    let recorded_centers: Vec<DVec2> = rows.iter().filter_map(|row| center(row.t_us)).collect();
    scores.gt_dist_traveled_m = recorded_centers.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let path = Polyline::new(recorded_centers);
    let mut last: Option<DVec2> = None;
    for row in rows {
        let body = body(row);
        let bodies: Vec<Footprint> = row.actors.iter().map(actor_body).collect();
        let contacts: Vec<Contact> = bodies.iter().filter_map(|actor| contact(&body, actor)).collect();
        scores.collision_front |= contacts.contains(&Contact::Front);
        scores.collision_rear |= contacts.contains(&Contact::Rear);
        scores.collision_lateral |= contacts.contains(&Contact::Lateral);
        let corners = body.corners();
        let distances = bodies.iter().map(|actor| shape::distance_m(&corners, &actor.corners()));
        scores.min_distance_to_obstacle_m =
            scores.min_distance_to_obstacle_m.into_iter().chain(distances).reduce(f64::min);
        scores.dist_traveled_m += last.map_or(0.0, |last| last.distance(body.center));
        last = Some(body.center);
        if let Some(path) = &path {
            let (station_m, distance_m) = path.nearest(body.center);
            scores.dist_to_gt_trajectory_m = scores.dist_to_gt_trajectory_m.max(distance_m);
            scores.progress_clipped_rel = (station_m / path.length_m()).clamp(0.0, 1.0);
        }
        let away = center(row.t_us).map_or(0.0, |place| place.distance(body.center));
        scores.dist_to_gt_location_m = scores.dist_to_gt_location_m.max(away);
        let is_off = road.is_some_and(|road| corners.iter().any(|corner| road.is_off(*corner)));
        scores.offroad = scores.offroad.map(|before| before || is_off);
        let is_against =
            scorer.is_some_and(|scorer| scorer.is_against_lane(body.center, row.ego.heading_rad));
        scores.wrong_lane = scores.wrong_lane.map(|before| before || is_against);
        if is_off || !contacts.is_empty() {
            break;
        }
    }
    scores.closed()
}

impl AlpaSimScores {
    /// Combines the fields.
    fn closed(self) -> Self {
        let collision_at_fault = self.collision_front || self.collision_lateral;
        let failure_reason = match (collision_at_fault, self.offroad) {
            (true, _) => Some("collision_at_fault"),
            (false, Some(true)) => Some("offroad"),
            (false, _) => None,
        };
        let progress = match self.gt_dist_traveled_m < MIN_GT_M {
            true => 1.0,
            false => (self.progress_clipped_rel / PROGRESS_SATURATION).min(1.0),
        };
        Self {
            collision_any: collision_at_fault || self.collision_rear,
            collision_at_fault,
            score: if failure_reason.is_some() { 0.0 } else { progress },
            passed: failure_reason.is_none(),
            failure_reason,
            ..self
        }
    }
}

/// Returns the kind of a contact; `None` if the rectangles do not overlap.
fn contact(ego: &Footprint, actor: &Footprint) -> Option<Contact> {
    if !ego.overlaps(actor) {
        return None;
    }
    let bumper = |side: f64| Footprint {
        center: ego.center + side * ego.forward * ego.half_m.x,
        half_m: DVec2::new(0.0, ego.half_m.y),
        ..*ego
    };
    let kind = if bumper(1.0).overlaps(actor) {
        Contact::Front
    } else if bumper(-1.0).overlaps(actor) {
        Contact::Rear
    } else {
        Contact::Lateral
    };
    Some(kind)
}

fn body(row: &StepRow) -> Footprint {
    let heading_rad = row.ego.heading_rad;
    PdmState { place_m: row.place_m(), heading_rad, ..PdmState::default() }.body()
}

fn actor_body(actor: &ActorRow) -> Footprint {
    let pose = Pose::from_yaw(actor.heading_rad, actor.center_m.into());
    Footprint::from(&Cuboid { pose, size: actor.size_m.into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contacts_are_classified_by_the_bumper() {
        let ego = Footprint { center: DVec2::ZERO, forward: DVec2::X, half_m: DVec2::new(2.0, 1.0) };
        let actor = |x: f64, y: f64| Footprint { center: DVec2::new(x, y), half_m: DVec2::ONE, ..ego };
        let found = [(2.5, 0.0), (-2.5, 0.0), (0.0, 1.5), (4.0, 0.0)];
        let expected = [Some(Contact::Front), Some(Contact::Rear), Some(Contact::Lateral), None];
        assert_eq!(found.map(|(x, y)| contact(&ego, &actor(x, y))), expected);
    }

    #[test]
    fn scores_are_zero_after_a_failure() {
        let drive =
            AlpaSimScores { gt_dist_traveled_m: 50.0, progress_clipped_rel: 0.4, ..Default::default() };
        let closed = drive.clone().closed();
        assert_eq!((closed.score, closed.passed, closed.failure_reason), (0.5, true, None));
        let full = AlpaSimScores { progress_clipped_rel: 0.9, ..drive.clone() }.closed();
        assert_eq!(full.score, 1.0);
        let short = AlpaSimScores { gt_dist_traveled_m: 4.0, ..drive.clone() }.closed();
        assert_eq!(short.score, 1.0);
        let hit = AlpaSimScores { collision_lateral: true, offroad: Some(true), ..drive.clone() }.closed();
        assert_eq!((hit.score, hit.failure_reason), (0.0, Some("collision_at_fault")));
        let hit_from_behind = AlpaSimScores { collision_rear: true, ..drive.clone() }.closed();
        assert!(hit_from_behind.passed && hit_from_behind.collision_any);
        let off = AlpaSimScores { offroad: Some(true), ..drive }.closed();
        assert_eq!((off.score, off.passed, off.failure_reason), (0.0, false, Some("offroad")));
    }
}
