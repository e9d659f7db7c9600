use std::collections::{BTreeMap, BTreeSet};
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use super::{
    EgoOffset, SceneMap, SceneState, name_of_frame, name_of_time, state_at, state_beside, state_of_frame,
    with_cameras,
};
use crate::dataset::{EgoTrack, Frame, Recording};
use crate::geometry::View;

/// Maximum rate, per second: times are whole microseconds.
const MAX_RATE_HZ: f64 = 1e6;

/// Rates that options accept, per second.
pub const RATES_HZ: RangeInclusive<f64> = 0.1..=100.0;

/// Times of a log.
#[derive(Clone, Debug, PartialEq)]
pub enum LogTimes {
    /// Frames of the log.
    Frames(Range<usize>),
    /// Times at a rate (per second, more than 0, at most 10⁶), from the first to the last of these frames.
    Rate(Range<usize>, f64),
    /// These times, absolute microseconds.
    At(Vec<i64>),
}

/// States of a log at several times: ego and actors of the log, optionally with other cameras.
#[derive(Clone, Debug)]
pub struct SceneSequence<'a> {
    log: &'a Recording,
    ego: EgoTrack,
    offset: EgoOffset,
    views: Option<Vec<View>>,
    map: Option<Arc<SceneMap>>,
    hidden: BTreeSet<String>,
    steps: Vec<Step>,
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Frame(usize),
    Time(i64),
}

impl<'a> SceneSequence<'a> {
    /// Creates the sequence of a log at some times. `views` replace the cameras of the log and are fixed in
    /// the global frame; `map` is the HD map of all states.
    ///
    /// # Errors
    /// Fails if the rate is out of range, if a time occurs twice or is outside the log, if there are no
    /// times, or if there are no cameras.
    pub fn new(
        log: &'a Recording,
        times: LogTimes,
        offset: EgoOffset,
        views: Option<Vec<View>>,
        map: Option<Arc<SceneMap>>,
    ) -> Result<Self, SequenceError> {
        let name = || log.shown_name().into_owned();
        let steps: Vec<Step> = match times {
            LogTimes::Frames(frames) => frames.map(Step::Frame).collect(),
            LogTimes::Rate(_, hz) if !(hz > 0.0 && hz <= MAX_RATE_HZ) => {
                return Err(SequenceError::Rate { hz });
            }
            LogTimes::Rate(frames, hz) => {
                let frames = log.frames.get(frames).unwrap_or_default();
                times_at_rate(frames, hz).map(Step::Time).collect()
            }
            LogTimes::At(times) => {
                check_times(log, &times)?;
                times.into_iter().map(Step::Time).collect()
            }
        };
        if steps.is_empty() {
            return Err(SequenceError::NoFrames { log: name() });
        }
        if views.is_none() && log.cameras.is_empty() {
            return Err(SequenceError::NoCameras { log: name() });
        }
        let (ego, hidden) = (EgoTrack::new(log), BTreeSet::new());
        Ok(Self { log, ego, offset, views, map, hidden, steps })
    }

    /// Leaves the actors of some tracks out of all states.
    ///
    /// # Errors
    /// Fails if the log has no such track.
    pub fn hiding(self, tracks: BTreeSet<String>) -> Result<Self, SequenceError> {
        match tracks.iter().find(|id| self.log.tracks.iter().all(|track| track.id != **id)) {
            Some(id) => {
                Err(SequenceError::NoTrack { track: id.clone(), log: self.log.shown_name().into_owned() })
            }
            None => Ok(Self { hidden: tracks, ..self }),
        }
    }

    /// Returns the number of states; at least one.
    #[allow(clippy::len_without_is_empty)] // never empty
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Returns the names of the states, in order.
    pub fn names(&self) -> impl Iterator<Item = String> {
        self.steps.iter().map(|step| match *step {
            Step::Frame(index) => name_of_frame(index),
            Step::Time(t_us) => name_of_time(t_us),
        })
    }

    /// Returns the states, in order. An item is an error if the log has no ego pose at its time.
    pub fn states(&self) -> impl Iterator<Item = Result<SceneState, SequenceError>> {
        self.steps.iter().map(|step| {
            let state = match *step {
                Step::Frame(index) => state_of_frame(self.log, index, self.offset),
                Step::Time(t_us) => state_at(self.log, &self.ego, t_us, self.offset),
            };
            let mut state = state.ok_or(SequenceError::NoPose)?;
            state.map.clone_from(&self.map);
            let state = state.hiding(&self.hidden);
            Ok(match &self.views {
                Some(views) => with_cameras(state, views),
                None => state,
            })
        })
    }

    /// Returns the state some seconds before a state of the sequence, or after it if that is outside the log,
    /// with the same offset of the ego; `None` if both are outside. The times between are those of a sweep.
    pub fn beside(&self, state: &SceneState, seconds: f64) -> Option<SceneState> {
        state_beside(self.log, &self.ego, state.t_us, seconds, self.offset)
    }

    /// Counts the frames without an image of a log's camera, by camera.
    pub fn missing_images(&self) -> BTreeMap<&str, usize> {
        let mut missing = BTreeMap::new();
        for step in &self.steps {
            let (Step::Frame(index), None) = (*step, &self.views) else { continue };
            let has = |channel| self.log.frames[index].images.iter().any(|i| i.channel == channel);
            for (_, camera) in self.log.cameras.iter().enumerate().filter(|(channel, _)| !has(*channel)) {
                *missing.entry(camera.as_str()).or_default() += 1;
            }
        }
        missing
    }
}

/// Invalid times of a [`SceneSequence`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SequenceError {
    /// The rate is out of range.
    #[error("expected a rate of more than 0 and at most {MAX_RATE_HZ} Hz, found {hz}")]
    Rate {
        /// The rate, per second.
        hz: f64,
    },
    /// The log has no such track.
    #[error("expected tracks of log {log}, found {track:?}")]
    NoTrack {
        /// Track id.
        track: String,
        /// Name of the log.
        log: String,
    },
    /// A time occurs twice; times become folder names.
    #[error("expected times that differ, found {t_us} twice")]
    Twice {
        /// The time, absolute microseconds.
        t_us: i64,
    },
    /// A time is outside the log.
    #[error("expected times within log {log} ({range} us), found {t_us}")]
    Outside {
        /// Name of the log.
        log: String,
        /// First and last time of the log.
        range: String,
        /// The time, absolute microseconds.
        t_us: i64,
    },
    /// The log has no frames.
    #[error("expected a log with frames, found none in {log}")]
    NoFrames {
        /// Name of the log.
        log: String,
    },
    /// The log has no cameras, and no others are given.
    #[error("expected cameras in log {log} or others in their place, found none")]
    NoCameras {
        /// Name of the log.
        log: String,
    },
    /// The log has no ego pose at a time.
    #[error("expected a time within the log's ego poses")]
    NoPose,
}

/// Returns the times from the first to the last frame at a rate: the first one and every `1 / hz` seconds,
/// each rounded to microseconds separately, so that they do not drift.
fn times_at_rate(frames: &[Frame], hz: f64) -> impl Iterator<Item = i64> {
    let ends = frames.first().zip(frames.last()).map(|(first, last)| [first.t_us, last.t_us]);
    ends.into_iter().flat_map(move |[first, last]| {
        let times = (0_u64..).map(move |i| first.saturating_add((i as f64 * 1e6 / hz).round() as i64));
        times.take_while(move |t_us| *t_us <= last)
    })
}

fn check_times(log: &Recording, times: &[i64]) -> Result<(), SequenceError> {
    for (i, &t_us) in times.iter().enumerate() {
        if times[..i].contains(&t_us) {
            return Err(SequenceError::Twice { t_us });
        }
        if !log.covers(t_us) {
            let ends = log.frames.first().zip(log.frames.last());
            let range = ends.map_or("nothing".to_owned(), |(a, b)| format!("{} to {}", a.t_us, b.t_us));
            return Err(SequenceError::Outside { log: log.shown_name().into_owned(), range, t_us });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    /// Returns the number of states at a rate, for a log with three frames in 0.2 s.
    fn count(frames: Range<usize>, hz: f64) -> Result<usize, SequenceError> {
        let frame = |i: i64| Frame {
            t_us: i * 100_000,
            global_from_ego: Pose::IDENTITY,
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        let log = Recording { frames: (0..3).map(frame).collect(), ..Recording::default() };
        let times = LogTimes::Rate(frames, hz);
        SceneSequence::new(&log, times, EgoOffset::default(), Some(Vec::new()), None)
            .map(|states| states.len())
    }

    #[test]
    fn rates_are_positive_and_bounded() {
        for (hz, states) in [(10.0, 3), (20.0, 5), (4.0, 1), (1e-300, 1), (MAX_RATE_HZ, 200_001)] {
            assert_eq!(count(0..3, hz), Ok(states), "{hz}");
        }
        for hz in [0.0, -1.0, f64::INFINITY, f64::NAN, 2.0 * MAX_RATE_HZ] {
            assert!(matches!(count(0..3, hz), Err(SequenceError::Rate { .. })), "{hz}");
        }
        assert!(matches!(count(1..4, 10.0), Err(SequenceError::NoFrames { .. })));
    }
}
