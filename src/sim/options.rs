use serde::Serialize;

use super::{LocalPath, PlannerSpec};

/// What a rollout is to do.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SimOptions {
    /// Told to planners; no policy of ours draws numbers.
    pub seed: u64,
    /// How many steps to take from the start, at least 1; the steps of the warm-up count.
    pub steps: usize,
    /// Steps a second; `None`: as [`Rates`] of the log.
    pub sim_hz: Option<f64>,
    /// Plans a second, which divide the steps; `None`: as [`Rates`] of the log.
    pub plan_hz: Option<f64>,
    /// Every so many-th frame of the log, from the start on, is a step and a plan, instead of rates: for an ego and actors
    /// that follow the log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every_frames: Option<usize>,
    /// Frames of a generator's window that follow the log, one a plan: the first `(N - 1) * sim_hz / plan_hz` steps do.
    pub warmup_frames: usize,
    /// When to start, absolute microseconds; `None`: at the log's first frame.
    pub start_us: Option<i64>,
    /// Who drives the ego after the warm-up.
    pub ego: EgoPolicy,
    /// How the ego follows what was planned.
    pub tracking: Tracking,
    /// Who moves the others after the warm-up.
    pub actors: ActorPolicy,
}

impl Default for SimOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            steps: 1,
            sim_hz: None,
            plan_hz: None,
            every_frames: None,
            warmup_frames: 1,
            start_us: None,
            ego: EgoPolicy::Replay,
            tracking: Tracking::Perfect,
            actors: ActorPolicy::Replay,
        }
    }
}

/// Who drives the ego.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EgoPolicy {
    /// The log.
    Replay,
    /// Straight on.
    Straight,
    /// Aims to the right, more and more with every plan.
    RightThenBack,
    /// Aims 1.5 m to the right along half a wave of a cosine.
    Cosine,
    /// One lane to the right of the recorded path, at 10 m/s.
    LaneChange,
    /// Along points of a file.
    File(LocalPath),
    /// As another process says.
    External(PlannerSpec),
}

/// How the ego follows a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Tracking {
    /// It is where the plan says.
    #[default]
    Perfect,
    /// A kinematic bicycle with limits steers after the plan.
    Bicycle,
}

/// Who moves the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ActorPolicy {
    /// The log.
    #[default]
    Replay,
    /// Vehicles and cycles near the ego follow their recorded paths by the Intelligent Driver Model; others the log.
    Idm,
    /// Everybody near the ego but objects keeps speed and curve, and brakes for what is in front.
    Reactive,
}

/// How often there is a step and a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Steps a second.
    pub sim_hz: f64,
    /// Plans a second.
    pub plan_hz: f64,
}

impl Rates {
    /// Of nuScenes.
    pub const NUSCENES: Self = Self { sim_hz: 12.0, plan_hz: 2.0 };
}

impl Default for Rates {
    /// Of nuPlan, and of any other log.
    fn default() -> Self {
        Self { sim_hz: 10.0, plan_hz: 5.0 }
    }
}
