//! The splat rasterizers: one interface, exact twins behind it.
//!
//! # How it works
//! A rasterizer is made once from all clouds of a scene ([`CloudSet`]), which then stay resident. Per frame and
//! view only [`Instance`]s (which cloud stands where) and the camera change. [`draws_from_job`] turns them into
//! [`Draw`]s: `f32` matrices multiplied out in `f64`, culled by bounds. Every rasterizer takes the same draws and
//! does the same `f32` operations in the same order, so the maps agree to the pixel.

pub mod cpu;
mod draw;
mod kind;
mod line;
mod line_test;
mod maps;
mod pages;
mod resolve;
mod schedule;
mod splat;
mod tiles;
mod vulkan;

pub use draw::{Crop, Draw, Instance, SplatJob, draws_from_job};
pub use kind::{RasterizerKind, UnknownRasterizer, create};
pub use maps::{Planes, Segment, SplatMaps, StageTimes};
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
    /// `raster` or `cpu`.
    pub rasterizer: &'static str,
    /// Device name.
    pub device: String,
    /// Driver name and version.
    pub driver: String,
}

/// Splats resident clouds, and draws lines, into one view at a time.
pub trait Rasterizer {
    /// Which rasterizer, device and driver this is.
    fn info(&self) -> RasterizerInfo;

    /// Draws the job's instances by the splat rule. Maps have the size of the job's camera; planes that were not
    /// asked for are empty.
    ///
    /// # Errors
    /// The device's, an unknown cloud, more than 2³² − 2 points.
    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError>;

    /// Draws segments `width_px` wide, later over earlier, on black: `height * width` RGB pixels. A pixel is
    /// covered when its centre lies in the segment's rectangle (butt ends).
    ///
    /// # Errors
    /// The device's.
    fn lines(
        &mut self,
        height: u32,
        width: u32,
        segments: &[Segment],
        width_px: f32,
    ) -> Result<Vec<[u8; 3]>, RasterError>;

    /// Times of the stages, summed since the last call.
    fn take_stages(&mut self) -> StageTimes;
}
