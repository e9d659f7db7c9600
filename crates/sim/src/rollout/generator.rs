use image::RgbImage;
use point_skeleton::Renderer;
use point_skeleton::scene::SceneState;
use serde::Serialize;

use super::error::AnyError;
use crate::report::images::StepImages;
use crate::{Committed, Forecast};

/// Generates the camera images of a rollout, one set of images per planning step.
pub trait ImageGenerator {
    /// Returns how many of the next planning steps are to be forecast for the next frame, at most.
    fn forecasts(&self) -> usize;

    /// Generates the images of a committed planning step, from it and from forecasts of the next ones.
    /// `frame` is the number of planning steps before it. Returns `None` if the step has no images.
    ///
    /// # Errors
    /// Returns the error of the network, the device or the files of the log.
    fn generate(
        &mut self,
        frame: usize,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<Option<StepImages>, AnyError>;

    /// Takes given images of a committed planning step as a reference, in place of recorded ones. All
    /// references come before the first [`ImageGenerator::generate`].
    ///
    /// # Errors
    /// Fails if there are enough references, if the images have another size, and as
    /// [`ImageGenerator::generate`].
    fn add_reference(
        &mut self,
        now: Committed<&SceneState>,
        images: Vec<RgbImage>,
        renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError>;

    /// Durations of the last generated images.
    fn times(&self) -> GenerationTimes;

    /// Returns the state to save with the step, for [`ImageGenerator::resume`]; `None` before the first
    /// generated frame.
    ///
    /// # Errors
    /// Returns an error if the state cannot be encoded.
    fn save(&self) -> Result<Option<Vec<u8>>, AnyError>;

    /// Continues after `frames` planning steps. `last` are the last of these steps: as many as the window has
    /// frames, or all if there are fewer. `saved` is the state saved with the last step.
    ///
    /// # Errors
    /// Returns an error if the saved state is missing, damaged or of another step, and any error of
    /// [`ImageGenerator::generate`].
    fn resume(
        &mut self,
        frames: usize,
        last: &[Committed<SceneState>],
        saved: Option<&[u8]>,
        renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError>;

    /// Number of frames in the window of the network.
    fn window(&self) -> usize;

    /// Returns whether every planning step has ground-truth images.
    fn has_truth(&self) -> bool;
}

/// Durations within a generated frame, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct GenerationTimes {
    /// Rendering the committed state as network input.
    pub conditions_s: f64,
    /// Rendering the forecasts.
    pub forecasts_s: f64,
    /// Getting the ground-truth images.
    pub truth_s: f64,
    /// The generator step with all its network calls.
    pub network_s: f64,
    /// Decoding the latent into images.
    pub decode_s: f64,
}

impl GenerationTimes {
    /// Cost of a frame: all parts except the ground-truth images, which only serve for comparison.
    pub fn total_s(&self) -> f64 {
        self.conditions_s + self.forecasts_s + self.network_s + self.decode_s
    }
}
