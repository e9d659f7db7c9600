//! The splat rasterizers: one interface, implementations with identical output.
//!
//! # How it works
//! A rasterizer is created once from all clouds of a scene ([`CloudSet`]). Their chunks are loaded when a
//! camera may see them, and stay while memory lasts (`residency`). Per frame and view only the camera and the
//! [`Instance`]s (posed clouds) change. [`Draw`]s contain their poses and projections as `f32` matrices
//! multiplied out in `f64`. `cpu` and `graphics` cull whole instances by bounds ([`draws_from_job`]),
//! `compute` culls parts of them. All do the same `f32` operations in the same order, so the maps agree to
//! the pixel.
//!
//! ```
//! use point_skeleton::raster::{Instance, MapSet, RasterizerKind, SplatJob, SplatSchedule, create};
//! # use point_skeleton::{cloud::Point, geometry::{Camera, View}};
//! # let camera = Camera::new("front", 8, 6, [[4.0, 0.0, 4.0], [0.0, 4.0, 3.0], [0.0, 0.0, 1.0]])?;
//! # let (view, pose) = (View { camera, camera_from_world: Default::default() }, Default::default());
//! let points = [Point::new([0.0, 0.0, 5.0], [255, 0, 0], 1)]; // meters, RGB, class
//! let mut rasterizer = create(&RasterizerKind::Cpu.into(), vec![(&points).into()])?;
//! let instances = [Instance { cloud: 0, world_from_local: pose, number: 0 }];
//! let schedule = SplatSchedule::default();
//! let (schedule, instances, maps) = (&schedule, &instances, MapSet::SPLATTED);
//! let job = SplatJob { view: &view, schedule, instances, crop: None, maps };
//! let maps = rasterizer.splat(&job)?;
//! # assert_eq!(maps.depth_m.iter().filter(|z| **z == 5.0).count(), 25);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod budget;
mod chunk;
mod compute;
mod cpu;
mod cull;
mod draw;
mod frame;
mod frames;
mod graphics;
mod kind;
mod layers;
mod lines;
mod maps;
pub mod reference;
mod residency;
mod schedule;
mod sight;
mod steps;
pub mod tiles;

pub(crate) use budget::{frame_bytes, need_of_views};
pub use compute::{ComputeRasterizer, ComputeRasterizerDesc};
pub use cpu::{CpuRasterizer, CpuRasterizerDesc};
pub use draw::{Crop, Draw, Instance, SplatJob, draws_from_job};
pub use frame::{FrameJob, FrameMaps, Occlusion, ViewMaps, class_of, rgb_of};
pub use graphics::{GraphicsRasterizer, GraphicsRasterizerDesc};
pub use kind::{RasterizerDesc, RasterizerKind, create};
pub(crate) use lines::LineRows;
pub use lines::draw_lines;
pub use maps::map_set::{MapDescription, MapKind, MapSet, PixelType};
pub use maps::plane::Plane;
pub use maps::reduce;
pub use maps::{Segment, SplatMaps, StageTimes};
pub use residency::DEFAULT_MEMORY_BYTES;
pub(crate) use schedule::DEFAULT_STEPS;
pub use schedule::{ScheduleError, SplatSchedule, SplatStep};

use crate::cloud::Cloud;
use crate::error::FileError;

/// All clouds of a rasterizer, in the order of their ids.
pub type CloudSet<'a> = Vec<Cloud<'a>>;

/// Rendering error.
#[derive(Debug, thiserror::Error)]
pub enum RasterError {
    /// Error of the device or driver.
    #[error(transparent)]
    Gpu(#[from] crate::gpu::GpuError),
    /// More memory is needed than available.
    #[error(transparent)]
    Memory(#[from] crate::memory::MemoryError),
    /// Points cannot be read or are damaged.
    #[error(transparent)]
    Points(#[from] FileError),
    /// More points than a 32-bit index can address.
    #[error("expected at most {max} points in one job, found {found}")]
    TooManyPoints {
        /// Number of points in the job.
        found: u64,
        /// 2³² − 2.
        max: u64,
    },
    /// What a single frame shows does not fit into the memory budget for points.
    #[error(
        "the cameras of a frame may see points of {} MiB, but {} MiB are allowed ({option}): allow more, or \
            render less far or fewer cameras",
        needed_bytes.div_ceil(1 << 20), allowed_bytes >> 20
    )]
    PointBudget {
        /// Bytes for the points of the frame.
        needed_bytes: u64,
        /// Budget, bytes.
        allowed_bytes: u64,
        /// Option of the command that sets it.
        option: &'static str,
    },
    /// A row of an image does not fit into any buffer of the device.
    #[error("image width {width} exceeds the device's buffer limit")]
    TooWide {
        /// Width, pixels.
        width: u32,
    },
    /// [`Rasterizer::begin`] was called too often without [`Rasterizer::finish`].
    #[error("expected at most {max} frames in flight, found one more")]
    TooManyFrames {
        /// [`FRAMES_IN_FLIGHT`].
        max: usize,
    },
    /// [`Rasterizer::finish`] was called without [`Rasterizer::begin`].
    #[error("expected a frame in flight, found none")]
    NoFrame,
    /// An instance names a cloud that was never uploaded.
    #[error("expected a cloud id below {clouds}, found {cloud}")]
    UnknownCloud {
        /// Cloud id.
        cloud: usize,
        /// Number of uploaded clouds.
        clouds: usize,
    },
}

/// Rasterizer, device and driver, for reports.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RasterizerInfo {
    /// `compute`, `graphics` or `cpu`.
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

/// Maximum number of frames begun and not yet finished.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// Renders resident clouds as splats.
pub trait Rasterizer: Send {
    /// Returns the rasterizer, device and driver.
    fn info(&self) -> RasterizerInfo;

    /// Begins a frame: all views of the job. The device may work on it until [`Rasterizer::finish`] waits for
    /// it.
    ///
    /// # Errors
    /// Fails on any device error, for an unknown cloud, for more than 2³² − 2 points, and for more than
    /// [`FRAMES_IN_FLIGHT`] frames.
    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError>;

    /// Waits for the oldest frame in flight. Its maps borrow the rasterizer until its next call.
    ///
    /// # Errors
    /// Fails on any device error, or if no frame is in flight.
    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError>;

    /// Renders a view at its full size by the splat rule. Maps that were not requested are empty.
    ///
    /// # Errors
    /// Fails on any device error, for an unknown cloud, and for more than 2³² − 2 points.
    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError>;

    /// Returns the stage times since they were last taken; callers may add to them.
    fn stages(&mut self) -> &mut StageTimes;

    /// Returns the stage times summed since the last call, and resets them.
    fn take_stages(&mut self) -> StageTimes {
        std::mem::take(self.stages())
    }
}
