use glam::{DVec2, DVec3};

use crate::dataset::{TrackBox, TrafficLight};
use crate::geometry::{Cuboid, Pose};

/// What has happened: states, and whatever is made of them.
///
/// A forecast is none:
///
/// ```compile_fail,E0308
/// use point_skeleton::sim::{Committed, Forecast, Instant};
/// fn happened(expected: Forecast<Instant>) -> Committed<Instant> {
///     expected
/// }
/// ```
///
/// Nor can anybody else say that it has happened:
///
/// ```compile_fail,E0624
/// use point_skeleton::sim::{Committed, Forecast, Instant};
/// fn happened(expected: Forecast<Instant>) -> Committed<Instant> {
///     Committed::new(expected.get().clone())
/// }
/// ```
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
    /// What traffic lights show, by lane connector: as in the log's last frame until then.
    pub lights: Vec<TrafficLight>,
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

/// Length, width and height of the ego, a Chrysler Pacifica, metres. Source: nuPlan's vehicle parameters.
pub const EGO_SIZE_M: DVec3 = DVec3::new(5.176, 2.297, 1.777);
/// From the ego's rear axle forward to the centre of its box, metres.
pub const REAR_AXLE_TO_CENTER_M: f64 = 1.461;
/// From the ego's rear axle to its front axle, metres.
pub const WHEELBASE_M: f64 = 3.089;

impl EgoState {
    /// Its yaw, radians.
    pub fn heading_rad(&self) -> f64 {
        self.pose.yaw_rad()
    }

    /// The middle of the rear axle seen from above, global metres.
    pub fn position_m(&self) -> DVec2 {
        self.pose.translation.truncate()
    }

    /// The box around the vehicle.
    pub fn cuboid(&self) -> Cuboid {
        let center = DVec3::new(REAR_AXLE_TO_CENTER_M, 0.0, EGO_SIZE_M.z / 2.0);
        let pose = Pose { rotation: self.pose.rotation, translation: self.pose.transform_point(center) };
        Cuboid { pose, size: EGO_SIZE_M }
    }
}

impl SimActor {
    /// As a log has it.
    pub fn track_box(&self) -> TrackBox {
        TrackBox { track: self.track, cuboid: self.cuboid }
    }
}

impl<T> Committed<T> {
    /// Says that something has happened: for the loop alone.
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

    /// What is made of it, if it can be made, has happened as well.
    ///
    /// # Errors
    /// Those of making it.
    pub fn try_map<U, E>(self, f: impl FnOnce(T) -> Result<U, E>) -> Result<Committed<U>, E> {
        f(self.0).map(Committed)
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
