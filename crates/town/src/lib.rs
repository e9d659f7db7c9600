//! Synthetic town: a procedural driving log that needs no files, with ground-truth images, exact boxes and an
//! HD map.
//!
//! # How it works
//! [`TownOptions`] select a town. Everything derives from its seed, by `hash` or by a seeded generator,
//! independent of order and number of threads. Plans use the town's frame: meters, flat, roads at z = 0.
//! 1. [`plan`] generates streets and lanes and simulates traffic on them; the result is the pose of every
//!    actor over time.
//! 2. [`built`] places houses, plants and markings along the streets; [`model`] generates the actors' bodies.
//!    Both produce triangles with a skin ([`mesh`]).
//! 3. `lidar` casts beams against the triangles; [`view`] renders them, with ground-truth depth, class and
//!    instance of each pixel.
//! 4. [`Town`] (`drive`) exposes the result as a [`LogReader`](point_skeleton::dataset::LogReader). It
//!    generates sweeps and images when they are read, and renders ground truth for any camera pose.
//!

pub mod built;
mod drive;
mod lidar;
pub mod mesh;
pub mod model;
mod options;
pub mod plan;
mod templates;
pub mod view;

pub use drive::{FORMAT, Town, TownError, TownRay, WriteError};
pub use lidar::TownHit;
pub use options::{Daylight, TownOptions, TownOptionsError};
pub use templates::templates;
