//! Condition of a frame, and the parts of it that can be dropped.

use serde::{Deserialize, Serialize};

/// Condition of a frame, in the form that a network takes.
pub trait Condition: Clone {
    /// Returns the condition with parts dropped, for training and guidance.
    fn without(&self, dropped: DroppedConditions) -> Self;
}

/// Conditions that are dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DroppedConditions {
    /// Boxes and map.
    pub layout: bool,
    /// Ego motion and text prompt.
    pub action: bool,
    /// Color of the points.
    pub color: bool,
    /// Depth of the points.
    pub depth: bool,
}

impl DroppedConditions {
    /// Dropped in the unconditional prediction of guidance: layout and action, not color and depth.
    pub const GUIDED: Self = Self { layout: true, action: true, color: false, depth: false };
    /// All conditions.
    pub const ALL: Self = Self { layout: true, action: true, color: true, depth: true };

    /// Union of two sets.
    pub fn or(self, other: Self) -> Self {
        Self {
            layout: self.layout || other.layout,
            action: self.action || other.action,
            color: self.color || other.color,
            depth: self.depth || other.depth,
        }
    }
}
