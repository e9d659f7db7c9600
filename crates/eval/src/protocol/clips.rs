use point_skeleton::dataset::Recording;
use point_skeleton::scene::frame_rate_hz;
use pskel_sim::{EgoPolicy, Rates};

use super::definition::{Length, Part, PartRates, Starts};

/// Clip of a log to generate.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// Name, also of the rollout's folder: the log's, with the second of its start or its number if a log has
    /// several.
    pub name: String,
    /// Time of the first frame, absolute microseconds.
    pub start_us: i64,
    /// Rates of its steps.
    pub clock: ClipClock,
    /// Number of frames, with the references.
    pub frames: usize,
}

/// Step rates of a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ClipClock {
    /// Every N-th frame of the log is a step and generated.
    Frames(usize),
    /// Steps at fixed rates, generated at the planning rate.
    Rates(Rates),
}

/// Largest relative difference between a rate and the rate of frames that have it.
const RATE_TOLERANCE: f64 = 0.05;

/// Error of a log with too few frames to generate one after the references.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("expected a log of more than {references} frames at {hz:.1} Hz, found {found}")]
pub struct ShortLog {
    references: usize,
    hz: f64,
    found: usize,
}

/// Error of a log without frames at the rate of a part whose images are copied into the data set.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "expected a log with frames at {hz} Hz for the copy of part {part}, found {found:.1} Hz (`pskel convert \
        --hz 12` writes annotations at 12 Hz)"
)]
pub struct OtherRate {
    part: &'static str,
    hz: f64,
    found: f64,
}

impl Clip {
    /// Returns the number of simulation steps after the first one.
    pub fn steps(&self) -> usize {
        let per_frame = match self.clock {
            ClipClock::Frames(_) => 1,
            ClipClock::Rates(rates) => (rates.sim_hz / rates.plan_hz).round() as usize,
        };
        (self.frames - 1) * per_frame
    }
}

impl Clip {
    /// Returns the times of its frames in a log, absolute microseconds, and their rate in hertz. They end
    /// with the log if the ego follows it.
    pub fn times_us(&self, log: &Recording, ego: &EgoPolicy) -> (Vec<i64>, f64) {
        let last_us = log.frames.last().map_or(i64::MIN, |frame| frame.t_us);
        match self.clock {
            ClipClock::Frames(every) => {
                let from = log.frames.iter().map(|frame| frame.t_us).filter(|t_us| *t_us >= self.start_us);
                let hz = frame_rate_hz(&log.frames).unwrap_or(1.0) / every as f64;
                (from.step_by(every).take(self.frames).collect(), hz)
            }
            ClipClock::Rates(Rates { sim_hz, plan_hz }) => {
                let per_frame = (sim_hz / plan_hz).round();
                let at =
                    |frame: usize| self.start_us + (frame as f64 * per_frame * 1e6 / sim_hz).round() as i64;
                let ends = *ego == EgoPolicy::Replay;
                ((0..self.frames).map(at).take_while(|t_us| !ends || *t_us <= last_us).collect(), plan_hz)
            }
        }
    }
}

impl Part {
    /// Returns its clips of a log with `rates` by default, for a generator with this number of reference
    /// frames. All lie within the log, except the first one if the log is shorter.
    ///
    /// # Errors
    /// Fails if the log ends with the references.
    pub fn clips(&self, log: &Recording, rates: Rates, references: usize) -> Result<Vec<Clip>, ShortLog> {
        let (clock, hz) = self.clock(log, rates);
        let times = log.frames.first().map(|frame| frame.t_us).zip(log.frames.last().map(|frame| frame.t_us));
        let (first_us, last_us) = times.unwrap_or_default();
        let found = match (clock, times) {
            (ClipClock::Frames(every), _) => log.frames.len().div_ceil(every),
            (ClipClock::Rates(_), None) => 0,
            (ClipClock::Rates(_), Some(_)) => ((last_us - first_us) as f64 / 1e6 * hz + 1e-6) as usize + 1,
        };
        if found <= references {
            return Err(ShortLog { references, hz, found });
        }
        let frames = match self.length {
            Length::Frames(frames) => frames.max(references + 1),
            Length::Generated(frames) => references + frames,
            Length::GeneratedS(seconds) => references + (seconds * hz).round() as usize,
        };
        let duration_us = ((frames - 1) as f64 / hz * 1e6).round() as i64;
        let spacing_s = match self.starts {
            Starts::First => {
                return Ok(vec![Clip { name: log.name.clone(), start_us: first_us, clock, frames }]);
            }
            Starts::EveryS(seconds) => seconds,
            Starts::Spread(count) => {
                let slack_s = (last_us - first_us - duration_us).max(0) as f64 / 1e6;
                (slack_s / (count.max(2) - 1) as f64).max(1.0 / hz)
            }
        };
        let clip = |number: usize| {
            let start_s = number as f64 * spacing_s;
            let name = match self.starts {
                Starts::Spread(_) => format!("{}-{number:02}", log.name),
                Starts::First | Starts::EveryS(_) => format!("{}-{start_s:03.0}s", log.name),
            };
            Clip { name, start_us: first_us + (start_s * 1e6).round() as i64, clock, frames }
        };
        let count = if let Starts::Spread(count) = self.starts { count } else { usize::MAX };
        // The last clip of `Spread` ends with the log, except for the rounding of its start.
        let fits = |clip: &Clip| clip.start_us == first_us || clip.start_us + duration_us <= last_us + 1;
        Ok((0..count).map(clip).take_while(fits).collect())
    }

    /// Checks that its clips step from frame to frame of a log with `rates` by default, if its images are
    /// copied into the data set: only then each image is at the time of a frame.
    ///
    /// # Errors
    /// Fails if the log has other frames.
    pub fn check_copy(&self, log: &Recording, rates: Rates) -> Result<(), OtherRate> {
        match self.clock(log, rates) {
            (ClipClock::Rates(_), hz) if self.copies_dataset => {
                Err(OtherRate { part: self.name, hz, found: frame_rate_hz(&log.frames).unwrap_or_default() })
            }
            _ => Ok(()),
        }
    }

    /// Returns the clock of its clips in a log, and the rate of their frames in hertz. Parts that follow the
    /// log step from frame to frame if its frames have their rate, since ground-truth images exist for
    /// frames.
    fn clock(&self, log: &Recording, rates: Rates) -> (ClipClock, f64) {
        // The stride of frames that is closest to a rate, and the rate of these frames.
        let by_frames = |hz: f64| {
            let log_hz = frame_rate_hz(&log.frames).unwrap_or(hz);
            let every = (log_hz / hz).round().max(1.0);
            (ClipClock::Frames(every as usize), log_hz / every)
        };
        let rates = match self.rates {
            PartRates::Frames(hz) => return by_frames(hz),
            PartRates::Fixed(rates) => rates,
            PartRates::OfLog => rates,
        };
        let (frames, hz) = by_frames(rates.plan_hz);
        let fits = (hz / rates.plan_hz - 1.0).abs() < RATE_TOLERANCE;
        if fits && self.ego == EgoPolicy::Replay {
            return (frames, hz);
        }
        (ClipClock::Rates(rates), rates.plan_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Protocol;
    use point_skeleton::dataset::Frame;
    use point_skeleton::geometry::Pose;

    /// A log of this many frames at this rate, from 1 s on.
    fn log(frames: i64, hz: i64) -> Recording {
        let frame = |i: i64| Frame {
            t_us: 1_000_000 + i * 1_000_000 / hz,
            global_from_ego: Pose::IDENTITY,
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        Recording { name: "log".to_owned(), frames: (0..frames).map(frame).collect(), ..Recording::default() }
    }

    fn clips(protocol: Protocol, part: usize, log: &Recording) -> Vec<Clip> {
        protocol.parts()[part].clips(log, Rates::NUSCENES, 3).unwrap()
    }

    #[test]
    fn clips_of_a_nuplan_log_start_every_ten_seconds() {
        // 20 frames at 5 Hz take 3.8 s: the third clip ends at 23.8 s.
        for (frames, starts) in [(239, vec![0, 10, 20]), (238, vec![0, 10]), (20, vec![0])] {
            let found = clips(Protocol::NuplanSimgen, 0, &log(frames, 10));
            let expected = |start: &i64| Clip {
                name: format!("log-{start:03}s"),
                start_us: (1 + start) * 1_000_000,
                clock: ClipClock::Frames(2),
                frames: 20,
            };
            assert_eq!(found, starts.iter().map(expected).collect::<Vec<_>>());
            assert_eq!(found[0].steps(), 19);
        }
        let off_log = clips(Protocol::NuplanSimgen, 3, &log(600, 10));
        assert_eq!((off_log.len(), off_log[0].steps(), off_log[0].name.as_str()), (1, 60, "log"));
        // Frames at 12 Hz do not have a rate of 5 Hz.
        let clock = clips(Protocol::NuplanSimgen, 0, &log(600, 12)).remove(0).clock;
        assert_eq!(clock, ClipClock::Rates(Rates { sim_hz: 10.0, plan_hz: 5.0 }));
    }

    #[test]
    fn lane_changes_are_spread_over_the_log() {
        // A clip takes 6 s: of a log of 4000 frames from 0 to 399.9 s, starts are 0 to 393.9 s.
        let found = clips(Protocol::NuplanSimgen, 1, &log(4000, 10));
        assert_eq!((found.len(), found[0].steps(), found[0].frames), (30, 60, 31));
        assert_eq!((found[0].name.as_str(), found[29].name.as_str()), ("log-00", "log-29"));
        let starts: Vec<i64> = found.iter().map(|clip| clip.start_us - 1_000_000).collect();
        assert_eq!((starts[0], starts[29]), (0, 393_900_000));
        let apart = starts.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(apart.clone().all(|us| (us - 393_900_000 / 29).abs() <= 1), "{starts:?}");
        // Two seconds of slack are 11 starts at 5 Hz; a log that is too short has one clip.
        assert_eq!(clips(Protocol::NuplanSimgen, 1, &log(81, 10)).len(), 11);
        assert_eq!(clips(Protocol::NuplanSimgen, 1, &log(20, 10)).len(), 1);
    }

    #[test]
    fn rejects_logs_without_generated_frames() {
        // Three frames at 6 Hz take 0.33 s.
        let six = &Protocol::NuscenesVal.parts()[0];
        let short = |log: &Recording| six.clips(log, Rates::NUSCENES, 3).unwrap_err().to_string();
        assert_eq!(short(&log(5, 12)), "expected a log of more than 3 frames at 6.0 Hz, found 3");
        // At 10 Hz, which is no multiple: 0.4 s.
        assert_eq!(short(&log(5, 10)), "expected a log of more than 3 frames at 6.0 Hz, found 3");
        assert!(six.clips(&log(7, 12), Rates::NUSCENES, 3).is_ok());
        assert_eq!(short(&Recording::default()), "expected a log of more than 3 frames at 6.0 Hz, found 0");
    }

    #[test]
    fn copies_need_frames_at_the_rate_of_the_part() {
        let check = |part: usize, hz: i64, copies_dataset: bool| {
            let part = Part { copies_dataset, ..Protocol::NuscenesVal.parts()[part].clone() };
            part.check_copy(&log(40, hz), Rates::NUSCENES)
        };
        for (part, hz) in [(0, 12), (0, 6), (1, 2), (1, 12), (1, 5), (2, 12), (2, 30)] {
            assert_eq!(check(part, hz, true), Ok(()), "{part} {hz}");
        }
        for (part, hz) in [(0, 2), (0, 10), (2, 2)] {
            assert!(check(part, hz, true).is_err() && check(part, hz, false).is_ok(), "{part} {hz}");
        }
        let message = "expected a log with frames at 6 Hz for the copy of part long, found 2.0 Hz (`pskel \
                       convert --hz 12` writes annotations at 12 Hz)";
        assert_eq!(check(2, 2, true).unwrap_err().to_string(), message);
    }

    #[test]
    fn nuscenes_scenes_have_one_clip_per_part() {
        // Annotations at 2 Hz, and those at 12 Hz of the same scene.
        for (frames, hz, every, steps) in [(40, 2, 1, 52), (240, 12, 6, 26)] {
            let log = log(frames, hz);
            let [six, two, long] = [0, 1, 2].map(|part| clips(Protocol::NuscenesVal, part, &log).remove(0));
            assert_eq!((six.frames, six.steps()), (27, steps));
            assert_eq!((two.frames, two.steps(), two.clock), (19, 18, ClipClock::Frames(every)));
            let per_frame = steps / 26;
            assert_eq!((long.frames, long.steps(), long.start_us), (100, 99 * per_frame, 1_000_000));
            // Both logs end after 19.5 s and more, the 100 frames at 6 Hz after 16.5 s.
            for (clip, expected, hz) in [(&six, 27, 6.0), (&two, 19, 2.0), (&long, 100, 6.0)] {
                let (times, found_hz) = clip.times_us(&log, &EgoPolicy::Replay);
                assert_eq!((times.len(), times[0]), (expected, 1_000_000));
                // Times of the log's frames are truncated to microseconds.
                let last_us = 1_000_000 + ((times.len() - 1) as f64 / hz * 1e6).round() as i64;
                assert!((times[times.len() - 1] - last_us).abs() <= 1, "{times:?}");
                assert!((found_hz - hz).abs() < 1e-4 * hz, "{found_hz}");
            }
        }
        // 10 s at the planning rate of the log, 2 Hz.
        let change = clips(Protocol::LaneChange, 1, &log(40, 2)).remove(0);
        assert_eq!((change.frames, change.steps()), (23, 132));
    }
}
