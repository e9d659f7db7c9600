//! A linear network whose predictions can be computed by hand, for tests and for trying out the generator
//! loop.

use crate::{Condition, Denoiser, DenoiserError, DroppedConditions, Frame, Latent, LatentShape};

/// Denoiser that predicts `v = 0.6 x - 0.25 x[next frame] + 0.1 x[frame before] + 0.5 condition + 0.05
/// sigma`. At the ends of the window, the frame itself replaces the missing neighbor.
#[derive(Clone, Copy, Debug)]
pub struct LinearDenoiser {
    /// Shape of its latents and of its conditions.
    pub shape: LatentShape,
}

/// Conditions of the toy are latents; dropping any part of one sets it to 0.
impl Condition for Latent {
    fn without(&self, dropped: DroppedConditions) -> Self {
        if dropped == DroppedConditions::default() { self.clone() } else { Self::filled(self.shape(), 0.0) }
    }
}

impl Denoiser for LinearDenoiser {
    type Condition = Latent;

    fn shape(&self) -> LatentShape {
        self.shape
    }

    fn predict(&mut self, window: &[Frame<'_, Latent>]) -> Result<Vec<Latent>, DenoiserError> {
        let last = window.len().saturating_sub(1);
        let of = |(position, frame): (usize, &Frame<'_, Latent>)| {
            let (next, before) = (window[(position + 1).min(last)], window[position.saturating_sub(1)]);
            let neighbours = next.latent.zip(before.latent, |next, before| 0.1 * before - 0.25 * next);
            let own = frame.latent.zip(frame.condition, |x, condition| 0.6 * x + 0.5 * condition);
            own.zip(&neighbours, |own, neighbours| own + neighbours + 0.05 * frame.level.sigma)
        };
        Ok(window.iter().enumerate().map(of).collect())
    }
}
