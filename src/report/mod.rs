//! What a rollout leaves for people and programs: a line of `states.jsonl` per step, a video, and a page that plays it.
//!
//! # How it works
//! Everything is made of files that lie in the folders of the steps and of the lines of `states.jsonl`, so a rollout that
//! was interrupted and resumed gives the same bytes as one that ran through. [`sight`] tells who is seen, [`view`]
//! writes the pictures of a step, [`film`] puts them together for the [`video`](Video), and [`page`] is the HTML around
//! them.

pub mod film;
pub mod images;
pub mod page;
pub mod plot;
mod row;
pub mod sight;
mod video;
pub mod view;

/// The file that tells that a folder is a rollout, of what and with what options.
pub const ROLLOUT: &str = "rollout.json";

pub use row::{ActorRow, EgoRow, LightRow, Observed, Phase, StateFile, StepRow};
pub use video::{MAX_SIDE_PX, Video, VideoError};
