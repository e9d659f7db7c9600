use candle_core::{Device, Tensor};
use point_skeleton::conditions::TensorEncoder;
use pskel_generate::{Condition, DroppedConditions, FlowMatch, FrameConditions, Roll, TrainingClip};
use rand_chacha::ChaCha8Rng;
use rand_core::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::Seeder;

use super::TrainOptions;
use crate::{Inputs, NetworkConfig, NetworkError, PatchCodec};

/// Minimum noise level of a frame that is not finished.
const SIGMA_MIN: f32 = 0.005;

/// Training batch of a step: windows of frames. Latents are rows `[R, C]`.
#[derive(Debug)]
pub(super) struct Batch {
    /// Clean latents of the images.
    pub(super) clean: Tensor,
    /// Noise in the noisy latents.
    pub(super) noise: Tensor,
    /// Noisy latents `(1-s) clean + s noise`; clean ones for finished frames.
    pub(super) noisy: Tensor,
    /// Noise level of each frame, as passed to the network.
    pub(super) sigmas: Vec<f32>,
    /// Whether the answer for a frame counts in the loss; false for finished frames.
    pub(super) counts: Vec<bool>,
    /// Conditions of the frames.
    pub(super) inputs: Inputs,
}

/// Random choices for a window.
#[derive(Clone, Debug, PartialEq)]
struct Window {
    drive: usize,
    /// Index of its first frame.
    first: usize,
    dropped: DroppedConditions,
    /// Number of leading frames that are finished.
    finished: usize,
    /// Noise level of each frame, as passed to the network.
    sigmas: Vec<f32>,
}

/// Data that batches are built from.
pub(super) struct Source<'a> {
    pub(super) options: &'a TrainOptions,
    pub(super) config: &'a NetworkConfig,
    pub(super) drives: &'a [TrainingClip],
    pub(super) codec: &'a PatchCodec,
    pub(super) encoder: &'a TensorEncoder,
}

/// Samples a uniform number in [0, 1), of 24 bits.
fn unit(random: &mut ChaCha8Rng) -> f32 {
    (random.next_u32() >> 8) as f32 / (1_u32 << 24) as f32
}

fn below(random: &mut ChaCha8Rng, count: usize) -> usize {
    ((u64::from(random.next_u32()) * count as u64) >> 32) as usize
}

impl Source<'_> {
    /// Returns the batch of a step, determined by the options' seed and the step number.
    pub(super) fn batch(&self, step: u64) -> Result<Batch, NetworkError> {
        let mut random: ChaCha8Rng = Seeder::from((self.options.seed, "batch", step)).into_rng();
        let lengths: Vec<usize> = self.drives.iter().map(|drive| drive.frames.len()).collect();
        let windows: Vec<Window> = (0..self.options.batch)
            .map(|_| draw(self.options, self.config.frames, &lengths, &mut random))
            .collect();
        let (mut clean, mut conditions) = (Vec::new(), Vec::new());
        for window in &windows {
            let drive = &self.drives[window.drive];
            for frame in window.first..window.first + self.config.frames {
                clean.extend(self.codec.encode_rows(&drive.frames[frame].truth));
                conditions.push(drive.conditions(frame, self.encoder).without(window.dropped));
            }
        }
        let noise: Vec<f32> = clean.iter().map(|_| StandardNormal.sample(&mut random)).collect();
        let sigmas: Vec<f32> = windows.iter().flat_map(|window| window.sigmas.clone()).collect();
        let of = |window: &Window| {
            (0..self.config.frames).map(|frame| frame >= window.finished).collect::<Vec<_>>()
        };
        let counts: Vec<bool> = windows.iter().flat_map(of).collect();
        let noisy = noisy(&clean, &noise, &sigmas, &counts);
        self.tensors([clean, noise, noisy], sigmas, counts, &conditions)
    }

    fn tensors(
        &self,
        latents: [Vec<f32>; 3],
        sigmas: Vec<f32>,
        counts: Vec<bool>,
        conditions: &[FrameConditions],
    ) -> Result<Batch, NetworkError> {
        let channels = self.config.channels();
        let rows = |values: Vec<f32>| {
            let count = values.len() / channels;
            Tensor::from_vec(values, (count, channels), &Device::Cpu)
        };
        let [clean, noise, noisy] = latents;
        let inputs = Inputs::new(self.config, conditions.iter())?;
        Ok(Batch { clean: rows(clean)?, noise: rows(noise)?, noisy: rows(noisy)?, sigmas, counts, inputs })
    }
}

/// Adds noise to latents at the levels of their frames; frames that do not count stay clean.
fn noisy(clean: &[f32], noise: &[f32], sigmas: &[f32], counts: &[bool]) -> Vec<f32> {
    let per_frame = clean.len() / sigmas.len();
    let frames = clean.chunks(per_frame).zip(noise.chunks(per_frame)).zip(sigmas.iter().zip(counts));
    let frames = frames.flat_map(|((clean, noise), (&sigma, &counts))| {
        let sigma = if counts { sigma } else { 0.0 };
        clean.iter().zip(noise).map(move |(clean, noise)| (1.0 - sigma) * clean + sigma * noise)
    });
    frames.collect()
}

/// Samples a window of `frames` frames from recordings of the given lengths.
fn draw(options: &TrainOptions, frames: usize, lengths: &[usize], random: &mut ChaCha8Rng) -> Window {
    let drive = below(random, lengths.len());
    let first = below(random, lengths[drive] + 1 - frames);
    let chances = options.drop;
    let all = unit(random) < chances.all;
    let mut drops = |chance: f32| unit(random) < chance || all;
    let dropped = DroppedConditions {
        layout: drops(chances.layout),
        action: drops(chances.action),
        color: drops(chances.color),
        depth: drops(chances.depth),
    };
    let table = FlowMatch::new(options.infer_steps, options.shift);
    let (finished, sigmas) = if unit(random) < options.staircase {
        staircase(&table, frames, random)
    } else {
        independent(options, &table, frames, random)
    };
    Window { drive, first, dropped, finished, sigmas }
}

/// Samples noise levels as in a random network call of a roll, after a random number of finished frames.
fn staircase(table: &FlowMatch, frames: usize, random: &mut ChaCha8Rng) -> (usize, Vec<f32>) {
    let steps = table.timesteps().len();
    let roll = Roll { window: frames, clean: 0, steps };
    let per_roll = roll.per_roll().unwrap_or(steps);
    let call = steps - per_roll + below(random, per_roll);
    let finished = below(random, frames);
    let progress = roll.progress(call, finished);
    (finished, progress.iter().map(|progress| table.sigmas()[progress.index]).collect())
}

/// Samples an independent noise level per frame, distributed like the schedule.
fn independent(
    options: &TrainOptions,
    table: &FlowMatch,
    frames: usize,
    random: &mut ChaCha8Rng,
) -> (usize, Vec<f32>) {
    let with_history = unit(random) < options.history;
    let finished = if with_history { below(random, frames) } else { 0 };
    let last = table.sigmas()[table.timesteps().len() - 1];
    let shift = options.shift as f32;
    let mut level = || {
        let time = unit(random);
        (shift * time / (1.0 + (shift - 1.0) * time)).max(SIGMA_MIN)
    };
    let sigmas = (0..frames).map(|frame| if frame < finished { last } else { level() }).collect();
    (finished, sigmas)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(options: &TrainOptions) -> Vec<Window> {
        let mut random: ChaCha8Rng = Seeder::from(7_u64).into_rng();
        (0..2000).map(|_| draw(options, 4, &[4, 9], &mut random)).collect()
    }

    #[test]
    fn staircases_are_those_of_rolls() {
        let options = TrainOptions { staircase: 1.0, ..TrainOptions::default() };
        let table = FlowMatch::new(8, 3.0);
        let s = table.sigmas();
        // Calls 6 and 7 of T = 8, with two steps per frame: the first frame is at index 6 or 7, each later frame
        // two steps behind the previous one.
        let expected = [[s[6], s[4], s[2], s[0]], [s[7], s[5], s[3], s[1]]];
        let (mut seen, mut finished) = ([0; 2], [0; 4]);
        for window in windows(&options) {
            let at = expected.iter().position(|e| e[window.finished..] == window.sigmas[window.finished..]);
            seen[at.unwrap()] += 1;
            finished[window.finished] += 1;
            assert!(window.sigmas[..window.finished].iter().all(|sigma| *sigma == s[7]));
        }
        assert!(seen.iter().all(|n| *n > 800) && finished.iter().all(|n| *n > 400), "{seen:?} {finished:?}");
    }

    #[test]
    fn independent_levels_and_drops_come_as_often_as_told() {
        let drop = super::super::DropChances { layout: 0.2, action: 0.0, color: 0.5, depth: 0.0, all: 0.1 };
        let options = TrainOptions { staircase: 0.0, history: 0.5, drop, ..TrainOptions::default() };
        let all = windows(&options);
        let share = |of: &dyn Fn(&Window) -> bool| all.iter().filter(|w| of(w)).count() as f32 / 2000.0;
        let found = [
            share(&|w| w.dropped.layout),
            share(&|w| w.dropped.action),
            share(&|w| w.dropped.color),
            share(&|w| w.dropped == DroppedConditions::ALL),
            share(&|w| w.finished == 0),
            share(&|w| w.drive == 1),
            share(&|w| w.sigmas[3] < 0.75),
        ];
        let expected = [0.28, 0.1, 0.55, 0.1, 0.625, 0.5, 0.5];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.04), "{found:?}");
        assert!(all.iter().all(|w| w.first + 4 <= [4, 9][w.drive]));
        assert!(all.iter().any(|w| w.drive == 1 && w.first == 5));
        assert!(all.iter().flat_map(|w| &w.sigmas).all(|s| (SIGMA_MIN..=1.0).contains(s)));
    }

    #[test]
    fn finished_frames_stay_clean() {
        let found = noisy(&[1.0, 2.0, 3.0, 4.0], &[0.0, 8.0, 1.0, 0.0], &[0.5, 0.25], &[false, true]);
        assert_eq!(found, [1.0, 2.0, 2.5, 3.0]);
    }
}
