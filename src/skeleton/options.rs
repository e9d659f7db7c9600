use serde::{Deserialize, Serialize};

use super::{CHUNK_M, SplitOptions};
use crate::{named, named_in_files};

/// Options for building a skeleton.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BuildOptions {
    /// Side of the voxels that merge points, meters; 0 retains all points.
    pub voxel_m: f64,
    /// The same for actor points; `None` for the background's.
    #[serde(default)]
    pub actor_voxel_m: Option<f64>,
    /// Options for separating background and actors.
    pub split: SplitOptions,
    /// Method of coloring points.
    pub coloring: Coloring,
    /// Number of frames before and after a point's own whose images may color it.
    pub color_window: usize,
    /// Whether a view must pass the occlusion test.
    pub occlusion_test: bool,
    /// Number of frames before and after an image's whose points may occlude others in it.
    pub occlusion_window: usize,
    /// Also uses the sweeps between annotated frames, with interpolated boxes.
    pub between_sweeps: bool,
}

/// Method of coloring points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coloring {
    /// One color, on which the views that pass an occlusion test agree: their robust mean.
    Agreed,
    /// One copy of the point for every camera of its frame that it projects into, occluded or not. For
    /// comparison: the behavior of existing scripts.
    EveryCamera,
}

named!(Coloring, "coloring" {
    Agreed => "agreed",
        "One color, on which the images that see the point agree: the robust mean of the views that pass an \
        occlusion test";
    EveryCamera => "every-camera",
        "One copy of the point for every camera of its frame that it projects into, occluded or not. For \
        comparison: the behavior of existing scripts";
});
named_in_files!(Coloring, "best-view" => Agreed);

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            voxel_m: 0.01,
            actor_voxel_m: None,
            split: SplitOptions::default(),
            coloring: Coloring::Agreed,
            color_window: 16,
            occlusion_test: true,
            occlusion_window: 4,
            between_sweeps: false,
        }
    }
}

impl BuildOptions {
    /// Returns whether a voxel may have this side: 0, which keeps all points, or a side that 21 bits can
    /// count within a chunk and that is not larger than a chunk, meters.
    pub fn is_voxel_m(side_m: f64) -> bool {
        side_m == 0.0 || (1e-4..=CHUNK_M).contains(&side_m)
    }

    /// Returns the defaults for a method of coloring.
    pub fn of(coloring: Coloring) -> Self {
        match coloring {
            Coloring::Agreed => Self::default(),
            Coloring::EveryCamera => Self::every_camera(),
        }
    }

    /// Returns the behavior of existing scripts, for comparison: colors from every camera that sees a point,
    /// no occlusion test, all copies retained, boxes grown by 0.5 m.
    pub fn every_camera() -> Self {
        let split = SplitOptions {
            margin_m: 0.5,
            ghost_window_s: [0.0; 2],
            ego_clearance_m: 0.0,
            primary_lidar: None,
            ..SplitOptions::default()
        };
        Self {
            voxel_m: 0.0,
            split,
            coloring: Coloring::EveryCamera,
            color_window: 0,
            occlusion_test: false,
            ..Self::default()
        }
    }
}
