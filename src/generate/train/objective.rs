use candle_core::{Device, Result, Tensor};

use super::batch::Batch;
use crate::generate::network::Model;

/// How far the network's answers are off: their mean square over patches, channels and frames that count, all levels of
/// noise alike. Channels weigh as much as their guesses are off (`priors [C]`).
///
/// # Errors
/// The tensor library's.
pub(super) fn loss(model: &Model, batch: &Batch, windows: usize, priors: &[f32]) -> Result<Tensor> {
    let frames = batch.sigmas.len();
    let taken = model.take(&batch.inputs, windows, frames / windows)?;
    let answer = model.answer(&batch.noisy, &batch.sigmas, &taken)?;
    let right = model.levels(&batch.sigmas).answer(&batch.clean, taken.guess(), &batch.noise)?;
    let (rows, channels) = answer.dims2()?;
    let weights =
        Tensor::from_vec(weights(&batch.counts, priors, rows), (frames, 1, channels), &Device::Cpu)?;
    let squares = (answer - right)?.sqr()?.reshape((frames, rows / frames, channels))?;
    squares.broadcast_mul(&weights)?.sum_all()
}

/// Weights of frames and channels, `[F, C]`; over all rows they sum up to 1.
fn weights(counts: &[bool], priors: &[f32], rows: usize) -> Vec<f32> {
    let mean = priors.iter().sum::<f32>() / priors.len() as f32;
    let counted = counts.iter().filter(|counts| **counts).count().max(1);
    let share = 1.0 / (counted * (rows / counts.len()) * priors.len()) as f32;
    let of = |counts: bool, prior: f32| if counts { share * prior / mean } else { 0.0 };
    counts.iter().flat_map(|counts| priors.iter().map(|prior| of(*counts, *prior))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_shares_of_what_counts() {
        let found = weights(&[false, true, true], &[0.5, 1.5], 12);
        // Two frames of four rows and two channels.
        let each = 1.0 / 16.0;
        assert_eq!(found, [0.0, 0.0, 0.5 * each, 1.5 * each, 0.5 * each, 1.5 * each]);
        assert!((found.iter().sum::<f32>() * 4.0 - 1.0).abs() < 1e-6);
    }
}
