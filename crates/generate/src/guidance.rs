use serde::{Deserialize, Serialize};

use super::denoiser::predict;
use super::{Condition, Denoiser, DenoiserError, DroppedConditions, Frame, Latent};

/// Classifier-free guidance: extrapolates from the unconditional prediction through the conditional one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Guidance {
    /// Scale of `v = v_without + scale (v_with - v_without)`; 1 needs a single network call.
    pub scale: f32,
    /// Conditions dropped in the unconditional prediction.
    pub dropped: DroppedConditions,
}

impl Default for Guidance {
    fn default() -> Self {
        Self { scale: 1.0, dropped: DroppedConditions::GUIDED }
    }
}

impl Guidance {
    /// Predicts a window, with guidance.
    pub(super) fn predict<D: Denoiser + ?Sized>(
        &self,
        denoiser: &mut D,
        window: &[Frame<'_, D::Condition>],
    ) -> Result<Vec<Latent>, DenoiserError> {
        let with = predict(denoiser, window)?;
        if self.scale == 1.0 {
            return Ok(with);
        }
        let conditions: Vec<_> = window.iter().map(|frame| frame.condition.without(self.dropped)).collect();
        let bare = window.iter().zip(&conditions);
        let bare: Vec<_> = bare.map(|(frame, condition)| Frame { condition, ..*frame }).collect();
        let without = predict(denoiser, &bare)?;
        let guided = |(with, without): (&Latent, &Latent)| {
            without.zip(with, |without, with| without + self.scale * (with - without))
        };
        Ok(with.iter().zip(&without).map(guided).collect())
    }
}
