//! The town that is built in: a drive that needs no files, with true images, exact boxes and an HD map.
//!
//! # How it works
//! [`TownOptions`] say which town; everything follows from its seed by `hash`, whatever the order and the number of
//! threads. Plans are in the town's own frame: metres, flat, roads on z = 0.
//! 1. [`plan`] draws streets and lanes and lets traffic move along them: who is where at what time.
//! 2. [`built`] puts houses, plants and markings along the streets, [`model`] gives everybody a body. Both end as
//!    triangles with a skin ([`mesh`]).
//! 3. `lidar` casts beams among the triangles; [`view`] draws them, with true depth, class and instance of each pixel.
//! 4. [`Town`] (`drive`) records it: a [`Dataset`](crate::dataset::Dataset) like any other, whose sweeps and images are
//!    made when they are read, and which can be asked for what is true from anywhere.
//!
//! `cloud` stands apart: the bare cloud of points, with cameras in it, that speed is measured on.

pub mod built;
mod cloud;
mod drive;
mod hash;
mod lidar;
pub mod mesh;
pub mod model;
mod options;
pub mod plan;
pub mod view;

pub use cloud::{street_cloud, street_views};
pub use drive::{Town, TownError, TrueActor};
pub use options::{Daylight, TownOptions, TownOptionsError};
