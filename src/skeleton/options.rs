use serde::{Deserialize, Serialize};

use super::SplitOptions;

/// How a skeleton is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BuildOptions {
    /// Side of the voxels that points are merged in, metres; 0 keeps all points.
    pub voxel_m: f64,
    /// How points are told apart.
    pub split: SplitOptions,
    /// How points get their color.
    pub coloring: Coloring,
    /// Frames before and after a point's own whose images may color it.
    pub color_window: usize,
    /// Whether a view must pass the occlusion test.
    pub occlusion_test: bool,
    /// Frames before and after an image's whose points may hide others in it.
    pub occlusion_window: usize,
    /// Also use the sweeps between annotated frames, with boxes in between.
    pub between_sweeps: bool,
}

/// How points get their color.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Coloring {
    /// One color, from the camera with the best view: of those that pass an occlusion test the one that the others
    /// agree with most.
    BestView,
    /// A copy of the point for every camera of its frame that it projects into, hidden or not (for comparison: what
    /// existing scripts do).
    EveryCamera,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            voxel_m: 0.01,
            split: SplitOptions::default(),
            coloring: Coloring::BestView,
            color_window: 8,
            occlusion_test: true,
            occlusion_window: 4,
            between_sweeps: false,
        }
    }
}

impl BuildOptions {
    /// What existing scripts do, for comparison: color from every camera that sees a point, no occlusion test, all
    /// copies kept, boxes grown by 0.5 m.
    pub fn every_camera() -> Self {
        let split = SplitOptions {
            margin_m: 0.5,
            ghost_window_s: [0.0; 2],
            ego_clearance_m: 0.0,
            every_lidar: true,
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
