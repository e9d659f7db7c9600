//! PDM scores of what was driven: windows of four seconds of a rollout.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec2, DVec3};
use point_skeleton::geometry::{Cuboid, Pose, wrap_angle};
use serde::Serialize;

use super::comfort::is_comfortable;
use super::scene::PdmScorer;
use super::score::{Parts, progress};
use super::state::{PdmState, principal};
use super::{FRAME_US, HORIZON_US, PdmScores, SAMPLE_US, SAMPLES, tracker};
use crate::SimActor;
use crate::report::{ActorRow, EgoRow, Phase, StepRow};

/// Samples before a window that count for the comfort, if the rollout has them: 1.5 s to 0.1 s before.
const PAST_SAMPLES: i64 = 15;

/// Mean PDM scores of the windows of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DriveScores {
    /// Number of windows of four seconds; they start every half second from the takeover on.
    pub windows: usize,
    /// Means over the windows. There is no two-frame comfort, since there is one drive.
    #[serde(flatten)]
    pub mean: PdmScores,
}

impl PdmScorer<'_> {
    /// Scores the steps of a rollout from the takeover on. What was driven is scored itself, without a
    /// controller, among the actors of the rollout; the progress of PDM-Closed from the start of each window
    /// is the reference. `None` for less than four seconds, or without a route.
    pub fn drive(&self, rows: &[StepRow]) -> Option<DriveScores> {
        let tracks: BTreeMap<&str, usize> = self
            .recorded
            .log
            .tracks
            .iter()
            .enumerate()
            .map(|(number, track)| (track.id.as_str(), number))
            .collect();
        let drive = Drive { rows, tracks };
        // The last step of the warm-up is the first one of the drive.
        let first =
            rows.iter().position(|row| row.phase == Phase::Policy).map_or(0, |row| row.saturating_sub(1));
        let (start_us, end_us) = (rows.get(first)?.t_us, rows.last()?.t_us);
        let starts = (0..).map(|i| start_us + i * FRAME_US).take_while(|t_us| t_us + HORIZON_US <= end_us);
        let scores: Vec<PdmScores> = starts.filter_map(|t_us| self.window(&drive, t_us)).collect();
        let mean = PdmScores::mean(&scores)?;
        Some(DriveScores { windows: scores.len(), mean })
    }

    fn window(&self, drive: &Drive<'_>, start_us: i64) -> Option<PdmScores> {
        let ego = |sample: i64| drive.ego(start_us + sample * SAMPLE_US);
        let states = (0..SAMPLES as i64).map(ego).collect::<Option<Vec<PdmState>>>()?;
        let past: Vec<PdmState> = (-PAST_SAMPLES..0).filter_map(ego).collect();
        let frames = || (0..=HORIZON_US / FRAME_US).map(|i| start_us + i * FRAME_US);
        let actors: Vec<Vec<SimActor>> = frames().map(|t_us| drive.actors(t_us)).collect();
        let red: Vec<BTreeSet<String>> = frames().map(|t_us| drive.red(t_us)).collect();
        let course = self.course(start_us, &states[0], &actors, &red)?;
        let reference = tracker::track(states[0], &course.reference);
        let parts = |states: &[PdmState]| Parts::of(states, &course.traffic, &self.roads, &course.route);
        let found = parts(&states);
        let progress = progress(&[parts(&reference), found])[1];
        let comfortable = is_comfortable(&[&past[..], &states[..]].concat());
        Some(PdmScores::of(&found, progress, comfortable, is_comfortable(&states)))
    }
}

/// Steps of a rollout, interpolated.
struct Drive<'a> {
    rows: &'a [StepRow],
    tracks: BTreeMap<&'a str, usize>,
}

impl Drive<'_> {
    /// Returns the rows around a time (microseconds) and the second one's share.
    fn around(&self, t_us: i64) -> Option<(&StepRow, &StepRow, f64)> {
        let next = self.rows.partition_point(|row| row.t_us < t_us);
        let after = self.rows.get(next)?;
        if after.t_us == t_us {
            return Some((after, after, 0.0));
        }
        let before = self.rows.get(next.checked_sub(1)?)?;
        Some((before, after, (t_us - before.t_us) as f64 / (after.t_us - before.t_us) as f64))
    }

    fn ego(&self, t_us: i64) -> Option<PdmState> {
        let (before, after, s) = self.around(t_us)?;
        Some(state(before).between(&state(after), s))
    }

    fn actors(&self, t_us: i64) -> Vec<SimActor> {
        let Some((before, after, s)) = self.around(t_us) else { return Vec::new() };
        let later: BTreeMap<&str, &ActorRow> =
            after.actors.iter().map(|actor| (actor.track.as_str(), actor)).collect();
        let actor = |actor: &ActorRow| {
            let track = *self.tracks.get(actor.track.as_str())?;
            Some(between(track, actor, later.get(actor.track.as_str())?, s))
        };
        before.actors.iter().filter_map(actor).collect()
    }

    fn red(&self, t_us: i64) -> BTreeSet<String> {
        let Some((row, ..)) = self.around(t_us) else { return BTreeSet::new() };
        let red = row.lights.iter().filter(|light| light.color == "red");
        red.map(|light| light.lane_connector.clone()).collect()
    }
}

fn state(row: &StepRow) -> PdmState {
    let EgoRow { heading_rad, speed_mps, acceleration_mps2, yaw_rate_radps, steering_rad, .. } = row.ego;
    PdmState {
        place_m: row.place_m(),
        heading_rad: principal(heading_rad),
        velocity_mps: DVec2::new(speed_mps, 0.0),
        acceleration_mps2: DVec2::new(acceleration_mps2, speed_mps * yaw_rate_radps),
        steering_rad,
        yaw_rate_radps,
        yaw_acceleration_radps2: 0.0,
    }
}

fn between(track: usize, before: &ActorRow, after: &ActorRow, s: f64) -> SimActor {
    let heading_rad = before.heading_rad + s * wrap_angle(after.heading_rad - before.heading_rad);
    let center = DVec3::from(before.center_m).lerp(DVec3::from(after.center_m), s);
    let velocity = DVec2::from(before.velocity_mps).lerp(DVec2::from(after.velocity_mps), s);
    let forward = DVec2::from_angle(heading_rad);
    SimActor {
        track,
        cuboid: Cuboid { pose: Pose::from_yaw(heading_rad, center), size: DVec3::from(before.size_m) },
        speed_mps: forward.dot(velocity),
        lateral_mps: forward.perp_dot(velocity),
        yaw_rate_radps: before.yaw_rate_radps,
    }
}
