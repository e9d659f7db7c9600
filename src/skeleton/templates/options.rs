use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::TemplateKind;
use crate::cloud::Bounds;

/// Options for generating templates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TemplateOptions {
    /// Clusters are split until their members' sizes have at most this relative deviation (root mean square
    /// along each axis) ...
    pub size_spread: f64,
    /// ... or a category has this many clusters.
    pub max_clusters: usize,
    /// Point count of a template that covers its box; determines its spacing.
    pub target_points: usize,
    /// Maximum number of points; the spacing is widened to satisfy it.
    pub max_points: usize,
    /// Minimum number of points; smaller templates are dropped.
    pub min_points: usize,
    /// Number of neighbors that a point requires ...
    pub neighbours: usize,
    /// ... within this many spacings.
    pub neighbour_spacings: f64,
    /// Minimum number of well-observed actors of a kind for a point to require points of another actor
    /// nearby. Features of a single actor (a ladder, a branch beside it) are not part of the kind. `None`
    /// retains them.
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
    /// Returns the distance between the points of a template, meters, at which `target_points` cover its box.
    /// Points packed at random with a minimum distance `s` have a density of about `0.7 / s²` per square
    /// meter.
    pub fn spacing_m(&self, size_m: DVec3) -> f64 {
        let area_m2 = 2.0 * (size_m.x * size_m.y + size_m.y * size_m.z + size_m.z * size_m.x);
        (0.7 * area_m2 / self.target_points.max(1) as f64).sqrt().clamp(0.005, 0.2)
    }
}

/// Report on the generation of templates.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TemplateReport {
    /// Summaries, in the order of kinds.
    pub templates: Vec<TemplateSummary>,
    /// Dropped items: reasons with counts.
    pub notes: BTreeMap<String, usize>,
}

/// Report on one template.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TemplateSummary {
    /// Kind of the template.
    pub kind: TemplateKind,
    /// Clusters of the kind.
    pub clusters: Vec<ClusterReport>,
    /// Number of assets in the used clusters.
    pub instances: usize,
    /// Point count of these assets before thinning.
    pub points_in: usize,
    /// Number of points removed for lack of neighbors.
    pub outliers: usize,
    /// Number of points removed because no other actor has points nearby.
    pub not_agreed: usize,
    /// Point count of the template; 0 if it was dropped for having too few.
    pub points: usize,
    /// Distance between the points, meters.
    pub spacing_m: f64,
    /// Box that all assets were scaled to: mean length, width, height, meters.
    pub size: [f64; 3],
    /// Bounds of the points, meters; `None` without points.
    pub bounds: Option<Bounds>,
}

/// Cluster of actors with similar sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClusterReport {
    /// Whether the template uses the cluster. Cars, people and cycles use all clusters. Trucks, buses and the
    /// like differ more, so only the cluster with the most actors is used.
    pub used: bool,
    /// Mean length, width, height, meters.
    pub size: [f64; 3],
    /// Members as `LOG/TRACK`, in input order.
    pub members: Vec<String>,
    /// Point count of the members before thinning.
    pub points_in: usize,
}
