use crate::DenoiserRig;

/// Rollout for which an image generator is started.
#[derive(Clone, Debug)]
pub struct ImageRig {
    /// Name of the log.
    pub log: String,
    /// Cameras and planning steps per second.
    pub rig: DenoiserRig,
    /// Whether the log has an HD map.
    pub has_map: bool,
    /// Seed of the noise.
    pub seed: u64,
}
