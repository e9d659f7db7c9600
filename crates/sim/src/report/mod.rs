//! Reports of a rollout: a line of `states.jsonl` per step, a video, and a web page that plays it.
//!
//! # How it works
//! All reports are created from the files in the folders of the steps and from the lines of `states.jsonl`. A
//! rollout that was interrupted and resumed therefore gives the same bytes as an uninterrupted one. [`sight`]
//! determines which actors are visible, [`view`] writes the images of a step, [`film`] composes them into frames of
//! the [`video`](Video), and [`page`] writes the HTML page.

pub mod film;
pub mod images;
pub mod page;
mod row;
pub mod sight;
mod video;
pub mod view;

/// File that marks a folder as a rollout, and records its source and options.
pub const ROLLOUT: &str = "rollout.json";
/// File with a line per step in the folder of a rollout, see [`StateFile`].
pub const STATES: &str = "states.jsonl";
/// Folder of the steps in the folder of a rollout; each has a folder with its name, see [`StepRow::name`].
pub const STEPS: &str = "steps";

pub use row::{ActorRow, EgoRow, LightRow, Phase, StateFile, StepObservations, StepRow};
pub use video::{MAX_SIDE_PX, Video, VideoError};
