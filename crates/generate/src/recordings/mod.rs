//! Copies of data sets with generated images.

pub(super) mod dataset_copy;
