use candle_core::{Device, Result, Tensor};

use super::batch::Batch;
use crate::{Model, NetworkConfig};

/// Weighting of errors in the loss.
#[derive(Clone, Copy, Debug)]
pub(super) struct LossWeights<'a> {
    /// Expected error of the network per channel, `[C]`; also the weight of the channel.
    pub(super) priors: &'a [f32],
    /// See [`TrainOptions::expected_error`](super::TrainOptions::expected_error).
    pub(super) expected_error: f32,
}

/// Weight of the decoded images beside the answers: an error of 0.1 counts as much as the expected one of an
/// answer.
const IMAGE_WEIGHT: f64 = 100.0;
/// Weight of the differences between neighboring pixels beside the pixels themselves.
const GRADIENT_WEIGHT: f64 = 0.5;

/// Returns the loss: the loss of the answers, and the loss of the images decoded from them.
///
/// # Errors
/// Returns any error of the tensor library.
pub(super) fn loss(
    model: &Model,
    config: &NetworkConfig,
    batch: &Batch,
    windows: usize,
    weighing: LossWeights<'_>,
) -> Result<Tensor> {
    let frames = batch.sigmas.len();
    let encoded = model.encode(&batch.inputs)?;
    let answer = model.answer(&batch.noisy, &batch.sigmas, &encoded.window, windows)?;
    let levels = model.levels(&batch.sigmas);
    let right = levels.answer(&batch.clean, encoded.window.guess(), &batch.noise)?;
    let (rows, channels) = answer.dims2()?;
    let off = guess_errors(&(&batch.clean - encoded.window.guess())?, frames, weighing)?;
    let weights = weights(&batch.counts, weighing.priors, &off, rows);
    let weights = Tensor::from_vec(weights, (frames, 1, channels), &Device::Cpu)?;
    let squares = (&answer - right)?.sqr()?.reshape((frames, rows / frames, channels))?;
    let mut loss = squares.broadcast_mul(&weights)?.sum_all()?;
    let latents = levels.clean(&batch.noisy, encoded.window.guess(), &answer)?;
    let part = |all: &Tensor, frame: usize| {
        let rows = all.dims2()?.0 / frames;
        all.narrow(0, frame * rows, rows)?.contiguous()
    };
    for frame in &batch.decoded {
        let images = model.decode(&part(&latents, *frame)?, &encoded.frame(*frame, frames)?)?;
        let errors = (images - part(&batch.images, *frame)?)?;
        let weight = IMAGE_WEIGHT / (batch.decoded.len() as f64 * f64::from(off[*frame]).max(1.0));
        loss = (loss + (image_loss(&errors, config)? * weight)?)?;
    }
    Ok(loss)
}

/// Returns the mean square error of images `[N H W, 3]` and of the differences between neighboring pixels.
fn image_loss(errors: &Tensor, config: &NetworkConfig) -> Result<Tensor> {
    let size = config.recipe.size;
    let (height, width) = (size.height as usize, size.width as usize);
    let (rows, channels) = errors.dims2()?;
    let images = errors.reshape((rows / (height * width), height, width, channels))?;
    let differences = |axis: usize, length: usize| -> Result<Tensor> {
        (images.narrow(axis, 1, length - 1)? - images.narrow(axis, 0, length - 1)?)?.sqr()?.mean_all()
    };
    let gradients = (differences(1, height)? + differences(2, width)?)?;
    images.sqr()?.mean_all()? + (gradients * GRADIENT_WEIGHT)?
}

/// Returns the mean square error of the first guess per frame, relative to its average over the training
/// data.
fn guess_errors(left: &Tensor, frames: usize, weighing: LossWeights<'_>) -> Result<Vec<f32>> {
    let scales: Vec<f32> = weighing.priors.iter().map(|prior| weighing.expected_error / prior).collect();
    let scales = Tensor::from_vec(scales, (1, weighing.priors.len()), &Device::Cpu)?;
    let squares = left.broadcast_mul(&scales)?.sqr()?;
    squares.reshape((frames, squares.elem_count() / frames))?.mean(1)?.to_vec1()
}

/// Returns weights of frames and channels, `[F, C]`: all noise levels weigh the same, and a frame whose first
/// guess is worse than usual, since conditions were dropped, gets a smaller weight, or these few frames would
/// dominate training. Summed over all rows, they are 1 if no guess is worse than usual.
fn weights(counts: &[bool], priors: &[f32], guess_errors: &[f32], rows: usize) -> Vec<f32> {
    let mean = priors.iter().sum::<f32>() / priors.len() as f32;
    let counted = counts.iter().filter(|counts| **counts).count().max(1);
    let share = 1.0 / (counted * (rows / counts.len()) * priors.len()) as f32;
    let frames = counts.iter().zip(guess_errors);
    let of = |(counts, error): (&bool, &f32)| if *counts { share / error.max(1.0) } else { 0.0 };
    frames.map(of).flat_map(|frame| priors.iter().map(move |prior| frame * prior / mean)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One image of 8x8 pixels by hand: an offset of 0.5 has no gradient; a step of 1 between two columns has
    /// one in 8 of 56 places.
    #[test]
    fn image_loss_counts_pixels_and_gradients() {
        let mut config = NetworkConfig::default();
        config.recipe.size = point_skeleton::geometry::ImageSize { height: 8, width: 8 };
        let loss = |of: fn(usize) -> f32| {
            let errors: Vec<f32> = (0..64 * 3).map(|i| of(i / 3)).collect();
            let errors = Tensor::from_vec(errors, (64, 3), &Device::Cpu).unwrap();
            image_loss(&errors, &config).unwrap().to_scalar::<f32>().unwrap()
        };
        assert!((loss(|_| 0.5) - 0.25).abs() < 1e-6);
        let step = loss(|pixel| if pixel % 8 < 4 { 0.0 } else { 1.0 });
        assert!((step - (0.5 + 0.5 * 8.0 / 56.0)).abs() < 1e-6, "{step}");
    }

    #[test]
    fn weights_sum_to_one_over_counted_rows() {
        let found = weights(&[false, true, true], &[0.5, 1.5], &[9.0, 0.8, 1.0], 12);
        // Two counted frames of four rows and two channels.
        let each = 1.0 / 16.0;
        assert_eq!(found, [0.0, 0.0, 0.5 * each, 1.5 * each, 0.5 * each, 1.5 * each]);
        assert!((found.iter().sum::<f32>() * 4.0 - 1.0).abs() < 1e-6);
        // The error is 4 times the usual one, so the weight is a quarter.
        let found = weights(&[true], &[1.0], &[4.0], 1);
        assert_eq!(found, [0.25]);
    }

    #[test]
    fn guess_errors_are_relative_to_the_average() {
        // The usual errors are 0.5 and 2; half of each is expected to remain.
        let weighing = LossWeights { priors: &[0.25, 1.0], expected_error: 0.5 };
        let left = Tensor::new(&[[0.5_f32, 2.0], [0.5, -2.0], [1.0, 4.0], [0.0, 0.0]], &Device::Cpu).unwrap();
        assert_eq!(guess_errors(&left, 2, weighing).unwrap(), [1.0, 2.0]);
    }
}
