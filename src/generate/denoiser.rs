use image::RgbImage;

use super::guidance::Dropped;
use super::{Latent, LatentShape, Level};
use crate::peer::PeerError;

/// A frame of the window as a network sees it.
#[derive(Debug)]
pub struct Frame<'a, C> {
    /// `[V, C, h, w]`.
    pub latent: &'a Latent,
    /// How noisy it is.
    pub level: Level,
    /// What it is to show.
    pub condition: &'a C,
}

impl<C> Clone for Frame<'_, C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Frame<'_, C> {}

/// What a frame is to show, in the form that a network takes.
pub trait Condition: Clone {
    /// The same with some of it taken away, as it is for training and guidance.
    fn without(&self, dropped: Dropped) -> Self;
}

/// A network that takes noise off frames.
pub trait Denoiser {
    /// What frames are to show.
    type Condition: Condition;

    /// Size of the latents it takes.
    fn shape(&self) -> LatentShape;

    /// What the network predicts for each frame of a window, `[V, C, h, w]` each: a velocity, noise or the clean frame,
    /// whichever the sampler is told.
    ///
    /// # Errors
    /// As the network has it; shapes and finite values are checked by who calls.
    fn predict(&mut self, window: &[Frame<'_, Self::Condition>]) -> Result<Vec<Latent>, DenoiserError>;
}

impl<D: Denoiser + ?Sized> Denoiser for Box<D> {
    type Condition = D::Condition;

    fn shape(&self) -> LatentShape {
        (**self).shape()
    }

    fn predict(&mut self, window: &[Frame<'_, D::Condition>]) -> Result<Vec<Latent>, DenoiserError> {
        (**self).predict(window)
    }
}

/// Between images and latents.
pub trait Codec {
    /// Size of a frame's latents.
    fn shape(&self) -> LatentShape;

    /// Latents of one frame's images, a camera after the other.
    ///
    /// # Errors
    /// Another number of images than cameras, or images of another size.
    fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError>;

    /// The images of a frame.
    ///
    /// # Errors
    /// Latents of another size.
    fn decode(&self, latent: &Latent) -> Result<Vec<RgbImage>, DenoiserError>;
}

/// Why a network gives nothing that is of use.
#[derive(Debug, thiserror::Error)]
pub enum DenoiserError {
    /// Something other than was asked for.
    #[error("expected {expected} from the denoiser, found {found}")]
    Answer {
        /// What would do.
        expected: String,
        /// What came.
        found: String,
    },
    /// What it was given does not fit it.
    #[error("expected {expected}, found {found}")]
    Input {
        /// What would do.
        expected: String,
        /// What was given.
        found: String,
    },
    /// A network in another process.
    #[error(transparent)]
    Process(#[from] PeerError),
    /// The network itself.
    #[error("the denoiser failed: {0}")]
    Network(#[from] Box<dyn std::error::Error + Send + Sync>),
}

impl DenoiserError {
    pub(super) fn answer(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Answer { expected: expected.into(), found: found.into() }
    }

    pub(super) fn input(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Input { expected: expected.into(), found: found.into() }
    }
}

/// Calls a network and looks at what comes: a latent a frame, of its shape, finite.
pub(super) fn predict<D: Denoiser + ?Sized>(
    denoiser: &mut D,
    window: &[Frame<'_, D::Condition>],
) -> Result<Vec<Latent>, DenoiserError> {
    let predictions = denoiser.predict(window)?;
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
