//! Figures of a rollout, from the takeover on: added up step by step.

pub(super) mod collision;
mod comfort;
mod road;
mod ttc;

pub use collision::{Collision, CollisionKind};
pub use comfort::Comfort;
pub(super) use road::Road;

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use self::comfort::ComfortTally;
use super::Instant;
use super::clock::seconds;
use super::recorded::Recorded;
use super::route::Route;
use super::simulation::World;
use crate::geometry::{Foot, wrap_angle};

/// Figures of a rollout, from the takeover (or the start) on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Metrics {
    /// How many steps they are of.
    pub steps: usize,
    /// How long these took, seconds.
    pub seconds: f64,
    /// The first contact with each actor.
    pub collisions: Vec<Collision>,
    /// How many collisions are the ego's fault, so far as known.
    pub at_fault_collisions: usize,
    /// Where the ego was beside the drivable area; `None` without a map.
    pub off_road: Option<OffRoad>,
    /// Along the recorded path, metres.
    pub progress_m: f64,
    /// What the log's ego made in that time along its path, metres; no more than to its end.
    pub log_progress_m: f64,
    /// How far the ego was from the recorded path, metres; `end` is positive to the left.
    pub lateral_deviation_m: Deviation,
    /// How far the ego was turned against the recorded ego at the nearest place, radians; `end` is positive to the left.
    pub heading_deviation_rad: Deviation,
    /// Accelerations and the like.
    pub comfort: Comfort,
    /// The least time until ego and somebody not behind it would meet if both went on straight at their speed, seconds;
    /// `None` where that was never under 3 s.
    pub min_time_to_collision_s: Option<f64>,
}

/// How much of the ego was beside the drivable area.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OffRoad {
    /// At how many instants a part of its footprint was.
    pub instants: usize,
    /// The share of the footprint that was, 0 to 1, as the mean over all instants.
    pub share: f64,
}

/// How far something was off, without its sign, and at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    /// Over all instants.
    pub mean: f64,
    /// Over all instants.
    pub max: f64,
    /// At the last instant, with its sign.
    pub end: f64,
}

/// A range of values that were met.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Range {
    /// With one more value.
    fn with(range: Option<Self>, value: f64) -> Self {
        let range = range.unwrap_or(Self { min: value, max: value });
        Self { min: range.min.min(value), max: range.max.max(value) }
    }
}

/// What the figures are made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tally {
    /// How many instants were added; the first begins the first step.
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

impl Tally {
    /// One more instant.
    pub(super) fn add(&mut self, recorded: &Recorded<'_>, road: Option<&Road>, world: &World) {
        let now = &world.instant;
        self.go(&recorded.route, now, world.foot);
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

    /// Along the path and beside it.
    fn go(&mut self, route: &Route, now: &Instant, foot: Foot) {
        self.log_m = route.station_at(now.t_us);
        self.station_m = foot.station_m;
        if self.instants == 0 {
            (self.start_us, self.start_m, self.log_start_m) = (now.t_us, self.station_m, self.log_m);
        }
        self.end_us = now.t_us;
        self.instants += 1;
        self.lateral.add(foot.offset_m, self.instants);
        self.heading.add(wrap_angle(now.ego.heading_rad() - route.yaw_at(foot.station_m)), self.instants);
    }

    /// The figures; `has_road` tells whether there was a map.
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

impl Deviation {
    /// One more value, the `count`th.
    fn add(&mut self, value: f64, count: usize) {
        self.mean += (value.abs() - self.mean) / count as f64;
        self.max = self.max.max(value.abs());
        self.end = value;
    }
}
