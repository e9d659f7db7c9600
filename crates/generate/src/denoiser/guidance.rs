use serde::{Deserialize, Serialize};

use super::checked;
use crate::{Denoiser, DenoiserError, DroppedConditions, Frame, GuidedPrediction, Latent};

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
    pub(crate) fn predict<D: Denoiser + ?Sized>(
        &self,
        denoiser: &mut D,
        window: &[Frame<'_, D::Condition>],
    ) -> Result<Vec<Latent>, DenoiserError> {
        if self.scale == 1.0 {
            return checked(denoiser.predict(window)?, window);
        }
        let GuidedPrediction { conditional, unconditional } =
            denoiser.predict_guided(window, self.dropped)?;
        let (with, without) = (checked(conditional, window)?, checked(unconditional, window)?);
        let guided = |(with, without): (&Latent, &Latent)| {
            without.zip(with, |without, with| without + self.scale * (with - without))
        };
        Ok(with.iter().zip(&without).map(guided).collect())
    }
}
