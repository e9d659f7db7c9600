//! Poses, cameras and boxes. Global coordinates are `f64`.
//!
//! Frames: `ego` is x forward, y left, z up; `camera` is x right, y down, z forward; `global` is the map
//! frame. Its coordinates reach 4·10⁶ m, so an origin is subtracted before a global position becomes `f32`.
//! Transforms are named target first: `camera_from_ego`.

mod camera;
mod cuboid;
mod extent;
mod footprint;
mod lens;
mod polyline;
mod pose;
mod size;

pub use camera::{Camera, CameraError, View};
pub use cuboid::{Cuboid, CuboidError};
pub use extent::{MAX_COORDINATE_M, MAX_SIDE_M, MIN_SIDE_M, is_position, is_size};
pub use footprint::Footprint;
pub use lens::{BrownConradyLens, CameraProjection, Distortion, FTheta, Lens, LensModel, Mei};
pub use polyline::{LineProjection, Polyline, wrap_angle};
pub use pose::{Pose, PoseError};
pub use size::{ImageSize, ParseOptionError};
