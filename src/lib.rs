//! Converts driving recordings to camera conditions.
//!
//! A recording (LiDAR sweeps, camera images, calibration, ego poses, tracked boxes) is accumulated once into
//! a point *skeleton*: the static background in the global frame and one point asset per tracked actor. For
//! any frame or any other ego pose, the skeleton is splatted with depth tests into the cameras. Each camera
//! yields a color map, a metric depth map, a class mask, an instance mask and layouts of boxes and HD map.
//!
//! ```no_run
//! use point_skeleton::{EgoOffset, Error, Log, RenderOptions, Renderer, Skeleton};
//!
//! fn main() -> Result<(), Error> {
//!     let log = Log::open("/data/nuscenes#scene-0061")?;
//!     let skeleton = Skeleton::build(&log, "out/skeleton", &Default::default())?;
//!     let mut renderer = Renderer::new(&skeleton, RenderOptions::default())?;
//!     let offset = EgoOffset { left_m: 2.0, yaw_deg: 5.0, ..Default::default() };
//!     for frame in log.frames() {
//!         let maps = renderer.render(&frame.moved(offset))?;
//!         maps.write(format!("out/maps/{}", frame.name))?;
//!     }
//!     Ok(())
//! }
//! ```
//!
//! Data flows one way: [`dataset`] → [`skeleton`] → [`scene`] → [`raster`] → [`conditions`]. To splat your
//! own points, see [`raster`] and `examples/splat_cloud.rs`. `docs/src/internals/architecture.md` has an
//! overview of the modules, `docs/src/reference/maps.md` the map definitions.
//!
//! # Features
//! All features are on by default.
//!
//! | feature | adds |
//! |---|---|
//! | `nuscenes` | reader of the nuScenes layout |
//! | `nuplan` | reader of nuPlan logs (SQLite) |
//! | `av2` | reader of Argoverse 2 sensor logs (Feather) |
//! | `123d` | reader of logs of py123d (Arrow), with `nuscenes` and `av2` for the files that they may name |
//! | `exr` | maps as OpenEXR files |

pub mod cloud;
pub mod conditions;
pub mod dataset;
pub mod error;
pub mod files;
pub mod geometry;
pub mod gpu;
pub mod hash;
pub mod idm;
pub mod lidar;
pub mod memory;
pub mod named;
pub mod pipeline;
pub mod raster;
pub mod scene;
pub mod sequence;
pub mod skeleton;
pub mod threads;

mod bits;
mod log;
mod maps;
mod renderer;
mod vectors;

pub use conditions::{CameraConditions, ConditionOptions, ImageSize, MapFormat, MapKind, MapSet};
pub use log::Log;
pub use maps::Maps;
pub use raster::{RasterizerKind, SplatSchedule};
pub use renderer::{MapOptions, RenderOptions, Renderer};
pub use scene::{EgoOffset, SceneState};
pub use skeleton::{BuildOptions, Skeleton};

/// Error of opening a log, or of building or rendering a skeleton.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Error of reading a log.
    #[error("{0}")]
    Log(#[from] dataset::DatasetError),
    /// Error of building a skeleton.
    #[error("{0}")]
    Build(#[from] skeleton::BuildError),
    /// Error of rendering or writing maps.
    #[error("{0}")]
    Render(#[from] conditions::ConditionError),
    /// Error of the rasterizer.
    #[error("{0}")]
    Raster(#[from] raster::RasterError),
    /// Error of a file.
    #[error("{0}")]
    File(#[from] error::FileError),
    /// Error of a LiDAR sweep.
    #[error("{0}")]
    Lidar(#[from] lidar::LidarError),
    /// Invalid times of a sequence.
    #[error("{0}")]
    Sequence(#[from] scene::SequenceError),
    /// A thread could not be started.
    #[error("{0}")]
    Threads(#[from] threads::ThreadError),
    /// A step of a sequence failed.
    #[error("step {name}")]
    Step {
        /// Name of the step.
        name: String,
        /// Cause.
        source: Box<Error>,
    },
}

impl Error {
    /// Returns a closure for `map_err` that adds the name of a step.
    fn step(name: &str) -> impl FnOnce(Self) -> Self {
        |source| Self::Step { name: name.to_owned(), source: Box::new(source) }
    }
}

/// Compiles the Rust blocks of `README.md`.
#[doc = include_str!("../README.md")]
#[cfg(doctest)]
pub struct ReadmeDoctests;
