use point_skeleton::files::text::printable;

use super::PlannerError;

/// Errors of starting or continuing a rollout.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The number of steps is 0.
    #[error("expected at least one step, found none")]
    NoSteps,
    /// A rate is out of range.
    #[error("expected {what} to be from {min} to {max} Hz, found {found}")]
    Rate {
        /// Name of the rate.
        what: &'static str,
        /// Minimum, hertz.
        min: f64,
        /// Maximum, hertz.
        max: f64,
        /// Given value, hertz.
        found: f64,
    },
    /// The simulation rate is not a multiple of the planning rate.
    #[error(
        "expected the steps a second to be a multiple of the plans a second, found {sim_hz} Hz and {plan_hz} \
            Hz"
    )]
    Clock {
        /// Simulation steps per second.
        sim_hz: f64,
        /// Plans per second.
        plan_hz: f64,
    },
    /// `every_frames` is 0, given together with rates, or used with an ego or actors that do not follow the
    /// log.
    #[error(
        "expected an ego and actors that follow the log, and no rates, with steps at every {every}-th frame"
    )]
    Frames {
        /// Given interval, frames.
        every: usize,
    },
    /// The log has no frames.
    #[error("expected a log with frames, found none: {}", printable(log))]
    NoFrames {
        /// Name of the log.
        log: String,
    },
    /// A state of another simulation comes after a later one.
    #[error("expected a state after {last_us} us, found one at {found_us}")]
    Earlier {
        /// Time of the last state, absolute microseconds.
        last_us: i64,
        /// Time of the state, absolute microseconds.
        found_us: i64,
    },
    /// The start lies outside the log.
    #[error("expected a start from {first_us} to {last_us} us, found {found_us}: {}", printable(log))]
    Start {
        /// Time of the first frame, absolute microseconds.
        first_us: i64,
        /// Time of the last frame, absolute microseconds.
        last_us: i64,
        /// Given start, absolute microseconds.
        found_us: i64,
        /// Name of the log.
        log: String,
    },
    /// The ego follows plans of the caller, who has given none for this step.
    #[error("expected a plan for step {step}, found none")]
    NoPlan {
        /// Number of the planning step.
        step: usize,
    },
    /// A plan of the caller is invalid.
    #[error(transparent)]
    Plan(#[from] super::peer::ProtocolError),
    /// The caller gives a plan at a step that has none.
    #[error(
        "unexpected plan for step {step}: it has one, is no planning step, or its ego does not follow the \
            caller"
    )]
    NotPlanned {
        /// Number of the step.
        step: usize,
    },
    /// The warm-up cannot end at a step without a plan.
    #[error("expected a takeover at a planning step (every {steps_per_plan} steps), found step {step}")]
    Takeover {
        /// Number of the step.
        step: usize,
        /// Steps per plan.
        steps_per_plan: usize,
    },
    /// Another policy cannot plan from here: the warm-up has not ended, or the policy replays the log.
    #[error("expected a policy with plans after the warm-up, found {policy} at step {step}")]
    Policy {
        /// Name of the policy.
        policy: &'static str,
        /// Number of the step.
        step: usize,
    },
    /// The saved state belongs to another rollout, or is invalid.
    #[error("expected a saved state with {expected}, found {found}")]
    Saved {
        /// Value required by this rollout.
        expected: String,
        /// Saved value.
        found: String,
    },
    /// An external planner failed.
    #[error(transparent)]
    Planner(#[from] PlannerError),
}

impl SimError {
    /// Returns whether the options are invalid, as opposed to a failure at run time.
    pub fn is_usage(&self) -> bool {
        use SimError::{Clock, Frames, NoSteps, Rate, Start};
        matches!(self, NoSteps | Rate { .. } | Clock { .. } | Frames { .. } | Start { .. })
    }
}
