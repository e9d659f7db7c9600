//! Options of the generator.

use serde::{Deserialize, Serialize};

use super::{GenerateError, Guidance, SamplerOptions, Strategy};
use crate::generator::window::Roll;

/// Options of the generator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GenerateOptions {
    /// Number of frames in the window, L.
    pub window: usize,
    /// Number of inference steps, T. A multiple of `window - clean` for the strategies that roll.
    pub steps: usize,
    /// Number of leading frames of the window that are always clean, C.
    pub clean: usize,
    /// Strategy that moves the window.
    pub strategy: Strategy,
    /// Noise schedule and denoising update.
    pub sampler: SamplerOptions,
    /// Classifier-free guidance.
    pub guidance: Guidance,
}

/// Maximum number of frames in a window.
const MAX_WINDOW: usize = 64;

impl GenerateOptions {
    /// Validates the options.
    ///
    /// # Errors
    /// Returns an error if the inference steps cannot be divided evenly among the frames, or if the window is
    /// too small.
    pub fn check(&self) -> Result<(), GenerateError> {
        let Self { window, steps, clean, strategy, .. } = *self;
        let wrong = |expected: String, found: String| Err(GenerateError::Options { expected, found });
        if !(2..=MAX_WINDOW).contains(&window) || clean >= window {
            let expected = format!("a window of 2 to {MAX_WINDOW} frames and fewer clean ones");
            return wrong(expected, format!("a window of {window} with {clean} clean"));
        }
        if !(1..=1000).contains(&steps) {
            return wrong("1 to 1000 inference steps".to_owned(), steps.to_string());
        }
        match strategy {
            Strategy::ResetAndRoll | Strategy::Rolling if self.roll().per_roll().is_none() => {
                wrong(format!("steps that are a multiple of {}", window - clean), steps.to_string())
            }
            Strategy::Rolling if clean > 0 => {
                wrong("no clean frames with rolling".to_owned(), clean.to_string())
            }
            Strategy::NonCausal { forecasts } if forecasts >= window => {
                wrong(format!("at most {} forecasts in the window", window - 1), forecasts.to_string())
            }
            Strategy::Causal { history_noise } if history_noise >= 1000 => {
                wrong("noise of less than 1000 steps".to_owned(), history_noise.to_string())
            }
            _ => Ok(()),
        }
    }

    /// Number of clean frames that are needed to begin, L-1.
    pub fn references(&self) -> usize {
        self.window - 1
    }

    /// Maximum number of forecasts that a step uses.
    pub fn forecasts(&self) -> usize {
        match self.strategy {
            Strategy::ResetAndRoll => self.window - self.clean - 1,
            Strategy::Rolling => self.window - 1,
            Strategy::Causal { .. } => 0,
            Strategy::NonCausal { forecasts } => forecasts,
        }
    }

    pub(super) fn roll(&self) -> Roll {
        Roll { window: self.window, clean: self.clean, steps: self.steps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_inconsistent_options() {
        let good = GenerateOptions {
            window: 4,
            steps: 8,
            clean: 0,
            strategy: Strategy::ResetAndRoll,
            sampler: SamplerOptions::default(),
            guidance: Guidance::default(),
        };
        let options = |change: fn(&mut GenerateOptions)| {
            let mut options = good;
            change(&mut options);
            options.check().map_err(|error: GenerateError| error.to_string())
        };
        assert_eq!([options(|_| ()), options(|o| o.clean = 3)], [Ok(()), Ok(())]);
        assert_eq!(options(|o| (o.window, o.clean) = (2, 1)), Ok(()));
        type Change = fn(&mut GenerateOptions);
        let refused: [(Change, &str); 10] = [
            (|o| o.steps = 7, "a multiple of 4, found 7"),
            (|o| o.steps = 0, "1 to 1000 inference steps, found 0"),
            (|o| o.window = 1, "a window of 2 to 64"),
            (|o| o.clean = 4, "a window of 4 with 4 clean"),
            (|o| o.clean = usize::MAX, "and fewer clean ones, found a window of 4 with"),
            (
                |o| o.strategy = Strategy::NonCausal { forecasts: usize::MAX },
                "at most 3 forecasts in the window",
            ),
            (|o| (o.clean, o.steps) = (1, 8), "a multiple of 3, found 8"),
            (
                |o| (o.clean, o.steps, o.strategy) = (1, 9, Strategy::Rolling),
                "no clean frames with rolling, found 1",
            ),
            (
                |o| o.strategy = Strategy::NonCausal { forecasts: 4 },
                "at most 3 forecasts in the window, found 4",
            ),
            (|o| o.strategy = Strategy::Causal { history_noise: 1000 }, "less than 1000 steps, found 1000"),
        ];
        for (change, said) in refused {
            let error = options(change).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }
}
