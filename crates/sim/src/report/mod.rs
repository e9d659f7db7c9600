//! Reports of a rollout: a line of `states.jsonl` per step, a video, and a web page that plays it.
//!
//! # How it works
//! All reports are created from the files in the folders of the steps and from the lines of `states.jsonl`. A
//! rollout that was interrupted and resumed therefore gives the same bytes as an uninterrupted one.
//! [`visibility`] determines which actors are visible, [`view`] writes the images of a step, [`page`] writes
//! the HTML page, and, with the feature `video`, `video_frame` composes images into frames of the `video`.

pub mod images;
pub mod page;
mod row;
#[cfg(feature = "video")]
mod video;
#[cfg(feature = "video")]
pub mod video_frame;
#[cfg(feature = "video")]
mod video_frames;
pub mod view;
pub mod visibility;

/// File that marks a folder as a rollout, and records its source and options.
pub const ROLLOUT: &str = "rollout.json";
/// File with a line per step in the folder of a rollout, see [`StateFile`].
pub const STATES: &str = "states.jsonl";
/// Folder of the steps in the folder of a rollout; each has a folder with its name, see [`StepRow::name`].
pub const STEPS: &str = "steps";
/// File name of the bird's-eye view in the folder of a step.
pub const BIRDSEYE: &str = "birdseye.png";

pub use page::{BASE_CSS, PLOTS_JS};
pub use row::{ActorRow, EgoRow, LightRow, Phase, StateFile, StepObservations, StepRow};
#[cfg(feature = "video")]
pub use video::{MAX_SIDE_PX, Video, VideoError};
#[cfg(feature = "video")]
pub use video_frames::VideoFrames;
