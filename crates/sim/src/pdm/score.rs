//! Sub-scores of drives, as NAVSIM's `PDMScorer` computes them.

use std::collections::BTreeSet;

use glam::DVec2;
use point_skeleton::geometry::Footprint;

use super::SAMPLES;
use super::roads::{Roads, Route, ring};
use super::shape;
use super::state::PdmState;
use super::traffic::{First, Traffic};

/// Speed up to which the ego or a road user is stopped in a collision, meters per second.
const STOPPED_MPS: f64 = 0.05;
/// Speed below which the ego has no time to collision, meters per second.
const TTC_STOPPED_MPS: f64 = 0.005;
/// Samples ahead at which contacts are predicted.
const TTC_SAMPLES: [usize; 4] = [0, 3, 6, 9];
/// Angles from the heading below which a road user is ahead, and above which it is behind, degrees.
const AHEAD_DEG: f64 = 30.0;
const BEHIND_DEG: f64 = 150.0;
/// Samples over which driving off the route's lanes is summed up.
const DIRECTION_SAMPLES: usize = 10;
/// Distances off the route's lanes from which the score is 0.5 and 0, meters.
const DIRECTION_M: [f64; 2] = [2.0, 6.0];
/// Distance from the center line beyond which the ego does not keep its lane, meters, and the number of
/// consecutive samples from which this counts.
const LANE_OFFSET_M: f64 = 0.5;
const LANE_SAMPLES: usize = 20;
/// Progress up to which all drives have the full score, meters.
const MIN_PROGRESS_M: f64 = 5.0;

/// Sub-scores of a drive but the normalized progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Parts {
    pub(super) no_at_fault_collisions: f64,
    pub(super) drivable_area: f64,
    pub(super) driving_direction: f64,
    pub(super) traffic_light: f64,
    /// Progress along the center line, meters, at least 0.
    pub(super) progress_m: f64,
    pub(super) time_to_collision: f64,
    pub(super) lane_keeping: f64,
}

/// Location of the ego on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Location {
    is_in_several_lanes: bool,
    is_off_drivable: bool,
    is_off_route: bool,
    /// Whether its center, and its rear axle, are in an intersection.
    is_crossing: [bool; 2],
}

impl Parts {
    /// Product of the penalties.
    pub(super) fn penalty(&self) -> f64 {
        self.no_at_fault_collisions * self.drivable_area * self.traffic_light * self.driving_direction
    }

    /// Scores a drive of [`SAMPLES`] states.
    pub(super) fn of(states: &[PdmState], traffic: &Traffic, roads: &Roads<'_>, route: &Route) -> Self {
        let bodies: Vec<Footprint> = states.iter().map(PdmState::body).collect();
        let locations: Vec<Location> = states
            .iter()
            .zip(&bodies)
            .map(|(state, body)| Location::of(roads, route, body, state.place_m))
            .collect();
        let drive = Drive { states, bodies: &bodies, locations: &locations, traffic };
        let centers: Vec<DVec2> = bodies.iter().map(|body| body.center).collect();
        let progress_m = match (centers.first(), centers.last()) {
            (Some(from), Some(to)) => route.centerline.station_m(*to) - route.centerline.station_m(*from),
            _ => 0.0,
        };
        Self {
            no_at_fault_collisions: drive.no_at_fault_collisions(),
            drivable_area: f64::from(u8::from(!locations.iter().any(|place| place.is_off_drivable))),
            driving_direction: driving_direction(&centers, &locations),
            traffic_light: drive.traffic_light(roads),
            progress_m: progress_m.max(0.0),
            time_to_collision: drive.time_to_collision(),
            lane_keeping: lane_keeping(&centers, &locations, route),
        }
    }
}

/// Returns the progress of each drive as a share of the longest one without penalties.
pub(super) fn progress(parts: &[Parts]) -> Vec<f64> {
    let longest_m = parts.iter().map(|parts| parts.progress_m * parts.penalty()).fold(0.0, f64::max);
    let share = |parts: &Parts| match longest_m > MIN_PROGRESS_M {
        true => (parts.progress_m / longest_m).clamp(0.0, 1.0),
        false => 1.0,
    };
    parts.iter().map(share).collect()
}

impl Location {
    fn of(roads: &Roads<'_>, route: &Route, body: &Footprint, axle: DVec2) -> Self {
        let lanes = body.corners().map(|corner| roads.lane_areas.around(corner));
        let touched: BTreeSet<usize> = lanes.iter().flatten().copied().collect();
        let holds_all = |lane: &usize| lanes.iter().all(|lanes| lanes.contains(lane));
        let crosses = |place: DVec2| !roads.intersections.around(place).is_empty();
        let below = roads.lane_areas.around(body.center);
        Self {
            is_in_several_lanes: touched.len() > 1 && !touched.iter().any(holds_all),
            is_off_drivable: body.corners().iter().any(|corner| roads.drivable.around(*corner).is_empty()),
            is_off_route: !below.iter().any(|lane| route.lanes.contains(lane)),
            is_crossing: [body.center, axle].map(crosses),
        }
    }

    fn is_between_lanes(&self) -> bool {
        self.is_in_several_lanes || self.is_off_drivable
    }
}

/// Drive with the rectangles and locations of its states.
struct Drive<'a> {
    states: &'a [PdmState],
    bodies: &'a [Footprint],
    locations: &'a [Location],
    traffic: &'a Traffic,
}

impl Drive<'_> {
    /// Returns 0 after an at-fault collision with a road user, 0.5 after one with an object.
    fn no_at_fault_collisions(&self) -> f64 {
        let mut score: f64 = 1.0;
        let mut ignored = self.traffic.ignored.clone();
        for (sample, body) in self.bodies.iter().enumerate() {
            for object in &self.traffic.objects[sample] {
                if ignored.contains(&object.track) || !body.overlaps(&object.body) {
                    continue;
                }
                let first = &self.traffic.first[&object.track];
                if self.is_at_fault(sample, &object.body, first) {
                    score = score.min(if first.is_agent() { 0.0 } else { 0.5 });
                } else {
                    ignored.insert(object.track);
                }
            }
        }
        score
    }

    /// Returns whether the ego is at fault: it hits something stopped, or with its front bumper, or sideways
    /// while it is not within one lane.
    fn is_at_fault(&self, sample: usize, object: &Footprint, first: &First) -> bool {
        let (state, body) = (&self.states[sample], &self.bodies[sample]);
        if state.velocity_mps.length() <= STOPPED_MPS {
            return false;
        }
        if !first.is_agent() || first.speed_mps <= STOPPED_MPS {
            return true;
        }
        if angle_rad(state, object) > BEHIND_DEG.to_radians() {
            return false;
        }
        let front = Footprint {
            center: body.center + body.forward * body.half_m.x,
            half_m: DVec2::new(0.0, body.half_m.y),
            ..*body
        };
        front.overlaps(object) || self.locations[sample].is_between_lanes()
    }

    fn traffic_light(&self, roads: &Roads<'_>) -> f64 {
        let runs = |(sample, body): (usize, &Footprint)| {
            let red = self.traffic.red.get(sample).into_iter().flatten();
            red.copied().any(|lane| shape::touch(ring(roads, lane), &body.corners()))
        };
        f64::from(u8::from(!self.bodies.iter().enumerate().any(runs)))
    }

    /// Returns 0 if the ego, at its present velocity, would hit something within 0.9 s.
    fn time_to_collision(&self) -> f64 {
        let mut ignored = self.traffic.ignored.clone();
        let mut score = 1.0;
        for sample in 0..SAMPLES - TTC_SAMPLES[3] {
            let state = &self.states[sample];
            let speed = state.velocity_mps.length();
            if speed < TTC_STOPPED_MPS {
                continue;
            }
            for ahead in TTC_SAMPLES {
                let moved = state.forward() * speed * (ahead as f64 * super::state::STEP_S);
                let body = Footprint { center: self.bodies[sample].center + moved, ..self.bodies[sample] };
                for object in &self.traffic.objects[sample + ahead] {
                    if ignored.contains(&object.track) || !body.overlaps(&object.body) {
                        continue;
                    }
                    let location = &self.locations[sample];
                    let angle = angle_rad(state, &object.body);
                    let is_turning = location.is_between_lanes() || location.is_crossing[1];
                    let is_behind = angle > BEHIND_DEG.to_radians();
                    if angle < AHEAD_DEG.to_radians() || (is_turning && !is_behind) {
                        score = 0.0;
                    } else {
                        ignored.insert(object.track);
                    }
                }
            }
        }
        score
    }
}

/// Returns the angle between the heading of the ego and the direction from its rear axle to an object; NaN at
/// the same place.
fn angle_rad(state: &PdmState, object: &Footprint) -> f64 {
    let arm = object.center - state.place_m;
    state.forward().dot(arm / arm.length()).acos()
}

/// Returns 1, 0.5 or 0 by the distance driven off the route's lanes, outside of intersections, within 1 s.
fn driving_direction(centers: &[DVec2], locations: &[Location]) -> f64 {
    let steps: Vec<f64> = (0..centers.len())
        .map(|i| match i.checked_sub(1) {
            Some(before) if locations[i].is_off_route && !locations[i].is_crossing[0] => {
                centers[i].distance(centers[before])
            }
            _ => 0.0,
        })
        .collect();
    let sums = (0..steps.len()).map(|i| steps[i.saturating_sub(DIRECTION_SAMPLES)..=i].iter().sum::<f64>());
    match sums.fold(0.0, f64::max) {
        most if most < DIRECTION_M[0] => 1.0,
        most if most < DIRECTION_M[1] => 0.5,
        _ => 0.0,
    }
}

/// Returns 0 if the ego is beside the center line for 2 s, outside of intersections.
fn lane_keeping(centers: &[DVec2], locations: &[Location], route: &Route) -> f64 {
    let mut count = 0;
    for (center, location) in centers.iter().zip(locations) {
        if location.is_crossing[0] {
            continue;
        }
        count = if route.centerline.distance_m(*center) > LANE_OFFSET_M { count + 1 } else { 0 };
        if count >= LANE_SAMPLES {
            return 0.0;
        }
    }
    1.0
}
