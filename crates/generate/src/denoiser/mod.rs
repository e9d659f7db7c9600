pub(super) mod error;
pub(super) mod guidance;
pub(super) mod latent;
pub(super) mod noise;
pub(super) mod pixel_codec;
pub(super) mod sampler;
pub(super) mod schedule;
pub mod toy;

use image::RgbImage;

use super::{Condition, DenoiserError, DroppedConditions, FrameConditions, Latent, LatentShape, Level};

/// A frame of the window, as input of a network.
#[derive(Debug)]
pub struct Frame<'a, C> {
    /// Noisy latent, `[V, C, h, w]`.
    pub latent: &'a Latent,
    /// Noise level of the latent.
    pub level: Level,
    /// Whether the frame is finished, a reference for the others, and its prediction is not used.
    pub is_reference: bool,
    /// Condition of the frame.
    pub condition: &'a C,
}

impl<C> Clone for Frame<'_, C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Frame<'_, C> {}

/// A network that denoises frames.
pub trait Denoiser {
    /// Type of its conditions.
    type Condition: Condition;

    /// Shape of its latents.
    fn shape(&self) -> LatentShape;

    /// Predicts a velocity, the noise or the clean latent (as set in the sampler) for each frame of a window,
    /// `[V, C, h, w]` each.
    ///
    /// # Errors
    /// Returns an error if the network fails. The caller checks shapes and finiteness of the result.
    fn predict(&mut self, window: &[Frame<'_, Self::Condition>]) -> Result<Vec<Latent>, DenoiserError>;

    /// Predicts a window for guidance: with its conditions, and without some of them. By default two calls.
    ///
    /// # Errors
    /// Fails as [`Denoiser::predict`].
    fn predict_guided(
        &mut self,
        window: &[Frame<'_, Self::Condition>],
        dropped: DroppedConditions,
    ) -> Result<GuidedPrediction, DenoiserError> {
        predict_twice(self, window, dropped)
    }
}

/// Predicts a window for guidance by two calls.
pub(super) fn predict_twice<D: Denoiser + ?Sized>(
    denoiser: &mut D,
    window: &[Frame<'_, D::Condition>],
    dropped: DroppedConditions,
) -> Result<GuidedPrediction, DenoiserError> {
    let conditional = denoiser.predict(window)?;
    let conditions: Vec<_> = window.iter().map(|frame| frame.condition.without(dropped)).collect();
    let bare = window.iter().zip(&conditions);
    let bare: Vec<_> = bare.map(|(frame, condition)| Frame { condition, ..*frame }).collect();
    Ok(GuidedPrediction { conditional, unconditional: denoiser.predict(&bare)? })
}

/// Predictions of a window for guidance, one per frame each.
#[derive(Clone, Debug, PartialEq)]
pub struct GuidedPrediction {
    /// With all conditions.
    pub conditional: Vec<Latent>,
    /// Without the dropped conditions.
    pub unconditional: Vec<Latent>,
}

impl<D: Denoiser + ?Sized> Denoiser for Box<D> {
    type Condition = D::Condition;

    fn shape(&self) -> LatentShape {
        (**self).shape()
    }

    fn predict(&mut self, window: &[Frame<'_, D::Condition>]) -> Result<Vec<Latent>, DenoiserError> {
        (**self).predict(window)
    }

    fn predict_guided(
        &mut self,
        window: &[Frame<'_, D::Condition>],
        dropped: DroppedConditions,
    ) -> Result<GuidedPrediction, DenoiserError> {
        (**self).predict_guided(window, dropped)
    }
}

/// Encodes images into latents and decodes latents into images.
pub trait Codec {
    /// Latent shape of a frame.
    fn shape(&self) -> LatentShape;

    /// Encodes the images of one frame, one per camera.
    ///
    /// # Errors
    /// Returns an error if the number of images differs from the number of cameras, or if an image has
    /// another size.
    fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError>;

    /// Decodes the images of a frame, one per camera, from its latent and its conditions.
    ///
    /// # Errors
    /// Returns an error if the latent has another shape, or if the conditions do not fit.
    fn decode(&self, latent: &Latent, conditions: &FrameConditions) -> Result<Vec<RgbImage>, DenoiserError>;
}

/// Validates the predictions of a network: one per frame, of the frame's shape, finite.
pub(super) fn checked<C>(
    predictions: Vec<Latent>,
    window: &[Frame<'_, C>],
) -> Result<Vec<Latent>, DenoiserError> {
    if predictions.len() != window.len() {
        let expected = format!("{} frames", window.len());
        return Err(DenoiserError::answer(expected, predictions.len().to_string()));
    }
    for (position, (prediction, frame)) in predictions.iter().zip(window).enumerate() {
        let shape = frame.latent.shape();
        if prediction.shape() != shape {
            let expected = format!("latents of {shape} for frame {position} of the window");
            return Err(DenoiserError::answer(expected, prediction.shape().to_string()));
        }
        if let Some(value) = prediction.values().iter().find(|value| !value.is_finite()) {
            let expected = format!("finite values for frame {position} of the window");
            return Err(DenoiserError::answer(expected, value.to_string()));
        }
    }
    Ok(predictions)
}
