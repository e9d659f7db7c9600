//! The generation step of each strategy.

use std::ops::Range;

use crate::{
    Cache, Denoiser, DenoiserError, Frame, GenerateError, GenerateOptions, Latent, NoiseSource, Progress,
    Sampler, Strategy,
};

/// Inputs of a generation step.
pub(crate) struct StepInputs<'a, D: Denoiser, N> {
    pub(crate) denoiser: &'a mut D,
    pub(crate) noise: &'a mut N,
    pub(crate) options: &'a GenerateOptions,
    pub(crate) sampler: &'a Sampler,
    /// Frame number of the first condition.
    pub(crate) first: usize,
    /// Conditions of the L-1 previous frames, the current frame and the forecasts.
    pub(crate) conditions: Vec<&'a D::Condition>,
    /// Number of forecasts among the conditions.
    pub(crate) forecasts: usize,
}

/// Checks that the forecasts of a step cover the rolling window in the cache.
///
/// # Errors
/// Returns an error if the forecasts end before the last frame of the window.
pub(crate) fn check(options: &GenerateOptions, cache: &Cache, forecasts: usize) -> Result<(), GenerateError> {
    let end = cache.next + forecasts;
    match last_of(options, cache).filter(|last| options.strategy == Strategy::Rolling && *last > end) {
        None => Ok(()),
        Some(last) => Err(GenerateError::Options {
            expected: format!(
                "forecasts up to frame {last}, the last in the window, at frame {}",
                cache.next
            ),
            found: format!("up to frame {end}"),
        }),
    }
}

/// Generates frame `cache.next`, and updates the cache for the next step.
pub(crate) fn step<D: Denoiser, N: NoiseSource>(
    known: &mut StepInputs<'_, D, N>,
    cache: &mut Cache,
) -> Result<Latent, DenoiserError> {
    match known.options.strategy {
        Strategy::ResetAndRoll => reset_and_roll(known, cache),
        Strategy::Rolling => rolling(known, cache),
        Strategy::Causal { history_noise } => at_once(known, cache, 0, history_noise),
        Strategy::NonCausal { .. } => at_once(known, cache, known.forecasts, 0),
    }
}

fn reset_and_roll<D: Denoiser, N: NoiseSource>(
    known: &mut StepInputs<'_, D, N>,
    cache: &mut Cache,
) -> Result<Latent, DenoiserError> {
    let GenerateOptions { window: size, clean, .. } = *known.options;
    let (frame, rolls) = (cache.next, size - clean);
    append(known, cache, frame, 0);
    known.roll(cache, frame)?;
    // From here on, latents depend on forecasts, so work on a copy of the cache.
    let mut ahead = cache.clone();
    let mut last = frame;
    for roll in 1..rolls {
        if roll <= known.forecasts {
            last += 1;
            append(known, &mut ahead, frame, roll);
        } else {
            ahead.in_place += 1;
        }
        known.roll(&mut ahead, last)?;
    }
    Ok(ahead.frames.swap_remove(size - 1 - (last - frame)))
}

fn rolling<D: Denoiser, N: NoiseSource>(
    known: &mut StepInputs<'_, D, N>,
    cache: &mut Cache,
) -> Result<Latent, DenoiserError> {
    let (size, frame) = (known.options.window, cache.next);
    let end = frame + known.forecasts;
    let (rolls, mut last) = match last_of(known.options, cache) {
        Some(last) => (1, last),
        None => {
            begin(cache, size);
            // The previous frames leave the window first, one per roll.
            (size, frame - 1)
        }
    };
    for _ in 0..rolls {
        if last < end && cache.in_place == 0 {
            last += 1;
            append(known, cache, last, 0);
        } else {
            cache.in_place += 1;
        }
        known.roll(cache, last)?;
    }
    Ok(cache.frames[size - 1 - (last - frame)].clone())
}

/// Last frame of a rolling window before its next step. The window advances by one frame with each roll that
/// was not in place. `None` if there is no window yet, or if all its frames were returned.
fn last_of(options: &GenerateOptions, cache: &Cache) -> Option<usize> {
    let last = (cache.next + options.window - 2).saturating_sub(cache.in_place);
    (cache.frames.len() == options.window && last >= cache.next).then_some(last)
}

/// Starts a new window with the last finished frames.
fn begin(cache: &mut Cache, size: usize) {
    cache.frames.drain(..cache.frames.len().saturating_sub(size - 1));
    (cache.references, cache.in_place) = (size - 1, 0);
}

/// Denoises the current frame and `forecasts` more frames together through all inference steps, after clean
/// frames.
fn at_once<D: Denoiser, N: NoiseSource>(
    known: &mut StepInputs<'_, D, N>,
    cache: &mut Cache,
    forecasts: usize,
    history_noise: usize,
) -> Result<Latent, DenoiserError> {
    let (size, frame) = (known.options.window, cache.next);
    let shape = known.denoiser.shape();
    let history = size - 1 - forecasts;
    let mut frames = cache.frames[cache.frames.len() - history..].to_vec();
    let level = (history_noise > 0).then(|| known.sampler.level_at(history_noise));
    if let Some(level) = level {
        for (position, clean) in frames.iter_mut().enumerate() {
            let noise = known.noise.noise(shape, frame, 1 + forecasts + position);
            *clean = known.sampler.noised(clean, &noise, level);
        }
    }
    frames.extend((0..=forecasts).map(|draw| known.noise.noise(shape, frame, draw)));
    let steps = known.sampler.steps();
    for call in 0..steps {
        let of = |position: usize| match position < history {
            true => Progress { index: steps - 1, is_updated: false },
            false => Progress { index: call, is_updated: true },
        };
        let progress: Vec<Progress> = (0..size).map(of).collect();
        known.call(&mut frames, &progress, frame + forecasts, level)?;
    }
    let finished = frames.swap_remove(history);
    cache.frames.remove(0);
    cache.frames.push(finished.clone());
    Ok(finished)
}

/// Appends noise to the window; drops the first frame if the window is full.
fn append<D: Denoiser, N: NoiseSource>(
    known: &mut StepInputs<'_, D, N>,
    cache: &mut Cache,
    frame: usize,
    draw: usize,
) {
    if cache.frames.len() == known.options.window {
        cache.frames.remove(0);
        cache.references = cache.references.saturating_sub(1).max(known.options.clean);
    }
    cache.frames.push(known.noise.noise(known.denoiser.shape(), frame, draw));
}

impl<D: Denoiser, N: NoiseSource> StepInputs<'_, D, N> {
    /// Rolls a window that ends with frame `last` once.
    fn roll(&mut self, window: &mut Cache, last: usize) -> Result<(), DenoiserError> {
        let roll = self.options.roll();
        let per_roll = roll.per_roll().unwrap_or(roll.steps);
        let begin = roll.steps - per_roll + window.in_place * per_roll;
        let calls: Range<usize> = begin..begin + per_roll;
        for call in calls {
            let progress = roll.progress(call, window.references);
            self.call(&mut window.frames, &progress, last, None)?;
        }
        Ok(())
    }

    /// Calls the network once. `history` is the noise level of the frames that are not updated, if it differs
    /// from the last of the schedule.
    fn call(
        &mut self,
        frames: &mut [Latent],
        progress: &[Progress],
        last: usize,
        history: Option<crate::Level>,
    ) -> Result<(), DenoiserError> {
        let begin = last + 1 - frames.len() - self.first;
        let conditions = &self.conditions[begin..begin + frames.len()];
        let level = |progress: &Progress| match history {
            Some(level) if !progress.is_updated => level,
            _ => self.sampler.level(progress.index),
        };
        let sees = frames.iter().zip(progress).zip(conditions);
        let window = sees.map(|((latent, progress), &condition)| Frame {
            latent,
            level: level(progress),
            is_reference: !progress.is_updated,
            condition,
        });
        let window: Vec<_> = window.collect();
        let predictions = self.options.guidance.predict(self.denoiser, &window)?;
        for ((frame, progress), prediction) in frames.iter_mut().zip(progress).zip(&predictions) {
            if progress.is_updated {
                *frame = self.sampler.step(progress.index, frame, prediction);
            }
        }
        Ok(())
    }
}
