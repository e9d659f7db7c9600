//! Committed state between two steps: the instant, actors under a policy, and the ego on the recorded path.

use point_skeleton::geometry::LineProjection;

use super::Instant;
use super::actors::ControlledActors;

/// Committed state that the next step depends on.
#[derive(Clone, Debug)]
pub(super) struct World {
    pub(super) instant: Instant,
    pub(super) driven: ControlledActors,
    /// Projection of the ego onto the recorded path.
    pub(super) projection: LineProjection,
}
