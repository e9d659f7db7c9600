use point_skeleton::conditions::{DepthEmbedding, TensorEncoder};
use pskel_generate::{DriveFrame, TrainingClip};
use rayon::prelude::*;

use super::regression::Regression;
use crate::{FirstGuess, Inputs, NetworkConfig, NetworkError, PatchCodec, Statistics};

/// Minimum standard deviation of a coefficient, and of the error of the guess; prevents division by 0.
const SCALE_MIN: f64 = 1e-3;
const PRIOR_MIN: f64 = 1e-2;
/// Maximum number of frames that the guess is fitted to, spread evenly over all recordings.
const FITTED: usize = 400;

/// Sums over patches, per channel: coefficients and their squares.
type Sums = Vec<[f64; 2]>;

/// Computes mean and standard deviation of the images' coefficients. Also fits the best linear guess of latents
/// from the maps of their patches, and computes its remaining error.
///
/// # Errors
/// Returns an error if the configuration is inconsistent, or if the recordings have too few frames or other sizes.
pub fn measure(
    config: &NetworkConfig,
    drives: &[TrainingClip],
) -> Result<(Statistics, FirstGuess), NetworkError> {
    config.check()?;
    check(config, drives)?;
    let ones = || vec![1.0; config.channels()];
    let plain = Statistics { means: vec![0.0; config.channels()], scales: ones(), priors: ones() };
    let mut statistics = moments(config, drives, plain)?;
    let codec = PatchCodec::new(config, &statistics)?;
    let encoder = TensorEncoder::new(config.recipe.bins, DepthEmbedding::Both);
    let all: Vec<(&TrainingClip, usize)> =
        drives.iter().flat_map(|drive| (0..drive.frames.len()).map(move |frame| (drive, frame))).collect();
    let mut sums = Regression::new(config.maps_and_channels());
    for (drive, frame) in all.iter().step_by(all.len().div_ceil(FITTED)) {
        let conditions = drive.conditions(*frame, &encoder);
        let inputs = Inputs::new(config, std::iter::once(&conditions))?;
        sums.add(inputs.maps(), &codec.encode_rows(&drive.frames[*frame].truth))?;
    }
    let (guess, left) = sums.solve();
    statistics.priors = left.iter().map(|left| left.max(PRIOR_MIN) as f32).collect();
    Ok((statistics, guess))
}

/// Computes means and scales.
fn moments(
    config: &NetworkConfig,
    drives: &[TrainingClip],
    plain: Statistics,
) -> Result<Statistics, NetworkError> {
    let (codec, channels) = (PatchCodec::new(config, &plain)?, config.channels());
    let frames: Vec<&DriveFrame> = drives.iter().flat_map(|drive| &drive.frames).collect();
    let sums: Vec<Sums> = frames.par_iter().map(|frame| sums(&codec, frame, channels)).collect();
    // A sequential sum gives the same bytes for any number of threads.
    let all = sums.iter().fold(vec![[0.0; 2]; channels], |mut all: Sums, sums| {
        all.iter_mut().zip(sums).for_each(|(all, sums)| *all = [all[0] + sums[0], all[1] + sums[1]]);
        all
    });
    let count = (frames.len() * config.shape().len() / channels) as f64;
    let mut measured = plain;
    for (channel, [sum, squares]) in all.into_iter().enumerate() {
        let mean = sum / count;
        measured.means[channel] = mean as f32;
        measured.scales[channel] = (squares / count - mean * mean).max(0.0).sqrt().max(SCALE_MIN) as f32;
    }
    Ok(measured)
}

fn sums(codec: &PatchCodec, frame: &DriveFrame, channels: usize) -> Sums {
    let mut sums = vec![[0.0; 2]; channels];
    for row in codec.encode_rows(&frame.truth).chunks(channels) {
        for (sums, value) in sums.iter_mut().zip(row) {
            let value = f64::from(*value);
            *sums = [sums[0] + value, sums[1] + value * value];
        }
    }
    sums
}

/// Checks that recordings fit a network: sizes, cameras and bins, and enough frames for a window.
///
/// # Errors
/// Returns an error that names a recording that does not fit, or an error if there is no recording.
pub(super) fn check(config: &NetworkConfig, drives: &[TrainingClip]) -> Result<(), NetworkError> {
    if drives.is_empty() {
        return Err(NetworkError::input("a drive to train on", "none"));
    }
    for drive in drives {
        let about = &drive.about;
        let wrong = |expected: String, found: String| {
            Err(NetworkError::input(expected, format!("{found} in {}", about.log)))
        };
        let (size, cameras, bins) = (config.recipe.size, config.cameras, config.recipe.bins);
        if (about.recipe.size, about.cameras.len()) != (size, cameras) {
            let found = format!("{} of {}", about.cameras.len(), about.recipe.size);
            return wrong(format!("{cameras} cameras of {size}"), found);
        }
        if about.recipe != config.recipe {
            return wrong(format!("maps made as {:?}", config.recipe), format!("{:?}", about.recipe));
        }
        if about.hz != drives[0].about.hz {
            return wrong(format!("{} frames a second", drives[0].about.hz), about.hz.to_string());
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
