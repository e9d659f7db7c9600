//! Vehicles in images: their masks, and the classifier that finds them.

pub(super) mod masks;
pub(super) mod patch_classifier;
pub(super) mod pseudo_label;
