use serde::{Deserialize, Serialize};

/// How the window moves and what a network sees beside the frame of the step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strategy {
    /// Each step rolls on to the forecasts and throws away what has seen them: the next step starts from what was there
    /// before them. T calls of the network a step. Source: *Point as Skeleton*.
    #[default]
    ResetAndRoll,
    /// The window begins at the frame of the step; one roll a step, nothing is thrown away: frames keep what old
    /// forecasts left in them. S calls a step.
    Rolling,
    /// Clean frames before it, no forecasts. T calls a step.
    Causal {
        /// Noise that the frames before it get, in steps of 1000; a network for windows of two frames is trained with 50
        /// to 200.
        history_noise: usize,
    },
    /// Clean frames before it, and forecasts that are made together with it and thrown away. T calls a step.
    NonCausal {
        /// Forecasts in the window, K.
        forecasts: usize,
    },
}

impl Strategy {
    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::ResetAndRoll => "reset_and_roll",
            Self::Rolling => "rolling",
            Self::Causal { .. } => "causal",
            Self::NonCausal { .. } => "non_causal",
        }
    }
}
