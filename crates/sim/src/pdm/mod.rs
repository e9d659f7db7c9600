//! PDM scores: how NAVSIM rates a plan, or a drive, over four seconds.
//!
//! # How it works
//! A [`PdmScorer`] has the roads of a log. [`PdmScorer::scene`] collects what a plan meets
//! from a time on: other road users and red lights (`traffic`), the route and its center line (`roads`), the
//! ego's past, and the drive of PDM-Closed (`closed`), whose progress is the reference. [`PdmScene::score`]
//! lets a controller with a kinematic bicycle track the plan (`tracker`, `profile`, `state`), as NAVSIM does,
//! and computes the sub-scores (`score`, `comfort`). [`PdmScorer::drive`] does the same for states that were
//! driven in a rollout.
//!
//! Facts (formulas, weights, thresholds, order of checks) from NAVSIM at commit 0a380a9. It reads frames at 2
//! Hz and interpolates; so does this module. Where a map has no road network and a log no roadblocks, lane
//! connectors are the intersections, and the recorded path is the route: such scores are not NAVSIM's.

mod closed;
mod comfort;
mod drive;
mod path;
mod profile;
mod roads;
mod scene;
mod score;
mod scores;
pub(crate) mod shape;
mod state;
mod tracker;
mod traffic;

pub use drive::DriveScores;
pub use scene::{PdmScene, PdmScorer};
pub use scores::{PdmResult, PdmScores};
pub use state::PdmState;

/// Number of states of a plan: 4 s at 10 Hz, with the first one.
const SAMPLES: usize = 41;
/// Duration of a plan, microseconds.
const HORIZON_US: i64 = 4_000_000;
/// Time between samples, microseconds.
const SAMPLE_US: i64 = 100_000;
/// Time between frames, microseconds.
const FRAME_US: i64 = 500_000;
/// Number of frames before the first one.
const PAST_FRAMES: i64 = 3;
