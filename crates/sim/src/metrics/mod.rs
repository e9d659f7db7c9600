//! Metrics of a rollout from the takeover on, accumulated step by step.

pub(super) mod collision;
mod comfort;
mod road;
mod statistics;
mod ttc;

pub use collision::{Collision, CollisionKind};
pub use comfort::Comfort;
pub(super) use road::{Areas, Road, in_ring, is_sound};
pub use statistics::{Deviation, Range};

use std::collections::BTreeSet;

use point_skeleton::geometry::{LineProjection, wrap_angle};
use serde::{Deserialize, Serialize};

use self::comfort::ComfortTally;
use super::Instant;
use super::recorded::Recorded;
use super::time::seconds;
use super::world::World;
use crate::path::route::Route;

/// Metrics of a rollout, from the takeover (or the start) on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Metrics {
    /// Number of evaluated steps.
    pub steps: usize,
    /// Duration of these steps, seconds.
    pub seconds: f64,
    /// First contact with each actor.
    pub collisions: Vec<Collision>,
    /// Number of collisions known to be the ego's fault.
    pub at_fault_collisions: usize,
    /// Departures from the drivable area; `None` without a map.
    pub off_road: Option<OffRoad>,
    /// Distance along the recorded path, meters.
    pub progress_m: f64,
    /// Distance of the log's ego along its path in the same time, meters; at most to the end of the path.
    pub log_progress_m: f64,
    /// Distance of the ego from the recorded path, meters; `end` is positive to the left.
    pub lateral_deviation_m: Deviation,
    /// Difference of the ego's heading from the recorded one at the nearest position, radians; `end` is
    /// positive to the left.
    pub heading_deviation_rad: Deviation,
    /// Accelerations, yaw rate and jerk.
    pub comfort: Comfort,
    /// Minimum time to contact between the ego and an actor not behind it, at constant velocities, seconds;
    /// `None` if it was always over 3 s.
    pub min_time_to_collision_s: Option<f64>,
}

/// Part of the ego outside the drivable area.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OffRoad {
    /// Number of instants with a part of the footprint outside.
    pub instants: usize,
    /// Share of the footprint that was outside, 0 to 1: mean over all instants.
    pub share: f64,
}

/// Accumulator of the metrics.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MetricsAccumulator {
    /// Number of added instants; the first is the start of the first step.
    instants: usize,
    start_us: i64,
    end_us: i64,
    start_m: f64,
    station_m: f64,
    log_start_m: f64,
    log_m: f64,
    collisions: Vec<Collision>,
    collided: BTreeSet<usize>,
    off_road: OffRoad,
    lateral: Deviation,
    heading: Deviation,
    comfort: ComfortTally,
    min_ttc_s: Option<f64>,
}

impl MetricsAccumulator {
    /// Adds an instant.
    pub(super) fn add(&mut self, recorded: &Recorded<'_>, road: Option<&Road>, world: &World) {
        let now = &world.instant;
        self.update_progress(&recorded.route, now, world.projection);
        let hits = collision::contacts(now, &recorded.log.tracks, road, &self.collided);
        self.collided.extend(hits.iter().map(|(track, _)| *track));
        self.collisions.extend(hits.into_iter().map(|(_, collision)| collision));
        if let Some(road) = road {
            let share = road.share_off(&now.ego.cuboid());
            self.off_road.instants += usize::from(share > 0.0);
            self.off_road.share += (share - self.off_road.share) / self.instants as f64;
        }
        self.comfort.add(&now.ego, now.t_us);
        let soonest = ttc::seconds_to_contact(now);
        self.min_ttc_s = self.min_ttc_s.into_iter().chain(soonest).reduce(f64::min);
    }

    /// Updates progress along the path and deviations from it.
    fn update_progress(&mut self, route: &Route, now: &Instant, projection: LineProjection) {
        self.log_m = route.station_at(now.t_us);
        self.station_m = projection.station_m;
        if self.instants == 0 {
            (self.start_us, self.start_m, self.log_start_m) = (now.t_us, self.station_m, self.log_m);
        }
        self.end_us = now.t_us;
        self.instants += 1;
        self.lateral.add(projection.offset_m, self.instants);
        self.heading
            .add(wrap_angle(now.ego.heading_rad() - route.yaw_at(projection.station_m)), self.instants);
    }

    /// Returns the number of instants with a part of the ego off the road; 0 without a map.
    #[cfg(feature = "mcap")]
    pub(super) fn off_road_instants(&self) -> usize {
        self.off_road.instants
    }

    /// Returns the metrics; `has_road` is `true` if a map was available.
    pub(super) fn metrics(&self, has_road: bool) -> Metrics {
        Metrics {
            steps: self.instants.saturating_sub(1),
            seconds: seconds(self.start_us, self.end_us),
            collisions: self.collisions.clone(),
            at_fault_collisions: self.collisions.iter().filter(|c| c.at_fault == Some(true)).count(),
            off_road: has_road.then_some(self.off_road),
            progress_m: self.station_m - self.start_m,
            log_progress_m: self.log_m - self.log_start_m,
            lateral_deviation_m: self.lateral,
            heading_deviation_rad: self.heading,
            comfort: self.comfort.figures(),
            min_time_to_collision_s: self.min_ttc_s,
        }
    }
}
