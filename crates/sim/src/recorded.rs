use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use point_skeleton::dataset::{Command, EgoTrack, Recording, TrackBox, TrafficLight, Triggers};
use point_skeleton::geometry::{Cuboid, LineProjection, Pose, wrap_angle};

use super::time::seconds;
use super::{EgoState, Instant, Scenario, SimActor, SimError, WHEELBASE_M};
use crate::path::fit::motion;
use crate::path::route::Route;

/// Half width of the pose window for estimating the ego's motion, seconds.
const EGO_WINDOW_S: f64 = 0.5;
/// Half width of the box window for estimating an actor's motion, seconds. It holds at least two frames of a
/// 2 Hz log.
const ACTOR_WINDOW_S: f64 = 0.6;
/// Minimum time between frames that counts as a gap, seconds.
const GAP_S: f64 = 1.0;
/// Interval over which the motion of a scripted actor is measured, microseconds.
const SCRIPT_WINDOW_US: i64 = 100_000;
/// Interval and number of the boxes ahead on a scripted path.
const AHEAD_STEP_US: i64 = 200_000;
const AHEAD_STEPS: i64 = 300;
/// Minimum speed for steering angles from yaw rates, meters per second.
const CREEP_MPS: f64 = 0.5;

/// Motion of a track: speeds along and across its heading, the latter to the left, meters per second, and yaw
/// rate to the left, radians per second.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ActorMotion {
    pub(super) speed_mps: f64,
    pub(super) lateral_mps: f64,
    pub(super) yaw_rate_radps: f64,
}

/// Recorded states of a log, interpolated at any time.
pub(super) struct Recorded<'a> {
    pub(super) log: &'a Recording,
    pub(super) route: Route,
    ego: EgoTrack,
    /// Boxes of each track without timed edits, in time order with absolute microseconds.
    tracks: Vec<Vec<(i64, Cuboid)>>,
    /// Times of the first and last frame, absolute microseconds.
    pub(super) first_us: i64,
    pub(super) last_us: i64,
}

impl<'a> Recorded<'a> {
    /// Indexes a scenario's log. Fails if the log has no frames.
    pub(super) fn of(scenario: &Scenario<'a>) -> Result<Self, SimError> {
        let log = scenario.log;
        Self::new(log).ok_or_else(|| SimError::NoFrames { log: log.name.clone() })
    }

    /// Indexes a log; `None` if it has no frames.
    pub(super) fn new(log: &'a Recording) -> Option<Self> {
        let (first_us, last_us) = (log.frames.first()?.t_us, log.frames.last()?.t_us);
        let mut tracks = vec![Vec::new(); log.tracks.len()];
        for frame in &log.frames {
            for item in &frame.boxes {
                if let Some(boxes) = tracks.get_mut(item.track) {
                    boxes.push((frame.t_us, item.cuboid));
                }
            }
        }
        for (track, boxes) in tracks.iter_mut().enumerate() {
            if let Some(of_log) = log.script.boxes_of_log(track) {
                *boxes = of_log;
            }
        }
        let ego = EgoTrack::new(log);
        Some(Self { log, route: Route::new(&ego), ego, tracks, first_us, last_us })
    }

    /// Returns notes on the log for the user: kinds with their counts.
    pub(super) fn notes(&self) -> BTreeMap<String, usize> {
        let gaps = self.log.frames.windows(2).filter(|w| seconds(w[0].t_us, w[1].t_us) > GAP_S).count();
        let boxless = usize::from(self.tracks.iter().all(Vec::is_empty));
        let notes = [("gaps of more than 1 s between frames", gaps), ("logs without boxes", boxless)];
        notes.into_iter().filter(|(_, n)| *n > 0).map(|(kind, n)| (kind.to_owned(), n)).collect()
    }

    /// Returns the recorded state at a time, with scripted actors; `None` outside the log.
    pub(super) fn instant(&self, step: usize, t_us: i64, triggers: &Triggers) -> Option<Instant> {
        let (ego, actors) = (self.ego_at(t_us)?, self.actors_at(t_us, triggers));
        Some(Instant { step, t_us, ego, actors, lights: self.lights_at(t_us) })
    }

    /// Returns the recorded ego state: the exact pose, and motion from a parabola fitted to the surrounding
    /// poses. `None` outside the log.
    pub(super) fn ego_at(&self, t_us: i64) -> Option<EgoState> {
        let pose = self.ego.at(t_us).filter(|_| (self.first_us..=self.last_us).contains(&t_us))?;
        let forward = pose.rotation * DVec3::X;
        let moved = motion(&samples(window(self.ego.poses(), t_us, EGO_WINDOW_S, 3), t_us, &pose), false);
        let velocity = moved.rate.truncate().extend(0.0);
        let (speed_mps, yaw_rate_radps) = (velocity.dot(forward), moved.rate.z);
        let steers = speed_mps.abs() > CREEP_MPS;
        Some(EgoState {
            pose,
            speed_mps,
            acceleration_mps2: moved.second.truncate().extend(0.0).dot(forward),
            yaw_rate_radps,
            steering_rad: if steers { (WHEELBASE_M * yaw_rate_radps / speed_mps).atan() } else { 0.0 },
        })
    }

    /// Returns the recorded and scripted actors at a time, sorted by track.
    pub(super) fn actors_at(&self, t_us: i64, triggers: &Triggers) -> Vec<SimActor> {
        let script = &self.log.script;
        let scripted: Vec<usize> = script.tracks().collect();
        let mut boxes = self.log.boxes_at(t_us);
        boxes.retain(|item| item.track < self.tracks.len() && scripted.binary_search(&item.track).is_err());
        let item =
            |track: &usize| Some(TrackBox { track: *track, cuboid: script.box_at(*track, t_us, triggers)? });
        boxes.extend(scripted.iter().filter_map(item));
        boxes.sort_by_key(|item| item.track);
        boxes.into_iter().map(|item| self.actor_of(item, t_us, triggers)).collect()
    }

    /// Returns a box of log or script as an actor.
    pub(super) fn actor_of(&self, item: TrackBox, t_us: i64, triggers: &Triggers) -> SimActor {
        let moved = match self.log.script.command(item.track, t_us, triggers) {
            Command::Free => self.actor_motion(item.track, t_us),
            _ => self.scripted_motion(item, t_us, triggers),
        };
        SimActor {
            track: item.track,
            cuboid: item.cuboid,
            speed_mps: moved.speed_mps,
            lateral_mps: moved.lateral_mps,
            yaw_rate_radps: moved.yaw_rate_radps,
        }
    }

    /// Returns a scripted actor's motion: to its box shortly after, or else from the one shortly before.
    fn scripted_motion(&self, item: TrackBox, t_us: i64, triggers: &Triggers) -> ActorMotion {
        let at = |t_us: i64| Some(self.log.script.box_at(item.track, t_us, triggers)?.pose);
        let here = Some(item.cuboid.pose);
        let (script, after_us) = (&self.log.script, t_us.saturating_add(SCRIPT_WINDOW_US));
        let goes_on =
            script.since(item.track, after_us, triggers) == script.since(item.track, t_us, triggers);
        let after = here.zip(at(after_us).filter(|_| goes_on));
        let ends = after.or_else(|| at(t_us.saturating_sub(SCRIPT_WINDOW_US)).zip(here));
        let Some((from, to)) = ends else { return ActorMotion::default() };
        let window_s = SCRIPT_WINDOW_US as f64 / 1e6;
        let velocity = (to.translation - from.translation).truncate() / window_s;
        let heading = DVec2::from_angle(item.cuboid.pose.yaw_rad());
        ActorMotion {
            speed_mps: velocity.dot(heading),
            lateral_mps: heading.perp_dot(velocity),
            yaw_rate_radps: wrap_angle(to.yaw_rad() - from.yaw_rad()) / window_s,
        }
    }

    /// Returns a track's motion at a time, from a line fitted to the surrounding boxes.
    pub(super) fn actor_motion(&self, track: usize, t_us: i64) -> ActorMotion {
        let near = window(&self.tracks[track], t_us, ACTOR_WINDOW_S, 2);
        let Some((_, base)) = near.iter().min_by_key(|(at, _)| at.abs_diff(t_us)) else {
            return ActorMotion::default();
        };
        let poses: Vec<(i64, Pose)> = near.iter().map(|(at, cuboid)| (*at, cuboid.pose)).collect();
        let moved = motion(&samples(&poses, t_us, &base.pose), true);
        let (velocity, heading) = (moved.rate.truncate(), DVec2::from_angle(base.pose.yaw_rad()));
        ActorMotion {
            speed_mps: velocity.dot(heading),
            lateral_mps: heading.perp_dot(velocity),
            yaw_rate_radps: moved.rate.z,
        }
    }

    /// Projects the log's ego at a time (microseconds) onto its own path.
    pub(super) fn logged_projection(&self, ego: &EgoState, t_us: i64) -> LineProjection {
        let place_m = ego.position_m();
        self.route.around(self.route.station_at(t_us), place_m).project(place_m)
    }

    /// Returns a track's boxes after a time on the path of log or script, in time order, without the script's
    /// changes of its size.
    pub(super) fn boxes_after(&self, track: usize, t_us: i64, triggers: &Triggers) -> Vec<Cuboid> {
        let script = &self.log.script;
        if script.has_path(track, t_us, triggers) {
            let times_us = (1..=AHEAD_STEPS).map(|step| t_us.saturating_add(step * AHEAD_STEP_US));
            let resized = |t_us: i64| {
                let cuboid = script.box_at(track, t_us, triggers)?;
                let sizes = script.sizes_at(track, t_us, triggers);
                Some(sizes.map_or(cuboid, |[without, _]| cuboid.resized(without)))
            };
            return times_us.map_while(resized).collect();
        }
        let later = self.tracks[track].iter().filter(|(at, _)| *at > t_us);
        later.map(|(_, cuboid)| *cuboid).collect()
    }

    /// Returns the traffic lights of the last frame up to a time; after the log they keep their last state.
    pub(super) fn lights_at(&self, t_us: i64) -> Vec<TrafficLight> {
        let Some(frame) = self.log.frames.partition_point(|f| f.t_us <= t_us).checked_sub(1) else {
            return Vec::new();
        };
        let lights = &self.log.lights;
        let first = lights.partition_point(|light| light.frame < frame);
        let last = lights.partition_point(|light| light.frame <= frame);
        lights[first..last].to_vec()
    }
}

/// Returns the samples within `reach_s` of a time, extended on both sides to at least `enough` samples if
/// available.
fn window<T>(samples: &[(i64, T)], t_us: i64, reach_s: f64, enough: usize) -> &[(i64, T)] {
    let reach_us = (reach_s * 1e6) as i64;
    let mut first = samples.partition_point(|(at, _)| *at < t_us.saturating_sub(reach_us));
    let mut last = samples.partition_point(|(at, _)| *at <= t_us.saturating_add(reach_us));
    while last - first < enough.min(samples.len()) {
        first = first.saturating_sub(1);
        last = (last + 1).min(samples.len());
    }
    &samples[first..last]
}

/// Converts poses to seconds from a time, and x, y (meters) and yaw (radians) relative to a base pose.
fn samples(poses: &[(i64, Pose)], t_us: i64, base: &Pose) -> Vec<(f64, DVec3)> {
    let yaw = base.yaw_rad();
    let sample = |(at, pose): &(i64, Pose)| {
        let arm = pose.translation - base.translation;
        (seconds(t_us, *at), DVec3::new(arm.x, arm.y, wrap_angle(pose.yaw_rad() - yaw)))
    };
    poses.iter().map(sample).collect()
}
