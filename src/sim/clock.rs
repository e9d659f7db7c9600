use super::{Rates, SimError, SimOptions};

/// Fewer steps a second move nobody smoothly, more only cost time.
const SIM_HZ: [f64; 2] = [1.0, 1000.0];
const MIN_PLAN_HZ: f64 = 0.01;

/// When there is a step, and which steps have a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Clock {
    pub(super) start_us: i64,
    pub(super) rates: Rates,
    /// Steps from one plan to the next, at least 1.
    pub(super) steps_per_plan: usize,
    /// The first step whose ego is not taken from the log is the one after this.
    pub(super) takeover: usize,
}

impl Clock {
    /// Checks the rates.
    pub(super) fn new(options: &SimOptions, rates: Rates, start_us: i64) -> Result<Self, SimError> {
        let sim_hz = options.sim_hz.unwrap_or(rates.sim_hz);
        let plan_hz = options.plan_hz.unwrap_or(rates.plan_hz);
        let checks =
            [("steps a second", sim_hz, SIM_HZ), ("plans a second", plan_hz, [MIN_PLAN_HZ, SIM_HZ[1]])];
        for (what, found, [min, max]) in checks {
            if !(min..=max).contains(&found) {
                return Err(SimError::Rate { what, min, max, found });
            }
        }
        let ratio = sim_hz / plan_hz;
        // Rates like 10 and 10/3 Hz are divided with rounding.
        if ratio.round() < 1.0 || (ratio - ratio.round()).abs() > 1e-9 * ratio {
            return Err(SimError::Clock { sim_hz, plan_hz });
        }
        let steps_per_plan = ratio.round() as usize;
        let takeover = options.warmup_frames.saturating_sub(1).saturating_mul(steps_per_plan);
        Ok(Self { start_us, rates: Rates { sim_hz, plan_hz }, steps_per_plan, takeover })
    }

    /// Absolute microseconds of a step.
    pub(super) fn at(&self, step: usize) -> i64 {
        self.start_us.saturating_add((step as f64 * 1e6 / self.rates.sim_hz).round() as i64)
    }

    /// Whether a plan is due at a step.
    pub(super) fn plans_at(&self, step: usize) -> bool {
        step >= self.takeover && step.is_multiple_of(self.steps_per_plan)
    }
}

/// From one time to another, both microseconds.
pub(super) fn seconds(from_us: i64, to_us: i64) -> f64 {
    to_us.saturating_sub(from_us) as f64 / 1e6
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
        Clock::new(&options, Rates::default(), 1000)
    }

    #[test]
    fn times_do_not_drift() {
        let clock = clock(12.0, 2.0).unwrap();
        assert_eq!(
            [0, 1, 2, 3, 12, 1_200_000].map(|i| clock.at(i) - 1000),
            [0, 83_333, 166_667, 250_000, 1_000_000, 100_000_000_000]
        );
        assert_eq!((clock.steps_per_plan, clock.takeover), (6, 18));
        assert!(!clock.plans_at(12) && clock.plans_at(18) && !clock.plans_at(19) && clock.plans_at(24));
    }

    #[test]
    fn rates_that_do_not_fit_are_named() {
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
