use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::TemplateKind;
use crate::cloud::Bounds;

/// How templates are made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TemplateOptions {
    /// Clusters are split until their members' sizes deviate by at most this share of the size (root mean square
    /// along each axis) ...
    pub size_spread: f64,
    /// ... or there are this many clusters of a category.
    pub max_clusters: usize,
    /// Points that a template would have if it covered its box; this sets its spacing.
    pub target_points: usize,
    /// The spacing is widened until there are at most this many points.
    pub max_points: usize,
    /// A template with fewer points is left out.
    pub min_points: usize,
    /// A point stays if this many others ...
    pub neighbours: usize,
    /// ... are within so many spacings of it.
    pub neighbour_spacings: f64,
    /// Where this many actors of a kind were seen well, a point stays only if another actor has points near it: what belongs
    /// to one alone (a ladder, a branch beside it) is no part of the kind. `None` keeps such points.
    pub agree_from_actors: Option<usize>,
}

impl Default for TemplateOptions {
    fn default() -> Self {
        Self {
            size_spread: 0.06,
            max_clusters: 8,
            target_points: 20_000,
            max_points: 50_000,
            min_points: 1000,
            neighbours: 8,
            neighbour_spacings: 2.5,
            agree_from_actors: Some(4),
        }
    }
}

impl TemplateOptions {
    /// Distance between the points of a template, metres, such that `target_points` cover its box: points that are packed at
    /// random no nearer than `s` to each other have about `0.7 / s²` a square metre.
    pub fn spacing_m(&self, size_m: DVec3) -> f64 {
        let area_m2 = 2.0 * (size_m.x * size_m.y + size_m.y * size_m.z + size_m.z * size_m.x);
        (0.7 * area_m2 / self.target_points.max(1) as f64).sqrt().clamp(0.005, 0.2)
    }
}

/// What templates were made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TemplateReport {
    /// In the order of their kinds.
    pub templates: Vec<TemplateSummary>,
    /// What was left out, by reason, with counts.
    pub notes: BTreeMap<String, usize>,
}

/// What one template was made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TemplateSummary {
    /// Kind.
    pub kind: TemplateKind,
    /// Clusters of the kind.
    pub clusters: Vec<ClusterReport>,
    /// Assets of the clusters that were used.
    pub instances: usize,
    /// Points of these assets as given.
    pub points_in: usize,
    /// Points taken off since few others are near.
    pub outliers: usize,
    /// Points taken off since no other actor has any near.
    pub not_agreed: usize,
    /// Points of the template; 0 where it was left out for having too few.
    pub points: usize,
    /// Distance between them, metres.
    pub spacing_m: f64,
    /// The box that all were scaled to: the mean length, width, height, metres.
    pub size: [f64; 3],
    /// Of the points, metres; `None` without points.
    pub bounds: Option<Bounds>,
}

/// Actors of about one size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClusterReport {
    /// Whether the template was made of it: all clusters of cars, people and cycles are laid over each other; of trucks, buses
    /// and the like, which differ more, only the one with the most actors.
    pub used: bool,
    /// Mean length, width, height, metres.
    pub size: [f64; 3],
    /// `LOG/TRACK`, in the order given.
    pub members: Vec<String>,
    /// Points of the members as given.
    pub points_in: usize,
}
