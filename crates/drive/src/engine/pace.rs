//! Pace of a simulation in real time.

use std::time::{Duration, Instant};

/// Maximum number of steps that are caught up; a machine that is slower slows the simulation down.
const MAX_LATE: u32 = 4;
/// Speeds, times the real time.
pub(super) const SPEEDS: std::ops::RangeInclusive<f64> = 0.05..=8.0;

/// When the next steps are due.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    playing: bool,
    speed: f64,
    /// Duration of a step at speed 1.
    period: Duration,
    next: Instant,
}

impl Pace {
    /// Creates a pace of some steps per second.
    pub(super) fn new(hz: f64, playing: bool, now: Instant) -> Self {
        Self { playing, speed: 1.0, period: Duration::from_secs_f64(1.0 / hz), next: now }
    }

    pub(super) fn is_playing(&self) -> bool {
        self.playing
    }

    pub(super) fn speed(&self) -> f64 {
        self.speed
    }

    /// Runs or pauses.
    pub(super) fn play(&mut self, playing: bool, now: Instant) {
        if playing && !self.playing {
            self.next = now;
        }
        self.playing = playing;
    }

    pub(super) fn set_speed(&mut self, speed: f64) {
        self.speed = speed;
    }

    fn step(&self) -> Duration {
        self.period.div_f64(self.speed)
    }

    /// Returns the time until the next step; `None` if it does not come by itself.
    pub(super) fn wait(&self, now: Instant) -> Option<Duration> {
        self.playing.then(|| self.next.saturating_duration_since(now))
    }

    /// Returns the number of steps that are due.
    pub(super) fn due(&mut self, now: Instant) -> u32 {
        if !self.playing || now < self.next {
            return 0;
        }
        let step = self.step();
        let late = (now - self.next).as_secs_f64() / step.as_secs_f64();
        let due = 1 + (late.min(f64::from(MAX_LATE)) as u32).min(MAX_LATE - 1);
        self.next += step * due;
        if self.next + step * MAX_LATE < now {
            self.next = now; // too slow for real time
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_due_in_real_time() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut pace = Pace::new(20.0, false, start);
        assert_eq!((pace.due(at(500)), pace.wait(at(500))), (0, None));
        pace.play(true, at(500));
        let due: Vec<u32> = [500, 520, 551, 700, 701, 10_000, 10_001].map(|ms| pace.due(at(ms))).to_vec();
        assert_eq!(due, [1, 0, 1, 3, 0, 4, 1]);
        pace.set_speed(0.5);
        assert_eq!((pace.due(at(10_060)), pace.due(at(10_090)), pace.due(at(10_200))), (1, 0, 1));
    }
}
