use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;
use point_skeleton::geometry::ImageSize;
use pskel_generate::{Codec, Denoiser, DenoiserError, Frame, FrameConditions, Latent, LatentShape, Recipe};

use super::inputs::check;
use super::latents::{latent_of_rows, latent_rows, rows_of_latent};
use super::model::{Encoded, Model};
use super::{NetworkConfig, NetworkError, Provenance, Statistics, Weights};

/// Encoded conditions by the fingerprints of their frames, latest last.
type Remembered = VecDeque<(u64, Arc<Encoded>)>;

/// The network as a denoiser, which predicts the velocity of flow matching, and as the codec of its latents.
/// Copies share their encoded conditions.
#[derive(Clone)]
pub struct Network {
    config: NetworkConfig,
    statistics: Statistics,
    about: Provenance,
    fingerprint: String,
    model: Arc<Model>,
    cameras: usize,
    /// Encoded conditions of the last frames.
    remembered: Arc<Mutex<Remembered>>,
}

impl Network {
    /// Creates a network from weights, for a number of cameras.
    ///
    /// # Errors
    /// Returns an error if the weights are inconsistent, or if the number of cameras is not 1 to 8.
    pub fn new(weights: Weights, cameras: usize) -> Result<Self, NetworkError> {
        NetworkConfig::check_cameras(cameras)?;
        let (fingerprint, model) = (weights.fingerprint(), Arc::new(weights.model()?));
        let Weights { config, statistics, about, .. } = weights;
        Ok(Self { config, statistics, about, fingerprint, model, cameras, remembered: Arc::default() })
    }

    /// Reads a network from a file of weights.
    ///
    /// # Errors
    /// Returns the errors of [`Weights::open`] and [`Network::new`].
    pub fn open(path: &Path, cameras: usize) -> Result<Self, NetworkError> {
        Self::new(Weights::open(path)?, cameras)
    }

    /// Creates the network that is included in the program.
    ///
    /// # Errors
    /// Returns the errors of [`Weights::shipped`] and [`Network::new`].
    pub fn shipped(cameras: usize) -> Result<Self, NetworkError> {
        Self::new(Weights::shipped()?, cameras)
    }

    /// Reads a network from a file of weights, or else creates the one that is included in the program.
    ///
    /// # Errors
    /// Returns the errors of [`Network::open`].
    pub fn open_or_shipped(path: Option<&Path>, cameras: usize) -> Result<Self, NetworkError> {
        path.map_or_else(|| Self::shipped(cameras), |path| Self::open(path, cameras))
    }

    /// Dimensions of the network.
    pub fn config(&self) -> &NetworkConfig {
        &self.config
    }

    /// Number of cameras.
    pub fn cameras(&self) -> usize {
        self.cameras
    }

    /// How its conditions are rendered.
    pub fn recipe(&self) -> &Recipe {
        &self.config.recipe
    }

    /// Provenance of its weights.
    pub fn about(&self) -> &Provenance {
        &self.about
    }

    /// Hash of its weights, see [`Weights::fingerprint`].
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }

    /// Shape of its latents.
    pub fn shape(&self) -> LatentShape {
        self.config.shape(self.cameras)
    }

    /// Returns the encoded conditions of frames; frames in the last windows are not encoded again.
    fn encoded(&self, frames: &[&FrameConditions]) -> Result<Vec<Arc<Encoded>>, NetworkError> {
        for frame in frames {
            if frame.views() != self.cameras {
                let expected = format!("conditions of {} cameras", self.cameras);
                return Err(NetworkError::input(expected, frame.views().to_string()));
            }
            check(&self.config, frame)?;
        }
        let mut remembered = self.remembered.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found = Vec::with_capacity(frames.len());
        for frame in frames {
            let key = frame.fingerprint();
            let known = remembered.iter().rev().find(|(known, _)| *known == key);
            let encoded = match known {
                Some((_, encoded)) => Arc::clone(encoded),
                None => {
                    let encoded = Arc::new(self.model.encode(frame));
                    remembered.push_back((key, Arc::clone(&encoded)));
                    encoded
                }
            };
            found.push(encoded);
        }
        // A step sees the frames of its window and as many forecasts, with guidance each of them twice.
        while remembered.len() > 4 * self.config.frames {
            remembered.pop_front();
        }
        Ok(found)
    }

    fn check(&self, window: &[Frame<'_, FrameConditions>]) -> Result<(), NetworkError> {
        let (frames, shape) = (self.config.frames, self.shape());
        if !(1..=frames).contains(&window.len()) {
            return Err(NetworkError::input(
                format!("a window of 1 to {frames} frames"),
                window.len().to_string(),
            ));
        }
        for frame in window {
            if frame.latent.shape() != shape {
                return Err(NetworkError::input(
                    format!("latents of {shape}"),
                    frame.latent.shape().to_string(),
                ));
            }
            if !(0.0..=1.0).contains(&frame.level.sigma) {
                return Err(NetworkError::input("a share of noise of 0 to 1", frame.level.sigma.to_string()));
            }
        }
        Ok(())
    }

    fn velocity(&self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<f32>, NetworkError> {
        self.check(window)?;
        let frames: Vec<&FrameConditions> = window.iter().map(|frame| frame.condition).collect();
        let encoded = self.encoded(&frames)?;
        let encoded: Vec<&Encoded> = encoded.iter().map(Arc::as_ref).collect();
        let sigmas: Vec<f32> = window.iter().map(|frame| frame.level.sigma).collect();
        let noisy: Vec<f32> = window.iter().flat_map(|frame| rows_of_latent(frame.latent)).collect();
        Ok(self.model.velocity(&noisy, &sigmas, &encoded))
    }

    fn decoded(&self, latent: &Latent, conditions: &FrameConditions) -> Result<Vec<RgbImage>, NetworkError> {
        let shape = self.shape();
        if latent.shape() != shape {
            return Err(NetworkError::input(format!("latents of {shape}"), latent.shape().to_string()));
        }
        let encoded = self.encoded(&[conditions])?;
        let Some(encoded) = encoded.first() else { return Ok(Vec::new()) };
        let colors = self.model.decode(&rows_of_latent(latent), conditions, encoded);
        let ImageSize { height, width } = self.config.recipe.size;
        let image = |colors: &[[f32; 3]]| {
            let byte = |level: &f32| (level * 255.0).round() as u8; // saturates
            RgbImage::from_raw(width, height, colors.as_flattened().iter().map(byte).collect())
        };
        Ok(colors.chunks(self.config.recipe.size.pixels()).filter_map(image).collect())
    }
}

impl Denoiser for Network {
    type Condition = FrameConditions;

    fn shape(&self) -> LatentShape {
        self.shape()
    }

    fn predict(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<Latent>, DenoiserError> {
        let shape = self.shape();
        Ok(self.velocity(window)?.chunks(shape.len()).map(|rows| latent_of_rows(shape, rows)).collect())
    }
}

impl Codec for Network {
    fn shape(&self) -> LatentShape {
        self.shape()
    }

    fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError> {
        let size = self.config.recipe.size;
        if images.len() != self.cameras {
            return Err(DenoiserError::input(format!("{} images", self.cameras), images.len().to_string()));
        }
        if let Some(other) = images.iter().find(|image| image.dimensions() != (size.width, size.height)) {
            let found = format!("{}x{}", other.height(), other.width());
            return Err(DenoiserError::input(format!("images of {size}"), found));
        }
        let pixels: Vec<[u8; 3]> = images.iter().flat_map(RgbImage::pixels).map(|pixel| pixel.0).collect();
        Ok(latent_of_rows(self.shape(), &latent_rows(&self.config, &self.statistics, &pixels)))
    }

    fn decode(&self, latent: &Latent, conditions: &FrameConditions) -> Result<Vec<RgbImage>, DenoiserError> {
        Ok(self.decoded(latent, conditions)?)
    }
}
