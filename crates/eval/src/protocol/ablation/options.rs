//! Options shared by all variants, and provenance of results.

use pskel_generate::Recipe;
use pskel_network::Network;
use serde::{Deserialize, Serialize};

use super::error::AblationError;
use super::variant::Variant;

/// Options shared by all variants.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AblationOptions {
    /// Number of frames to generate in each scene, after the references.
    pub steps: usize,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for AblationOptions {
    fn default() -> Self {
        Self { steps: 60, seed: 0 }
    }
}

/// Provenance of a result. Results of one table must have the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Options of the study.
    pub settings: AblationOptions,
    /// Fingerprint of the network's weights.
    pub weights: String,
}

/// Compared networks.
pub struct Networks {
    /// Network of all rows that name no other network.
    pub main: Network,
    /// Trained as other variants, each once.
    pub variants: Vec<(Variant, Network)>,
    /// Trained like `main`, with other seeds.
    pub others: Vec<Network>,
}

/// Selects one of [`Networks`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    Main,
    Variant(usize),
    Other(usize),
}

impl Networks {
    /// Checks that all networks have the same window and number of cameras, and the same recipe, of which
    /// variants may have other bins.
    pub(super) fn check(&self) -> Result<(), AblationError> {
        let shape = |network: &Network| {
            let config = network.config();
            (config.recipe.clone(), config.frames, network.cameras())
        };
        let main = shape(&self.main);
        let main_bins = main.0.bins;
        let variant = |(_, network): &(Variant, Network)| {
            let (recipe, frames, cameras) = shape(network);
            (Recipe { bins: main_bins, ..recipe }, frames, cameras)
        };
        let others = self.variants.iter().map(variant).chain(self.others.iter().map(shape));
        match others.into_iter().find(|other| *other != main) {
            None => Ok(()),
            Some(other) => Err(AblationError::Networks { found: format!("{main:?} and {other:?}") }),
        }
    }

    /// Returns the network of a row.
    pub(super) fn get(&self, choice: Choice) -> &Network {
        match choice {
            Choice::Main => &self.main,
            Choice::Variant(place) => self.variants.get(place).map_or(&self.main, |(_, network)| network),
            Choice::Other(place) => self.others.get(place).unwrap_or(&self.main),
        }
    }
}
