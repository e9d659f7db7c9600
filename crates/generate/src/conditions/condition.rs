//! Condition of a frame, and the parts of it that can be dropped.

use point_skeleton::named;
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

/// Choice of the conditions that guidance drops.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GuidedConditions {
    /// Layout and action: [`DroppedConditions::GUIDED`].
    #[default]
    Layout,
    /// All conditions.
    All,
}

named!(GuidedConditions, "conditions of the guidance" {
    Layout => "layout", "Drops layout, text and action";
    All => "all", "Drops all conditions";
});

/// Condition of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConditionKind {
    /// Boxes and map.
    Layout,
    /// Ego motion and text prompt.
    Action,
    /// Color of the points.
    Color,
    /// Depth of the points.
    Depth,
}

named!(ConditionKind, "condition" {
    Layout => "layout", "Boxes and HD map";
    Action => "action", "Ego motion and text";
    Color => "color", "Color of the points";
    Depth => "depth", "Depth of the points";
});

impl FromIterator<ConditionKind> for DroppedConditions {
    fn from_iter<I: IntoIterator<Item = ConditionKind>>(kinds: I) -> Self {
        kinds.into_iter().fold(Self::default(), |dropped, kind| match kind {
            ConditionKind::Layout => Self { layout: true, ..dropped },
            ConditionKind::Action => Self { action: true, ..dropped },
            ConditionKind::Color => Self { color: true, ..dropped },
            ConditionKind::Depth => Self { depth: true, ..dropped },
        })
    }
}

impl From<GuidedConditions> for DroppedConditions {
    fn from(guided: GuidedConditions) -> Self {
        match guided {
            GuidedConditions::Layout => Self::GUIDED,
            GuidedConditions::All => Self::ALL,
        }
    }
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
