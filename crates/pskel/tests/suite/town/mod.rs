//! The synthetic town: its log, its data set, its images.

pub(super) mod cli;
pub(super) mod log;
pub(super) mod synthetic_town;
pub(super) mod town_view;
