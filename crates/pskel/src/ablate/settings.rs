//! Settings shared by all variants, and provenance of results.

use serde::{Deserialize, Serialize};

/// Settings shared by all variants.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Settings {
    /// Number of generated frames.
    pub(super) steps: usize,
    pub(super) infer_steps: usize,
    pub(super) seed: u64,
    /// Seed of the asset augmentation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) augment: Option<u64>,
}

/// Provenance of a result. Results of one table must have the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Origin {
    pub(super) settings: Settings,
    /// Fingerprint of the network's weights.
    pub(super) weights: String,
}
