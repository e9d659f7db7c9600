use point_skeleton::conditions::{DepthEmbedding, TensorEncoder};
use pskel_generate::{DriveFrame, TrainingClip};
use rayon::prelude::*;

use crate::{Inputs, NetworkConfig, NetworkError, Statistics, latent_rows};

/// Channel count of the latents.
const CHANNELS: usize = 3;
/// Minimum standard deviation of a channel, and of the guess's error; prevents division by 0.
const SCALE_MIN: f64 = 1e-3;
const PRIOR_MIN: f64 = 1e-2;
/// Maximum number of frames whose guess is compared, spread evenly over all recordings.
const COMPARED: usize = 400;

/// Sums over places: values and their squares of each channel.
type Sums = [[f64; 2]; CHANNELS];

/// Computes mean and standard deviation of the latents, and the error of the filled color as a guess of them.
///
/// # Errors
/// Returns an error if the configuration is inconsistent, or if the recordings have too few frames or other
/// sizes.
pub fn measure(config: &NetworkConfig, drives: &[TrainingClip]) -> Result<Statistics, NetworkError> {
    config.check()?;
    check(config, drives)?;
    let all: Vec<(&TrainingClip, usize)> =
        drives.iter().flat_map(|drive| (0..drive.frames.len()).map(move |frame| (drive, frame))).collect();
    let unit =
        Statistics { means: vec![0.0; CHANNELS], scales: vec![1.0; CHANNELS], priors: vec![1.0; CHANNELS] };
    let latents = |(drive, frame): &(&TrainingClip, usize)| {
        sums(latent_rows(config, &unit, &drive.frames[*frame].truth).into_iter())
    };
    let [means, scales] = moments(all.par_iter().map(latents).collect());
    let scales = scales.map(|scale| scale.max(SCALE_MIN));
    let encoder = TensorEncoder::new(config.recipe.bins, DepthEmbedding::Both);
    let compared: Vec<&(&TrainingClip, usize)> = all.iter().step_by(all.len().div_ceil(COMPARED)).collect();
    let errors = |(drive, frame): &&(&TrainingClip, usize)| -> Result<(Sums, usize), NetworkError> {
        let conditions = drive.conditions(*frame, &encoder);
        let guess = Inputs::new(config, std::iter::once(&conditions))?.colors()?;
        let latents = latent_rows(config, &unit, &drive.frames[*frame].truth);
        Ok(sums(latents.into_iter().zip(guess).map(|(latent, guess)| latent - guess)))
    };
    let errors = compared.par_iter().map(errors).collect::<Result<Vec<_>, _>>()?;
    let [bias, spread] = moments(errors);
    let prior =
        |c: usize| ((bias[c] * bias[c] + spread[c] * spread[c]).sqrt() / scales[c]).max(PRIOR_MIN) as f32;
    Ok(Statistics {
        means: means.map(|mean| mean as f32).to_vec(),
        scales: scales.map(|scale| scale as f32).to_vec(),
        priors: (0..CHANNELS).map(prior).collect(),
    })
}

/// Returns the sums of rows `[n, 3]`, and n.
fn sums(values: impl Iterator<Item = f32>) -> (Sums, usize) {
    let (mut sums, mut count) = (Sums::default(), 0);
    for (i, value) in values.enumerate() {
        let (value, sums) = (f64::from(value), &mut sums[i % CHANNELS]);
        *sums = [sums[0] + value, sums[1] + value * value];
        count = i / CHANNELS + 1;
    }
    (sums, count)
}

/// Returns mean and standard deviation of each channel. The parts are added in their order, for the same
/// bytes with any number of threads.
fn moments(parts: Vec<(Sums, usize)>) -> [[f64; CHANNELS]; 2] {
    let (mut all, mut count) = (Sums::default(), 0);
    for (sums, places) in parts {
        all.iter_mut().zip(sums).for_each(|(all, sums)| *all = [all[0] + sums[0], all[1] + sums[1]]);
        count += places;
    }
    let count = count.max(1) as f64;
    let mean = |c: usize| all[c][0] / count;
    let spread = |c: usize| (all[c][1] / count - mean(c) * mean(c)).max(0.0).sqrt();
    [std::array::from_fn(mean), std::array::from_fn(spread)]
}

/// Checks that recordings fit a network: sizes, cameras and bins, and enough frames for a window.
///
/// # Errors
/// Returns an error that names a recording that does not fit, or an error if there is no recording.
pub(super) fn check(config: &NetworkConfig, drives: &[TrainingClip]) -> Result<(), NetworkError> {
    if drives.is_empty() {
        return Err(NetworkError::input("a training clip", "none"));
    }
    for drive in drives {
        let about = &drive.about;
        let wrong = |expected: String, found: String| {
            Err(NetworkError::input(expected, format!("{found} in {}", about.log)))
        };
        let (size, cameras, bins) = (config.recipe.size, about.cameras.len(), config.recipe.bins);
        NetworkConfig::check_cameras(cameras)?;
        if about.recipe.size != size {
            return wrong(format!("images of {size}"), about.recipe.size.to_string());
        }
        if about.recipe != config.recipe {
            return wrong(format!("maps made as {:?}", config.recipe), format!("{:?}", about.recipe));
        }
        if drive.frames.len() < config.frames {
            return wrong(format!("at least {} frames", config.frames), drive.frames.len().to_string());
        }
        let pixels = cameras * size.pixels();
        for (number, frame) in drive.frames.iter().enumerate() {
            let DriveFrame { color, bins: depth, boxes, map, truth, cameras: lenses, .. } = frame;
            let found = [color.len(), depth.len(), boxes.len(), map.len(), truth.len()];
            if found != [pixels; 5] || lenses.len() != cameras {
                return wrong(format!("maps of {pixels} pixels"), format!("{found:?} of frame {number}"));
            }
            if let Some(bin) = depth.iter().find(|bin| **bin > bins.count) {
                return wrong(format!("bins up to {}", bins.count), format!("{bin} of frame {number}"));
            }
        }
    }
    Ok(())
}
