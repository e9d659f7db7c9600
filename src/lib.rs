//! Converts driving recordings to camera conditions.
//!
//! A recording (LiDAR sweeps, camera images, calibration, ego poses, tracked boxes) is accumulated once into a point
//! *skeleton*: the static background in the global frame and one point asset per tracked actor. For any frame or any
//! other ego pose, the skeleton is splatted with depth tests into the cameras. Each camera yields a color map, a
//! metric depth map, a class mask, an instance mask and a box layout.
//!
//! Data flows one way: [`dataset`] → [`skeleton`] → [`scene`] → [`raster`] → [`conditions`]. See
//! `docs/ARCHITECTURE.md` for the module overview and `docs/CONDITIONS.md` for the map definitions.

pub mod cloud;
pub mod conditions;
pub mod dataset;
pub mod error;
pub mod files;
pub mod geometry;
pub mod gpu;
pub mod hash;
pub mod raster;
pub mod scene;
pub mod skeleton;
