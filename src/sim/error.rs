use super::PlannerError;
use crate::files::text::printable;

/// Why a rollout cannot be made, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// No steps.
    #[error("expected at least one step, found none")]
    NoSteps,
    /// A rate that is none.
    #[error("expected {what} to be from {min} to {max} Hz, found {found}")]
    Rate {
        /// Which rate.
        what: &'static str,
        /// Hertz.
        min: f64,
        /// Hertz.
        max: f64,
        /// Hertz.
        found: f64,
    },
    /// Plans that fall between steps.
    #[error(
        "expected the steps a second to be a multiple of the plans a second, found {sim_hz} Hz and {plan_hz} Hz"
    )]
    Clock {
        /// Steps a second.
        sim_hz: f64,
        /// Plans a second.
        plan_hz: f64,
    },
    /// Steps at the frames of a log for those who do not follow it.
    #[error(
        "expected every so many-th frame to be a step of an ego and actors that follow the log, without rates, found every {every}"
    )]
    Frames {
        /// What was asked for.
        every: usize,
    },
    /// A log without frames.
    #[error("expected a log with frames, found none: {}", printable(log))]
    NoFrames {
        /// Its name.
        log: String,
    },
    /// A start outside of the log.
    #[error("expected a start from {first_us} to {last_us} us, found {found_us}: {}", printable(log))]
    Start {
        /// Of the first frame.
        first_us: i64,
        /// Of the last frame.
        last_us: i64,
        /// What was asked for.
        found_us: i64,
        /// The log's name.
        log: String,
    },
    /// A saved state of another rollout, or none at all.
    #[error("expected a saved state with {expected}, found {found}")]
    Saved {
        /// What this rollout asks for.
        expected: String,
        /// What was saved.
        found: String,
    },
    /// A planner in another process.
    #[error(transparent)]
    Planner(#[from] PlannerError),
}

impl SimError {
    /// Whether the options are wrong, rather than that something failed.
    pub fn is_usage(&self) -> bool {
        use SimError::{Clock, Frames, NoSteps, Rate, Start};
        matches!(self, NoSteps | Rate { .. } | Clock { .. } | Frames { .. } | Start { .. })
    }
}
