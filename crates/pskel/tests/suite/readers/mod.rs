//! Logs read by the command and the library.

pub(super) mod av2;
pub(super) mod nuplan;
pub(super) mod nuscenes_bad;
pub(super) mod nuscenes_map;
