//! State of the log that is looked at: a time, and a displacement of the ego.

use std::sync::Arc;

use point_skeleton::dataset::{EgoTrack, Recording};
use point_skeleton::scene::{EgoOffset, SceneMap, SceneState, state_at, state_of_frame};

use crate::frame::Ego;
use crate::message::LookChange;

/// Maximum displacement, meters.
const MAX_OFFSET_M: f64 = 1000.0;

/// Time and displacement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Look {
    pub(super) at: At,
    pub(super) offset: EgoOffset,
}

/// Time that is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum At {
    /// Frame of the log, with the cameras at their own times.
    Frame(usize),
    /// Any time within the log, absolute microseconds.
    Time(i64),
}

impl Default for At {
    fn default() -> Self {
        Self::Frame(0)
    }
}

impl Look {
    /// Returns what is looked at after a change. Times are limited to those of the log.
    ///
    /// # Errors
    /// Returns what was expected and what was found.
    pub(super) fn changed(self, change: &LookChange, log: &Recording) -> Result<Self, String> {
        let mut look = self;
        if let Some(t_us) = change.t_us {
            look.at = At::time(t_us, log);
        }
        if let Some(frame) = change.frame {
            if frame >= log.frames.len() {
                return Err(format!("expected a frame of 0 to {}, found {frame}", log.frames.len() - 1));
            }
            look.at = At::Frame(frame);
        }
        let camera = change.camera.unwrap_or_default();
        let parts = [
            (&mut look.offset.forward_m, change.forward_m, MAX_OFFSET_M),
            (&mut look.offset.left_m, change.left_m, MAX_OFFSET_M),
            (&mut look.offset.up_m, camera.up_m, MAX_OFFSET_M),
            (&mut look.offset.yaw_deg, change.yaw_deg, 360.0),
            (&mut look.offset.pitch_deg, camera.pitch_deg, 90.0),
        ];
        for (part, value, most) in parts {
            let Some(value) = value else { continue };
            if value.is_nan() || value.abs() > most {
                return Err(format!("expected a displacement of at most {most}, found {value}"));
            }
            *part = value;
        }
        Ok(look)
    }

    /// Returns the time, absolute microseconds.
    pub(super) fn t_us(&self, log: &Recording) -> i64 {
        match self.at {
            At::Frame(index) => log.frames.get(index).map_or(0, |frame| frame.t_us),
            At::Time(t_us) => t_us,
        }
    }

    /// Returns the state; `None` if the log has no ego pose at its time.
    pub(super) fn state(
        &self,
        log: &Recording,
        ego: &EgoTrack,
        map: Option<Arc<SceneMap>>,
    ) -> Option<SceneState> {
        let state = match self.at {
            At::Frame(index) => state_of_frame(log, index, self.offset),
            At::Time(t_us) => state_at(log, ego, t_us, self.offset),
        }?;
        Some(SceneState { map, ..state })
    }

    /// Returns the arguments of `pskel render` for this state.
    pub(super) fn arguments(&self) -> Vec<String> {
        let mut arguments = match self.at {
            At::Frame(index) => vec!["--frames".to_owned(), format!("{index}..{}", index + 1)],
            At::Time(t_us) => vec!["--at".to_owned(), t_us.to_string()],
        };
        if self.offset != EgoOffset::default() {
            arguments.extend(["--ego-offset".to_owned(), self.offset.to_string()]);
        }
        arguments
    }
}

impl At {
    /// Returns a time within the log: the frame, if it is one's own time.
    pub(super) fn time(t_us: i64, log: &Recording) -> Self {
        let t_us = within(log, t_us);
        match log.frames.binary_search_by_key(&t_us, |frame| frame.t_us) {
            Ok(index) => Self::Frame(index),
            Err(_) => Self::Time(t_us),
        }
    }
}

/// Returns the time of a log that is nearest to a time, absolute microseconds.
pub(super) fn within(log: &Recording, t_us: i64) -> i64 {
    let (first, last) = (log.frames.first(), log.frames.last());
    first.zip(last).map_or(t_us, |(first, last)| t_us.clamp(first.t_us, last.t_us))
}

/// Returns the recorded ego at a time, displaced: position, and speed along the heading.
pub(super) fn ego_of(state: &SceneState, ego: &EgoTrack) -> Ego {
    const STEP_US: i64 = 100_000;
    let position = |t_us: i64| ego.at(t_us).map(|pose| pose.translation.truncate());
    let ends = [state.t_us - STEP_US, state.t_us + STEP_US].map(|t_us| position(t_us).map(|at| (t_us, at)));
    let here = position(state.t_us).map(|at| (state.t_us, at));
    let moved = ends[0].or(here).zip(ends[1].or(here));
    let speed_mps = moved.filter(|((a, _), (b, _))| a < b).map_or(0.0, |((a, from), (b, to))| {
        let seconds = (b - a) as f64 / 1e6;
        from.distance(to) / seconds
    });
    let at = state.global_from_ego.translation;
    let yaw_rad = state.global_from_ego.yaw_rad();
    Ego { x: at.x, y: at.y, z: at.z, yaw_rad, speed_mps, ..Ego::default() }
}
