//! Generated images, as engine, encoder and page share them.

use pskel_sim::report::images::StepImages;
use serde::{Deserialize, Serialize};

/// Whether images are generated, and what waits for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Mode {
    /// No images are generated.
    #[default]
    Off,
    /// The simulation waits for each image.
    Lockstep,
    /// The simulation goes on.
    Beside,
}

/// Generated images of a step.
pub(crate) struct Generated {
    pub(crate) step: usize,
    pub(crate) t_us: i64,
    pub(crate) images: StepImages,
    /// Time that it took, seconds.
    pub(crate) seconds: f64,
}

/// Answer of the thread.
pub(crate) struct Made {
    pub(crate) session: u64,
    pub(crate) result: Result<Generated, String>,
}

/// What the page shows of the generator.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct GeneratedHeader {
    pub(crate) mode: Mode,
    /// Step and time (seconds since the first frame of the log) of the images.
    pub(crate) step: Option<usize>,
    pub(crate) t_s: Option<f64>,
    /// Time from the images to the state that is shown, seconds.
    pub(crate) behind_s: Option<f64>,
    /// Whether the images are recorded ones, with which the generator begins.
    pub(crate) is_reference: bool,
    /// Number of reference images that are there.
    pub(crate) references: usize,
    /// Number of frames, without references, that are generated, and that were skipped.
    pub(crate) count: usize,
    pub(crate) skipped: usize,
    /// Time that the last frame took, seconds.
    pub(crate) network_s: Option<f64>,
    /// Whether a frame is being generated.
    pub(crate) is_waiting: bool,
    pub(crate) failure: Option<String>,
}
