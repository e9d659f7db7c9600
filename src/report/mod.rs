//! What a person looks at after a rollout.

mod video;

pub use video::{MAX_SIDE_PX, Video, VideoError};
