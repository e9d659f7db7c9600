//! Training recordings, and copies of data sets with generated images.

pub(super) mod dataset_copy;
pub(super) mod drive;
pub(super) mod drive_file;
