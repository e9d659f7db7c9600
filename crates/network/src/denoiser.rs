use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{Device, Tensor};
use image::RgbImage;
use point_skeleton::geometry::ImageSize;
use pskel_generate::{Codec, Denoiser, DenoiserError, Frame, FrameConditions, Latent, LatentShape, Recipe};

use super::latents::{latent_of_rows, latent_rows, rows_of_latent};
use super::{
    EncodedConditions, Inputs, Model, NetworkConfig, NetworkError, Provenance, Statistics, Weights,
    WindowConditions,
};

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
    /// Conditions of the last frames with their encodings, latest last.
    remembered: Arc<Mutex<Vec<(FrameConditions, EncodedConditions)>>>,
}

impl Network {
    /// Creates a network from weights, for a number of cameras.
    ///
    /// # Errors
    /// Returns an error if the weights are inconsistent, or if the number of cameras is not 1 to 8.
    pub fn new(weights: Weights, cameras: usize) -> Result<Self, NetworkError> {
        NetworkConfig::check_cameras(cameras)?;
        let fingerprint = weights.fingerprint()?;
        let Weights { config, statistics, about, parameters } = weights;
        let parameters = parameters.into_iter().map(|(name, tensor)| (name, tensor.detach())).collect();
        let model = Arc::new(Model::new(&config, &statistics, parameters)?);
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
    fn encoded(&self, frames: &[&FrameConditions]) -> Result<Vec<EncodedConditions>, NetworkError> {
        if let Some(other) = frames.iter().find(|frame| frame.views() != self.cameras) {
            let expected = format!("conditions of {} cameras", self.cameras);
            return Err(NetworkError::input(expected, other.views().to_string()));
        }
        let mut remembered = self.remembered.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut missing, mut places) = (Vec::<&FrameConditions>::new(), Vec::new());
        for frame in frames {
            let known = remembered.iter().rposition(|(known, _)| known == *frame);
            let place =
                known.or_else(|| Some(remembered.len() + missing.iter().position(|other| other == frame)?));
            places.push(place.unwrap_or_else(|| {
                missing.push(frame);
                remembered.len() + missing.len() - 1
            }));
        }
        if !missing.is_empty() {
            let encoded = self.model.encode(&Inputs::new(&self.config, missing.iter().copied())?)?;
            for (place, frame) in missing.iter().enumerate() {
                remembered.push(((*frame).clone(), encoded.frame(place, missing.len())?));
            }
        }
        let found = places.into_iter().map(|place| remembered[place].1.clone()).collect();
        // A step sees the frames of its window and as many forecasts, with guidance each of them twice.
        let most = 4 * self.config.frames;
        let surplus = remembered.len().saturating_sub(most);
        remembered.drain(..surplus);
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

    /// Returns latents `[V, C, h, w]` as rows.
    fn rows(&self, latents: &[&Latent]) -> Result<Tensor, NetworkError> {
        let rows: Vec<f32> = latents.iter().flat_map(|latent| rows_of_latent(latent)).collect();
        let channels = self.shape().channels;
        Ok(Tensor::from_vec(rows, (latents.len() * self.shape().len() / channels, channels), &Device::Cpu)?)
    }

    fn velocity(&self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<f32>, NetworkError> {
        self.check(window)?;
        let frames: Vec<&FrameConditions> = window.iter().map(|frame| frame.condition).collect();
        let encoded = self.encoded(&frames)?;
        let conditions: Vec<&WindowConditions> = encoded.iter().map(|frame| &frame.window).collect();
        let sigmas: Vec<f32> = window.iter().map(|frame| frame.level.sigma).collect();
        let noisy = self.rows(&window.iter().map(|frame| frame.latent).collect::<Vec<_>>())?;
        let velocity = self.model.velocity(&noisy, &sigmas, &WindowConditions::joined(&conditions)?)?;
        Ok(velocity.flatten_all()?.to_vec1::<f32>()?)
    }

    fn decoded(&self, latent: &Latent, conditions: &FrameConditions) -> Result<Vec<RgbImage>, NetworkError> {
        let shape = self.shape();
        if latent.shape() != shape {
            return Err(NetworkError::input(format!("latents of {shape}"), latent.shape().to_string()));
        }
        let encoded = self.encoded(&[conditions])?;
        let Some(encoded) = encoded.first() else { return Ok(Vec::new()) };
        let levels = self.model.decode(&self.rows(&[latent])?, encoded)?.flatten_all()?.to_vec1::<f32>()?;
        let ImageSize { height, width } = self.config.recipe.size;
        let image = |levels: &[f32]| {
            let byte = |level: &f32| (level * 255.0).round() as u8; // saturates
            RgbImage::from_raw(width, height, levels.iter().map(byte).collect())
        };
        Ok(levels.chunks(levels.len() / self.cameras).filter_map(image).collect())
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
