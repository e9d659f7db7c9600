//! LiDAR sweeps from a skeleton: ranges along the beams of a device at any pose and time.
//!
//! # How it works
//! Points have gaps that rays would pass through. So each cloud is divided into pieces of planes (`split`):
//! as large as the points are on a plane, and as fine as they are dense. A piece has a mask of where its
//! points are, whose gaps are closed (`mask`). The pieces of a cloud are in a tree (`solid`, `tree`), and so
//! are the clouds of a scene (`bodies`). A [`LidarSpec`] describes the devices: a preset, or a JSON file. The
//! rays of a few columns fire at once, from where the device is at that time, at the actors where they are
//! then (`motion`, `cast`). They are near a half-plane, and descend a tree together (`fan`, `search`): eight
//! boxes are compared with all rays at a time, and eight rays with a piece (`lanes`). Gaps that are narrower
//! than two rays are closed in the range image (`image`, `gaps`). All of this is on the host, so sweeps are
//! the same bytes with any rasterizer and any number of threads.
//!
//! # What was rejected
//! Images of point numbers by the rasterizers, and planes through the visible points around each ray: rays
//! passed between the points of near cars, and fitting planes for each ray took several times as long. Depth
//! maps: a pixel of the road 30 m ahead is half a meter long. Splats as large as the gaps: objects grow.

mod bodies;
mod cast;
mod error;
mod fan;
mod gaps;
mod image;
mod lanes;
mod mask;
mod motion;
mod patch;
mod plane;
mod presets;
mod rays;
mod render;
mod search;
mod solid;
mod solids;
mod spec;
mod split;
mod sweep;
mod tree;
mod write;

pub use error::LidarError;
pub use motion::Motion;
pub use presets::Preset;
pub use rays::{LidarHit, LidarRays};
pub(crate) use render::{Scene, render};
pub use solids::SolidError;
pub(crate) use solids::Solids;
pub use spec::{LidarDevice, LidarSpec, MAX_ELEVATION_DEG, MAX_RAYS, Mount};
pub use sweep::{LidarReturn, LidarSweep, RangeImage};
pub use write::{LidarFormat, LidarNumber};
