//! LiDAR sweeps from a skeleton: ranges along the beams of a device at any pose and time.
//!
//! # How it works
//! A [`LidarSpec`] describes the devices: a preset, or a JSON file. A sweep is divided into sectors
//! (`sectors`), which the rasterizer renders as pinhole images of point numbers, one pixel per point, from
//! where the device is in the middle of the sector, with the actors where they are then (`motion`). The host
//! looks up the positions of the visible points (`points`, `image`) and casts each ray, from where the device
//! is at the time of its column, against planes through the points around it (`cast`, `surface`). Maps of
//! point numbers are equal on all rasterizers, and rays do not depend on each other, so sweeps are the same
//! bytes everywhere.
//!
//! # What was rejected
//! Depth maps in place of point numbers: a pixel of the road 30 m ahead is half a meter long, so the depth of
//! its point is not that of its middle. Splats larger than a pixel: they make objects larger, and hide what
//! is beside them.

mod cast;
mod error;
mod image;
mod motion;
mod points;
mod presets;
mod render;
mod sectors;
mod spec;
mod surface;
mod sweep;
mod write;

pub use error::LidarError;
pub use motion::Motion;
pub(crate) use points::PointPages;
pub use presets::Preset;
pub(crate) use render::{Scene, render};
pub use spec::{LidarDevice, LidarSpec, MAX_ELEVATION_DEG, MAX_RAYS, Mount};
pub use sweep::{LidarReturn, LidarSweep, RangeImage};
pub use write::LidarFormat;
