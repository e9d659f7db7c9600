//! Paths in space and time: recorded, planned and read from files.

pub(super) mod fit;
pub(super) mod local_path;
pub(super) mod pose_path;
pub(super) mod route;
pub(super) mod trajectory;
pub(super) mod trajectory_file;
