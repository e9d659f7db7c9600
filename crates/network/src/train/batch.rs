use candle_core::{Device, Tensor};
use point_skeleton::conditions::TensorEncoder;
use pskel_generate::{
    CAMERA_NUMBERS, Condition, DriveFrame, DroppedConditions, FlowMatch, Roll, TrainingClip,
};
use rand_chacha::ChaCha8Rng;
use rand_core::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::Seeder;

use super::TrainOptions;
use super::augment::{Augmentation, unit};
use crate::{Inputs, NetworkConfig, NetworkError, Statistics, latent_rows};

/// Minimum noise level of a frame that is not finished.
const SIGMA_MIN: f32 = 0.005;
/// Maximum errors of frames, in latent units: logarithm of the gain, shift of all channels and of each, and
/// noise.
const MAX_GAIN: f32 = 0.2;
const MAX_SHIFT: f32 = 0.3;
const MAX_TINT: f32 = 0.1;
const MAX_NOISE: f32 = 0.3;
/// Minimum noise level at which noisy frames have their full errors.
const FULL_ERRORS: f32 = 0.3;

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
    /// Images of the frames, 0 to 1, `[F V H W, 3]`.
    pub(super) images: Tensor,
    /// Frames whose decoded images count in the loss.
    pub(super) decoded: Vec<usize>,
}

/// Random choices for a window.
#[derive(Clone, Debug, PartialEq)]
struct Window {
    drive: usize,
    /// Index of its first frame.
    first: usize,
    /// First camera; others follow around the ego.
    camera: usize,
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
    /// Probability of each drive, relative to the others.
    pub(super) shares: &'a [f64],
    pub(super) statistics: &'a Statistics,
    pub(super) encoder: &'a TensorEncoder,
}

fn below(random: &mut ChaCha8Rng, count: usize) -> usize {
    ((u64::from(random.next_u32()) * count as u64) >> 32) as usize
}

impl Source<'_> {
    /// Returns the batch of a step, determined by the options' seed and the step number.
    pub(super) fn batch(&self, step: u64) -> Result<Batch, NetworkError> {
        let mut random: ChaCha8Rng = Seeder::from((self.options.seed, "batch", step)).into_rng();
        let (views, windows) = self.windows(&mut random);
        let (mut clean, mut conditions, mut images) = (Vec::new(), Vec::new(), Vec::new());
        for window in &windows {
            let drive = &self.drives[window.drive];
            let augmentation = Augmentation::draw(self.options.augment, views, &mut random);
            for frame in window.first..window.first + self.config.frames {
                let size = drive.about.recipe.size;
                let mut frame = cameras_of(&drive.frames[frame], window.camera, views, size.pixels());
                augmentation.apply(&mut frame, size, &mut random);
                clean.extend(latent_rows(self.config, self.statistics, &frame.truth));
                images.extend(frame.truth.as_flattened().iter().map(|level| f32::from(*level) / 255.0));
                let shown = frame.conditions(drive.about.recipe.size, self.encoder);
                conditions.push(shown.without(window.dropped));
            }
        }
        let shown = windows.len() * self.config.frames * views;
        let erring = match unit(&mut random) < self.options.errors {
            true => errors(&clean, shown, &mut random),
            false => clean.clone(),
        };
        let mut noise: Vec<f32> = clean.iter().map(|_| StandardNormal.sample(&mut random)).collect();
        let sigmas: Vec<f32> = windows.iter().flat_map(|window| window.sigmas.clone()).collect();
        let of = |window: &Window| {
            (0..self.config.frames).map(|frame| frame >= window.finished).collect::<Vec<_>>()
        };
        let counts: Vec<bool> = windows.iter().flat_map(of).collect();
        let noisy = noisy(&clean, &erring, &mut noise, &sigmas, &counts);
        let rows = |values: Vec<f32>| {
            let count = values.len() / 3;
            Tensor::from_vec(values, (count, 3), &Device::Cpu)
        };
        let inputs = Inputs::new(self.config, conditions.iter())?;
        let decoded = windows.iter().enumerate().flat_map(|(place, window)| {
            window.decoded().into_iter().map(move |frame| place * self.config.frames + frame)
        });
        Ok(Batch {
            clean: rows(clean)?,
            noise: rows(noise)?,
            noisy: rows(noisy)?,
            images: rows(images)?,
            decoded: decoded.collect(),
            sigmas,
            counts,
            inputs,
        })
    }

    /// Draws the number of cameras and the windows of a batch.
    fn windows(&self, random: &mut ChaCha8Rng) -> (usize, Vec<Window>) {
        let cameras: Vec<usize> = self.drives.iter().map(|drive| drive.about.cameras.len()).collect();
        let lengths: Vec<usize> = self.drives.iter().map(|drive| drive.frames.len()).collect();
        let first = pick(self.shares, random);
        let all = unit(random) < self.options.all_cameras;
        let views = if all { cameras[first] } else { 1 + below(random, cameras[first]) };
        let fitting = self.shares.iter().zip(&cameras);
        let shares: Vec<f64> =
            fitting.map(|(share, count)| if *count >= views { *share } else { 0.0 }).collect();
        let window = |place: usize| {
            let drive = if place == 0 { first } else { pick(&shares, random) };
            let camera = below(random, cameras[drive]);
            Window { camera, ..draw(self.options, self.config.frames, drive, lengths[drive], random) }
        };
        (views, (0..self.options.batch).map(window).collect())
    }
}

/// Returns a number with a probability of its share.
fn pick(shares: &[f64], random: &mut ChaCha8Rng) -> usize {
    let mut left = f64::from(unit(random)) * shares.iter().sum::<f64>();
    for (place, share) in shares.iter().enumerate() {
        left -= share;
        if left < 0.0 {
            return place;
        }
    }
    shares.iter().rposition(|share| *share > 0.0).unwrap_or(0)
}

/// Returns a frame with `count` of its cameras from camera `first` on, around the ego.
fn cameras_of(frame: &DriveFrame, first: usize, count: usize, pixels: usize) -> DriveFrame {
    fn part<T: Copy>(values: &[T], chosen: &[usize], pixels: usize) -> Vec<T> {
        chosen.iter().flat_map(|view| &values[view * pixels..][..pixels]).copied().collect()
    }
    let chosen: Vec<usize> = (first..first + count).map(|view| view % frame.cameras.len()).collect();
    let lenses: Vec<[f32; CAMERA_NUMBERS]> = chosen.iter().map(|view| frame.cameras[*view]).collect();
    DriveFrame {
        color: part(&frame.color, &chosen, pixels),
        bins: part(&frame.bins, &chosen, pixels),
        boxes: part(&frame.boxes, &chosen, pixels),
        map: part(&frame.map, &chosen, pixels),
        truth: part(&frame.truth, &chosen, pixels),
        action: frame.action,
        cameras: lenses,
    }
}

impl Window {
    /// Returns the frames to decode: those with the most noise and with the least, of those that are not
    /// finished.
    fn decoded(&self) -> Vec<usize> {
        let by_noise = |a: &usize, b: &usize| self.sigmas[*a].total_cmp(&self.sigmas[*b]);
        let frames = self.finished..self.sigmas.len();
        let mut chosen: Vec<usize> =
            [frames.clone().max_by(by_noise), frames.min_by(by_noise)].into_iter().flatten().collect();
        chosen.dedup();
        chosen
    }
}

/// Returns latents `[F V h w, 3]` with errors like those that generated frames have: another brightness of
/// each image, and noise.
fn errors(clean: &[f32], images: usize, random: &mut ChaCha8Rng) -> Vec<f32> {
    let mut between = |most: f32| (2.0 * unit(random) - 1.0) * most;
    let spread = between(MAX_NOISE).abs();
    let shifts: Vec<[f32; 4]> = (0..images)
        .map(|_| {
            let (gain, shift) = (between(MAX_GAIN).exp(), between(MAX_SHIFT));
            let [a, b, c] = [0; 3].map(|_| shift + between(MAX_TINT));
            [gain, a, b, c]
        })
        .collect();
    let per_image = clean.len() / images;
    let err = |(i, value): (usize, &f32)| {
        let shifts = shifts[i / per_image];
        let noise: f32 = StandardNormal.sample(random);
        value * shifts[0] + shifts[1 + i % 3] + spread * noise
    };
    clean.iter().enumerate().map(err).collect()
}

/// Adds noise to latents at the levels of their frames, and returns them. Finished frames have errors and no
/// noise. The others have errors too, less so at low levels; the noise is changed to what leads from the
/// noisy latents to the clean ones.
fn noisy(clean: &[f32], erring: &[f32], noise: &mut [f32], sigmas: &[f32], counts: &[bool]) -> Vec<f32> {
    let per_frame = clean.len() / sigmas.len();
    let mut noisy = Vec::with_capacity(clean.len());
    for (i, (clean, noise)) in clean.iter().zip(noise).enumerate() {
        let (sigma, error) = (sigmas[i / per_frame], erring[i] - clean);
        if counts[i / per_frame] {
            *noise += error * (sigma / FULL_ERRORS).min(1.0) * (1.0 - sigma) / sigma;
            noisy.push((1.0 - sigma) * clean + sigma * *noise);
        } else {
            noisy.push(erring[i]);
        }
    }
    noisy
}

/// Samples a window of `frames` frames from a recording of some length.
fn draw(
    options: &TrainOptions,
    frames: usize,
    drive: usize,
    length: usize,
    random: &mut ChaCha8Rng,
) -> Window {
    let first = below(random, length + 1 - frames);
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
    Window { drive, first, camera: 0, dropped, finished, sigmas }
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
        (0..2000)
            .map(|_| {
                let drive = pick(&[1.0, 3.0], &mut random);
                draw(options, 4, drive, [4, 9][drive], &mut random)
            })
            .collect()
    }

    #[test]
    fn staircase_levels_match_a_roll() {
        let options = TrainOptions { staircase: 1.0, ..TrainOptions::default() };
        let table = FlowMatch::new(8, 3.0);
        let s = table.sigmas();
        // Calls 6 and 7 of T = 8, with two steps per frame: the first frame is at index 6 or 7, each later
        // frame two steps behind the previous one.
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
    fn independent_levels_and_drops_follow_their_chances() {
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
        let expected = [0.28, 0.1, 0.55, 0.1, 0.625, 0.75, 0.5];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.04), "{found:?}");
        assert!(all.iter().all(|w| w.first + 4 <= [4, 9][w.drive]));
        assert!(all.iter().any(|w| w.drive == 1 && w.first == 5));
        assert!(all.iter().flat_map(|w| &w.sigmas).all(|s| (SIGMA_MIN..=1.0).contains(s)));
    }

    #[test]
    fn adjusted_noise_leads_to_the_clean_latents() {
        let clean = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let erring = [1.5, 2.0, 3.0, 3.0, 7.0, 6.0];
        let mut noise = [0.0, 8.0, 1.0, 0.0, 0.5, 1.0];
        let found = noisy(&clean, &erring, &mut noise, &[0.5, 0.25, 0.03], &[false, true, true]);
        // A finished frame has its errors.
        assert_eq!(found[..2], [1.5, 2.0]);
        let near = |a: f32, b: f32| (a - b).abs() < 1e-5;
        for (i, sigma) in [(2, 0.25), (3, 0.25), (4, 0.03), (5, 0.03)] {
            assert!(near(found[i], (1.0 - sigma) * clean[i] + sigma * noise[i]), "{i}");
        }
        // An error of -1 at a level of 0.25: three quarters of 0.25 / 0.3 of it are seen.
        assert!(near(found[3], 0.75 * (4.0 - 0.25 / 0.3)) && near(found[2], 0.75 * 3.0 + 0.25));
        assert!(near(found[4], 0.97 * (5.0 + 0.2) + 0.015), "{}", found[4]);
        let mut same = noise;
        noisy(&clean, &clean, &mut same, &[0.5, 0.25, 0.03], &[false, true, true]);
        assert_eq!(same, noise);
    }

    /// Two images of two hundred places: each has a brightness of its own.
    #[test]
    fn brightness_errors_are_per_image() {
        let mut random: ChaCha8Rng = Seeder::from(5_u64).into_rng();
        let clean = vec![0.0_f32; 2 * 200 * 3];
        let mut shifts = Vec::new();
        for _ in 0..100 {
            let found = errors(&clean, 2, &mut random);
            for image in found.chunks(600) {
                let mean = image.iter().sum::<f32>() / 600.0;
                assert!(mean.abs() < MAX_SHIFT + MAX_TINT + 0.1, "{mean}");
                shifts.push(mean);
            }
        }
        let spread = (shifts.iter().map(|s| s * s).sum::<f32>() / 200.0).sqrt();
        // Uniform within 0.3, and a third of three within 0.1.
        assert!((spread - 0.3 / 3.0_f32.sqrt()).abs() < 0.03, "{spread}");
        assert!(shifts.chunks(2).filter(|pair| (pair[0] - pair[1]).abs() > 0.05).count() > 60);
    }
}
