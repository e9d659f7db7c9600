use std::collections::VecDeque;

use pskel_sim::{Committed, Forecast};
use serde::{Deserialize, Serialize};

use super::rolling::{self, StepInputs};
use super::window::Roll;
use super::{Denoiser, DenoiserError, Guidance, Latent, NoiseSource, Sampler, SamplerOptions, Strategy};

/// Options of the generator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GenerateOptions {
    /// Number of frames in the window, L.
    pub window: usize,
    /// Number of inference steps, T. A multiple of `window - clean` for the strategies that roll.
    pub steps: usize,
    /// Number of leading frames of the window that are always clean, C.
    pub clean: usize,
    /// Strategy by which the window moves.
    pub strategy: Strategy,
    /// Noise schedule and denoising update.
    pub sampler: SamplerOptions,
    /// Classifier-free guidance.
    pub guidance: Guidance,
}

/// Generates frames one after the other. Frames are numbered from the first reference: the references are
/// `0 .. L-1`, the first generated frame is `L-1`.
pub struct Generator<D: Denoiser, N> {
    denoiser: D,
    noise: N,
    options: GenerateOptions,
    sampler: Sampler,
    cache: Cache,
    /// Conditions of the last L-1 frames.
    shown: VecDeque<Committed<D::Condition>>,
}

/// State that is carried from step to step. It depends on no forecast, except with [`Strategy::Rolling`].
#[derive(Clone, Debug, PartialEq)]
pub struct Cache {
    /// Number of the next frame.
    pub next: usize,
    /// Latents of the window: L frames, or the last L-1 finished frames before the first step and with strategies
    /// that do not roll.
    pub frames: Vec<Latent>,
    /// Number of leading frames of the window that are finished and no longer updated: references, or the frames
    /// that a new window began with.
    pub references: usize,
    /// Number of rolls in place after the end of all conditions; only with [`Strategy::Rolling`].
    pub in_place: usize,
}

/// Error of generating a frame.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// Inconsistent options, or frames, a cache or forecasts that do not fit them.
    #[error("expected {expected}, found {found}")]
    Options {
        /// Accepted values.
        expected: String,
        /// Given values.
        found: String,
    },
    /// Error of the network.
    #[error("frame {frame}: {source}")]
    Denoiser {
        /// Number of the frame being generated.
        frame: usize,
        /// Underlying error.
        source: DenoiserError,
    },
}

impl GenerateOptions {
    /// Validates the options.
    ///
    /// # Errors
    /// Returns an error if the inference steps cannot be divided evenly among the frames, or if the window is too
    /// small.
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

/// Maximum number of frames in a window.
const MAX_WINDOW: usize = 64;

impl<D: Denoiser, N: NoiseSource> Generator<D, N> {
    /// Creates a generator from reference latents, oldest first, each with its committed conditions.
    ///
    /// # Errors
    /// Returns an error if the options are inconsistent, if there are not [`GenerateOptions::references`]
    /// references, or if one has another shape.
    pub fn new(
        denoiser: D,
        noise: N,
        options: GenerateOptions,
        references: Vec<(Latent, Committed<D::Condition>)>,
    ) -> Result<Self, GenerateError> {
        options.check()?;
        let (frames, shown): (Vec<_>, Vec<_>) = references.into_iter().unzip();
        let count = options.references();
        let cache = Cache { next: count, frames, references: count, in_place: 0 };
        Self::resume(denoiser, noise, options, cache, shown)
    }

    /// Resumes from a cache and the committed conditions of the last L-1 frames.
    ///
    /// # Errors
    /// Returns the errors of [`Generator::new`], or an error if a generator with these options cannot have produced
    /// the cache.
    pub fn resume(
        denoiser: D,
        noise: N,
        options: GenerateOptions,
        cache: Cache,
        shown: Vec<Committed<D::Condition>>,
    ) -> Result<Self, GenerateError> {
        options.check()?;
        let count = options.references();
        cache.check(&options, denoiser.shape())?;
        if shown.len() != count {
            let expected = format!("the conditions of {count} frames");
            return Err(GenerateError::Options { expected, found: shown.len().to_string() });
        }
        let sampler = Sampler::new(options.sampler, options.steps);
        Ok(Self { denoiser, noise, options, sampler, cache, shown: shown.into() })
    }

    /// State for the next step.
    pub fn cache(&self) -> &Cache {
        &self.cache
    }

    /// Network that the generator calls.
    pub fn denoiser(&self) -> &D {
        &self.denoiser
    }

    /// Generates the next frame. Fewer forecasts than [`GenerateOptions::forecasts`] mean that the conditions end
    /// there: the window then stays in place.
    ///
    /// # Errors
    /// Returns an error if the network fails, or, with [`Strategy::Rolling`], if the forecasts end before the last
    /// frame of the window. The cache is then unchanged.
    pub fn step(
        &mut self,
        now: Committed<D::Condition>,
        forecasts: &[Forecast<D::Condition>],
    ) -> Result<Latent, GenerateError> {
        let frame = self.cache.next;
        let used = forecasts.len().min(self.options.forecasts());
        rolling::check(&self.options, &self.cache, used)?;
        let mut cache = self.cache.clone();
        let finished = {
            let committed = self.shown.iter().chain([&now]).map(Committed::get);
            let mut known = StepInputs {
                denoiser: &mut self.denoiser,
                noise: &mut self.noise,
                options: &self.options,
                sampler: &self.sampler,
                first: frame - self.shown.len(),
                conditions: committed.chain(forecasts[..used].iter().map(Forecast::get)).collect(),
                forecasts: used,
            };
            rolling::step(&mut known, &mut cache)
        };
        let finished = finished.map_err(|source| GenerateError::Denoiser { frame, source })?;
        self.cache = Cache { next: frame + 1, ..cache };
        self.shown.pop_front();
        self.shown.push_back(now);
        Ok(finished)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_do_not_go_together_are_refused() {
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
