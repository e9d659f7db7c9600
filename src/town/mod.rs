//! The town that is built in: a drive that needs no files, with true images, exact boxes and an HD map.
//!
//! # How it works
//! [`plan`] draws streets and lanes and lets traffic move, [`built`] and [`model`] give everything its triangles
//! ([`mesh`]). Everything follows from a seed. `lidar` casts beams among the triangles, and [`Town`] is the drive as a
//! [`Dataset`](crate::dataset::Dataset).
//!
//! `street` is a smaller one of convex solids, filmed by casting rays: [`Street`] is a
//! [`Dataset`](crate::dataset::Dataset) like any recorded one.
//!
//! `cloud` is another street, a bare cloud with cameras in it: what speed is measured on.

pub mod built;
mod cloud;
mod drive;
mod film;
mod hash;
mod lidar;
mod material;
pub mod mesh;
pub mod model;
mod model_surface;
mod models;
mod options;
pub mod plan;
mod scenery;
mod shape;
mod street;
pub mod view;
mod world;

pub use cloud::{street_cloud, street_views};
pub use drive::{Town, TownError, TrueActor};
pub use model_surface::{Model, SurfacePoint};
pub use options::{Daylight, TownOptions, TownOptionsError};
pub use street::{Street, StreetOptions};
