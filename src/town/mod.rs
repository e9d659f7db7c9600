//! The built-in street: a small drive that needs no files, with true images and exact boxes.
//!
//! # How it works
//! `street` sets up the scene: houses, trees, parked and moving actors, and the drive through it. `world` finds what a ray
//! meets, `material` what it looks like there, `film` turns rays into images and LiDAR sweeps. [`Street`] is a
//! [`Dataset`](crate::dataset::Dataset) like any recorded one. Everything follows from a seed.
//!
//! `cloud` is another street, a bare cloud with cameras in it: what speed is measured on.

mod cloud;
mod film;
mod hash;
mod material;
mod model_surface;
mod models;
mod scenery;
mod shape;
mod street;
mod world;

pub use cloud::{street_cloud, street_views};
pub use model_surface::{Model, SurfacePoint};
pub use street::{Street, StreetOptions};
