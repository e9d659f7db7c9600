use point_skeleton::dataset::Recording;
use point_skeleton::scene::frame_rate_hz;

use super::{ActorPolicy, EgoPolicy, Rates, SimError, SimOptions};

/// Range of simulation rates, hertz: fewer steps per second do not move smoothly, more only cost time.
const SIM_HZ: [f64; 2] = [1.0, 1000.0];
const MIN_PLAN_HZ: f64 = 0.01;

/// Times of the steps, and the steps at which a plan is due.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Clock {
    pub(super) start_us: i64,
    pub(super) rates: Rates,
    /// Steps per plan, at least 1.
    pub(super) steps_per_plan: usize,
    /// Last step whose ego is taken from the log.
    pub(super) takeover: usize,
    /// Times of the steps if they are frames of a log, absolute microseconds.
    frames_us: Option<Vec<i64>>,
}

impl SimOptions {
    /// Returns the rates to simulate a log whose format has the given default rates.
    ///
    /// # Errors
    /// Returns an error if a rate is out of range, if the planning rate does not divide the simulation rate,
    /// or if steps are frames of the log and the other options contradict that.
    pub fn rates(&self, defaults: Rates, log: &Recording) -> Result<Rates, SimError> {
        let Some(every) = self.every_frames else {
            let sim_hz = self.sim_hz.unwrap_or(defaults.sim_hz);
            return checked(Rates { sim_hz, plan_hz: self.plan_hz.unwrap_or(defaults.plan_hz) });
        };
        let follows_log = self.ego == EgoPolicy::Replay && self.actors == ActorPolicy::Replay;
        if every == 0 || !follows_log || self.sim_hz.or(self.plan_hz).is_some() {
            return Err(SimError::Frames { every });
        }
        let hz = frame_rate_hz(&log.frames).map_or(defaults.plan_hz, |hz| hz / every as f64);
        checked(Rates { sim_hz: hz, plan_hz: hz })
    }
}

fn checked(rates: Rates) -> Result<Rates, SimError> {
    let Rates { sim_hz, plan_hz } = rates;
    let checks = [("steps a second", sim_hz, SIM_HZ), ("plans a second", plan_hz, [MIN_PLAN_HZ, SIM_HZ[1]])];
    for (what, found, [min, max]) in checks {
        if !(min..=max).contains(&found) {
            return Err(SimError::Rate { what, min, max, found });
        }
    }
    let ratio = sim_hz / plan_hz;
    // Quotients of rates like 10 and 10/3 Hz have rounding errors.
    if ratio.round() < 1.0 || (ratio - ratio.round()).abs() > 1e-9 * ratio {
        return Err(SimError::Clock { sim_hz, plan_hz });
    }
    Ok(rates)
}

impl Clock {
    /// Validates the rates and creates the clock; steps at frames use the times of a log.
    pub(super) fn of(
        options: &SimOptions,
        defaults: Rates,
        start_us: i64,
        log: &Recording,
    ) -> Result<Self, SimError> {
        let rates = options.rates(defaults, log)?;
        let frames_us = options.every_frames.map(|every| {
            let times = log.frames.iter().map(|frame| frame.t_us).filter(|t_us| *t_us >= start_us);
            times.step_by(every).collect::<Vec<i64>>()
        });
        let start_us = frames_us.iter().flatten().next().copied().unwrap_or(start_us);
        let steps_per_plan = (rates.sim_hz / rates.plan_hz).round() as usize;
        let takeover = options.warmup_frames.saturating_sub(1).saturating_mul(steps_per_plan);
        Ok(Self { start_us, rates, steps_per_plan, takeover, frames_us })
    }

    /// Returns the clock with another last step of the log.
    pub(super) fn with_takeover(&self, takeover: usize) -> Self {
        Self { takeover, ..self.clone() }
    }

    /// Returns the time of a step, absolute microseconds; `i64::MAX` beyond a log's frames.
    pub(super) fn at(&self, step: usize) -> i64 {
        if let Some(times) = &self.frames_us {
            return times.get(step).copied().unwrap_or(i64::MAX);
        }
        self.start_us.saturating_add((step as f64 * 1e6 / self.rates.sim_hz).round() as i64)
    }

    /// Returns the time this many steps before the start, absolute microseconds.
    pub(super) fn before_start(&self, steps: i64) -> i64 {
        self.start_us.saturating_sub((steps as f64 * 1e6 / self.rates.sim_hz).round() as i64)
    }

    /// Returns whether a plan is due at a step.
    pub(super) fn plans_at(&self, step: usize) -> bool {
        step >= self.takeover && step.is_multiple_of(self.steps_per_plan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clock(sim_hz: f64, plan_hz: f64) -> Result<Clock, SimError> {
        let options = SimOptions {
            sim_hz: Some(sim_hz),
            plan_hz: Some(plan_hz),
            warmup_frames: 4,
            ..SimOptions::default()
        };
        Clock::of(&options, Rates::default(), 1000, &Recording::default())
    }

    #[test]
    fn times_do_not_drift() {
        let clock = clock(12.0, 2.0).unwrap();
        assert_eq!(
            [0, 1, 2, 3, 12, 1_200_000].map(|i| clock.at(i) - 1000),
            [0, 83_333, 166_667, 250_000, 1_000_000, 100_000_000_000]
        );
        assert_eq!([1, 2, 12].map(|i| clock.before_start(i) - 1000), [-83_333, -166_667, -1_000_000]);
        assert_eq!((clock.steps_per_plan, clock.takeover), (6, 18));
        assert!(!clock.plans_at(12) && clock.plans_at(18) && !clock.plans_at(19) && clock.plans_at(24));
    }

    #[test]
    fn steps_at_frames_use_log_times() {
        use point_skeleton::dataset::Frame;
        let frame = |t_us: i64| Frame {
            t_us,
            global_from_ego: point_skeleton::geometry::Pose::IDENTITY,
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        // Uneven times, as of keyframes.
        let frames = [0, 99_000, 201_000, 300_000, 398_000, 502_000].map(frame).to_vec();
        let log = Recording { frames, ..Recording::default() };
        let options = SimOptions { every_frames: Some(2), warmup_frames: 3, ..SimOptions::default() };
        let clock = Clock::of(&options, Rates::default(), 99_000, &log).unwrap();
        assert_eq!([0, 1, 2, 3].map(|step| clock.at(step)), [99_000, 300_000, 502_000, i64::MAX]);
        assert_eq!((clock.start_us, clock.steps_per_plan, clock.takeover), (99_000, 1, 2));
        // Half of the median frame rate.
        assert!((clock.rates.sim_hz - 1e6 / 99_000.0 / 2.0).abs() < 1e-9, "{:?}", clock.rates);
        for wrong in [
            SimOptions { every_frames: Some(0), ..options.clone() },
            SimOptions { ego: EgoPolicy::Straight, ..options.clone() },
            SimOptions { sim_hz: Some(10.0), ..options.clone() },
        ] {
            let error = Clock::of(&wrong, Rates::default(), 0, &log).unwrap_err();
            assert!(matches!(error, SimError::Frames { .. }) && error.is_usage(), "{error}");
        }
    }

    #[test]
    fn rejects_incompatible_rates() {
        let message = clock(10.0, 3.0).unwrap_err().to_string();
        assert!(message.contains("10 Hz") && message.contains("3 Hz"), "{message}");
        assert!(matches!(clock(5.0, 10.0), Err(SimError::Clock { .. })));
        for (sim_hz, plan_hz) in
            [(0.0, 1.0), (f64::NAN, 1.0), (10.0, f64::INFINITY), (10.0, -5.0), (1e9, 1.0)]
        {
            assert!(matches!(clock(sim_hz, plan_hz), Err(SimError::Rate { .. })), "{sim_hz} {plan_hz}");
        }
        assert_eq!(clock(10.0, 10.0 / 3.0).unwrap().steps_per_plan, 3);
    }
}
