//! The splat rasterizers: one interface, exact twins behind it.
//!
//! # How it works
//! A rasterizer is made once from all clouds of a scene ([`CloudSet`]), which then stay resident. Per frame and
//! view only [`Instance`]s (which cloud stands where) and the camera change. [`draws_from_job`] turns them into
//! [`Draw`]s: `f32` matrices multiplied out in `f64`, culled by bounds. Every rasterizer takes the same draws and
//! does the same `f32` operations in the same order, so the maps agree to the pixel.

mod compute;
pub mod cpu;
mod draw;
mod frame;
mod frames;
mod kind;
mod line_test;
mod lines;
mod maps;
mod pages;
mod plane;
pub mod reduce;
mod resolve;
mod schedule;
mod splat;
mod steps;
pub(crate) mod tiles;
mod vulkan;

pub use compute::{ComputeRasterizer, ComputeRasterizerDesc};
pub use draw::{Crop, Draw, Instance, SplatJob, draws_from_job};
pub use frame::{FrameJob, FrameKinds, FrameMaps, Occlusion, ViewMaps, class_of, rgb_of};
pub use kind::{RasterizerDesc, RasterizerKind, UnknownRasterizer, create};
pub use lines::{LineRows, draw_lines};
pub use maps::{Planes, Segment, SplatMaps, StageTimes};
pub use plane::Plane;
pub use schedule::{ScheduleError, SplatSchedule, SplatStep};
pub use vulkan::{VulkanRasterizer, VulkanRasterizerDesc};

use crate::cloud::Point;

/// All clouds that a rasterizer holds, in the order of their ids.
pub type CloudSet<'a> = Vec<&'a [Point]>;

/// What went wrong while drawing.
#[derive(Debug, thiserror::Error)]
pub enum RasterError {
    /// The device or driver.
    #[error(transparent)]
    Gpu(#[from] crate::gpu::GpuError),
    /// More points than an index of 32 bits can tell apart.
    #[error("expected at most {max} points in one job, found {found}")]
    TooManyPoints {
        /// Points asked for.
        found: u64,
        /// 2³² − 2.
        max: u64,
    },
    /// A row of an image that no buffer of the device holds.
    #[error("expected images that the device can hold a row of, found {width} pixels in a row")]
    TooWide {
        /// Pixels.
        width: u32,
    },
    /// [`Rasterizer::begin`] without [`Rasterizer::finish`], too often.
    #[error("expected at most {max} frames in flight, found one more")]
    TooManyFrames {
        /// [`FRAMES_IN_FLIGHT`].
        max: usize,
    },
    /// [`Rasterizer::finish`] without [`Rasterizer::begin`].
    #[error("expected a frame in flight, found none")]
    NoFrame,
    /// An instance names a cloud that was never uploaded.
    #[error("expected a cloud id below {clouds}, found {cloud}")]
    UnknownCloud {
        /// The id.
        cloud: usize,
        /// How many there are.
        clouds: usize,
    },
}

/// What draws: the device and driver, for reports.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RasterizerInfo {
    /// `compute`, `raster` or `cpu`.
    pub rasterizer: &'static str,
    /// Device name.
    pub device: String,
    /// Driver name and version.
    pub driver: String,
}

impl RasterizerInfo {
    fn on(rasterizer: &'static str, device: &crate::gpu::Device) -> Self {
        Self { rasterizer, device: device.name().to_owned(), driver: device.driver().to_owned() }
    }
}

/// How many frames may be begun before the first of them is finished.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// Splats resident clouds.
pub trait Rasterizer {
    /// Which rasterizer, device and driver this is.
    fn info(&self) -> RasterizerInfo;

    /// Begins a frame: all views of the job. The device may work on it until [`Rasterizer::finish`] asks for it.
    ///
    /// # Errors
    /// The device's, an unknown cloud, more than 2³² − 2 points, more than [`FRAMES_IN_FLIGHT`] frames.
    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError>;

    /// Waits for the oldest frame that was begun. Its maps are borrowed until something else is asked for.
    ///
    /// # Errors
    /// The device's, no frame in flight.
    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError>;

    /// Draws one cloud into one view at its full size by the splat rule. Planes that were not asked for are empty.
    ///
    /// # Errors
    /// The device's, an unknown cloud, more than 2³² − 2 points.
    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError>;

    /// Times of the stages since they were last taken, to which others may be added.
    fn stages(&mut self) -> &mut StageTimes;

    /// Times of the stages, summed since the last call.
    fn take_stages(&mut self) -> StageTimes {
        std::mem::take(self.stages())
    }
}
