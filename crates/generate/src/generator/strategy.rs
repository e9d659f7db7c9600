use point_skeleton::named;
use serde::{Deserialize, Serialize};

/// How the window moves, and which frames a network sees beside the current one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strategy {
    /// Each step rolls the window on to the forecasts, then discards all latents that depend on them: the
    /// next step resets to the cache from before the forecasts. T network calls per step. Source: *Point as
    /// Skeleton*.
    #[default]
    ResetAndRoll,
    /// The window begins at the current frame and rolls once per step. Nothing is discarded, so frames retain
    /// the influence of old forecasts. S network calls per step.
    Rolling,
    /// Clean previous frames, then the current one; no forecasts. T network calls per step.
    Causal {
        /// Training timestep, of 1000, of the noise added to the previous frames. A network for windows of
        /// two frames is trained with 50 to 200.
        history_noise: usize,
    },
    /// Clean previous frames, the current one, and forecasts that are denoised together with it and
    /// discarded. T network calls per step.
    NonCausal {
        /// Number of forecasts in the window, K.
        forecasts: usize,
    },
}

named!(Strategy, "strategy" {
    ResetAndRoll => "reset_and_roll",
        "Rolls on to the forecasts, then discards all frames influenced by them";
    Rolling => "rolling", "One roll per step; frames retain the influence of old forecasts";
    Causal { history_noise: 0 } => "causal", "Clean previous frames, no forecasts";
    NonCausal { forecasts: 1 } => "non_causal",
        "Clean previous frames, the current one, and forecasts that are discarded";
});
