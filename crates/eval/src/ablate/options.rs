//! Options shared by all variants, and provenance of results.

use pskel_network::Network;
use serde::{Deserialize, Serialize};

use super::error::AblateError;

/// Options shared by all variants.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AblateOptions {
    /// Number of frames to generate in each scene, after the references.
    pub steps: usize,
    /// Inference steps, T; `None` for the frames of the window.
    pub infer_steps: Option<usize>,
    /// Seed of the noise.
    pub seed: u64,
    /// Seed of the asset augmentation; `None` for unchanged assets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub augment: Option<u64>,
    /// Noise on the previous frames of `causal`, in steps of 1000.
    #[serde(default)]
    pub history_noise: usize,
    /// Forecasts in the window of `non_causal`.
    #[serde(default = "one")]
    pub ahead: usize,
}

fn one() -> usize {
    1
}

impl Default for AblateOptions {
    fn default() -> Self {
        Self { steps: 60, infer_steps: None, seed: 0, augment: None, history_noise: 0, ahead: one() }
    }
}

/// Provenance of a result. Results of one table must have the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Options of the study.
    pub settings: AblateOptions,
    /// Fingerprint of the network's weights.
    pub weights: String,
}

/// Compared networks.
pub struct Networks {
    /// Network of all rows that name no other network.
    pub main: Network,
    /// Trained without augmentation.
    pub plain: Option<Network>,
    /// Trained like `main`, with other seeds.
    pub others: Vec<Network>,
}

/// Selects one of [`Networks`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    Main,
    Plain,
    Other(usize),
}

impl Networks {
    /// Checks that all networks have the same recipe, window and number of cameras.
    pub(super) fn check(&self) -> Result<(), AblateError> {
        let shape = |network: &Network| {
            let config = network.config();
            (config.recipe.clone(), config.frames, network.cameras())
        };
        let main = shape(&self.main);
        match self.plain.iter().chain(&self.others).map(shape).find(|other| *other != main) {
            None => Ok(()),
            Some(other) => Err(AblateError::Networks { found: format!("{main:?} and {other:?}") }),
        }
    }

    /// Returns the network of a row.
    pub(super) fn get(&self, choice: Choice) -> &Network {
        match choice {
            Choice::Main => &self.main,
            Choice::Plain => self.plain.as_ref().unwrap_or(&self.main),
            Choice::Other(place) => self.others.get(place).unwrap_or(&self.main),
        }
    }
}
