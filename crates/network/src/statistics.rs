//! Statistics of the training data.

use serde::{Deserialize, Serialize};

use super::NetworkError;

/// Statistics of the training data, with one value per latent channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Statistics {
    /// Means of the images' colors, 0 to 1.
    pub means: Vec<f32>,
    /// Standard deviations of the mean colors of 16x16 pixels, the divisors of latents.
    pub scales: Vec<f32>,
    /// Standard deviations of the error that the denoiser is expected to leave, in units of `scales`.
    pub priors: Vec<f32>,
}

impl Statistics {
    /// Checks that there is a finite value per channel, and that scales and priors are positive.
    pub(crate) fn check(&self, channels: usize) -> Result<(), NetworkError> {
        let Self { means, scales, priors } = self;
        for (name, values) in [("means", means), ("scales", scales), ("priors", priors)] {
            let is_scale = ["scales", "priors"].contains(&name);
            let wrong = values.iter().find(|value| !value.is_finite() || is_scale && **value <= 0.0);
            if values.len() != channels || wrong.is_some() {
                let found = wrong.map_or_else(|| values.len().to_string(), f32::to_string);
                let expected = format!("{channels} finite {name} of channels, scales and priors above 0");
                return Err(NetworkError::input(expected, found));
            }
        }
        Ok(())
    }
}
