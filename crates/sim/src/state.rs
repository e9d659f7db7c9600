use glam::{DVec2, DVec3};
use point_skeleton::dataset::{TrackBox, TrafficLight};
use point_skeleton::geometry::{Cuboid, Pose};
use point_skeleton::scene::SceneState;

use super::SimError;

/// Simulated past: a committed state, or a value derived from committed states.
///
/// A forecast cannot take its place:
///
/// ```compile_fail,E0308
/// use pskel_sim::{Committed, Forecast, Instant};
/// fn happened(expected: Forecast<Instant>) -> Committed<Instant> {
///     expected
/// }
/// ```
///
/// Nor can code outside a simulation create one:
///
/// ```compile_fail,E0624
/// use pskel_sim::{Committed, Forecast, Instant};
/// fn happened(expected: Forecast<Instant>) -> Committed<Instant> {
///     Committed::new(expected.get().clone())
/// }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Committed<T>(T);

/// Predicted value: computed anew at each step and never part of the state.
#[derive(Clone, Debug, PartialEq)]
pub struct Forecast<T>(T);

/// State of ego and actors at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Instant {
    /// Number of simulation steps since the start.
    pub step: usize,
    /// Absolute time, microseconds.
    pub t_us: i64,
    /// State of the ego.
    pub ego: EgoState,
    /// Actors, sorted by track.
    pub actors: Vec<SimActor>,
    /// Traffic light states by lane connector, from the log's last frame up to this time.
    pub lights: Vec<TrafficLight>,
}

/// Pose and motion of the ego.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EgoState {
    /// `global_from_ego`; the origin is the log's ego frame, taken as the center of the rear axle.
    pub pose: Pose,
    /// Speed along the heading, meters per second.
    pub speed_mps: f64,
    /// Acceleration along the heading, meters per second squared.
    pub acceleration_mps2: f64,
    /// Yaw rate to the left, radians per second.
    pub yaw_rate_radps: f64,
    /// Steering angle of the front wheels to the left, radians.
    pub steering_rad: f64,
}

/// Pose and motion of an actor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimActor {
    /// Index in [`Recording::tracks`](point_skeleton::dataset::Recording::tracks).
    pub track: usize,
    /// Bounding box in the global frame.
    pub cuboid: Cuboid,
    /// Speed along the heading, meters per second.
    pub speed_mps: f64,
    /// Speed across the heading, to the left, meters per second.
    pub lateral_mps: f64,
    /// Yaw rate to the left, radians per second.
    pub yaw_rate_radps: f64,
}

/// Length, width and height of the ego, a Chrysler Pacifica, meters. Source: nuPlan's vehicle parameters.
pub const EGO_SIZE_M: DVec3 = DVec3::new(5.176, 2.297, 1.777);
/// Distance from the ego's rear axle forward to the center of its box, meters.
pub const REAR_AXLE_TO_CENTER_M: f64 = 1.461;
/// Distance from the ego's rear axle to its front axle, meters.
pub const WHEELBASE_M: f64 = 3.089;

/// Returns the bounding box of the ego at a pose.
pub(super) fn ego_cuboid(pose: &Pose) -> Cuboid {
    let center = DVec3::new(REAR_AXLE_TO_CENTER_M, 0.0, EGO_SIZE_M.z / 2.0);
    let pose = Pose { rotation: pose.rotation, translation: pose.transform_point(center) };
    Cuboid { pose, size: EGO_SIZE_M }
}

impl EgoState {
    /// Returns the global yaw, radians.
    pub fn heading_rad(&self) -> f64 {
        self.pose.yaw_rad()
    }

    /// Returns the center of the rear axle in x and y, global meters.
    pub fn position_m(&self) -> DVec2 {
        self.pose.translation.truncate()
    }

    /// Returns the vehicle's bounding box.
    pub fn cuboid(&self) -> Cuboid {
        ego_cuboid(&self.pose)
    }
}

impl SimActor {
    /// Returns the velocity in global x and y, meters per second.
    pub fn velocity_mps(&self) -> DVec2 {
        DVec2::from_angle(self.cuboid.pose.yaw_rad()).rotate(DVec2::new(self.speed_mps, self.lateral_mps))
    }

    /// Returns the bounding box in the log's format.
    pub fn track_box(&self) -> TrackBox {
        TrackBox { track: self.track, cuboid: self.cuboid }
    }
}

/// Simulation of another program, which commits its states one after another.
#[derive(Clone, Debug, Default)]
pub struct OtherSimulation {
    last_us: Option<i64>,
}

impl OtherSimulation {
    /// Marks the next state as committed.
    ///
    /// # Errors
    /// Fails if its time is not after that of the last one.
    pub fn commit(&mut self, state: SceneState) -> Result<Committed<SceneState>, SimError> {
        if let Some(last_us) = self.last_us.filter(|last_us| state.t_us <= *last_us) {
            return Err(SimError::Earlier { last_us, found_us: state.t_us });
        }
        self.last_us = Some(state.t_us);
        Ok(Committed(state))
    }
}

impl<T> Committed<T> {
    /// Marks a value as committed; only the simulation may do so.
    pub(super) fn new(value: T) -> Self {
        Self(value)
    }

    /// Returns the committed value.
    pub fn get(&self) -> &T {
        &self.0
    }

    /// Returns the value, which no longer counts as committed.
    pub(super) fn into_inner(self) -> T {
        self.0
    }

    /// Derives a committed value from this one.
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Committed<U> {
        Committed(f(self.0))
    }

    /// Derives a committed value from this one by a fallible function.
    ///
    /// # Errors
    /// Returns any error of `f`.
    pub fn try_map<U, E>(self, f: impl FnOnce(T) -> Result<U, E>) -> Result<Committed<U>, E> {
        f(self.0).map(Committed)
    }

    /// Returns a committed reference to the value.
    pub fn as_ref(&self) -> Committed<&T> {
        Committed(&self.0)
    }
}

impl<T> Forecast<T> {
    /// Marks a value as predicted.
    pub fn new(value: T) -> Self {
        Self(value)
    }

    /// Returns the predicted value.
    pub fn get(&self) -> &T {
        &self.0
    }

    /// Derives a predicted value from this one.
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Forecast<U> {
        Forecast(f(self.0))
    }

    /// Returns a predicted reference to the value.
    pub fn as_ref(&self) -> Forecast<&T> {
        Forecast(&self.0)
    }
}
