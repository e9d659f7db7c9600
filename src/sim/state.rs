use crate::geometry::{Cuboid, Pose};

/// What has happened: states, and whatever is made of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Committed<T>(T);

/// What is expected to happen: it is made anew at each step and never enters the state.
#[derive(Clone, Debug, PartialEq)]
pub struct Forecast<T>(T);

/// Everybody at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Instant {
    /// Number of simulation steps since the start.
    pub step: usize,
    /// Absolute microseconds.
    pub t_us: i64,
    /// The ego.
    pub ego: EgoState,
    /// Sorted by track.
    pub actors: Vec<SimActor>,
}

/// How the ego moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EgoState {
    /// `global_from_ego`; the origin is that of the log's ego frame, which counts as the middle of the rear axle.
    pub pose: Pose,
    /// Along the heading, metres per second.
    pub speed_mps: f64,
    /// Along the heading, metres per second squared.
    pub acceleration_mps2: f64,
    /// To the left, radians per second.
    pub yaw_rate_radps: f64,
    /// Of the front wheels to the left, radians.
    pub steering_rad: f64,
}

/// How somebody else moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimActor {
    /// Index in [`Log::tracks`](crate::dataset::Log::tracks).
    pub track: usize,
    /// Where it stands, global.
    pub cuboid: Cuboid,
    /// Along the heading, metres per second.
    pub speed_mps: f64,
}

impl<T> Committed<T> {
    /// Says that something has happened: for the loop alone.
    #[expect(dead_code, reason = "the loop comes with the next change")]
    pub(super) fn new(value: T) -> Self {
        Self(value)
    }

    /// What has happened.
    pub fn get(&self) -> &T {
        &self.0
    }

    /// What is made of it has happened as well.
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Committed<U> {
        Committed(f(self.0))
    }

    /// The same by reference.
    pub fn as_ref(&self) -> Committed<&T> {
        Committed(&self.0)
    }
}

impl<T> Forecast<T> {
    /// Something expected.
    pub fn new(value: T) -> Self {
        Self(value)
    }

    /// What is expected.
    pub fn get(&self) -> &T {
        &self.0
    }

    /// What is made of it is only expected as well.
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Forecast<U> {
        Forecast(f(self.0))
    }

    /// The same by reference.
    pub fn as_ref(&self) -> Forecast<&T> {
        Forecast(&self.0)
    }
}
