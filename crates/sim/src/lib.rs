//! Closed-loop simulation: ego and actors move step by step, and each step is a state to render conditions
//! from.
//!
//! # How it works
//! Past states are [`Committed`], predicted ones are [`Forecast`]. They are different types, and no forecast
//! can be converted to a committed state.
//!
//! A [`Simulation`] commits the first steps from the log (the warm-up). Then, at each planning step, the
//! ego's policy computes a plan from the committed state. Until the next plan, the ego tracks it exactly or
//! with a kinematic bicycle, and the actors move by their own policy. Forecasts apply the same rules to a
//! copy that is then discarded.
//!
//! A log may have a scenario, whose conditions are met by the simulated ego; [`families`] makes some.
//!
//! A step is a pure function: the same log, options and plans give the same bytes, and a rollout that was
//! saved and resumed equals an uninterrupted one.

pub mod families;
mod path;
pub mod pdm;
pub mod peer;
pub mod report;
pub mod rollout;

mod actors;
mod clock;
mod ego;
mod error;
mod external;
mod history;
mod metrics;
mod options;
mod recorded;
mod saved;
mod scenario;
mod scores;
mod simulation;
mod state;
mod time;
mod tracking;
mod wheel;
mod world;

pub use actors::idm_step;
pub use error::SimError;
pub use metrics::{Collision, CollisionKind, Comfort, Deviation, Metrics, OffRoad, Range};
pub use options::{ActorPolicy, EgoKind, EgoPolicy, PathAnchor, Rates, SimOptions, Tracking};
pub use path::local_path::{LocalPath, LocalPathError};
pub use path::trajectory::{Trajectory, Waypoint};
pub use path::trajectory_file::TrajectoryFile;
pub use saved::SavedState;
pub use scenario::{Scenario, scene_state};
pub use scores::{AlpaSimScores, DrivingScores, NeuroNcap, ncap_score};
pub use simulation::{EndReason, Simulation, StepOutcome};
pub use state::{
    Committed, EGO_SIZE_M, EgoState, Forecast, Instant, OtherSimulation, REAR_AXLE_TO_CENTER_M, SimActor,
    WHEELBASE_M,
};
pub use wheel::{Controls, Wheel};

pub use crate::peer::{PeerAddress as PlannerAddress, PeerError as PlannerError, PeerSpec as PlannerSpec};
