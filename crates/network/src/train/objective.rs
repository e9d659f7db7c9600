use candle_core::{Device, Result, Tensor};

use super::batch::Batch;
use crate::Model;

/// Weighting of errors in the loss.
#[derive(Clone, Copy, Debug)]
pub(super) struct LossWeights<'a> {
    /// Expected error of the network per channel, `[C]`; also the weight of the channel.
    pub(super) priors: &'a [f32],
    /// See [`TrainOptions::expected_error`](super::TrainOptions::expected_error).
    pub(super) expected_error: f32,
}

/// Returns the loss: the weighted mean square error of the network's answers over patches, channels and counted
/// frames. All noise levels weigh the same. A frame whose first guess is worse than usual, since conditions were
/// dropped, gets a smaller weight: otherwise these few frames would dominate training.
///
/// # Errors
/// Returns any error of the tensor library.
pub(super) fn loss(
    model: &Model,
    batch: &Batch,
    windows: usize,
    weighing: LossWeights<'_>,
) -> Result<Tensor> {
    let frames = batch.sigmas.len();
    let taken = model.take(&batch.inputs, windows, frames / windows)?;
    let answer = model.answer(&batch.noisy, &batch.sigmas, &taken)?;
    let right = model.levels(&batch.sigmas).answer(&batch.clean, taken.guess(), &batch.noise)?;
    let (rows, channels) = answer.dims2()?;
    let off = guess_errors(&(&batch.clean - taken.guess())?.detach(), frames, weighing)?;
    let weights = weights(&batch.counts, weighing.priors, &off, rows);
    let weights = Tensor::from_vec(weights, (frames, 1, channels), &Device::Cpu)?;
    let squares = (answer - right)?.sqr()?.reshape((frames, rows / frames, channels))?;
    squares.broadcast_mul(&weights)?.sum_all()
}

/// Returns the mean square error of the first guess per frame, relative to its average over the training data.
fn guess_errors(left: &Tensor, frames: usize, weighing: LossWeights<'_>) -> Result<Vec<f32>> {
    let scales: Vec<f32> = weighing.priors.iter().map(|prior| weighing.expected_error / prior).collect();
    let scales = Tensor::from_vec(scales, (1, weighing.priors.len()), &Device::Cpu)?;
    let squares = left.broadcast_mul(&scales)?.sqr()?;
    squares.reshape((frames, squares.elem_count() / frames))?.mean(1)?.to_vec1()
}

/// Returns weights of frames and channels, `[F, C]`. Summed over all rows, they are 1 if no guess is worse than
/// usual.
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

    #[test]
    fn weights_are_shares_of_what_counts() {
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
    fn errors_of_guesses_are_in_units_of_the_usual_one() {
        // The usual errors are 0.5 and 2; half of each is expected to remain.
        let weighing = LossWeights { priors: &[0.25, 1.0], expected_error: 0.5 };
        let left = Tensor::new(&[[0.5_f32, 2.0], [0.5, -2.0], [1.0, 4.0], [0.0, 0.0]], &Device::Cpu).unwrap();
        assert_eq!(guess_errors(&left, 2, weighing).unwrap(), [1.0, 2.0]);
    }
}
