use rayon::prelude::*;

use crate::generate::network::{NetworkConfig, NetworkError, PatchCodec, Statistics};
use crate::generate::{Drive, DriveFrame};

/// Smallest standard deviation of a coefficient, and of what the color map leaves of it: nothing is divided by 0.
const SCALE_MIN: f64 = 1e-3;
const PRIOR_MIN: f64 = 1e-2;

/// Sums over patches, per channel: of the images' coefficients and the color maps', of both squares and their product.
type Sums = Vec<[f64; 5]>;

/// Mean and standard deviation of the images' coefficients, and of what the best linear guess from the same coefficient of
/// the color map leaves of them.
///
/// # Errors
/// A configuration that does not go together, drives without frames or of other sizes.
pub fn measure(config: &NetworkConfig, drives: &[Drive]) -> Result<Statistics, NetworkError> {
    config.check()?;
    check(config, drives)?;
    let channels = config.channels();
    let plain = Statistics {
        means: vec![0.0; channels],
        scales: vec![1.0; channels],
        gains: vec![1.0; channels],
        offsets: vec![0.0; channels],
        priors: vec![1.0; channels],
    };
    let codec = PatchCodec::new(config, &plain)?;
    let frames: Vec<&DriveFrame> = drives.iter().flat_map(|drive| &drive.frames).collect();
    let sums: Vec<Sums> = frames.par_iter().map(|frame| sums(&codec, frame, channels)).collect();
    // One frame after the other: the same bytes for any number of threads.
    let all = sums.iter().fold(vec![[0.0; 5]; channels], |mut all: Sums, sums| {
        all.iter_mut().zip(sums).for_each(|(all, sums)| *all = std::array::from_fn(|i| all[i] + sums[i]));
        all
    });
    let count = (frames.len() * config.shape().len() / channels) as f64;
    let mut measured = plain;
    for (channel, sums) in all.into_iter().enumerate() {
        let [mean, color, square, color_square, product] = sums.map(|sum| sum / count);
        let (variance, color_variance) = (square - mean * mean, color_square - color * color);
        let covariance = product - mean * color;
        // The color map has edges where it is empty that the image has not: its gain may be far below 1.
        let gain = if color_variance > SCALE_MIN * SCALE_MIN { covariance / color_variance } else { 0.0 };
        let scale = variance.max(0.0).sqrt().max(SCALE_MIN);
        let left = (variance - gain * covariance).max(0.0).sqrt();
        measured.means[channel] = mean as f32;
        measured.scales[channel] = scale as f32;
        measured.gains[channel] = gain as f32;
        measured.offsets[channel] = (gain * (mean - color) / scale) as f32;
        measured.priors[channel] = (left / scale).max(PRIOR_MIN) as f32;
    }
    Ok(measured)
}

fn sums(codec: &PatchCodec, frame: &DriveFrame, channels: usize) -> Sums {
    let (truth, color) = (codec.encode_rows(&frame.truth), codec.encode_rows(&frame.color));
    let mut sums = vec![[0.0; 5]; channels];
    for (truth, color) in truth.chunks(channels).zip(color.chunks(channels)) {
        for (sums, (truth, color)) in sums.iter_mut().zip(truth.iter().zip(color)) {
            let (truth, color) = (f64::from(*truth), f64::from(*color));
            let of = [truth, color, truth * truth, color * color, truth * color];
            *sums = std::array::from_fn(|i| sums[i] + of[i]);
        }
    }
    sums
}

/// Whether drives fit a network: their sizes, cameras and bins, and that each has frames for a window.
///
/// # Errors
/// One that does not, by name; none at all.
pub(super) fn check(config: &NetworkConfig, drives: &[Drive]) -> Result<(), NetworkError> {
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
