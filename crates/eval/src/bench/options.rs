use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::DatasetError;
use point_skeleton::error::FileError;
use point_skeleton::raster::{RasterError, RasterizerDesc};

/// Options of a measurement.
#[derive(Clone, Debug)]
pub struct BenchOptions {
    /// Rasterizer and device.
    pub rasterizer: RasterizerDesc,
    /// Maps, sizes and splat radii. With layouts or tensors, the frames of a log are rendered as whole steps.
    pub conditions: ConditionOptions,
    /// Number of untimed frames at the start.
    pub warm_up: usize,
    /// Number of timed passes over the frames of the workload.
    pub repeat: usize,
    /// Frames in flight; at least 1, at most [`point_skeleton::raster::FRAMES_IN_FLIGHT`].
    pub in_flight: usize,
}

impl BenchOptions {
    /// Returns the number of frames to render of a workload with `count` frames, without those that only keep
    /// the device busy at the end.
    pub fn frames(&self, count: usize) -> usize {
        self.warm_up + self.repeat * count
    }

    /// Returns whether maps are requested that only whole steps of a log have: layouts or tensors.
    pub fn has_whole_steps(maps: MapSet) -> bool {
        [MapKind::Boxes, MapKind::Map, MapKind::Tensor].into_iter().any(|kind| maps.contains(kind))
    }
}

/// Error of a measurement.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The HD map cannot be read.
    #[error("{0}")]
    Log(#[from] DatasetError),
    /// Points of a skeleton are damaged, or a trace cannot be written.
    #[error("{0}")]
    File(#[from] FileError),
    /// The rasterizer cannot be created.
    #[error("{0}")]
    Raster(#[from] RasterError),
    /// The drive is shorter.
    #[error("expected frames within 0..{frames}, the drive through this location, found ..{found}")]
    NoFrames {
        /// End of the frames.
        found: usize,
        /// Number of frames in the drive.
        frames: usize,
    },
    /// No frame has cameras.
    #[error("expected frames with cameras in log {log}, found none among {frames} frames")]
    NoCameras {
        /// Name of the log.
        log: String,
        /// Number of frames.
        frames: usize,
    },
    /// The renderer cannot be created, or a frame cannot be rendered.
    #[error("cannot draw the frames")]
    Render(#[source] point_skeleton::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_and_tensors_need_whole_steps() {
        for (maps, whole) in [("color,point", false), ("map", true), ("depth,boxes", true), ("tensor", true)]
        {
            assert_eq!(BenchOptions::has_whole_steps(maps.parse().unwrap()), whole, "{maps}");
        }
    }
}
