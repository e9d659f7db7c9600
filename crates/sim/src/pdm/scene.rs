//! What a plan meets: traffic, route, past and reference from a time of a log on.

use std::collections::BTreeSet;

use glam::{DVec2, DVec3};
use point_skeleton::dataset::{Class, Recording, TrafficLight, VectorMap};
use point_skeleton::geometry::wrap_angle;

use super::comfort::is_comfortable;
use super::roads::{Roads, Route, ring};
use super::score::{Parts, progress};
use super::state::{PdmState, principal};
use super::traffic::{FRAME_SAMPLES, Traffic};
use super::{FRAME_US, HORIZON_US, PAST_FRAMES, PdmResult, PdmScores, SAMPLE_US, SAMPLES, closed, tracker};
use crate::metrics::in_ring;
use crate::recorded::Recorded;
use crate::{EgoState, SimActor};

/// Number of samples of the past that count for the comfort: from 1.5 s to 0.2 s before, as in NAVSIM.
const PAST_SAMPLES: usize = 14;

/// Angle from a lane's heading at which the ego drives against it, radians. Source: AlpaSim.
const AGAINST_RAD: f64 = 2.0 / 3.0 * std::f64::consts::PI;

/// Scorer of plans and drives in a log.
pub struct PdmScorer<'a> {
    pub(super) recorded: Recorded<'a>,
    pub(super) roads: Roads<'a>,
    pub(super) classes: Vec<Class>,
}

/// What a plan meets from a time on.
pub struct PdmScene<'a, 'b> {
    scorer: &'b PdmScorer<'a>,
    start_us: i64,
    /// States of the ego at 2 Hz, the last one at the start.
    past: Vec<PdmState>,
    /// Actors at 2 Hz, the first ones at the start.
    frames: Vec<Vec<SimActor>>,
    /// Ids of red lane connectors at these frames.
    red: Vec<BTreeSet<String>>,
}

/// Parts of a scene that depend on the ego's first state.
pub(super) struct Course {
    pub(super) route: Route,
    pub(super) traffic: Traffic,
    pub(super) reference: Vec<(DVec2, f64)>,
}

impl<'a> PdmScorer<'a> {
    /// Prepares the scores of a log; `None` without frames or a map with a drivable area.
    pub fn new(log: &'a Recording, map: &'a VectorMap) -> Option<Self> {
        let recorded = Recorded::new(log)?;
        let classes = log.tracks.iter().map(|track| track.class).collect();
        (!map.drivable_area.is_empty()).then(|| Self { recorded, roads: Roads::new(map), classes })
    }

    /// Returns the scene of plans from a time of the log on (absolute microseconds); `None` if the log does
    /// not have 1.5 s before and 4 s after it.
    pub fn scene(&self, start_us: i64) -> Option<PdmScene<'a, '_>> {
        let times = |range: std::ops::RangeInclusive<i64>| range.map(move |i| start_us + i * FRAME_US);
        let ego = |t_us: i64| self.recorded.ego_at(t_us).map(|ego| PdmState::logged(&ego));
        let past = times(-PAST_FRAMES..=0).map(ego).collect::<Option<Vec<PdmState>>>()?;
        self.recorded.ego_at(start_us + HORIZON_US)?;
        let ahead = || times(0..=HORIZON_US / FRAME_US);
        let red = |t_us: i64| red_ids(&self.recorded.lights_at(t_us));
        let log = self.recorded.log;
        let triggers = log.script.recorded(log, i64::MAX);
        Some(PdmScene {
            scorer: self,
            start_us,
            past,
            frames: ahead().map(|t_us| self.recorded.actors_at(t_us, &triggers)).collect(),
            red: ahead().map(red).collect(),
        })
    }

    /// Returns whether a heading (radians) is more than 120 degrees from a lane's at a position
    /// (global, meters).
    pub(crate) fn is_against_lane(&self, place: DVec2, heading_rad: f64) -> bool {
        self.roads.headings(place).any(|lane_rad| wrap_angle(lane_rad - heading_rad).abs() > AGAINST_RAD)
    }

    /// Returns route, traffic and reference for states from a first one on; `None` without a route.
    pub(super) fn course(
        &self,
        start_us: i64,
        first: &PdmState,
        frames: &[Vec<SimActor>],
        red: &[BTreeSet<String>],
    ) -> Option<Course> {
        let body = first.body();
        let route = self.roads.route(&self.recorded, first, start_us)?;
        let now = self.roads.red(&red[0], &route);
        let entered = |lane: &usize| {
            let ring = ring(&self.roads, *lane);
            body.corners().iter().all(|corner| in_ring(ring, *corner))
        };
        let entered = now.iter().copied().filter(entered).collect();
        let predicted = Traffic {
            red: vec![now; SAMPLES],
            entered,
            ..Traffic::predicted(&frames[0], &self.classes, &body)
        };
        let reference = closed::plan(first, &predicted, &self.roads, &route);
        let lights = (0..SAMPLES).map(|sample| self.roads.red(&red[sample / FRAME_SAMPLES], &route));
        let traffic = Traffic { red: lights.collect(), ..Traffic::between(frames, &self.classes, &body) };
        Some(Course { route, traffic, reference })
    }
}

/// Returns the ids of red lane connectors.
pub(super) fn red_ids(lights: &[TrafficLight]) -> BTreeSet<String> {
    lights.iter().filter(|light| light.color == "red").map(|light| light.lane_connector.clone()).collect()
}

impl PdmScene<'_, '_> {
    /// Returns the scene with other states of the ego at 2 Hz, the last one at the start; the log's are
    /// estimated from its poses.
    #[must_use]
    pub fn with_past(self, past: Vec<PdmState>) -> Self {
        Self { past, ..self }
    }

    /// Returns the scene with other red lane connectors all the time.
    #[must_use]
    pub fn with_red(self, lane_connectors: &BTreeSet<String>) -> Self {
        Self { red: vec![lane_connectors.clone(); self.red.len()], ..self }
    }

    /// Returns the ego's state at the start.
    pub fn start(&self) -> PdmState {
        self.past.last().copied().unwrap_or_default()
    }

    /// Scores plans. A plan is a number of poses, `interval_s` apart, in the frame of the ego at the start:
    /// meters to the front and left, radians. Returns `None` if the ego never moves in the log.
    pub fn score(&self, plans: &[Vec<DVec3>], interval_s: f64) -> Option<Vec<PdmResult>> {
        let start = self.start();
        let course = self.scorer.course(self.start_us, &start, &self.frames, &self.red)?;
        let reference = self.sampled(&course.reference, SAMPLE_US as f64 / 1e6, true);
        let reference = tracker::track(start, &reference);
        let parts =
            |states: &[PdmState]| Parts::of(states, &course.traffic, &self.scorer.roads, &course.route);
        let reference = parts(&reference);
        let past = self.past_samples();
        let result = |plan: &Vec<DVec3>| {
            let poses: Vec<_> = plan.iter().map(|pose| start.global(*pose)).collect();
            let states = tracker::track(start, &self.sampled(&poses, interval_s, false));
            let found = parts(&states);
            let comfortable = is_comfortable(&[&past[..], &states[..]].concat());
            let progress = progress(&[reference, found])[1];
            let scores = PdmScores::of(&found, progress, comfortable, is_comfortable(&states));
            PdmResult { scores, states }
        };
        Some(plans.iter().map(result).collect())
    }

    /// Returns the plan that the recorded ego drove: eight poses, 0.5 s apart.
    pub fn recorded_plan(&self) -> Vec<DVec3> {
        let start = self.start();
        let local = |ego: EgoState| {
            let (forward, arm) = (start.forward(), ego.position_m() - start.place_m);
            let arm = DVec2::new(forward.dot(arm), forward.perp_dot(arm));
            arm.extend(wrap_angle(ego.heading_rad() - start.heading_rad))
        };
        let times = (1..=HORIZON_US / FRAME_US).map(|i| self.start_us + i * FRAME_US);
        times.filter_map(|t_us| self.scorer.recorded.ego_at(t_us)).map(local).collect()
    }

    /// Interpolates poses to [`SAMPLES`] at 10 Hz; the ego's first pose is added unless they have one. As in
    /// NAVSIM, times are floating-point seconds, cut to whole microseconds.
    fn sampled(&self, poses: &[(DVec2, f64)], interval_s: f64, has_first: bool) -> Vec<(DVec2, f64)> {
        let start = self.start();
        let cut = |s: f64| ((s + self.start_us as f64 * 1e-6) * 1e6) as i64;
        let first = (!has_first).then_some((self.start_us, start.place_m, start.heading_rad));
        let knot = |(index, (place, heading)): (usize, &(DVec2, f64))| {
            let t_us = match has_first {
                true => self.start_us + index as i64 * SAMPLE_US,
                false => cut(index as f64 * interval_s + interval_s),
            };
            (t_us, *place, *heading)
        };
        let knots: Vec<_> = first.into_iter().chain(poses.iter().enumerate().map(knot)).collect();
        let last_us = knots.last().map_or(self.start_us, |knot| knot.0);
        let sample = |index: usize| {
            let t_us = cut(index as f64 * 0.1).clamp(self.start_us, last_us);
            let next = knots.partition_point(|knot| knot.0 < t_us).clamp(1, knots.len() - 1);
            let ((from_us, a, yaw), (to_us, b, other)) = (knots[next - 1], knots[next]);
            let s = (t_us - from_us) as f64 / (to_us - from_us) as f64;
            (a + s * (b - a), principal(yaw + s * wrap_angle(other - yaw)))
        };
        (0..SAMPLES).map(sample).collect()
    }

    /// Returns the states before the start that count for the comfort.
    fn past_samples(&self) -> Vec<PdmState> {
        let sample = |index: usize| {
            let frame = index / FRAME_SAMPLES;
            let s = (index % FRAME_SAMPLES) as f64 / FRAME_SAMPLES as f64;
            self.past[frame].between(&self.past[frame + 1], s)
        };
        (0..PAST_SAMPLES).map(sample).collect()
    }
}
