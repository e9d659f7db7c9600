//! The closed loop: ego and actors move step by step, and every step is a state that conditions are made of.
//!
//! # How it works
//! What has happened is [`Committed`], what is only expected is [`Forecast`]. They are different types, and nothing
//! turns a forecast into something committed.
//!
//! A [`Simulation`] commits the first steps from the log (the warm-up). Then, at each plan step, the ego's policy makes a
//! plan from what was committed; the ego follows it, exactly or as a bicycle does, until the next one, and the actors
//! move by theirs. What is expected next is found by the same rules on a copy that is thrown away.
//!
//! A step is a pure function: the same log, options and plans give the same bytes, and a rollout that was saved and
//! resumed is the one that ran through.

mod actors;
mod clock;
mod ego;
mod error;
mod external;
mod fit;
mod metrics;
mod options;
mod pose_path;
mod recorded;
mod route;
mod saved;
mod scenario;
mod simulation;
mod state;
mod tracking;
mod trajectory;

pub use actors::{Leader, idm_step};
pub use ego::{LocalPath, LocalPathError};
pub use error::SimError;
pub use metrics::{Collision, CollisionKind, Comfort, Deviation, Metrics, OffRoad, Range};
pub use options::{ActorPolicy, EgoPolicy, Rates, SimOptions, Tracking};
pub use saved::SavedState;
pub use scenario::{Scenario, scene_state};
pub use simulation::{EndReason, Simulation, StepOutcome};
pub use state::{
    Committed, EGO_SIZE_M, EgoState, Forecast, Instant, REAR_AXLE_TO_CENTER_M, SimActor, WHEELBASE_M,
};
pub use trajectory::{Trajectory, Waypoint};

pub use crate::peer::{PeerAddress as PlannerAddress, PeerError as PlannerError, PeerSpec as PlannerSpec};
