//! MCAP files with the message schemas of Foxglove, for Foxglove, Lichtblick and Rerun.
//!
//! A [`SceneFile`] has the topics `/camera/CAM/..` of each camera, `/tf`, `/actors` and `/log`, and those
//! that its writer adds. All messages of an instant have its time. The frame `map` has the axes of the global
//! frame and its origin at the ego's position in the first frame of the log, since viewers draw in single
//! precision. The metadata record `log` states the origin.

mod file;
mod messages;
mod scene_file;

pub use foxglove::messages::Timestamp;
pub use foxglove::messages::log::Level;
pub use scene_file::{SceneFile, camera_topic};
