use serde::{Deserialize, Serialize};

use crate::dataset::Appearance;

/// One change of one actor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Change {
    /// Track id: a new one for [`Action::Insert`], otherwise one of the log or an inserted one.
    pub track: String,
    /// What changes.
    pub action: Action,
    /// Begin; by default the first frame of the log.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<When>,
    /// End, after which the actor is where it would be without the change; by default never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end: Option<When>,
}

/// What a change does. Later changes of a track apply on top of earlier ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Action {
    /// A new actor stands at a place.
    Insert(Insert),
    /// The actor is gone.
    Remove,
    /// The actor stands at a place.
    Move(Place),
    /// The actor keeps its motion, displaced in its own frame.
    Shift(Shift),
    /// The actor follows a path.
    Path(Path),
    /// The actor follows its path by the Intelligent Driver Model; in simulations alone.
    Idm,
    /// The actor has another length, width and height on the same ground, meters. It moves as without this.
    Resize([f64; 3]),
    /// The actor looks like another track of the log, with its size, or like the template of its category. It
    /// moves as without this. Begin and end are times.
    Replace(Appearance),
}

/// A new actor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Insert {
    /// Dotted category as in nuScenes, like `vehicle.car`; that of the track whose points it has, if there is
    /// one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
    /// Length, width and height, meters; the track's whose points it has, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size_m: Option<[f64; 3]>,
    /// Where it stands.
    pub at: Place,
}

/// Place on the ground: the recorded ego path beside it gives the height.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Frame of the coordinates.
    #[serde(rename = "in")]
    pub anchor: Anchor,
    /// Center of the box: global x, or forward, meters.
    pub x_m: f64,
    /// Center of the box: global y, or to the left, meters.
    pub y_m: f64,
    /// Heading, to the left of the frame's x axis, degrees.
    #[serde(default)]
    pub yaw_deg: f64,
}

/// Frame of a place or path. Only the heading of ego and actor counts, not their tilt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Anchor {
    /// Global frame of the log.
    Global,
    /// Frame of the recorded ego at a time.
    Ego(Time),
    /// The actor's box, without this change, at its start.
    Actor,
}

/// Displacement of an actor in its own frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Shift {
    /// Forward, meters.
    pub forward_m: f64,
    /// To the left, meters.
    pub left_m: f64,
    /// Up, meters.
    pub up_m: f64,
    /// Rotation to the left, degrees.
    pub yaw_deg: f64,
}

/// Path with speeds; beyond its last point it continues straight, at the last speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Path {
    /// Frame of the points.
    #[serde(rename = "in")]
    pub anchor: Anchor,
    /// At least two points; the actor is at the first one at the start.
    pub points: Vec<PathPoint>,
}

/// Point of a path. The acceleration between two points is constant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathPoint {
    /// Center of the box, meters.
    pub x_m: f64,
    /// Center of the box, meters.
    pub y_m: f64,
    /// Speed there, meters per second, at least 0; of two consecutive points at most one is 0.
    pub speed_mps: f64,
}

/// Time of a log.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// Absolute microseconds.
    TUs(i64),
    /// Seconds after the first frame.
    AfterS(f64),
}

/// Begin or end of a change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// Absolute microseconds.
    TUs(i64),
    /// Seconds after the first frame of the log.
    AfterS(f64),
    /// As soon as the ego is near something.
    EgoWithin(EgoWithin),
}

/// Condition: the ego's origin is near an actor or a point, in x and y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EgoWithin {
    /// Maximum distance from the center of the actor's box, or from the point, meters.
    pub distance_m: f64,
    /// Actor; by default the changed one, for [`Action::Insert`] the place where it is to stand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub track: Option<String>,
    /// Point instead of an actor, global meters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_m: Option<[f64; 2]>,
}
